"""The press log as a rig writes it: noise, the contract's columns and some that mean nothing."""

from __future__ import annotations

from collections.abc import Set

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from validation.blind.independent.draws import Floats, uniform
from validation.blind.independent.drive import Channel
from validation.blind.independent.session import Session

Columns = dict[str, NDArray[np.generic]]


def log_frame(
    session: Session,
    normal: Channel,
    shear: Channel,
    names: Set[str],
    *,
    noise_rng: np.random.Generator,
    columns_rng: np.random.Generator,
) -> pd.DataFrame:
    """One row a frame.

    A covariate is logged where an effect follows it (``names``), and most often where none does.
    """
    rng, clock, trial = columns_rng, session.clock, session.clock.trial
    of_normal, of_shear = _measured(session, normal, shear, noise_rng)
    columns: Columns = {
        "trial": trial + int(rng.integers(0, 2)),
        "time_s": clock.session_s[clock.sampled],
        **of_normal,
    }
    known = session.covariates
    if "geometry" in names or rng.random() < 0.85:
        columns |= {"indenter": known.indenter[trial], "radius_mm": known.radius_mm[trial]}
    if "position" in names or rng.random() < 0.85:
        columns |= {"x_mm": known.x_mm[trial], "y_mm": known.y_mm[trial]}
    if session.has_shear:
        columns |= of_shear
    if "temperature" in names or rng.random() < 0.7:
        columns["temperature_c"] = known.temperature_c[clock.sampled]
    distracts = rng.random() < 0.5
    if "operator" in names or (distracts and rng.random() < 0.5):
        columns["operator"] = known.operator[trial]
    if "humidity_percent" in names or (distracts and rng.random() < 0.5):
        columns["humidity_percent"] = known.humidity_percent[trial]
    if distracts:
        columns |= {name: values[trial] for name, values in _distractors(session, rng).items()}
    return pd.DataFrame(columns)


def _measured(
    session: Session, normal: Channel, shear: Channel, rng: np.random.Generator
) -> tuple[Columns, Columns]:
    """Forces and responses of both channels with noise, which may be correlated in time."""
    trial = session.clock.trial
    correlation = uniform(rng, 0.3, 0.6) if rng.random() < 0.25 else 0.0
    force_n = normal.force_n + session.gauge_noise_n * rng.normal(size=trial.size)
    shear_n = shear.force_n + session.gauge_noise_shear_n * rng.normal(size=(trial.size, 2))
    volume_noise = _noise(rng, trial, 1, correlation)[:, 0]
    moved_mm = shear.response + session.noise_mm * _noise(rng, trial, 2, correlation)
    of_normal: Columns = {
        "force_normal_n": np.maximum(force_n, 1e-3),
        "volume_mm3": normal.response + session.noise_mm3 * volume_noise,
    }
    of_shear: Columns = {
        "force_shear_x_n": shear_n[:, 0],
        "force_shear_y_n": shear_n[:, 1],
        "shear_x_mm": moved_mm[:, 0],
        "shear_y_mm": moved_mm[:, 1],
    }
    return of_normal, of_shear


def _noise(
    rng: np.random.Generator, trial: NDArray[np.intp], n_columns: int, correlation: float
) -> Floats:
    """Noise of standard deviation 1, white or with a memory of the frame before in the trial."""
    noise = rng.normal(size=(trial.size, n_columns))
    if correlation:
        new = np.sqrt(1 - correlation**2)
        for row in range(1, trial.size):
            if trial[row] == trial[row - 1]:
                noise[row] = correlation * noise[row - 1] + new * noise[row]
    return noise


def _distractors(session: Session, rng: np.random.Generator) -> Columns:
    """One to three columns of one value a trial that nothing follows."""
    n_trials = len(session.force_n)
    passed = session.clock.start_s / session.clock.end_s
    charge = (passed * uniform(rng, 1, 3) + rng.random()) % 1
    possible: Columns = {
        "battery_v": 12.6 - 0.8 * charge + 0.02 * rng.normal(size=n_trials),
        "room_light_lux": np.clip(
            uniform(rng, 200, 500) + 30 * rng.normal(size=n_trials).cumsum(), 20, None
        ),
        "approach_angle_deg": rng.uniform(-5, 5, n_trials),
        "wrist_joint_deg": rng.uniform(-170, 170, n_trials),
        "air_pressure_hpa": 1013 + 0.3 * rng.normal(size=n_trials).cumsum(),
        "camera": np.array(["cam_a", "cam_b"])[rng.integers(0, 2, n_trials)],
    }
    chosen = rng.permutation(sorted(possible))[: int(rng.integers(1, 4))]
    return {str(name): possible[str(name)] for name in chosen}
