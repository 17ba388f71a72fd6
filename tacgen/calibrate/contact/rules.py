"""Thresholds of the zero, the contact law and the shear field of a log, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignRules:
    """What decides where depth, force and volume count from, and the radius of an unknown ball."""

    # Where presses begin
    held_share: float = 0.1  # of the deepest: a depth that varies by less is held
    min_contact_samples: int = 6  # fewer do not carry a slope and a contact point
    median_stderr: float = 1.25  # of normal noise, in standard errors of the mean
    begins_elsewhere_p: float = 0.1  # a shift that is fitted in vain costs certainty, one left out
    # is an error
    tail_share: float = 0.02  # of the largest force: several times the noise; beyond, tails
    in_contact_share: float = 0.05  # of the deepest: nearer to the surface noise of the depth
    # decides
    instrument_steps: int = 6  # each a tenth of the one before it
    most_shift_share: float = 0.15  # of the deepest, median: zeros of stages are off by less,
    # stiffening more
    most_step_share: float = 0.2  # of the deepest: of a longer step the direction alone is known
    least_shift_share: float = 1e-4  # of the deepest: a shift of which changes no volume that
    # matters

    # One shift of all presses, beside effects
    n_taus: int = 5  # time constants of creep, from what samples resolve to two presses
    bends: tuple[float, ...] = (0.8, 2.0)  # powers of the force by which a gel yields more at
    # first, or later
    effect_p: float = 0.001  # one that is not there costs only that presses share a shift;
    bent_p: float = 0.01  # stiffening that is there and is not seen becomes one
    misfit: float = 1.15  # residuals over their noise by differences: up to 1.1 where the model
    # holds
    unloaded_share: float = 0.01  # of the span of force: a tenth of the deepest, or less
    shifted_sigmas: float = 3.0  # of the shift's error

    # The radius of an unknown ball
    radii_mm: tuple[float, float] = (0.1, 100.0)  # outside are no balls that a gel is pressed with
    n_radii: int = 121  # of a profile: 6 % apart
    n_starts: int = 13  # contact points tried along a curve: its loss has several minima
    min_curve_samples: int = 8  # in contact: two for each of the four numbers of a curve

    # What is read at rest
    least_rows: int = 3  # before a press
    least_trials: int = 3  # that have them
    reach_sigmas: float = 5.0  # of a sample's noise that a row at rest may be off
    rise_sigmas: float = 3.0  # of the halves of a rest: more is a press that has begun
    pressed_sigmas: float = 10.0  # that a press rises above its rest
    apart_sigmas: float = 2.0  # of their means that zeros of trials differ by where they wander
    clear_sigmas: float = 5.0  # standard errors that a zero must be off,
    least_zero_share: float = 0.005  # and share of a column's span: less is below any interval

    # What a log leaves open
    few_trials: int = 10  # with fewer presses the t quantile makes intervals clearly wider
    small_spread_mm: float = 1.0  # positions closer than a contact is wide are one place
    hold_s: float = 1.0  # long enough to tell creep from the speed of loading


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


ALIGN = AlignRules()
RULES = LawRules()
FIELD = FieldRules()
