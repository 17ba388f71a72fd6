"""Every threshold and every number of steps of the diagnosis of images, in one record."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SelectionRules:
    """What decides which effects ball presses show, and how finely that is computed.

    The values were set on the presses of ``validation/optics/trust_optics.py`` (two sensors, each
    effect at half, once and twice its usual strength, and none), and on Taxim's 37 real presses
    where it says so. Each field's reason follows it.
    """

    # Which presses and pixels are looked at.
    min_presses: int = 8
    """Two test presses, and six to fit: fewer have no four folds of different depths."""
    test_every: int = 4
    """Every fourth press is kept from fitting and choosing: a quarter, spread over the session."""
    reach_radii: float = 1.6
    """Pixels up to here from a centre: shadows and blur show outside the contact too."""
    pixels_per_press: int = 350
    """On an even lattice: twice as many change no name and no error by 1 %, and cost twice."""
    max_label_balls: float = 1.5
    """A labelled radius beyond this share of the ball's is cut to it: no contact is so wide."""
    background_smoothing: float = 0.03
    """Gaussian on the background, in image widths: its noise is no effect to find."""

    # The model without any effect.
    table_degree: int = 6
    """Of the polynomial in the surface normal; as in ``tacgen calibrate lookup``."""
    place_degree: int = 2
    """Terms up to this degree may change with the place: lamps close by turn and dim their
    light, which is of low degree."""
    place_complexity: float = 15.0
    """Parameters of each such term: five places in each of three channels."""
    table_ridge: float = 1e-4
    """Relative to the mean of the normal matrix: it holds only slopes that no press has."""
    first_skirt_radii: float = 0.4
    """Length of the gel's exponential tail that a fit begins at, in contact radii."""
    joint_sharpness: float = 20.0
    """Power that joins ball and tail: a kink, rounded over a twentieth of a radius."""
    table_margin: float = 1.02
    """The written table goes this far beyond the steepest slope of any press."""

    # The grid of radial profiles of the gel.
    profile_step_radii: float = 0.03
    """A pixel of a contact 30 pixels wide; finer changes no error by 1 %."""
    profile_reach_radii: float = 3.0
    """Beyond the pixels that are looked at and the widest blur."""
    profile_contacts: int = 6
    """Contact radii between which profiles are interpolated."""
    smallest_contact: float = 0.5
    largest_contact: float = 1.6
    """Of these, over the smallest and the largest label: as far as a scale may move them."""
    relief_points: int = 151
    """Of the profile that a height map around a ball is drawn by: finer than those steps."""
    least_contact: float = 0.1
    """Share of its label that a contact's radius never falls below: a fit must not lose it."""

    # Gauss–Newton.
    first_steps: int = 6
    steps: int = 3
    more_steps: int = 3
    """Of the plain model; of each candidate; and of those that are best after that."""
    start_steps: int = 1
    """Of each of several starts: enough to rank them."""
    trusted_steps: int = 2
    """On the pixels that a candidate trusts, before all are used."""
    converged_share: float = 1e-4
    """A step that lowers the squared error by less than this share is the last."""
    step_shares: tuple[float, ...] = (1.0, 0.4, 0.1)
    """Shares of a step that are tried in turn while it makes the fit worse."""
    max_step_range: float = 1 / 3
    max_step_differences: float = 40.0
    """No parameter goes farther in one step than this share of its range, or so many of the steps
    of its finite difference: beyond, the linear model says nothing."""
    max_press_step_range: float = 0.25
    """The same for parameters of each press, which fewer pixels determine."""
    correlated_pixels: float = 6.0
    """Residuals of neighbouring lattice pixels go together: so many count as one."""
    least_square_grey: float = 0.05
    """Mean squared error that noise has at least: half of rounding to 8 bits."""
    press_steps: int = 4
    linear_press_steps: int = 2
    """Of a held-out press's own parameters; of those in which the grey levels are linear."""
    derivative_grey: float = 1e-3
    """Change of colour for the derivative of what comes after the look-up."""

    # The choice of effects.
    folds: int = 4
    """Of cross-validation, each of every depth: no table reaches beyond its slopes."""
    false_alarm: float = 0.01
    """Chance, over all candidates, of an effect on presses that have none."""
    least_gain: float = 0.05
    """An effect, or a covariate, must lower the error by this share, or nobody would notice."""
    least_gain_evident: float = 0.01
    """The same for an effect that the grey levels show by themselves: a table hides most of it."""
    least_noise_share: float = 0.5
    """What an effect changes, RMS, in standard deviations of the camera's noise."""
    least_noise_share_of_form: float = 1.0
    """The same for effects that can bend to the errors of form that a table's polynomial and a
    gel's form leave around every contact, on presses without any effect."""
    most_of_gain: float = 0.8
    """A candidate with fewer parameters that reaches this share of the best one's gain is
    preferred."""
    max_effects: int = 5
    """Six effects at once have never been seen."""
    finalists: int = 3
    """The best candidates of a step are fitted to the end before they are compared."""
    decisive_covariates: tuple[str, ...] = ("place_on_gel", "image_number")
    """What no effect follows by itself; if one of these explains more, the selection ends."""

    # What the residuals follow.
    cells: int = 16
    """Along each side of the image, in which a mark on the gel is looked for: a millimetre."""
    held_presses: float = 2.0
    """A pattern is held back as if so many presses had shown nothing."""
    ring_radii: float = 0.2
    n_rings: int = 10
    n_sectors: int = 8
    """Cells around a contact: eight rings within reach, and eighths of a turn."""


RULES = SelectionRules()
