"""Every threshold of the diagnosis of a press log, with its reason, in one record.

``docs/method.md`` holds the table of them and what halving or doubling each does to the logs of
``validation.blind``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

BLIND = "`python -m validation.blind.evaluate`"
CONVENTION = "convention"
NUMERICAL = "numerical"


def _rule(value: Any, reason: str, set_by: str = BLIND) -> Any:
    return field(default=value, metadata={"reason": reason, "set_by": set_by})


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectionRules:
    """Thresholds of the diagnosis; see each field's ``reason`` and the study that ``set_by`` it.

    A *share* is of the held-out sum of squares, noise included, unless its reason says otherwise;
    *few* means fewer than ``min_trials_as_units`` trials to fit.
    """

    # Rows, halves and units
    min_samples_of_trial: int = _rule(4, "what two halves of two rows need", NUMERICAL)
    min_samples: int = _rule(12, "what second differences need", NUMERICAL)
    rows_per_trial: int = _rule(
        60, "rows a trial is averaged to while choosing: more change no choice", NUMERICAL
    )
    min_rows: int = _rule(1200, "rows in all where trials are few", NUMERICAL)
    refit_rows_per_trial: int = _rule(
        250, "rows a trial in the last fit, whose parameters the law gets", NUMERICAL
    )
    gp_rows_per_trial: int = _rule(30, "rows a trial that the Gaussian process sees", NUMERICAL)
    min_trials_as_units: int = _rule(
        12, "with fewer trials, parts of trials are what tests resample"
    )
    min_units: int = _rule(36, "about so many parts of trials then")
    min_trials_as_folds: int = _rule(4, "with fewer trials, folds are parts of trials too")
    outlier_sigmas: float = _rule(
        7.0, "a sample so many σ from its neighbours is a spike: it has no weight", CONVENTION
    )
    max_variance_ratio: float = _rule(
        25.0, "most that noise which grows with the load changes a sample's weight", NUMERICAL
    )

    # Held-out trials
    trials_per_test_trial: int = _rule(4, "one trial in so many is held out", CONVENTION)
    min_trials_to_split: int = _rule(8, "with fewer, each trial is held out in turn", CONVENTION)
    n_bootstrap: int = _rule(1000, "resamplings of held-out trials for the gain's interval")
    n_folds: int = _rule(10, "folds of whole trials in cross-validation", CONVENTION)
    n_shuffles: int = _rule(1999, "sign flips or permutations of trials in each test", CONVENTION)
    shuffle_tail_share: float = _rule(
        0.05, "part of the shuffles that an exponential tail of p-values is fitted to"
    )

    # Which columns compete
    max_share_beside_load: float = _rule(
        0.4,
        "part of a column's variation within trials that load, turn and time must leave for it to "
        "be a condition of the press and not another reading of it",
    )
    max_levels_if_few: int = _rule(
        4, "levels of a text column that compete however few trials there are"
    )
    trials_per_level: int = _rule(3, "trials for each level of a text column beyond that")
    coefficients_per_trial: float = _rule(
        1 / 3, "most coefficients of what has one number a trial, for each trial"
    )
    min_cycles: float = _rule(1.5, "slower within the session is a drift, not an oscillation")
    rows_per_period: int = _rule(4, "shortest period that an oscillation may have, in samples")
    n_oscillation_flips: int = _rule(
        39, "sign flips whose highest peaks show how high one is by chance", NUMERICAL
    )

    # Numbers of the linear algebra
    ridge: float = _rule(
        1e-8, "of the diagonal: enough to solve with columns equal but for noise", NUMERICAL
    )
    min_column_share_in_fold: float = _rule(
        0.02, "part of a column's squares that the fitted folds must hold for it to count"
    )
    negative_loss_tolerance: float = _rule(
        0.25,
        "part of the noise by which a sum of products between halves may fall below 0: chance "
        "hardly brings it there, columns that only noise tells apart do",
    )
    one_number_a_trial_share: float = _rule(
        0.97, "part of a column that must follow the response within trials to be permuted"
    )
    max_newton_gain: float = _rule(
        0.01,
        "gain of one more linear step beyond which a fit does not stand for a refit",
        NUMERICAL,
    )

    # When an effect is kept
    alpha: float = _rule(0.01, "chance of a first false effect, over all candidates together")
    min_gain: float = _rule(
        0.02,
        "least share that an effect must explain, a seventh of the noise in amplitude: below it "
        "the force's noise is no longer negligible",
    )
    clear_share: float = _rule(
        0.5, "of the remaining structure: what explains it is believed at clear_alpha"
    )
    clear_gain: float = _rule(0.2, "the share that such a member must explain as well")
    clear_alpha: float = _rule(
        0.02, "p before correction for it: shuffles of a dozen trials cannot go lower"
    )
    few_alpha: float = _rule(0.05, "alpha where trials are few: their parts are not independent")
    few_min_gain: float = _rule(0.2, "min_gain where trials are few")
    trials_per_member_if_few: int = _rule(4, "trials for each member where trials are few")
    max_members: int = _rule(5, "most members of a channel's model", CONVENTION)

    # Which of two is kept
    parameter_price: float = _rule(
        0.002, "share by which a form with one parameter more must be better"
    )
    few_parameter_price: float = _rule(0.02, "the same where trials are few")
    min_swap_gain: float = _rule(0.001, "share that an exchange of members must gain")
    least_share_of_rival: float = _rule(
        0.06,
        "of another member's worth that each must have, a quarter in amplitude: less cannot be "
        "separated from the other's true form being a little different",
    )
    confusable_in_se: float = _rule(
        2.0, "lead in standard errors below which a rival is reported as confusable", CONVENTION
    )

    # How much is looked at
    single_share: float = _rule(
        0.5, "of the best candidate's linearised gain: below it one is not fitted"
    )
    singles_fitted: int = _rule(6, "effects or covariates that are fitted alone", NUMERICAL)
    pair_share: float = _rule(0.85, "the same for pairs of candidates")
    pair_pool: int = _rule(44, "candidates whose pairs are looked at", NUMERICAL)
    pairs_scored: int = _rule(60, "pairs that are cross-validated", NUMERICAL)
    pairs_fitted: int = _rule(8, "pairs that are fitted", NUMERICAL)

    # What remains
    form_share_left: float = _rule(
        0.06, "part of what the effects explain that their formulas' inexactness may leave"
    )
    misfit: float = _rule(
        1.0, "held-out structure, in units of the noise, beyond which no law that fits was found"
    )
    misfit_share: float = _rule(0.5, "of the structure before, that must remain as well")
    misfit_in_se: float = _rule(2.0, "standard errors over trials that it must exceed as well")
    residual_degree: int = _rule(3, "degree in a covariate that a residual is tested for")
    residual_levels: int = _rule(12, "most levels of a text covariate that it is tested for")

    # The noise floor
    floor_lags: tuple[int, ...] = _rule(
        (1, 2, 4, 8), "samples over which second differences are taken"
    )
    rows_per_lag: int = _rule(10, "samples of the median trial for each sample of lag")
    max_floor_rise: float = _rule(
        1.1,
        "from one lag to twice it: noise that goes on for some samples rises less, what a law "
        "leaves of a load's course goes on rising",
    )


DEFAULT_RULES = SelectionRules()


def rules_table(rules: SelectionRules = DEFAULT_RULES) -> str:
    """The rules as a table in Markdown: name, value, reason, and the study that set it."""
    rows = [
        f"| `{rule.name}` | {_shown(getattr(rules, rule.name))} | {rule.metadata['reason']} "
        f"| {rule.metadata['set_by']} |"
        for rule in fields(rules)
    ]
    return "\n".join(["| rule | value | reason | set by |", "|---|---|---|---|", *rows])


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
