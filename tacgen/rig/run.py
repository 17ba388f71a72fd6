"""One session on the virtual rig, and the files that it leaves."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.contact.law import load_law, save_law
from tacgen.core.files import atomic_path, refuse_existing, refuse_foreign
from tacgen.core.progress import print_status
from tacgen.core.resources import __version__
from tacgen.core.sensors import load_sensor
from tacgen.optics.table import load_table
from tacgen.rig.effects import SessionTruth, true_response
from tacgen.rig.images import LAST, write_images
from tacgen.rig.markers import marker_tracks
from tacgen.rig.rig_recipe import RigRecipe
from tacgen.rig.schedule import NOISE, press_rng, true_session

DECIMALS = 6  # below any sensor's resolution
MARKER_DECIMALS = 3  # of a pixel


@dataclass(frozen=True, slots=True)
class Session:
    """A press log with noise, the true columns behind it, and the law they obey."""

    log: pd.DataFrame
    true_columns: dict[str, NDArray[Any]]
    truth: SessionTruth


def simulate_session(recipe: RigRecipe) -> Session:
    """Press by the recipe; the same recipe gives the same log."""
    true_columns = true_session(recipe)
    truth = true_response(recipe, true_columns)
    log = pd.DataFrame(_measured(recipe, true_columns, truth))
    return Session(log, true_columns, truth)


def run_rig(recipe: RigRecipe, out: Path, *, force: bool = False) -> list[Path]:
    """Write the recipe's session into ``out``; returns what was written.

    ``press_log.csv`` (unless only images are wanted), ``markers.csv`` where the recipe asks for
    tracks, ``presses/`` with ``background.png``, one
    image a line of ``presses.csv`` and ``sensor.yaml`` (unless only a log is), and
    ``truth.yaml``, the law that the gel really has, in the form of a ``contact.yaml``. A session
    that was interrupted is finished.

    Raises ``DatasetError`` if there is a session already, unless ``force``.
    """
    out = Path(out)
    truth, log, presses = out / "truth.yaml", out / "press_log.csv", out / "presses"
    tracks = out / "markers.csv"
    session = simulate_session(recipe)
    sensor = load_sensor(recipe.sensor, needs_table=False)
    pitch_mm = sensor.markers.pitch_mm if sensor.markers else np.nan
    provenance = {"rig": recipe.model_dump(mode="json"), "versions": {"tacgen": __version__}}
    law = replace(session.truth.law, marker_pitch_mm=pitch_mm, provenance=provenance)
    last = log if recipe.output == "log" else presses / LAST
    is_begun = truth.is_file() and not last.exists() and load_law(truth).provenance == provenance
    if is_begun:
        print_status(f"{out}: finishes the session that was interrupted")
    else:
        refuse_foreign(out, truth.name, [log.name, tracks.name, presses.name])
        refuse_existing(force, truth)
        # What is there of another session must not be taken for this one's.
        for path in (
            presses / LAST,
            log,
            tracks,
            *presses.glob("press_*.png"),
            presses / "presses.csv",
        ):
            path.unlink(missing_ok=True)
        save_law(law, truth)
    written = [truth]
    if recipe.markers is not None:
        found = marker_tracks(recipe, sensor, session.true_columns)
        with atomic_path(tracks) as partial:
            found.round(MARKER_DECIMALS).to_csv(partial, index=False)
        written.append(tracks)
    if recipe.output != "images":
        with atomic_path(log) as partial:
            session.log.round(DECIMALS).to_csv(partial, index=False)
        written.append(log)
    if recipe.output != "log":
        if sensor.table and "virtual" not in load_table(sensor.table).origin:
            print_status(
                f"warning: the rig's pictures are those of a virtual sensor: the table of "
                f"{sensor.name}, which is real, does not read them; calibrate one of these presses"
            )
        written.append(write_images(recipe, sensor, session.log, session.truth, presses))
    return written


def _measured(
    recipe: RigRecipe, true_columns: dict[str, NDArray[Any]], truth: SessionTruth
) -> dict[str, NDArray[Any]]:
    measured = dict(true_columns)
    trial = true_columns["trial"]
    counts = np.bincount(trial)
    draws = np.concatenate(
        [press_rng(recipe, press, NOISE).standard_normal((n, 7)) for press, n in enumerate(counts)]
    )
    noise = recipe.noise
    for column, name in enumerate(("force_normal_n", "force_shear_x_n", "force_shear_y_n")):
        measured[name] = true_columns[name] + noise.force_n * draws[:, column]
    measured["volume_mm3"] = truth.volume_mm3 + noise.volume_mm3 * draws[:, 3]
    # The noise is that of the sum's length: each axis has its share.
    per_axis = noise.marker_sum_mm / np.sqrt(2.0)
    measured["shear_x_mm"] = truth.shear_mm[:, 0] + per_axis * draws[:, 4]
    measured["shear_y_mm"] = truth.shear_mm[:, 1] + per_axis * draws[:, 5]
    if recipe.temperature is not None:
        measured["temperature_c"] = (
            true_columns["temperature_c"] + recipe.temperature.noise_c * draws[:, 6]
        )
    return measured
