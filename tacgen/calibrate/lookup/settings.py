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
    ridge : float
        Strength of the penalty on rough terms, relative to the mean of the normal matrix.
    """

    degree: int = 7
    ridge: float = 1e-4


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
class BinSettings:
    """How fine the bins are and how firmly they are held to the smooth model.

    Attributes
    ----------
    n_slope, n_direction : int
        0 for no bins: the smooth model alone.
    held_presses : float
        The ridge, in presses: a bin that as many presses reach goes half of the way.
    """

    n_slope: int = 0
    n_direction: int = 0
    held_presses: float = 0.0

    def __str__(self) -> str:
        if not self.n_slope:
            return "smooth model alone"
        return f"{self.n_slope}×{self.n_direction} bins, held by {self.held_presses:g} presses"


@dataclass(frozen=True, slots=True)
class LookupRules:
    """Numbers that steer the fit of a table and that a study may vary.

    Attributes
    ----------
    reach_radii : float
        Pixels up to this many label radii from the centre are fitted: the gel beside the contact
        shows where its rim is.
    rim_weight : float
        Weight of pixels outside the labelled circle, which the error is not measured on.
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
    degrees, ridges : tuple
        Candidates for the smooth model.
    backgrounds : tuple of BackgroundRecipe
        Candidates, from what needs no evidence to what needs most: the first is the reference
        image itself.
    bin_counts, bin_held_presses : tuple
        Candidates for bins of (slope, direction) and for how firmly they are held.
    n_folds : int
        Folds of whole presses that candidates are compared on and the table is scored on.
    clear_sigmas, clear_share : float
        A disagreement in scale or radius is reported where it exceeds this many standard errors
        and this share.
    """

    reach_radii: float = 1.5
    rim_weight: float = 0.05
    pixels_per_press: int = 2000
    pixels_to_place: int = 600
    pixels_to_choose: int = 700
    pixels_for_ratio: int = 300
    first_radius_share: float = 0.85
    noise_grey: float = 6.0
    correlated_pixels: float = 20.0
    drift_noise_grey: float = 0.5
    center_scatter_radii: float = 0.15
    radius_scatter_radii: float = 0.10
    seen_scatter_radii: float = 0.07
    degrees: tuple[int, ...] = (3, 5, 7)
    ridges: tuple[float, ...] = (1e-4, 1e-3, 1e-2, 1e-1)
    backgrounds: tuple[BackgroundRecipe, ...] = (
        BackgroundRecipe(),
        BackgroundRecipe(drift=True),
        BackgroundRecipe(smooth=0.02),
        BackgroundRecipe(smooth=0.02, drift=True),
        BackgroundRecipe(smooth=0.05),
        SMOOTH_WITH_DRIFT,
    )
    bin_counts: tuple[tuple[int, int], ...] = ((6, 12), (12, 24), (24, 48))
    bin_held_presses: tuple[float, ...] = (1.0, 4.0, 16.0)
    n_folds: int = 5
    clear_sigmas: float = 3.0
    clear_share: float = 0.02

    @property
    def bins(self) -> tuple[BinSettings, ...]:
        """All candidates for bins; the first is none."""
        found = (BinSettings(*n, held) for n in self.bin_counts for held in self.bin_held_presses)
        return (BinSettings(), *found)
