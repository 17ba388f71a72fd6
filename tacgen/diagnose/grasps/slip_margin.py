"""From simulated outcomes to one continuous number a grasp: how far it is from the other label."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FARTHEST = 1.5
"""Slack is a logarithm; beyond a factor of 4.5 it makes no difference how far."""
NEAR, LEAST = 0.5, 0.05
TURN_LIMIT_RAD = 0.1
"""The turn at which a lifted grasp counts as failed (DESIGN §4)."""
SAME_SLACK = 0.02
SURE_MODE = 0.9
_MODE_WIDTH = 0.2


def closed_form_slack(
    friction_ratio: FloatArray, torsion_ratio: FloatArray, torsion_factor: FloatArray | float = 1.0
) -> FloatArray:
    """Logarithm of the factor by which the grip could be weaker before it slips.

    With s the part of the friction that the weight takes up and m the part of the whole moment
    that gravity asks for, a soft contact slips at s² + m² = 1, and both fall as the force grows.
    ``torsion_ratio`` is √(1 − s²)/m; where the weight alone slips it is 0 and m is not known.

    Parameters
    ----------
    friction_ratio, torsion_ratio : (...) float
        Limit over demand, see ``records.SlipMargin``; NaN gives NaN.
    torsion_factor : (...) float
        By how much the pads hold a larger moment than they did.

    Source
    ------
    Howe & Cutkosky 1996, Practical force-motion models for sliding manipulation.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 1 / friction_ratio
        left = np.sqrt(np.maximum(0.0, 1 - share**2))
        moment = np.where(left > 0, left / (torsion_ratio * torsion_factor), 0.0)
        slack: FloatArray = -0.5 * np.log(share**2 + moment**2)
    return np.clip(slack, -FARTHEST, FARTHEST)


def signed_slack(
    label: NDArray[np.int64],
    friction_ratio: FloatArray,
    torsion_ratio: FloatArray,
    turn_rad: FloatArray,
) -> FloatArray:
    """How far each grasp is from ending otherwise: positive holds, negative fails.

    The closed form is of slip about to start, so where the simulated label says otherwise it is
    right: a grasp that turns a little and then holds is as far from failing as its turn is from
    the limit.

    Parameters
    ----------
    label : (..., ) int
        1, 0, or −1 where the grasp was not executed, which counts as a clear failure.
    friction_ratio, torsion_ratio : (...) float
        As in ``closed_form_slack``.
    turn_rad : (...) float
        How far the lifted object had turned.
    """
    slip = np.nan_to_num(closed_form_slack(friction_ratio, torsion_ratio), nan=-FARTHEST)
    with np.errstate(invalid="ignore"):
        turned = 0.5 * np.abs(np.log(np.maximum(turn_rad, 1e-6) / TURN_LIMIT_RAD))
    aside = np.clip(np.nan_to_num(turned, nan=LEAST), LEAST, NEAR)
    sign = np.where(label == 1, 1.0, -1.0)
    agrees = np.where(label == 1, slip > 0, slip < 0)
    return np.where(label < 0, -1.0, np.where(agrees, slip, sign * aside))


def turning_share(
    label: NDArray[np.int64],
    turned: NDArray[np.bool_],
    friction_ratio: FloatArray,
    torsion_ratio: FloatArray,
) -> FloatArray:
    """Probability that a grasp, if it fails, fails by turning and not by sliding.

    A simulated failure says which it was; of a success, the nearer limit would give way first.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        lead = np.log(friction_ratio) - np.log(torsion_ratio)
    lead = np.clip(np.nan_to_num(lead, nan=0.0), -FARTHEST, FARTHEST)
    nearer = 1 / (1 + np.exp(-lead / _MODE_WIDTH))
    likely = (1 - SURE_MODE) + (2 * SURE_MODE - 1) * nearer
    known = np.where(turned, SURE_MODE, 1 - SURE_MODE)
    return np.where(label == 0, known, np.where(label < 0, 0.5, likely))


def slack_at_force(log_scale: FloatArray, slack: FloatArray, wanted: FloatArray) -> FloatArray:
    """Slack (M, N) at other forces, from the slack (K, N) at ``log_scale`` (K,) of the force.

    What holds grows in proportion to the force, so beyond the ends the slope is 1.

    Parameters
    ----------
    wanted : (M, N) float
        Logarithm of the force of each grasp over the declared one.
    """
    beyond = wanted - np.clip(wanted, log_scale[0], log_scale[-1])
    return np.clip(at_force(log_scale, slack, wanted) + beyond, -FARTHEST, FARTHEST)


def at_force(log_scale: FloatArray, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """Anything (M, N) of each grasp at its own ``wanted`` force, from (K, N) at ``log_scale``."""
    columns = range(values.shape[1])
    return np.stack([np.interp(wanted[:, n], log_scale, values[:, n]) for n in columns], axis=1)


def slack_at_torsion(
    slack: FloatArray, friction_ratio: FloatArray, torsion_ratio: FloatArray, log_factor: FloatArray
) -> FloatArray:
    """Slack (M, N) where the pads hold a moment that is larger by ``log_factor`` (M,).

    Grasps change by as much as turning has a part in their slip.
    """
    before = closed_form_slack(friction_ratio, torsion_ratio)
    after = closed_form_slack(friction_ratio, torsion_ratio, np.exp(log_factor)[:, None])
    return np.clip(slack + np.nan_to_num(after - before), -FARTHEST, FARTHEST)


def holds_from(log_force: FloatArray, slack: FloatArray) -> float | None:
    """The force from which on a grasp holds, of those at which it was simulated (K,).

    By the closed form where it agrees with the simulation on both sides: slack then lies as far
    apart as the forces do. Else half-way, so that the next simulation halves what is not known.
    None if it holds or fails everywhere, or begins to hold more than once.
    """
    changes = np.flatnonzero(np.diff(slack > 0))
    if len(changes) != 1 or slack[0] > 0:
        return None
    (low, high), (below, above) = (row[changes[0] :][:2] for row in (log_force, slack))
    if abs((above - below) - (high - low)) < SAME_SLACK:
        return float(low - below)
    return float(low + high) / 2


def crossings(axis: FloatArray, slack: FloatArray) -> FloatArray:
    """Where on ``axis`` (M,) the interpolated slack (M,) of a grasp passes through zero."""
    at = np.flatnonzero(slack[:-1] * slack[1:] < 0)
    part = slack[at] / (slack[at] - slack[at + 1])
    places: FloatArray = axis[at] + part * (axis[at + 1] - axis[at])
    return places
