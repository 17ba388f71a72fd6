"""What can be set in the fit of a lookup table: candidates, priors and the rules of the choice."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FitSettings:
    """The smooth model that cross-validation chooses."""

    degree: int = 5  # of the polynomial in the surface normal
    position_degree: int = 4  # of the polynomial in image position
    ridge: float = 1e-4  # penalty on rough terms, relative to the mean of the squared features
    bend: float = 0.0  # sine of the slope at which light saturates, 0: it does not

    def __str__(self) -> str:
        bent = f" bent at {self.bend:g}" if self.bend else ""
        return (
            f"degree {self.degree} in the normal{bent} and {self.position_degree} in position, "
            f"ridge {self.ridge:g}"
        )


@dataclass(frozen=True, slots=True)
class BackgroundRecipe:
    """How a background is made.

    The reference is smoothed by a Gaussian, ``smooth`` wide as a share of the image's width. With
    ``drift`` the median change of the bare gel over the presses is added: lamps and camera drift
    between the reference and the presses.
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
    """Numbers that steer the fit of a table; ``RULES`` is what it uses.

    *Radii* are those of the labelled contact circle.
    """

    # The contact, its rim and the gel beside it: the contact is what a table is for, the gel
    # beside it is most of the pixels.
    ring_radii: tuple[float, float, float] = (1.0, 1.5, 2.5)  # outer ones
    ring_weights: tuple[float, float, float] = (1.0, 0.25, 0.1)  # of a pixel in the fit
    ring_pixels: tuple[float, float, float] = (0.5, 0.25, 0.25)  # share of those looked at

    # Most pixels of a press, an even lattice of them: neighbours say the same, time grows with them
    pixels_per_press: int = 2000  # that the table is fitted to
    pixels_to_place: int = 700  # that a press is placed by
    pixels_to_choose: int = 700  # that settings are compared on
    pixels_for_ratio: int = 300  # that a ball's size is judged by

    first_radius_share: float = 0.85  # of the labelled contact radius, where the fit starts:
    # people circle the dark rim around the contact; or at the circle that is seen if it is smaller
    noise_grey: float = 6.0  # standard deviation of a pixel's residual
    correlated_pixels: float = 20.0  # that count as one: JPEG blocks and texture go together
    drift_noise_grey: float = 0.5  # to which bare gel tells the drift of a whole picture
    center_scatter_radii: float = 0.15  # standard deviation of a label's centre
    radius_scatter_radii: float = 0.10  # and of its radius
    seen_scatter_radii: float = 0.07  # of the centre of a circle that is seen in the picture: what
    # remains of its distance from 37 real labels (1.6 px of 17) beside the labels' own scatter

    # Candidates of the choice
    degrees: tuple[int, ...] = (3, 5)
    position_degrees: tuple[int, ...] = (1, 2, 4)
    bends: tuple[float, ...] = (0.0, 0.25)
    ridges: tuple[float, ...] = (1e-7, 1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 1e-3, 1e-2)
    backgrounds: tuple[BackgroundRecipe, ...] = (  # from what needs no evidence to what needs most
        BackgroundRecipe(),
        BackgroundRecipe(drift=True),
        BackgroundRecipe(smooth=0.02),
        BackgroundRecipe(smooth=0.02, drift=True),
        BackgroundRecipe(smooth=0.05),
        SMOOTH_WITH_DRIFT,
    )
    n_folds: int = 5  # of whole presses, to choose and to score

    # A disagreement in scale or radius is reported beyond so many standard errors and this share.
    clear_sigmas: float = 3.0
    clear_share: float = 0.02


RULES = LookupRules()
