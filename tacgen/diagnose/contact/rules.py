"""Every threshold of the diagnosis of a press log, with its reason, in one record."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionRules:
    """Thresholds of the diagnosis.

    A *share* is of the held-out sum of squares, noise included, unless its reason says otherwise;
    *few* means fewer than ``min_trials_as_units`` trials to fit.
    """

    # Rows, neighbours and units
    rows_per_trial: int = 60  # averaged to while choosing: more change no choice
    min_rows: int = 4800  # in all where trials are few
    min_trials_as_units: int = 16  # with fewer, parts of trials are what tests resample
    min_units: int = 36  # about so many parts of trials then

    # Held-out trials
    n_shuffles: int = 999  # sign flips, permutations or resamplings of trials in each test

    # Which columns compete
    max_share_beside_load: float = 0.4  # of a condition's variation that load and time leave
    trials_per_level: int = 2  # of a text column that competes

    # Numbers of the linear algebra
    ridge_at_fit: float = 0.05  # the same around a fit, where it keeps the fitted parameters
    negative_loss_in_sd: float = 3.0  # of chance: no true set leaves so much less than nothing

    # When an effect is kept
    alpha: float = 0.005  # chance of a first false effect, over all that is shuffled alike
    min_gain: float = 0.02  # least share of an effect, a seventh of the noise in amplitude
    few_min_gain: float = 0.1  # min_gain where trials are few
    max_members: int = 5  # of a channel's model

    min_trials_of_part: int = 4  # fewer say nothing together; of so few, parts are folds
    local_price: float = 0.05  # share by which an effect in a part must beat what acts everywhere

    # Which of two is kept
    parameter_price: float = 0.002  # share that a parameter, an exchange, a correction must gain
    least_share_of_all: float = 0.02  # of what all explain: less is another's model error
    confusable_in_se: float = 2.0  # lead below which another explanation is confusable

    # How much is looked at
    fitted_share: float = 0.85  # of the best linearised gain: what promises less is fitted later

    # What remains
    form_share_left: float = 0.06  # of what is explained, that inexact formulas may leave


DEFAULT_RULES = SelectionRules()
