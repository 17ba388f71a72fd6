"""Domain randomisation: what a grasp's own seed changes about the world it happens in."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tacgen.collection.recipe import Randomize
from tacgen.core.records import GraspConfig, GraspObject, Mesh, frozen_array

# Relative changes are log-normal, so that no draw makes a mass or a friction negative; beyond
# this many standard deviations a draw is pulled back, so that none is absurd.
_MAX_DEVIATIONS = 3.0


@dataclass(frozen=True, slots=True)
class Variation:
    """One draw: factors on figures of the recipe, and shifts in mm and rad."""

    friction_factor: float = 1.0
    mass_factor: float = 1.0
    center_of_mass_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    k_n_factor: float = 1.0
    gain_factor: float = 1.0
    position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0


def draw_variation(spread: Randomize, rng: np.random.Generator) -> Variation:
    """Draw what one grasp varies; the same generator state gives the same draw.

    Every figure consumes its random numbers whether it is varied or not, so that switching one
    on leaves the draws of the others as they were.
    """
    z = np.clip(rng.standard_normal(11), -_MAX_DEVIATIONS, _MAX_DEVIATIONS)
    return Variation(
        friction_factor=float(np.exp(spread.friction_relative * z[0])),
        mass_factor=float(np.exp(spread.mass_relative * z[1])),
        center_of_mass_mm=_triple(spread.center_of_mass_mm * z[2:5]),
        k_n_factor=float(np.exp(spread.k_n_relative * z[5])),
        gain_factor=float(np.exp(spread.sensor_gain_relative * z[6])),
        position_mm=_triple(spread.position_mm * z[7:10]),
        yaw_rad=float(spread.yaw_rad * z[10]),
    )


def vary_object(grasped: GraspObject, variation: Variation) -> GraspObject:
    """The object with its friction, mass and centre of mass changed."""
    moved = grasped.center_of_mass_mm + np.asarray(variation.center_of_mass_mm)
    varied = with_friction(grasped, grasped.friction * variation.friction_factor)
    varied = with_mass(varied, grasped.mass_kg * variation.mass_factor)
    return replace(varied, center_of_mass_mm=frozen_array(moved))


def with_friction(grasped: GraspObject, friction: float) -> GraspObject:
    """The object with another Coulomb coefficient.

    The moment a patch holds about its normal is proportional to μ, so the spinning friction
    follows.
    """
    ratio = friction / grasped.friction if grasped.friction > 0 else 1.0
    return replace(
        grasped,
        friction=friction,
        spinning_friction_mm=grasped.spinning_friction_mm * ratio,
    )


def with_mass(grasped: GraspObject, mass_kg: float) -> GraspObject:
    """The object with another mass, distributed as before."""
    inertia = grasped.inertia_kg_mm2 * (mass_kg / grasped.mass_kg)
    return replace(grasped, mass_kg=mass_kg, inertia_kg_mm2=frozen_array(inertia))


def with_scale(grasped: GraspObject, factor: float) -> GraspObject:
    """The object of another size about the centre of its footprint, its mass as before."""

    def scaled(mesh: Mesh) -> Mesh:
        return Mesh(frozen_array(mesh.vertices_mm * factor), mesh.faces)

    return replace(
        grasped,
        surface=scaled(grasped.surface),
        collision=tuple(scaled(part) for part in grasped.collision),
        center_of_mass_mm=frozen_array(grasped.center_of_mass_mm * factor),
        inertia_kg_mm2=frozen_array(grasped.inertia_kg_mm2 * factor**2),
    )


def vary_config(config: GraspConfig, variation: Variation) -> GraspConfig:
    """The configuration as it is carried out, off from the one asked for."""
    dx_mm, dy_mm, dz_mm = variation.position_mm
    return replace(
        config,
        x_mm=config.x_mm + dx_mm,
        y_mm=config.y_mm + dy_mm,
        z_mm=config.z_mm + dz_mm,
        yaw_rad=config.yaw_rad + variation.yaw_rad,
    )


def _triple(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
