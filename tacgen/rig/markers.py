"""Marker tracks of a rig session: what a camera that follows every dot would write."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.contact.ball_shear import STICKS, BallShear
from tacgen.contact.gel import mm_to_px
from tacgen.contact.shear import marker_grid_mm, turned
from tacgen.core.errors import RecipeError
from tacgen.core.records import Sensor
from tacgen.rig.rig_recipe import RigRecipe
from tacgen.rig.schedule import MARKERS, press_rng


def marker_tracks(
    recipe: RigRecipe, sensor: Sensor, columns: Mapping[str, NDArray[Any]]
) -> pd.DataFrame:
    """Rows of ``markers.csv`` for the true ``columns`` (N,) of a session.

    Raises ``RecipeError`` if the recipe asks for no tracks or the sensor has no markers.
    """
    given = recipe.markers
    if given is None or sensor.markers is None:
        msg = f"markers: the sensor {sensor.name} has none to follow"
        raise RecipeError(msg)
    gel = BallShear(sensor, given.decay_mm)
    rest = turned(marker_grid_mm(sensor), np.radians(given.grid_turn_deg)) + given.grid_shift_mm
    compliance = recipe.law.k_s_mm_per_n * sensor.markers.pitch_mm**2
    friction = given.friction or STICKS
    every = max(1, round(recipe.schedule.rate_hz / given.rate_hz))
    parts = []
    for press in np.unique(columns["trial"]):
        rows = np.flatnonzero(columns["trial"] == press)[::every]
        load = columns["force_normal_n"][rows]
        force = np.column_stack([columns[f"force_shear_{axis}_n"][rows] for axis in "xy"])
        ball = float(columns["radius_mm"][rows[0]])
        center = np.array([columns["x_mm"][rows[0]], columns["y_mm"][rows[0]]])
        k_n = recipe.law.k_n_mm3_per_n
        depth = [gel.depth_mm(ball, center, k_n * one) for one in load]
        pressure = [one / k_n for one in depth]
        strain = gel.strain(rest, pressure, force, friction, given.place)
        places = rest + compliance * strain
        places += np.stack([gel.dilation_mm(rest, one) for one in depth])
        rng = press_rng(recipe, int(press), MARKERS)
        places += given.noise_mm * rng.standard_normal(places.shape)
        px = mm_to_px(places, sensor.shape_px, sensor.mm_per_px)
        frame, marker = np.indices(places.shape[:2])
        parts.append(
            pd.DataFrame(
                {
                    "press": int(press),
                    "frame": frame.ravel() * every,
                    "marker": marker.ravel(),
                    "x_px": px[..., 0].ravel(),
                    "y_px": px[..., 1].ravel(),
                }
            )
        )
    return pd.concat(parts, ignore_index=True)
