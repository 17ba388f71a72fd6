"""Thresholds of the fit of a contact law, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class LawRules:
    """What decides how k_n and k_s are fitted, and what is said of the fit."""

    # The slope and its error
    tukey: float = 4.685  # 95 % efficiency at normal noise (Holland & Welsch 1977)
    max_iterations: int = 100  # of reweighting; it ends earlier where it has converged
    tolerance: float = 1e-9  # relative; far below any standard error
    scale_iterations: int = 5  # the residuals' scale is settled by then; a median that flickers
    # would never let it end
    loaded_share: float = 0.1  # of the largest load: below it a sample tells little about the slope
    min_remaining_leverage: float = 0.1  # left to a press: its part of the scatter is enlarged by
    # no more than tenfold
    min_relevance: float = 0.8  # of the load's square: neighbours that explain less are no
    # instrument for it
    max_outlying_share: float = 0.2  # of the presses: more that stick out are how presses differ
    widenings: tuple[float, ...] = (1.0, 1.7, 3.0, 5.0, 10.0, 30.0, 1e3)  # on the outlier bound,
    # in turn until no more than that share sticks out

    # The law
    min_trials: int = 3  # two presses give no scatter to tell an outlier by; a depth's course tells
    max_folds: int = 20  # limits the time of cross-validation over presses
    min_samples_for_noise: int = 10  # of a press: in shorter ones neighbouring samples are too far
    # apart to show a sample's own noise
    parts_of_a_trial: int = 8  # that a single press is cut into: its samples are not independent

    # What is said
    structure_factor: float = 1.5  # of a sample's own noise: larger held-out errors are no noise
    disagreement_p: float = 0.01  # Welch's p below which groups differ
    max_groups_shown: int = 12  # in a terminal; the page has all
    max_worst: int = 8  # presses that the page lists

    # Volumes by a table of the same pictures are better than by the circle from
    min_pictures_for_own_table: int = 10  # pictures on, and
    min_presses_for_own_table: int = 6  # presses that they are of


RULES = LawRules()
