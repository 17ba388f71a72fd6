"""Every threshold and every number of steps of the diagnosis of images, in one record."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SelectionRules:
    """What decides which effects ball presses show, and how finely that is computed.

    Gains are falls of the mean logarithm of the squared error of a press: 0.1 is 5 % of its RMSE.
    The least gains were set on Taxim's and FOTS' presses, clean and with effects put in
    (``validation/optics/altered_images.py``). Each field's reason follows it.
    """

    # Which presses and pixels are looked at.
    min_presses: int = 8
    """Two test presses, and six to fit: fewer do not fill the folds."""
    test_every: int = 4
    """Every fourth press is kept from fitting and choosing: a quarter, spread over the session."""
    folds: int = 5
    """Folds of whole presses; as many as ``tacgen calibrate lookup`` scores a table on."""
    reach_radii: float = 2.2
    """Pixels up to here from a centre belong to the contact: a lamp's shadow lies within."""
    pixels_per_press: int = 800
    """On an even lattice; more cost time and change no name."""
    bare_beyond_radii: float = 2.2
    """From here on the gel is bare, as for the calibration's drift."""
    bare_pixels: int = 200
    """On an even lattice over the rest of the image: what acts on the whole image shows there
    without the errors of form that a table leaves around a contact."""

    # Gauss–Newton.
    steps: int = 4
    place_steps: int = 6
    """Steps of a candidate's parameters, and of presses' places, which start at the labels."""
    nudge_radii: float = 0.01
    """Step of the finite differences of a place: a fraction of a pixel."""
    converged_share: float = 1e-4
    """A step that lowers the squared error by less than this share is the last."""
    longest_step: float = 0.2
    """Longest step, as a share of a parameter's range or of the contact's radius: the linear model
    says nothing beyond."""
    residual_grey: float = 6.0
    correlated_pixels: float = 6.0
    """Standard deviation of a pixel's residual; residuals of neighbouring lattice pixels go
    together, so many count as one. Both as in the calibration; priors weigh little against them."""
    label_scatter_radii: tuple[float, float, float] = (0.15, 0.15, 0.10)
    """Standard deviations of a label's centre and radius; as in the calibration."""
    exposure_scatter: float = 0.1
    """Standard deviation of a picture's exposure, by channel: lamps and cameras drift less."""

    # The choice of effects.
    false_alarm: float = 0.005
    """Chance, over all candidates of a step, of an effect on presses without: of six kinds, 3 %."""
    least_gain: float = 0.1
    least_gain_per_parameter: float = 0.018
    """5 % of the error, and more for what can bend to a table's errors of form: clean presses gain
    up to 0.1 by a shadow and 0.25 by the nine shares of a camera's colours."""
    least_gain_of_rigid: float = 0.05
    """For what geometry gives its form: clean simulated presses gain up to 0.02 by a near lamp's
    shadow or the gel's skirt, four measured sets 0.05 to 0.2."""
    least_gain_grey: float = 0.08
    """Of the error, grey levels: clean simulated presses gain 0.07, by the skirt of their own
    renderer, which is no exponential."""
    clear_gain_in_se: float = 3.0
    """Standard errors that a gain must exceed: what harms the first presses is not on all."""
    least_gain_of_places: float = 0.65
    least_gain_of_exposures: float = 1.0
    """For places or exposures of their own: by those clean presses gain up to 0.5 and 0.85."""
    usual_scatter_radii: float = 0.01
    """What a typical label is off by, each way, where the table's presses had less."""
    table_presses: float = 20.0
    """That the table was fitted to, where it does not say: a usual calibration."""
    sharp_noise_share: float = 0.7
    """Pictures with less of the table's camera noise are out of focus: of four sensors' presses
    mixed colours, vignetting or a gain leave 0.8 and more of it, a Gaussian of 1.5 pixels 0.52."""
    clear_lead_in_se: float = 2.0
    """A candidate whose lead is below this many standard errors is replaced by one with fewer
    parameters; an effect whose gain over all presses is, is dropped."""
    min_objecting: int = 4
    """Test presses whose mean gain must not be negative: those of fewer differ by themselves."""
    max_effects: int = 4
    """More at once have never been seen."""

    # What the residuals follow.
    least_gain_of_place: float = 0.5
    least_gain_of_condition: float = 0.1
    """For a pattern on the gel, and a line in a condition of the presses: by those clean presses
    gain up to 0.48 and 0.09."""
    least_structure_grey: float = 1.0
    """Root mean square of a pattern of distance and direction: less lies in clean simulated
    presses, 0.7, whose renderer's skirt is no exponential."""
    rings: int = 10
    """Distances from a contact that such a pattern has values at: a quarter of its radius apart."""
    cells: int = 16
    """Along each side of the image, in which a mark on the gel is looked for: a millimetre."""
    held_presses: float = 2.0
    """A pattern or trend is held back as if so many presses had shown nothing."""


RULES = SelectionRules()
