"""Every threshold of the four diagnoses, each with its reason, in one record a kind of data."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRules:
    """How far the one search goes (``engine``); every kind of data has its own figures."""

    max_members: int = 5  # of a model: more at once have never been seen
    max_growth: int = 5  # members that are added before a set is tested: pairs may hide each other
    max_exchanges: int = 4  # rounds in which members are exchanged for others
    width: int = 1  # sets of a size that are extended
    fitted_share: float = 0.85  # of the best promised gain: what promises less is fitted later


@dataclass(frozen=True, slots=True, kw_only=True)
class ContactRules(SearchRules):
    """Thresholds of the diagnosis of press logs.

    A *share* is of the held-out sum of squares, noise included, unless its reason says otherwise;
    *few* means fewer than ``min_trials_as_units`` trials to fit.
    """

    width: int = 3  # of one effect, the form that alone is best may not be so beside another

    # Rows, neighbours and units
    rows_per_trial: int = 60  # averaged to while choosing: more change no choice
    min_rows: int = 4800  # in all where trials are few
    min_trials_as_units: int = 16  # with fewer, parts of trials are what tests resample
    min_units: int = 36  # about so many parts of trials then
    min_samples: int = 4  # of a trial: what two second differences need
    refit_rows_per_trial: int = 1000  # in the last fit: software smooths samples, not means

    # Held-out trials
    n_shuffles: int = 999  # sign flips, permutations or resamplings of trials in each test
    local_flips: int = 9999  # of the test of effects in a part: its p is multiplied by their number
    trials_per_test_trial: int = 4  # one in so many is held out
    max_draws: int = 20  # of test trials, where few trials have load
    n_folds: int = 10  # of whole trials in cross-validation

    # Which columns compete
    max_share_beside_load: float = 0.4  # of a condition's variation that load and time leave
    trials_per_level: int = 2  # of a text column that competes
    min_cycles: float = 1.5  # of an oscillation: slower within the session is a drift

    # Numbers of the linear algebra
    ridge_at_fit: float = 0.05  # the same around a fit, where it keeps the fitted parameters
    negative_loss_in_sd: float = 3.0  # of chance: no true set leaves so much less than nothing

    # When an effect is kept
    alpha: float = 0.005  # chance of a first false effect, over all that is shuffled alike
    min_gain: float = 0.02  # least share of an effect, a seventh of the noise in amplitude
    few_min_gain: float = 0.1  # min_gain where trials are few
    few_parts_gain: float = 0.9  # the same where parts are too few for any p below alpha: noise of
    # so few parts is no such share of a residual

    max_error_of_compliance: float = 0.5  # standard errors over the value: k_n is then no figure
    max_error_of_time: float = 1.0  # the same of a time or a limit: another would do as well

    min_trials_of_part: int = 4  # fewer say nothing together; of so few, parts are folds
    local_price: float = 0.05  # share by which an effect in a part must beat what acts everywhere
    parts_of_side: int = 10  # in which all forms of a local effect are tried
    local_forms_tried: int = 2  # of each local effect, in every part of their best side
    max_local_columns: int = 3  # of a form that is looked at in every part
    local_effects_fitted: int = 3  # in the part of the log where each is best

    # Which of two is kept
    parameter_price: float = 0.002  # share that a parameter, an exchange, a correction must gain
    least_share_of_all: float = 0.02  # of what all explain: less is another's model error
    confusable_in_se: float = 2.0  # lead below which another explanation is confusable

    # What remains
    form_share_left: float = 0.06  # of what is explained, that inexact formulas may leave
    clearly_more: float = 2.0  # times the noise floor, of the extended law's residual: more is no
    # noise, whether a column explains it or not
    exact_share: float = 0.01  # of what is measured: a smaller error is no fault of a law
    share_of_presses: float = 0.3  # of such a residual's squares, that a gain and a zero of each
    # trial explain: it differs from press to press
    share_of_both: float = 0.9  # of what both explain: one of them that does is named alone
    own_block: int = 8  # rows, that are fitted or scored together then: noise hardly lasts longer
    share_of_one_trial: float = 0.5  # of the residual in one trial: that is worth a look
    max_explanations: int = 8  # of a channel, by held-out score, that next presses separate


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerRules(SearchRules):
    """Thresholds of the choice, set on other seeds of validation/blind/markers.py than reported."""

    min_gain: float = 0.002  # Share of the squared error, noise included, that an effect explains:
    # by chance 0.0005.
    frames: int = 6  # Of a press, in the choice: a place is tried in some hundred spots.
    scan_mm: float = 1.5  # Distance of those spots: half of a contact's radius.
    spots: int = 4  # Best ones, from which a place is fitted.
    scan_radius_mm: float = 1.75  # Of a place that is tried; it is fitted then.
    excess: float = 2.5  # Standard deviations of the noise's own squared error that a press is off
    # by: a place is looked for there.
    more: float = 4.0  # Times 1/μ in a place that is tried.
    less: float = 0.25  # The same, of a place with more friction.
    least_slip: float = 4.0  # 1/μ in a place that is tried in a contact that sticks.
    test_every: int = 4  # Every so many presses one is held out.
    unexplained: float = 1.2  # Times the noise floor: what is left is looked into.
    alpha: float = 0.01  # p-value, for all covariates together, below which the residual follows
    # one.
    n_shuffles: int = 9999  # Of presses: resolve a p-value of 0.01 for ten columns.
    max_exchanges: int = 0  # Four effects, of which all sets are reached by adding.


@dataclass(frozen=True, slots=True, kw_only=True)
class OpticsRules(SearchRules):
    """What decides which effects ball presses show, and how finely that is computed.

    Gains are falls of the mean logarithm of the squared error of a press: 0.1 is 5 % of its RMSE.
    The least gains were set on Taxim's and FOTS' presses, clean and with effects put in
    (``validation/optics/altered_images.py``). Each field's reason follows it.
    """

    # Which presses and pixels are looked at.
    min_presses: int = 8  # Two test presses, and six to fit: fewer do not fill the folds.
    test_every: int = 4  # Every fourth press is kept from fitting and choosing: a quarter, spread
    # over the session.
    folds: int = 5  # Folds of whole presses; as many as ``tacgen calibrate lookup`` scores a table
    # on.
    reach_radii: float = 2.2  # Pixels up to here from a centre belong to the contact: its rim and
    # the shadow that it casts lie within.
    pixels_per_press: int = 800  # On an even lattice; more cost time and change no name.
    bare_beyond_radii: float = 2.2  # From here on the gel is bare, as for the calibration's drift.
    bare_pixels: int = 200  # On an even lattice over the rest of the image: what acts on the whole
    # image shows there without the errors of form that a table leaves around a contact.

    # Gauss–Newton.
    steps: int = 4
    place_steps: int = 6  # Steps of a candidate's parameters, and of presses' places, which start
    # at the labels.
    nudge_radii: float = 0.01  # Step of the finite differences of a place: a fraction of a pixel.
    converged_share: float = 1e-4  # A step that lowers the squared error by less than this share is
    # the last.
    longest_step: float = 0.2  # Longest step, as a share of a parameter's range or of the contact's
    # radius: the linear model says nothing beyond.
    residual_grey: float = 6.0
    correlated_pixels: float = 6.0  # Standard deviation of a pixel's residual; residuals of
    # neighbouring lattice pixels go together, so many count as one. Both as in the calibration;
    # priors weigh little against them.
    label_scatter_radii: tuple[float, float, float] = (0.15, 0.15, 0.10)  # Standard deviations of a
    # label's centre and radius; as in the calibration.
    exposure_scatter: float = 0.1  # Standard deviation of a picture's exposure, by channel: lamps
    # and cameras drift less.

    # The choice of effects.
    false_alarm: float = 0.005  # Chance, over all candidates of a step, of an effect on presses
    # without: of six kinds, 3 %.
    least_gain: float = 0.05
    least_gain_per_parameter: float = 0.01  # 2.5 % of the error, and more for what can bend to a
    # table's errors of form: clean simulated presses gain up to 0.01, measured ones 0.1 by the nine
    # shares of a camera's colours.
    least_gain_of_rigid: float = 0.03  # For what geometry gives its form: clean simulated presses
    # gain up to 0.02 by it, Taxim's and a Mini's 0.15 and 0.22 by shadows of near lamps.
    least_gain_grey: float = 0.08  # Of the error, grey levels, of the same: clean simulated presses
    # gain 0.07, by the skirt of their own renderer, which is no exponential.
    clear_gain_in_se: float = 3.0  # Standard errors that a gain must exceed: what harms the first
    # presses is not on all.
    least_gain_of_places: float = 0.65
    least_gain_of_exposures: float = 1.0  # For places or exposures of their own: by those clean
    # presses gain up to 0.5 and 0.85.
    usual_scatter_radii: float = 0.01  # What a typical label is off by, each way, where the table's
    # presses had less.
    table_presses: float = 20.0  # That the table was fitted to, where it does not say: a usual
    # calibration.
    sharp_noise_share: float = 0.7  # Pictures with less of the table's camera noise are out of
    # focus: of four sensors' presses mixed colours, vignetting or a gain leave 0.8 and more of it,
    # a Gaussian of 1.5 pixels 0.52.
    clear_lead_in_se: float = 2.0  # A candidate whose lead is below this many standard errors is
    # replaced by one with fewer parameters; an effect whose gain over all presses is, is dropped.
    resamplings: int = 2000  # of the test presses, for the interval of a gain
    min_objecting: int = 4  # Test presses whose mean gain must not be negative: those of fewer
    # differ by themselves.
    max_members: int = 4
    max_growth: int = 2
    max_exchanges: int = 0  # A fit to pictures takes seconds: effects are added in pairs only where
    # they hide each other, as a skirt and a near lamp's shadow do, and none is exchanged.

    # What the residuals follow.
    least_gain_of_place: float = 0.5
    least_gain_of_condition: float = 0.1  # For a pattern on the gel, and a line in a condition of
    # the presses: by those clean presses gain up to 0.48 and 0.09.
    least_structure_grey: float = 1.0  # Root mean square of a pattern of distance and direction:
    # clean simulated presses have 0.7, by the skirt of their renderer.
    rings: int = 10  # Distances from a contact at which such a pattern has values: a quarter of
    # its radius apart.
    cells: int = 16  # Along each side of the image, in which a mark on the gel is looked for: a
    # millimetre.
    held_presses: float = 2.0  # A pattern or trend is held back as if so many presses had shown
    # nothing.
    held_of_own: float = 0.05  # Of that, for a pattern of one press its own: a tenth of a press.


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspRules(SearchRules):
    """Thresholds, sizes and prior weights of the diagnosis of grasp labels.

    "Trust study" is ``python -m validation.grasps``, whose figures are in
    ``docs/results/diagnosis_grasps.md``, on sets of grasps that are not among the reported ones.
    "Chosen" means that no study varied the figure.
    """

    # Margins are logarithms of the friction to spare.
    farthest_margin: float = 1.5  # beyond a factor of 4.5 it makes no difference how far; chosen
    turn_margin: tuple[float, float] = (0.05, 0.5)  # where label and closed form disagree: never
    # zero and never sure; trust study
    not_executed_margin: float = -1.0  # a clear failure; chosen
    sure_margin: float = 0.5  # a factor of 1.6 from the threshold; trust study
    same_margin: float = 0.02  # 2 %, the narrower of ``border_widths``; trust study
    sure_mode: float = 0.9  # a simulated failure mode is the real one in 9 of 10; chosen
    mode_width: float = 0.2  # limits within a factor of 1.2 may be passed in either order; chosen

    # The model of labels: flipped at random, and uncertain near the threshold.
    flip_rates: tuple[float, ...] = (0.005, 0.03, 0.1)  # clean, usual and careless labels; chosen
    flip_weights: tuple[float, ...] = (0.5, 0.3, 0.2)  # most labels are right; chosen
    border_widths: tuple[float, ...] = (0.02, 0.1)  # over which a threshold repeats; chosen
    axis_values: int = 121  # of a parameter: finer than a posterior of 100 labels; chosen

    # Choosing.
    false_alarm: float = 0.03  # promised share of clean labels in which anything is named
    null_draws: int = 500  # of labels; gives the 3 % quantile to ±0.8 %
    max_members: int = 3  # 60 labels support no more; chosen
    cause_odds: float = 0.1  # prior odds of a cause of weight 1; chosen
    width: int = 8  # explanations to which a further cause is tried; chosen for time
    explanations_reported: int = 12  # chosen
    sentence_explanations: int = 4  # in the sentence where no cause can be named; chosen
    sentence_least_share: float = 0.05  # probability of one of them; chosen
    axis_steps: tuple[tuple[int, ...], ...] = ((1,), (1, 3), (3, 5, 6))  # of ``axis_values`` for
    # one, two and three causes; unequal, so that sums of two causes' changes lie densely; numerical
    second_mode_share: float = 0.2  # of the posterior: less is not reported; chosen
    mode_edge: float = 0.02  # of the peak, where a mode of the posterior ends; chosen
    ridge_widening: float = 1.3  # of an estimate's error beside another cause, with which it then
    # shares what is known; trust study
    excluding_gain: float = math.log(10)  # strong evidence against another cause beside what was
    # found, prior weights aside (Jeffreys 1961, Theory of probability, appendix B)
    least_alternative: float = 0.1  # of the best explanation's probability, prior weights
    # included: one with less is not reported; chosen
    same_errors: float = 3.0  # by which other factors may miss the value of a product; chosen
    least_variance: float = 1e-8  # of a coordinate; numerical
    confusable_gain: float = math.log(100)  # further behind in evidence competes no more; chosen

    # Simulations about the leading values.
    leading_gain: float = 5.0  # in log-evidence: those further behind do not come first; chosen
    most_refined: int = 4  # explanations a round; chosen for time
    least_change: float = 0.15  # of a prior's spread: several causes at once are simulated where
    # each is changed by more; trust study
    refining_rounds: int = 3  # each halves the unknown interval; trust study
    refining_deviations: float = 2.5  # about a value: 99 % of a normal posterior
    least_force_n: float = 0.01  # delivered force below which a ratio means nothing; chosen

    # Held-out predictions and what remains.
    few_grasps: int = 10  # a note is given below; chosen
    max_folds: int = 100  # up to so many grasps each is held out alone; chosen for time
    usual_flips: float = 0.05  # of labels that disagree with any model; as in the trust study
    too_many_p: float = 0.01  # chance of so many flips, below which the verdict is unexplained
    dependence_p: float = 0.05  # corrected p-value below which a covariate is named; the usual 5 %
    shuffles: int = 1999  # resolve a p-value of 0.05 / 6 covariates to ±0.002

    # Grasps to make next.
    grasps_considered: int = 24  # of the grid; chosen for time
    grasps_proposed: int = 5  # chosen
    max_competing: int = 3  # explanations to separate; chosen
    proposal_width: float = 0.1  # the wider of ``border_widths``
    least_disagreement: float = 0.2  # between probabilities of success; chosen

    # Force from images.
    image_forces: tuple[float, ...] = (0.6, 0.8, 1.0, 1.25, 1.6)  # over the declared one, to
    # 2.5 deviations of its prior
    images_read: int = 10  # grasps: the gel's compliance limits the reading, not their number
    least_images: int = 3  # the median of fewer follows an outlier
    declared_k_n_error: float = 0.15  # relative error of a compliance that nobody measured; chosen
    calibrated_k_n_error: float = 0.07  # of a calibrated one; chosen
    image_width_px: int = 160  # averages the camera's noise over 4 × 4 px of a GelSight Mini
    image_noise_grey: float = 2.0  # that is not counted as an imprint; chosen


CONTACT = ContactRules()
MARKERS = MarkerRules()
OPTICS = OpticsRules()
GRASPS = GraspRules()
