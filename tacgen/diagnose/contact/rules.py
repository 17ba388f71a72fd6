"""Every threshold of the diagnosis of a press log, with its reason, in one record."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionRules:
    """Thresholds of the diagnosis.

    A *share* is of the held-out sum of squares, noise included, unless its reason says otherwise;
    *few* means fewer than ``min_trials_as_units`` trials to fit.
    """

    # Rows, neighbours and units
    min_samples_of_trial: int = 4  # what two second differences need
    min_samples: int = 12  # what second differences need
    rows_per_trial: int = 60  # averaged to while choosing: more change no choice
    min_rows: int = 4800  # in all where trials are few
    refit_rows_per_trial: int = 1000  # in the last fit: software smooths samples, not means
    gp_rows_per_trial: int = 30  # that the Gaussian process sees
    min_trials_as_units: int = 16  # with fewer, parts of trials are what tests resample
    min_units: int = 36  # about so many parts of trials then
    min_trials_as_folds: int = 4  # with fewer trials, folds are parts of trials too
    outlier_sigmas: float = 7.0  # so far from its neighbours a sample has no weight
    max_variance_ratio: float = 25.0  # of the weights that noise growing with the load gives

    # Held-out trials
    trials_per_test_trial: int = 4  # one in so many is held out
    min_trials_to_split: int = 8  # with fewer, each trial is held out in turn
    n_bootstrap: int = 1000  # resamplings of held-out trials for the gain's interval
    n_folds: int = 10  # of whole trials in cross-validation
    n_shuffles: int = 999  # sign flips or permutations of trials in each test
    few_shuffles: int = 9999  # the same where trials are few: a dozen numbers have no long tail
    shuffle_tail_share: float = 0.05  # of the shuffles: an exponential tail is fitted to it

    # Which columns compete
    max_share_beside_load: float = 0.4  # of a condition's variation that load and time leave
    max_levels_if_few: int = 4  # of a text column that competes however few trials there are
    trials_per_level: int = 3  # of a text column beyond that
    min_cycles: float = 1.5  # slower within the session is a drift, not an oscillation
    rows_per_period: int = 4  # of the shortest oscillation
    n_oscillation_flips: int = 199  # sign flips whose highest peaks show how high chance goes

    # Numbers of the linear algebra
    ridge: float = 1e-8  # of the diagonal: enough for columns that are equal but for noise
    ridge_at_fit: float = 0.05  # the same around a fit, where it keeps the fitted parameters
    one_number_a_trial_share: float = 0.97  # of a column that follows the response: permuted
    negative_loss_in_sd: float = 3.0  # of chance: no true set leaves so much less than nothing

    # When an effect is kept
    alpha: float = 0.01  # chance of a first false effect, over all candidates together
    min_gain: float = 0.02  # least share of an effect, a seventh of the noise in amplitude
    clear_share: float = 0.5  # of the remaining structure: then the gains' own p suffices
    clear_alpha: float = 0.02  # of those gains; corrected, of each of several found together
    few_min_gain: float = 0.1  # min_gain where trials are few, or the p is above alpha
    share_of_few: float = 0.3  # of what a few trials leave: so much is explained of what they show
    max_members: int = 5  # of a channel's model

    min_trials_of_part: int = 4  # in a part of the log to which an effect is confined, and outside
    local_price: float = 0.05  # share by which an effect in a part must beat what acts everywhere

    # Which of two is kept
    parameter_price: float = 0.002  # share by which one parameter more must be better
    min_swap_gain: float = 0.001  # share that an exchange of members, or a correction, must gain
    correction_share: float = 0.5  # of an effect's own size that corrections of its form may have
    least_share_of_all: float = 0.02  # of what all explain: less is another's model error
    confusable_in_se: float = 2.0  # lead below which a rival is confusable; rows tell by more

    # How much is looked at
    fitted_share: float = 0.85  # of the best linearised gain: what promises less is fitted later
    pair_pool: int = 44  # candidates whose pairs are looked at
    pairs_scored: int = 60  # pairs that are cross-validated
    pairs_fitted: int = 8  # pairs that are fitted
    locals_fitted: int = 3  # effects that are fitted in the part of the log where each is best

    # What remains
    form_share_left: float = 0.06  # of what is explained, that inexact formulas may leave
    residual_degree: int = 3  # in a covariate that a residual is tested for
    residual_levels: int = 12  # most of a text covariate that it is tested for

    # The noise floor
    floor_lags: tuple[int, ...] = (1, 2, 4, 8)  # samples, for second differences
    rows_per_lag: int = 10  # samples of the median trial for each sample of lag
    max_floor_rise: float = 1.1  # from a lag to twice it: a load's course rises more than noise


DEFAULT_RULES = SelectionRules()
