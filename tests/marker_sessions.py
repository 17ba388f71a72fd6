"""Sessions of the virtual rig with marker tracks, for tests of several folders."""

from __future__ import annotations

from pathlib import Path

from tacgen.core.sensors import load_sensor
from tacgen.presses.marker_tracks import MarkerTracks, read_marker_tracks
from tacgen.presses.press_log import PressLog, read_press_log
from tacgen.rig import load_rig_recipe, run_rig
from tacgen.rig.rig_recipe import MarkerTracks as TrackRecipe

K_N, K_S = 5.135, 0.8
SENSOR = load_sensor("virtual_gelsight", needs_table=False)


def make_session(folder: Path, *, presses: int = 8, seed: int = 0, **markers) -> Path:
    """A folder with press_log.csv and markers.csv; ``markers`` as in a rig's recipe."""
    given = load_rig_recipe("rig")
    schedule = given.schedule.model_copy(
        update={"presses": presses, "shear_ratio": (0.15, 0.5), "force_n": (3.0, 9.0)}
    )
    tracks = TrackRecipe.model_validate({"rate_hz": 3.0, **markers})
    run_rig(
        given.model_copy(update={"schedule": schedule, "markers": tracks, "seed": seed}), folder
    )
    return folder


def read_session(folder: Path) -> tuple[PressLog, MarkerTracks]:
    log = read_press_log(folder / "press_log.csv")
    return log, read_marker_tracks(folder / "markers.csv", SENSOR, log)
