"""Thresholds of the fits of a contact law and of a shear field, each with its reason."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldRules:
    """What decides how friction and decay are fitted to dots, and when a fit is refused."""

    # What is fitted, and how far
    least_presses: int = 4  # with shear: fewer leave no scatter to give intervals by
    most_frames: int = 16  # of a press, from loading over the largest shear back to none: with half
    # of them the load's steps are so coarse that μ comes out a few per cent wrong
    start_decay_mm: float = 1.5
    start_slips: tuple[float, ...] = (0.6, 1.2, 2.4, 5.0)  # 1/μ, the best of which is gone on from
    step: float = 0.02  # of a parameter, for its derivative: the slip's rim goes node by node
    first_slip_steps: float = 25.0  # 1/μ at which a rim slips that is seen
    field_tolerance: float = 1e-4  # of the motion, of which a step of a parameter changes some 1e-2
    tolerance: float = 2e-3  # of the parameters, far below any interval
    most_steps: int = 10
    most_known: int = 6000  # strains that are kept: some 80 MB of them
    arrows: int = 3  # presses that are drawn: the worst explained, the median and the best

    # Refusals; shares of the squared motion, noise left out
    clear: float = (
        0.5  # less explained, or a gel that moves against the force: tried in other axes.
    )
    # On the virtual rig it is 0.98 for decays of 0.8 to 3 mm, in other axes at most 0.3
    frames_for_axes: int = 4  # of a press, that tell in which axes its tracks are written
    other_axes: float = 0.5  # times the squared error as written: what the right axes leave at most
    least: float = 0.2  # explained: unrelated motions are by 0.1
    contradiction: float = 0.25  # of the log's own k_s, where intervals differ too: on the virtual
    # rig they agree to 0.03


RULES = LawRules()
FIELD = FieldRules()
