"""How far a grasp is from slipping: closed forms on the forces at the moment of grasp."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.core.records import SlipMargin, frozen_array
from tacgen.core.units import MM_PER_M, STANDARD_GRAVITY_M_S2
from tacgen.physics.contacts import Contacts


@dataclass(frozen=True, slots=True)
class Capacity:
    """What the pads can hold and what the lifted object asks of them.

    ``torsion_limit_n_mm`` already allows for the friction that the weight takes up.
    """

    friction_limit_n: float
    tangential_load_n: float
    torsion_limit_n_mm: float
    moment_n_mm: float

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


def grasp_capacity(
    pads: Sequence[Contacts],
    *,
    closing_axis: FloatArray,
    center_of_mass_m: FloatArray,
    mass_kg: float,
    friction: float,
    spinning_friction_mm: float,
) -> Capacity:
    """What ``pads``, by the contacts of each, can hold once the table is gone, world axes.

    The tangential load is the part of the weight across ``closing_axis`` that the contact
    normals do not carry; the moment is that of weight and normal forces about the axis through
    the pads' centres of pressure. A pad's moment is its spinning friction's and that of its
    contact points' friction about their own centre.
    """
    up = np.array([0.0, 0.0, 1.0])
    weight_n = mass_kg * STANDARD_GRAVITY_M_S2
    pads = [pad for pad in pads if pad.normal_force_n.sum() > 0]
    if not pads:
        return Capacity(0.0, weight_n, 0.0, 0.0)
    forces = np.concatenate([pad.normal_force_n for pad in pads])
    points = np.concatenate([pad.point_m for pad in pads])
    pushes = forces[:, None] * np.concatenate([pad.normal for pad in pads])
    total_n = float(forces.sum())
    load = weight_n * up - pushes.sum(axis=0)
    load -= (load @ closing_axis) * closing_axis
    friction_limit_n = friction * total_n
    tangential_load_n = float(np.linalg.norm(load))
    share = tangential_load_n / friction_limit_n if friction_limit_n > 0 else np.inf

    center = (forces @ points) / total_n
    moment = np.cross(center_of_mass_m - center, -weight_n * up)
    moment += np.cross(points - center, pushes).sum(axis=0)
    torsion_n_mm = spinning_friction_mm * total_n
    for pad in pads:
        arms = pad.point_m - (pad.normal_force_n @ pad.point_m) / pad.normal_force_n.sum()
        arms -= np.outer(arms @ closing_axis, closing_axis)
        torsion_n_mm += friction * float(
            pad.normal_force_n @ np.linalg.norm(arms, axis=1) * MM_PER_M
        )
    return Capacity(
        friction_limit_n=friction_limit_n,
        tangential_load_n=tangential_load_n,
        torsion_limit_n_mm=torsion_n_mm * torsion_factor(share),
        moment_n_mm=abs(float(moment @ closing_axis)) * MM_PER_M,
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
    )


def _ratio(limit: float, asked: float) -> float:
    """How many times over a limit suffices; infinite where nothing is asked of it."""
    return limit / asked if asked > 0 else float("inf")
