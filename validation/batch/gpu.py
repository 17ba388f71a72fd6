"""A batch on a GPU: ``python -m validation.batch.gpu [OUT.json]``.

Nothing is built there but Warp's kernels. First the same pictures as ``Sensor``, then frames a
second, by CUDA events around whole batches of gap maps and of posed meshes: 64, 1024 and 4096
worlds, 320 × 240 and 640 × 480, with shadows and without. Then Taxim's GPU port (package taxim,
torch and JAX) where it is there, by the wall's clock.
"""

import importlib.util
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import warp as wp

import tacgen
from tacgen.contact import gap_map
from validation.batch.__main__ import compare_all, shipped_meshes
from validation.batch.frames import random_frames

WORLDS, SENSORS, REPEATS = (64, 1024, 4096), ("gelsight_mini", "gelsight"), 10
SAME_FRAMES = 256
TAXIM_FRAMES = 64


def frames_per_s(draw: Callable[[], object], n: int) -> float:
    """Median over ``REPEATS`` batches of n frames, after two that warm up."""
    times_ms = []
    for _ in range(REPEATS + 2):
        start, stop = (wp.Event(enable_timing=True) for _ in range(2))
        wp.record_event(start)
        draw()
        wp.record_event(stop)
        wp.synchronize_event(stop)
        times_ms.append(wp.get_event_elapsed_time(start, stop))
    return 1e3 * n / float(np.median(times_ms[2:]))


def measure(name: str, n: int, *, shadows: bool) -> dict[str, Any]:
    """Frames a second of one sensor in n worlds."""
    sensor = tacgen.BatchSensor(name, n, "cuda", shadows=shadows)
    meshes = shipped_meshes()
    for mesh in meshes:
        sensor.add_mesh(mesh)
    frames = random_frames(np.random.default_rng(1), meshes, 64)
    frames = [frames[k % len(frames)] for k in range(n)]
    some = [(gap_map(meshes[i].vertices_mm, meshes[i].faces, pose, sensor.description), force)
            for i, pose, force in frames[:64]]  # fmt: skip
    gaps = wp.array(np.stack([some[k % 64][0] for k in range(n)]), device="cuda")
    ids, poses, force = (np.array(one) for one in zip(*frames, strict=True))
    on_gpu = wp.array(ids, device="cuda"), wp.array(poses, device="cuda")
    force_n = wp.array(force, device="cuda")
    height, width = sensor.description.shape_px
    return {
        "sensor": name, "size": f"{width}x{height}", "worlds": n, "shadows": shadows,
        "gap_maps_per_s": frames_per_s(lambda: sensor.render(gaps, force_n), n),
        "meshes_per_s": frames_per_s(lambda: sensor.render_meshes(*on_gpu, force_n), n),
    }  # fmt: skip


def measure_taxim(backend: str, *, shadows: bool) -> dict[str, Any]:
    """Frames a second of Taxim's GPU port, an image at a time as it takes them."""
    from taxim import Taxim

    try:
        taxim = Taxim(backend=backend, device="cuda")
    except ImportError as error:
        return {"taxim": backend, "error": str(error)}
    sensor, meshes = tacgen.Sensor("virtual_gelsight").description, shipped_meshes()
    frames = random_frames(np.random.default_rng(1), meshes, TAXIM_FRAMES)
    heights = []  # distances to the highest point of the gel, mm
    for i, pose, _ in frames:
        gap_mm = gap_map(meshes[i].vertices_mm, meshes[i].faces, pose, sensor)
        height_mm = cv2.resize(np.minimum(gap_mm, 50.0), (taxim.width, taxim.height))
        heights.append(taxim.convert_height_map(height_mm))

    def draw() -> None:
        for height in heights:
            image = taxim.render(height, with_shadow=shadows, press_depth=1.0)
        np.asarray(taxim.img_to_numpy(image))  # waits for all of them

    times_s = []
    for _ in range(5):
        start = time.perf_counter()
        draw()
        times_s.append(time.perf_counter() - start)
    rate = TAXIM_FRAMES / float(np.median(times_s[2:]))
    size = f"{taxim.width}x{taxim.height}"
    return {"taxim": backend, "shadows": shadows, "size": size, "frames_per_s": rate}


def main(out: Path) -> int:
    """Check, measure, print and write."""
    is_same = compare_all(SAME_FRAMES, "cuda", shipped_meshes())
    found: dict[str, Any] = {"device": wp.get_device("cuda").name, "is_same": is_same, "rates": []}
    for name in SENSORS:
        for n in WORLDS:
            for shadows in (False, True):
                found["rates"].append(measure(name, n, shadows=shadows))
                print(found["rates"][-1], flush=True)  # noqa: T201
                out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    cases = [(backend, shadows) for backend in ("torch", "jax") for shadows in (False, True)]
    has_taxim = importlib.util.find_spec("taxim") is not None
    found["taxim"] = [measure_taxim(b, shadows=on) for b, on in cases] if has_taxim else "not there"
    print(found["taxim"])  # noqa: T201
    out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return 0 if is_same else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "batch_gpu.json")))
