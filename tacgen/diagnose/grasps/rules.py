"""Every threshold of the diagnosis of grasp labels, with its reason and the study that set it.

"Trust study" is ``python -m validation.grasps``, whose figures are in
``docs/results/diagnosis_grasps.md``, on sets of grasps that are not among
the reported ones. "Chosen" means that no study varied the figure.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GraspRules:
    """Thresholds, sizes and prior weights; ``RULES`` is what the diagnosis uses."""

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
    max_causes: int = 3  # 60 labels support no more; chosen
    cause_odds: float = 0.1  # prior odds of a cause of weight 1; chosen
    most_extended: int = 8  # explanations to which a further cause is tried; chosen for time
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


RULES = GraspRules()
