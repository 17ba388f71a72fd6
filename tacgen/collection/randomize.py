"""Domain randomisation: what a grasp's own seed changes about the declared simulation."""

from dataclasses import dataclass, field, replace

import numpy as np

from tacgen.collection.perturbed import Perturbation, shift_of_center
from tacgen.collection.recipe import Randomize
from tacgen.core.records import GraspConfig

# Relative changes are log-normal, so that no draw makes a mass or a friction negative; beyond
# this many standard deviations a draw is pulled back, so that none is absurd.
_MAX_DEVIATIONS = 3.0


@dataclass(frozen=True, slots=True)
class Variation:
    """One draw: changes to object, gel and camera, and shifts of the grasp in mm and rad."""

    perturbation: Perturbation = field(default_factory=Perturbation)
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
    x_mm, y_mm, z_mm = (spread.position_mm * z[7:10]).tolist()
    return Variation(
        Perturbation(
            friction_factor=float(np.exp(spread.friction_relative * z[0])),
            mass_factor=float(np.exp(spread.mass_relative * z[1])),
            **shift_of_center((spread.center_of_mass_mm * z[2:5]).tolist()),
        ),
        k_n_factor=float(np.exp(spread.k_n_relative * z[5])),
        gain_factor=float(np.exp(spread.sensor_gain_relative * z[6])),
        position_mm=(x_mm, y_mm, z_mm),
        yaw_rad=float(spread.yaw_rad * z[10]),
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
