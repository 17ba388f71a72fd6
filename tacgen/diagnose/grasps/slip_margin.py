"""From simulated outcomes to one continuous number a grasp: how far it is from the other label."""

from collections.abc import Sequence

import numpy as np

from tacgen.collection.perturbed import Outcome
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.diagnose.rules import GRASPS


def limited(margin: FloatArray) -> FloatArray:
    """Margins cut where it makes no difference how far they are."""
    return np.clip(margin, -GRASPS.farthest_margin, GRASPS.farthest_margin)


def closed_form_margin(
    friction_ratio: FloatArray,
    torsion_ratio: FloatArray,
    whole_torsion_ratio: FloatArray | float = np.inf,
) -> FloatArray:
    """Logarithm of the factor by which the friction could be smaller before a grasp slips.

    With s the part of the friction that the weight takes up and m the part of the whole moment that
    gravity asks for, a soft contact slips at s² + m² = 1, and both fall as the friction grows.
    The ratios (...) are limit over demand, see ``records.SlipMargin``; NaN gives NaN.
    ``torsion_ratio`` is √(1 − s²)/m; where the weight alone slips it is 0, and the whole one is
    1/m.

    Source: Howe & Cutkosky 1996, Practical force-motion models for sliding manipulation.
    """
    share, moment = _demands(friction_ratio, torsion_ratio, whole_torsion_ratio)
    with np.errstate(divide="ignore"):
        margin: FloatArray = -0.5 * np.log(share**2 + moment**2)
    return limited(margin)


def _demands(
    friction_ratio: FloatArray, torsion_ratio: FloatArray, whole_torsion_ratio: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """The parts s of the friction and m of the moment that gravity asks for (...)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 1 / friction_ratio
        remaining = np.sqrt(np.maximum(0.0, 1 - share**2))
        return share, np.where(remaining > 0, remaining / torsion_ratio, 1 / whole_torsion_ratio)


def moment_part(outcomes: Sequence[Outcome]) -> FloatArray:
    """How much of a grasp's slip is turning: m²/(s² + m²) (N,), 0 where it is not known."""
    share, moment = _demands(
        np.array([one.friction_ratio for one in outcomes]),
        np.array([one.swing_ratio for one in outcomes]),
        np.array([one.whole_swing_ratio for one in outcomes]),
    )
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(moment**2 / (share**2 + moment**2))


def gain_by_torsion(moment: FloatArray, log_factor: FloatArray) -> FloatArray:
    """What margins gain where the pads hold a larger moment, by the part ``moment`` of turning.

    −½ log(s² + m²/f²) + ½ log(s² + m²).
    """
    return np.asarray(-0.5 * np.log1p(moment * np.expm1(-2 * log_factor)))


def gain_by_force(moment: FloatArray, log_factor: FloatArray) -> FloatArray:
    """What margins gain by the grip force: as much as by friction, and patches that grow.

    The moment that a patch holds grows as F^(1 + 1/4), see ``physics.margins.dome_patch``; less
    where the face ends under the pad, or the object declares its own ``spinning_friction_mm``.
    """
    return np.asarray(log_factor + gain_by_torsion(moment, 0.25 * log_factor))


def signed_margin(
    label: IntArray,
    friction_ratio: FloatArray,
    torsion_ratio: FloatArray,
    turn_ratio: FloatArray,
    whole_torsion_ratio: FloatArray | float = np.inf,
) -> FloatArray:
    """How far each grasp is from the other label: positive holds, negative fails.

    The closed form is of slip about to start, so where the simulated label disagrees the label
    counts: a grasp that turns a little and then holds is as far from failing as its turn is from
    the largest of a success (``turn_ratio``, one over the other). A ``label`` of −1 (not executed)
    counts as a clear failure; ratios as in ``closed_form_margin``, all of one shape.
    """
    least, most = GRASPS.turn_margin
    slip = np.nan_to_num(
        closed_form_margin(friction_ratio, torsion_ratio, whole_torsion_ratio),
        nan=-GRASPS.farthest_margin,
    )
    with np.errstate(invalid="ignore"):
        turned = 0.5 * np.abs(np.log(np.maximum(turn_ratio, 1e-5)))
    by_turn = np.clip(np.nan_to_num(turned, nan=least), least, most)
    sign = np.where(label == 1, 1.0, -1.0)
    agrees = np.where(label == 1, slip > 0, slip < 0)
    executed = np.where(agrees, slip, sign * by_turn)
    return np.where(label < 0, GRASPS.not_executed_margin, executed)


def turning_share(
    label: IntArray, turned: BoolArray, friction_ratio: FloatArray, torsion_ratio: FloatArray
) -> FloatArray:
    """Probability that a grasp, if it fails, fails by turning and not by sliding.

    A simulated failure shows which it was; of a success, the nearer limit is passed first.
    """
    sure = GRASPS.sure_mode
    with np.errstate(divide="ignore", invalid="ignore"):
        lead = np.log(friction_ratio) - np.log(torsion_ratio)
    lead = limited(np.nan_to_num(lead, nan=0.0))
    nearer = 1 / (1 + np.exp(-lead / GRASPS.mode_width))
    likely = (1 - sure) + (2 * sure - 1) * nearer
    known = np.where(turned, sure, 1 - sure)
    return np.where(label == 0, known, np.where(label < 0, 0.5, likely))


def margins_of(outcomes: Sequence[Outcome]) -> tuple[FloatArray, FloatArray]:
    """Margin and turning share (N,) of simulated grasps."""
    label = np.array([one.label for one in outcomes])
    friction = np.array([one.friction_ratio for one in outcomes])
    torsion = np.array([one.swing_ratio for one in outcomes])
    turn = np.array([one.turn_ratio for one in outcomes])
    whole = np.array([one.whole_swing_ratio for one in outcomes])
    turned = np.array([one.failure_mode == "rotational_slip" for one in outcomes])
    return (
        signed_margin(label, friction, torsion, turn, whole),
        turning_share(label, turned, friction, torsion),
    )


def margin_at_force(log_force: FloatArray, margin: FloatArray, wanted: FloatArray) -> FloatArray:
    """Margins (M, N) at other forces, from those (K, N) at ``log_force`` (K,).

    What holds grows in proportion to the force, so beyond the ends the slope is 1. ``wanted`` (M,
    N) is the logarithm of the force of each grasp over the declared one.
    """
    beyond = wanted - np.clip(wanted, log_force[0], log_force[-1])
    return limited(at_force(log_force, margin, wanted) + beyond)


def at_force(log_force: FloatArray, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """Anything (M, N) of each grasp at its own ``wanted`` force, from (K, N) at ``log_force``."""
    columns = range(values.shape[1])
    return np.stack([np.interp(wanted[:, n], log_force, values[:, n]) for n in columns], axis=1)


def holds_from(gain: FloatArray, margin: FloatArray) -> float | None:
    """The gain from which on a grasp holds, of those at which it was simulated (K,), ascending.

    By the closed form where it agrees with the simulation on both sides: margins then lie as far
    apart as the gains do. Else half-way, so that the next simulation halves the unknown interval.
    None if it holds or fails everywhere, or begins to hold more than once.
    """
    changes = np.flatnonzero(np.diff(margin > 0))
    if len(changes) != 1 or margin[0] > 0:
        return None
    (low, high), (below, above) = (row[changes[0] :][:2] for row in (gain, margin))
    if abs((above - below) - (high - low)) < GRASPS.same_margin:
        return float(np.clip(low - below, low, high))
    return float(low + high) / 2


def crossings(axis: FloatArray, margin: FloatArray) -> FloatArray:
    """Where on ``axis`` (M,) the interpolated margin (M,) of a grasp passes through zero."""
    at = np.flatnonzero(margin[:-1] * margin[1:] < 0)
    part = margin[at] / (margin[at] - margin[at + 1])
    places: FloatArray = axis[at] + part * (axis[at + 1] - axis[at])
    return places
