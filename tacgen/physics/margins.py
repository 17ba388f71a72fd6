"""How far a grasp is from slipping: closed forms on the forces at the moment of grasp."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tacgen.core.compiled import njit
from tacgen.core.records import ContactPatch, SlipMargin, frozen_array
from tacgen.core.types import (
    MM_PER_M,
    PUBLISHED_K_N_MM3_PER_N,
    STANDARD_GRAVITY_M_S2,
    FloatArray,
    cross,
)
from tacgen.physics.contacts import Contacts

TorsionLimit = Callable[[float], float]
"""Moment about its normal that a pad holds, mm for each newton of normal force, by the share of
its friction that a tangential force takes up."""
ROTATION_CENTERS = np.concatenate([[0.0], np.geomspace(0.05, 50.0, 24)])
"""Places of a sliding patch's centre of rotation, from its middle, in mean distances of its
pressure: closest where the limits change most; the last leaves 2 % of friction for a moment."""

STIFFER_THAN_GEL = 10.0
"""The simulated pads are rigid: touches within 0.2 mm at 8 N share a force, whereas the places at
which objects come to rest vary by 0.01 to 0.04 mm."""


@dataclass(frozen=True, slots=True)
class Capacity:
    """What the pads can hold and what the lifted object asks of them.

    ``torsion_limit_n_mm`` already allows for the friction that the weight takes up,
    ``whole_torsion_n_mm`` does not; ``swing_moment_n_mm`` is what has to be held so that the
    object turns no farther than a success may; ``spinning_mm`` is what each pad's has to add to its
    contact points' friction, for each newton.
    """

    friction_limit_n: float
    tangential_load_n: float
    torsion_limit_n_mm: float
    whole_torsion_n_mm: float
    moment_n_mm: float
    swing_moment_n_mm: float
    spinning_mm: tuple[float, ...]

    @property
    def friction_share(self) -> float:
        """The part of the friction that the weight takes up; 1 and above slips."""
        if self.friction_limit_n <= 0:
            return np.inf
        return self.tangential_load_n / self.friction_limit_n


def torsion_factor(friction_share: float) -> float:
    """What is left of a patch's moment when ``friction_share`` of its friction holds a force.

    The limit surface of a soft contact, taken as an ellipsoid: (f/f_max)² + (m/m_max)² = 1.

    Source: Howe & Cutkosky 1996, Practical force-motion models for sliding manipulation.
    """
    return float(np.sqrt(max(0.0, 1.0 - friction_share**2)))


def dome_patch(force_n: float, *, dome_radius_mm: float, k_n_mm3_per_n: float) -> ContactPatch:
    """The patch of a domed gel on a flat face (or of a ball of that radius on a flat gel).

    An elastic foundation whose pressure is the indentation over k_n: a paraboloid over a circle of
    radius a = (4 R k_n F/π)^¼, which is that of V = π a⁴/(4 R) = k_n F.
    """
    radius_mm = (4 * dome_radius_mm * k_n_mm3_per_n * force_n / np.pi) ** 0.25
    r, angle = (np.arange(20) + 0.5) / 20, (np.arange(24) + 0.5) / 24 * 2 * np.pi
    share = np.repeat((1 - r**2) * r, len(angle))
    points_mm = radius_mm * np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], -1)
    return ContactPatch(points_mm.reshape(-1, 2), share / share.sum())


def dome_stiffness_n_mm2(dome_radius_mm: float) -> float:
    """Force of a pad over the square of its indentation, where it shares it between touches.

    ``STIFFER_THAN_GEL`` times that of ``dome_patch``, whose volume is V = π R δ² = k_n F.
    """
    return STIFFER_THAN_GEL * np.pi * dome_radius_mm / PUBLISHED_K_N_MM3_PER_N


def torsion_limit(patch: ContactPatch) -> TorsionLimit:
    """Largest moment of a sliding patch about its normal, over friction times normal force, mm.

    A share of its friction holds a force along the gel's y. Of all centres of rotation c on the x
    axis through the centre of pressure the least bound is the limit: E|r − c| − share |c| by the
    pressure's mean E. Without a force it is the mean distance of the pressure from its centre:
    8/15 a of ``dome_patch``, 2/3 a of a uniform pressure.

    Source: Goyal, Ruina & Papadopoulos 1991, Planar sliding with dry friction 1.
    """
    if len(patch.share) == 0:
        return lambda _: 0.0
    arms_mm = patch.points_mm - patch.share @ patch.points_mm
    mean_mm = _mean_distances(arms_mm, patch.share, np.zeros(1))
    levers = mean_mm * np.concatenate([-ROTATION_CENTERS, ROTATION_CENTERS])
    distances = _mean_distances(arms_mm, patch.share, levers)

    def limit_mm(friction_share: float) -> float:
        if friction_share >= 1:
            return 0.0
        return max(0.0, float(np.min(distances - friction_share * np.abs(levers))))

    return limit_mm


@njit(cache=True, nogil=True)
def _mean_distances(points: FloatArray, share: FloatArray, x: FloatArray) -> FloatArray:
    """Mean distances of ``points`` (n, 2) from each (x, 0), each counted by its ``share`` (n,)."""
    total = np.zeros(x.shape)
    for k in range(share.shape[0]):
        for i in range(x.shape[0]):
            total[i] += share[k] * math.sqrt((points[k, 0] - x[i]) ** 2 + points[k, 1] ** 2)
    return total


def grasp_capacity(
    pressing: Sequence[tuple[Contacts, TorsionLimit]],
    *,
    closing_axis: FloatArray,
    center_of_mass_m: FloatArray,
    weight_n: float,
    friction: float,
    success_turn_rad: float,
) -> Capacity:
    """What pads, by the contacts of each and its torsion limit, can hold once the table is gone.

    In world axes. ``weight_n`` is with what the lift's acceleration adds to it. Tangential is the
    part of it across ``closing_axis`` that the contact normals do not carry; the moment is that of
    load and normal forces about the axis through the pads' centres of pressure. A pad's moment is
    that of its limit, or of its contact points' friction about their own centre if that is larger.

    An object whose moment is not held swings, and dry friction stops it once the moment's mean over
    the turn is the limit: a mass that hangs below the pads is let go and caught again. That is of
    an object let go at once; one that the table lets down slowly turns less, down to half as far.
    """
    up = np.array([0.0, 0.0, 1.0])
    pads = [pad for pad, _ in pressing]
    forces = np.concatenate([pad.normal_force_n for pad in pads])
    if forces.sum() <= 0:
        return Capacity(0.0, weight_n, 0.0, 0.0, 0.0, 0.0, (0.0,) * len(pads))
    points = np.concatenate([pad.point_m for pad in pads])
    pushes = forces[:, None] * np.concatenate([pad.normal for pad in pads])
    total_n = float(forces.sum())
    load = weight_n * up - pushes.sum(axis=0)
    load -= (load @ closing_axis) * closing_axis
    # Where the faces are slanted friction acts along them.
    slopes = np.abs(np.concatenate([pad.normal for pad in pads]) @ closing_axis)
    friction_limit_n = friction * float(forces @ slopes)
    tangential_load_n = float(np.linalg.norm(load))
    share = tangential_load_n / friction_limit_n if friction_limit_n > 0 else np.inf

    center = (forces @ points) / total_n
    lever = center_of_mass_m - center
    moment = cross(lever, -weight_n * up) + cross(points - center, pushes).sum(axis=0)
    along_n_m = float(moment @ closing_axis)
    # The mean over the turn is the moment half-way, where a mass below the pads has come nearer.
    above_m = lever[2] - closing_axis[2] * (lever @ closing_axis)
    change_n_m = success_turn_rad / 2 * weight_n * min(0.0, float(above_m))
    torsion_n_mm, whole_n_mm, spinning_mm = 0.0, 0.0, []
    for pad, limit in pressing:
        normal_n = float(pad.normal_force_n.sum())
        if normal_n <= 0:
            spinning_mm.append(0.0)
            continue
        arms = pad.point_m - (pad.normal_force_n @ pad.point_m) / normal_n
        arms -= np.outer(arms @ closing_axis, closing_axis)
        arm_mm = float(pad.normal_force_n @ np.linalg.norm(arms, axis=1) * MM_PER_M) / normal_n
        of_points_mm = friction * arm_mm * torsion_factor(share)
        spinning_mm.append(max(0.0, limit(share) - of_points_mm))
        torsion_n_mm += normal_n * (of_points_mm + spinning_mm[-1])
        whole_n_mm += normal_n * max(limit(0.0), friction * arm_mm)
    return Capacity(
        friction_limit_n=friction_limit_n,
        tangential_load_n=tangential_load_n,
        torsion_limit_n_mm=torsion_n_mm,
        whole_torsion_n_mm=whole_n_mm,
        moment_n_mm=abs(along_n_m) * MM_PER_M,
        swing_moment_n_mm=max(0.0, abs(along_n_m) + change_n_m) * MM_PER_M,
        spinning_mm=tuple(spinning_mm),
    )


def slip_margin(
    capacity: Capacity, mass_kg: float, first_slip_time_s: float, first_slip_direction: FloatArray
) -> SlipMargin:
    """The record of a grasp's margins, see ``records.SlipMargin``."""
    weight_n = mass_kg * STANDARD_GRAVITY_M_S2
    return SlipMargin(
        translational=(capacity.friction_limit_n - capacity.tangential_load_n) / weight_n,
        rotational=(capacity.torsion_limit_n_mm - capacity.moment_n_mm) / weight_n,
        first_slip_time_s=first_slip_time_s,
        first_slip_direction=frozen_array(first_slip_direction),
        friction_ratio=_ratio(capacity.friction_limit_n, capacity.tangential_load_n),
        torsion_ratio=_ratio(capacity.torsion_limit_n_mm, capacity.moment_n_mm),
        whole_torsion_ratio=_ratio(capacity.whole_torsion_n_mm, capacity.moment_n_mm),
        swing_moment_share=min(1.0, _ratio(capacity.swing_moment_n_mm, capacity.moment_n_mm)),
    )


def _ratio(limit: float, asked: float) -> float:
    """How many times over a limit suffices; infinite where nothing is asked of it."""
    return limit / asked if asked > 0 else float("inf")
