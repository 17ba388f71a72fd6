"""Time of a batch against that of one sensor: ``python -m validation.batch.speed``.

64 worlds, drawn in turn by ``BatchSensor.render_meshes``, on all cores, and by 64 calls of
``Sensor.render``, from the same meshes; then from gap maps. By the clock, on a machine with nothing
else to do, and in processor seconds of all threads together; medians of the ratios of the pairs.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

import tacgen
from tacgen.contact import gap_map
from validation.batch.__main__ import shipped_meshes, shipped_sensors
from validation.batch.frames import random_frames

WORLDS, PAIRS = 64, 9


def seconds(draw: Callable[[], object]) -> NDArray[np.float64]:
    """Seconds by the clock, and that the process has computed for (2,)."""
    start = np.array([time.perf_counter(), time.process_time()])
    draw()
    return np.array([time.perf_counter(), time.process_time()]) - start


def measure(name: str, *, shadows: bool) -> str:
    """A line of figures of one sensor."""
    meshes = shipped_meshes()[:4]
    sensor = tacgen.Sensor(name, shadows=shadows)
    batch = tacgen.BatchSensor(name, WORLDS, "cpu", shadows=shadows)
    for mesh in meshes:
        batch.add_mesh(mesh)
    frames = sorted(random_frames(np.random.default_rng(3), meshes, WORLDS), key=lambda one: one[0])
    frames = [(i, pose, min(force, 25.0)) for i, pose, force in frames]
    ids, poses, force_n = (np.array(one) for one in zip(*frames, strict=True))
    gaps = np.stack([gap_map(meshes[i].vertices_mm, meshes[i].faces, pose, sensor.description)
                     for i, pose, _ in frames])  # fmt: skip

    def single() -> None:
        for i, pose, force in frames:
            sensor.render(meshes[i], pose, force)

    ways: dict[str, Callable[[], object]] = {
        "meshes": partial(batch.render_meshes, ids, poses, force_n),
        "gap maps": partial(batch.render, gaps, force_n),
    }
    single()
    parts = []
    for what, draw in ways.items():
        draw()
        pairs = np.array([(seconds(draw), seconds(single)) for _ in range(PAIRS)])
        by_clock, of_processor = np.median(pairs[:, 0] / pairs[:, 1], axis=0)
        own, other = 1e3 * np.median(pairs[:, :, 0], axis=0) / WORLDS
        parts.append(
            f"{what} {own:.2f} ms, Sensor {other:.2f} ms, ratio {by_clock:.2f} by the clock, "
            f"{of_processor:.2f} in processor seconds"
        )
    return f"{name:<18} {'shadows' if shadows else '':<8}" + "; ".join(parts)


if __name__ == "__main__":
    for sensor_name in shipped_sensors():
        for with_shadows in (False, True):
            print(measure(sensor_name, shadows=with_shadows), flush=True)  # noqa: T201
