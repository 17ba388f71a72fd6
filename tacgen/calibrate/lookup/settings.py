"""What can be set in the fit of a lookup table: candidates, priors and the rules of the choice."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FitSettings:
    """The smooth model that cross-validation chooses.

    Attributes
    ----------
    degree : int
        Of the polynomial in the surface normal.
    position_degree : int
        Of the polynomial in image position.
    ridge : float
        Strength of the penalty on rough terms, relative to the mean of the squared features.
    """

    degree: int = 5
    position_degree: int = 4
    ridge: float = 1e-4

    def __str__(self) -> str:
        return (
            f"degree {self.degree} in the normal and {self.position_degree} in position, "
            f"ridge {self.ridge:g}"
        )


@dataclass(frozen=True, slots=True)
class BackgroundRecipe:
    """How a background is made.

    Attributes
    ----------
    smooth : float
        Gaussian width, as a share of the image's width, that the reference is smoothed with;
        0 leaves it as it is.
    drift : bool
        Whether the median change of the bare gel over the presses is added (lamps and camera
        drift between the reference and the presses).
    """

    smooth: float = 0.0
    drift: bool = False

    def __str__(self) -> str:
        smooth = f"smoothed {self.smooth:g}" if self.smooth else "as it is"
        return f"background {smooth}{' with drift' if self.drift else ''}"


SMOOTH_WITH_DRIFT = BackgroundRecipe(smooth=0.05, drift=True)
"""What the presses are first placed on; smooth, so that the choice among backgrounds is open."""


@dataclass(frozen=True, slots=True)
class LookupRules:
    """Numbers that steer the fit of a table and that a study may vary.

    Attributes
    ----------
    ring_radii : tuple of float
        Outer radii, in label radii, of the rings that are fitted and scored: the contact, its rim
        and the gel beside it.
    ring_weights : tuple of float
        Weight of a pixel of each ring: the contact is what a table is for, the gel beside it is
        most of the pixels.
    ring_pixels : tuple of float
        Share of the pixels that are looked at in each ring.
    pixels_per_press, pixels_to_place, pixels_to_choose, pixels_for_ratio : int
        Most pixels of a press, an even lattice of them, that the table is fitted to, that a
        press is placed by, that settings are compared on and that a ball's size is judged by:
        neighbouring pixels say the same, and the time grows with their number.
    first_radius_share : float
        Where the contact radius starts, as a share of the labelled one: people circle the dark
        rim around the contact.
    noise_grey : float
        Standard deviation of a pixel's residual, grey levels.
    correlated_pixels : float
        Residuals of neighbouring pixels go together (JPEG blocks, texture): so many count as one.
    drift_noise_grey : float
        How well the drift of a whole picture is known from its bare gel, grey levels.
    center_scatter_radii, radius_scatter_radii : float
        Standard deviations of a label's centre and radius, in label radii.
    seen_scatter_radii : float
        Standard deviation, in radii, of the centre of a circle that is seen in the picture: what
        remains of its distance from 37 real labels (1.6 px of 17) beside the labels' own scatter.
    degrees, position_degrees, ridges : tuple
        Candidates for the smooth model.
    backgrounds : tuple of BackgroundRecipe
        Candidates, from what needs no evidence to what needs most: the first is the reference
        image itself.
    n_folds : int
        Folds of whole presses that candidates are compared on and the table is scored on.
    clear_sigmas, clear_share : float
        A disagreement in scale or radius is reported where it exceeds this many standard errors
        and this share.
    """

    ring_radii: tuple[float, float, float] = (1.0, 1.5, 2.5)
    ring_weights: tuple[float, float, float] = (1.0, 0.25, 0.1)
    ring_pixels: tuple[float, float, float] = (0.5, 0.25, 0.25)
    pixels_per_press: int = 2000
    pixels_to_place: int = 700
    pixels_to_choose: int = 700
    pixels_for_ratio: int = 300
    first_radius_share: float = 0.85
    noise_grey: float = 6.0
    correlated_pixels: float = 20.0
    drift_noise_grey: float = 0.5
    center_scatter_radii: float = 0.15
    radius_scatter_radii: float = 0.10
    seen_scatter_radii: float = 0.07
    degrees: tuple[int, ...] = (3, 5)
    position_degrees: tuple[int, ...] = (1, 2, 4)
    ridges: tuple[float, ...] = (1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 1e-3, 1e-2)
    backgrounds: tuple[BackgroundRecipe, ...] = (
        BackgroundRecipe(),
        BackgroundRecipe(drift=True),
        BackgroundRecipe(smooth=0.02),
        BackgroundRecipe(smooth=0.02, drift=True),
        BackgroundRecipe(smooth=0.05),
        SMOOTH_WITH_DRIFT,
    )
    n_folds: int = 5
    clear_sigmas: float = 3.0
    clear_share: float = 0.02
