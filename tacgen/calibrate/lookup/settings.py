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
    structure_grey: float = 1.0  # of held-out error above the camera's noise: worth a diagnosis,
    # which calls as much unexplained
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
    tilt_cost: float = (
        1000.0  # times the ridge, on the contact's terms in nx and ny: what the slope
    )
    # itself explains is the slope's, or a picture read backwards shows contacts too wide
    n_folds: int = 5  # of whole presses, to choose and to score

    # How a press is placed
    rough_settings: FitSettings = FitSettings(degree=4, position_degree=3, ridge=1e-4)  # by a model
    # of at most these degrees and at least this ridge: a stiffer one moves contacts to explain
    # light, a softer one bends to explain contacts out of place
    expected_radius_share: float = 0.95  # of the ball's radius, the largest expected contact: a fit
    # may still go up to ``MAX_RADIUS_SHARE``
    largest_step_radii: float = 0.06  # of a Gauss–Newton step: the model is linear over no more
    membrane_step: float = 2.0  # times a step of the gel's rim: the light, which is fitted anew
    # after each, follows about half of the way back
    largest_shift_radii: float = 0.5  # of a label: presses close together tell none elsewhere
    same_place_scatters: float = 2.0  # labels of one press scatter by less times what labels do
    tilt_ridges: tuple[float, ...] = (0.5, 0.05, 0.005, 0.0005)  # on what a label's shift grows by
    # in 10 mm, in presses 10 mm from the centre

    # The light of the gel at rest and its drift
    block_px: int = 8  # side of the blocks that take turns in estimating and scoring: JPEG's
    bare_beyond_radii: float = 2.2  # from a contact's centre the gel is bare
    min_views: int = 3  # presses that must leave a pixel bare for their median to be used there
    light_smooth_share: float = 0.05  # of the image's width, the Gaussian that leaves the light of
    # the reference: a table's nodes of position stand as far apart
    fine_sigma_px: float = 4.0  # a Gaussian this wide is as good as a wider one on fewer pixels
    coarse_px: int = 160  # width that the drift is estimated on: light drifts smoothly
    carried_over_share: float = 0.05  # of the image's width, the Gaussian that carries the drift to
    # pixels that too few presses leave bare

    # The table's nodes
    n_slope: int = 48  # of its coefficients; with
    n_direction: int = 120  # interpolation adds less than 0.1 grey levels
    response_slopes: int = 32  # of its response to a slope,
    response_directions: int = 64  # its direction,
    response_places: int = 25  # and position along the image's longer side
    images_for_noise: int = 12  # the camera's noise is the same in every image
    beyond_steepest: float = 1.02  # times the steepest slope of the presses, where the table ends

    # Scale and size of the balls
    min_ruler_presses: int = 4  # two places fix a scale and a turn; as many more tell the error
    max_condition: float = 100.0  # of places: spread in one direction ten times as far as across
    min_ratio_presses: int = 3  # of a second ball that its size is judged from
    uneven_light_share: float = 0.005  # of their distances, that light which changes across the
    # picture moves the centres found in it by
    rim_excess: float = 1.05  # the rim that is seen lies outside the contact by up to this factor
    radius_factors: tuple[float, ...] = (0.9, 0.95, 1.0, 1.05, 1.1)  # tried on the stated radius;
    # the best is interpolated
    ratio_settings: FitSettings = FitSettings(degree=4, position_degree=2, ridge=1e-4)  # few terms
    # tell the size of a ball as well and are fitted five times a ball
    bootstraps: int = 200  # draws of presses: the standard error of a ratio to 5 %

    # Pictures of presses that a table renders
    margin_px: int = 3  # the renderer's differences reach so far beyond the pixels that are read
    kept_shaders: int = 6  # a step of a fit goes through a few values of an effect, press by press
    drawn_presses: int = 6  # from that with the smallest error to that with the largest
    drawn_width_px: int = 320  # four fit into a page's width
    drawn_pixels: int = 150  # of a press, in the figure of fit and residual

    # Taxim's files
    max_polycalib_bytes: int = 1 << 26  # one of 125 bins, the most that Taxim uses, has 2 MB
    max_background_bytes: int = 1 << 28

    # What is warned of
    many_presses: int = 30  # spread over the gel: the held-out error hardly falls any more
    contrast_range: tuple[float, float] = (0.8, 1.25)  # of the images over the table's: presses of
    # the table's own sensor stay within it

    # A disagreement in scale or radius is reported beyond so many standard errors and this share.
    clear_sigmas: float = 3.0
    clear_share: float = 0.02


RULES = LookupRules()
