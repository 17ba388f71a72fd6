"""How fast this machine makes frames and grasps, reads pictures, calibrates and diagnoses.

Every figure is the median of repeats on one thread, of wall time by ``perf_counter``. A frame is
timed from the posed mesh to the RGB array: gap map, indentation, deformation, colour. A grasp is
timed from its configuration to the images, all phases simulated up to the label, without the
scene picture and without writing. A batch runs on all cores, and so do the fits of a table, which
are timed once, as a diagnosis is.
"""

import statistics
import tempfile
import timeit
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.table_fit import calibrate
from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe
from tacgen.contact import gap_map, solve_indentation
from tacgen.contact.gel_response import GelLoad
from tacgen.contact.indenter import Imprint
from tacgen.core.records import Mesh
from tacgen.core.sensors import load_sensor
from tacgen.diagnose.contact.command import diagnose
from tacgen.objects import load_object
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_log import read_press_log
from tacgen.rig import load_rig_recipe, run_rig
from tacgen.sensor.read_image import ImageReader
from tacgen.sensor.tactile_pad import TactilePad

FRAME_OBJECT = "tomato_soup_can"
FRAME_VOLUME_MM3 = 40.0  # about what 8 N press into the default gel
BATCHES, BATCH_FORCE_N, BATCH_WORLDS = (1, 64, 1024), 8.0, 64
GRASP = {"force_n": 10.0, "x_mm": 0.0, "y_mm": 0.0, "z_mm": 60.0}
SEQUENCE_FRAMES = 24  # of the default recipe
SIDE_POSE = (
    (0.0, 1.0, 0.0, 0.0),
    (0.0, 0.0, -1.0, 0.0),
    (-1.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.0, 1.0),
)
"""The object lying against the gel with its +x side; its middle is to be over the pad's centre."""

Figure = tuple[str, float, str, str]
"""One measured figure: its name, its median, its unit, and what was timed."""


def run_benchmarks(repeats: int) -> Iterator[Figure]:
    """Measure everything; 30 repeats take about a minute."""
    yield from _frame_figures(repeats)
    yield from _grasp_figures(max(5, repeats // 3))
    yield from batch_figures([BATCH_WORLDS], "cpu", repeats)
    yield from reading_figures(repeats)
    yield from _measurement_figures()


def batch_figures(sizes: Sequence[int], device: str, repeats: int) -> Iterator[Figure]:
    """Time a frame of batches of so many worlds, from posed meshes and from gap maps.

    Raises ``SensorError`` if Warp or the device is not there, or the memory does not suffice.
    """
    from tacgen.batch.sensor import BatchSensor

    surface, pose = _side_of_object()
    for name in ("gelsight_mini", "gelsight"):
        for n in sizes:
            batch = BatchSensor(name, n, device)
            batch.add_mesh(surface)
            one = gap_map(surface.vertices_mm, surface.faces, pose, batch.description)
            poses, gap_mm = np.repeat(pose[None], n, axis=0), np.repeat(one[None], n, axis=0)
            given: list[Any] = [np.zeros(n, int), poses, np.full(n, BATCH_FORCE_N), gap_mm]
            if device != "cpu":
                import warp as wp

                given = [wp.array(values, device=device) for values in given]
            ids, poses, force_n, gap_mm = given
            height, width = batch.description.shape_px
            for what, frames in (
                ("meshes", partial(batch.render_meshes, ids, poses, force_n)),
                ("gap maps", partial(batch.render, gap_mm, force_n)),
            ):
                seconds = _median_s(frames, max(3, repeats // n)) / n
                rate = f"{name}, {what}, {n} worlds on {device}: {1 / seconds:.0f} frames/s"
                key = f"batch_{n}_{what.split()[0]}_ms_{width}x{height}"
                yield key, 1e3 * seconds, "ms", rate


def _side_of_object() -> tuple[Mesh, NDArray[np.float64]]:
    """An object that lies against the gel with its side."""
    surface = load_object(FRAME_OBJECT).surface
    pose = np.array(SIDE_POSE)
    pose[1, 3] = float(np.mean(surface.vertices_mm[:, 2]))
    return surface, pose


def _frame_figures(repeats: int) -> Iterator[Figure]:
    surface, pose = _side_of_object()
    for name, sensor_name, shadows in (
        ("frame_ms_640x480", "gelsight", False),
        ("frame_shadow_ms_640x480", "gelsight", True),
        ("frame_ms_320x240", "gelsight_mini", False),
    ):
        pad = TactilePad(load_sensor(sensor_name), shadows=shadows)
        frame = partial(pad.render, surface, pose, GelLoad(FRAME_VOLUME_MM3))
        what = f"{sensor_name}, {len(surface.faces)} triangles{', shadows' if shadows else ''}"
        yield name, 1e3 * _median_s(frame, repeats), "ms", what
    sensor = load_sensor("gelsight")
    make_gap = partial(gap_map, surface.vertices_mm, surface.faces, pose, sensor)
    solve = partial(solve_indentation, make_gap(), FRAME_VOLUME_MM3, sensor.pixel_area_mm2)
    yield "gap_map_ms", 1e3 * _median_s(make_gap, repeats), "ms", "whole 640×480 map, by itself"
    yield "solve_ms", 1e3 * _median_s(solve, repeats), "ms", "V → δ on the whole map, by itself"


def _grasp_figures(repeats: int) -> Iterator[Figure]:
    for name, frames, what in (
        ("grasp_s_single", {"mode": "single"}, "1 image"),
        ("grasp_s_sequence", {"mode": "sequence", "count": SEQUENCE_FRAMES}, "24 images"),
    ):
        sections = {"objects": [FRAME_OBJECT], "grid": GRASP, "frames": frames}
        no_pictures = {"scene_pictures": False}
        recipe = Recipe.model_validate({"name": "bench", **sections, "dataset": no_pictures})
        planned = plan_recipe(recipe)[0]
        with GraspPipeline(recipe) as pipeline:
            seconds = _median_s(partial(pipeline.sample, planned), repeats)
        yield name, seconds, "s", f"floating gripper, {FRAME_OBJECT}, {what}"


def reading_figures(repeats: int) -> Iterator[Figure]:
    """Time the reading of one picture of each size, by a reader that is kept."""
    surface, pose = _side_of_object()
    for name in ("gelsight_mini", "gelsight"):
        sensor = load_sensor(name)
        pad = TactilePad(sensor)
        rgb = pad.render(surface, pose, GelLoad(FRAME_VOLUME_MM3))
        read = partial(ImageReader(name, pad.image(Imprint())).read, rgb)
        size = f"{sensor.width_px}x{sensor.height_px}"
        yield f"read_ms_{size}", 1e3 * _median_s(read, repeats), "ms", f"{name}, a picture to depth"


def _measurement_figures() -> Iterator[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        run_rig(load_rig_recipe("rig_images"), Path(folder) / "images")
        presses = read_presses(Path(folder) / "images" / "presses")
        count = len(presses.experiment)
        seconds = timeit.timeit(partial(calibrate, presses), number=1)
        yield "calibrate_lookup_s", seconds, "s", f"one table of {count} simulated pictures, scored"
        run_rig(load_rig_recipe("rig"), Path(folder) / "log")
        log = read_press_log(Path(folder) / "log" / "press_log.csv")
        rows = len(next(iter(log.columns.values())))
        seconds = timeit.timeit(partial(diagnose, log.columns), number=1)
        yield "diagnose_contact_s", seconds, "s", f"one simulated log of {rows} rows"


def _median_s(action: Callable[[], object], repeats: int) -> float:
    for _ in range(2):
        action()
    return statistics.median(timeit.repeat(action, number=1, repeat=repeats))
