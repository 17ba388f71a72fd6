"""A batch on a GPU: ``python -m validation.batch.gpu [OUT.json] [cuda | cpu]``.

Nothing is built there but Warp's kernels. Beside torch, JAX, numba, SciPy and OpenCV it needs
warp-lang, trimesh, manifold3d, pydantic, pydantic-core and annotated-types: a machine without a
network installs their wheels, which ``pip download --no-deps`` fetched elsewhere, by ``pip install
--no-index --no-deps``. First the same pictures as ``Sensor``, then frames a
second of whole batches of gap maps, of posed meshes and of meshes that pull: 64, 1024 and 4096
worlds, 320 × 240 and 640 × 480, with shadows and without. Then Taxim's GPU port (package taxim,
with torch and JAX) where it is there, an image at a time and 64 at once. Every figure is the median
of repeats by the wall's clock, until the device is done. With ``cpu`` it is a rehearsal of few
frames, whose figures say nothing.
"""

import importlib.util
import json
import sys
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import warp as wp

import tacgen
from tacgen.contact import gap_map
from validation.batch.__main__ import compare_all, shipped_meshes
from validation.batch.frames import random_frames

SENSORS, REPEATS, KINDS = ("gelsight_mini", "gelsight"), 7, 64
PULL = 0.3  # shear over the force: some of a patch slips


def frames_per_s(draw: Callable[[], object], n: int, device: str) -> float:
    """Median over ``REPEATS`` batches of n frames, after two that warm up."""
    times_s = []
    for _ in range(REPEATS + 2):
        wp.synchronize_device(device)
        start = time.perf_counter()
        draw()
        wp.synchronize_device(device)
        times_s.append(time.perf_counter() - start)
    return n / float(np.median(times_s[2:]))


def measure(name: str, n: int, device: str, *, shadows: bool) -> dict[str, Any]:
    """Frames a second of one sensor in n worlds."""
    sensor, meshes = tacgen.BatchSensor(name, n, device, shadows=shadows), shipped_meshes()
    for mesh in meshes:
        sensor.add_mesh(mesh)
    frames = random_frames(np.random.default_rng(1), meshes, KINDS)
    maps = np.stack([gap_map(meshes[i].vertices_mm, meshes[i].faces, pose, sensor.description)
                     for i, pose, _ in frames])  # fmt: skip
    which = np.arange(n) % KINDS
    ids, poses, force_n = (np.array(one)[which] for one in zip(*frames, strict=True))
    force_n = np.minimum(force_n, 25.0)
    given = {name: wp.array(one, device=device) for name, one in {
        "gaps": maps[which], "ids": ids, "poses": poses, "force": force_n,
        "pull": PULL * np.column_stack([force_n, 0 * force_n])}.items()}  # fmt: skip
    posed = given["ids"], given["poses"], given["force"]
    ways: dict[str, Callable[[], object]] = {
        "gap_maps_per_s": lambda: sensor.render(given["gaps"], given["force"]),
        "meshes_per_s": lambda: sensor.render_meshes(*posed),
        "pulling_meshes_per_s": lambda: sensor.render_meshes(*posed, given["pull"]),
    }
    height, width = sensor.description.shape_px
    found = {"sensor": name, "size": f"{width}x{height}", "worlds": n, "shadows": shadows}
    return found | {way: frames_per_s(draw, n, device) for way, draw in ways.items()}


def _torch_scatter() -> ModuleType:
    """What Taxim takes of torch-scatter, which has no wheels, by ``scatter_reduce_`` of torch."""
    module = ModuleType("torch_scatter")

    def scatter_min(source: Any, index: Any, out: Any, **_: Any) -> None:
        out.scatter_reduce_(-1, index.expand_as(source), source, "amin")

    module.scatter_min = scatter_min  # type: ignore[attr-defined]
    return module


def measure_taxim(backend: str, device: str, n: int, *, shadows: bool) -> dict[str, Any]:
    """Frames a second of Taxim's GPU port: an image at a time, and all at once."""
    if "torch_scatter" not in sys.modules and not importlib.util.find_spec("torch_scatter"):
        sys.modules["torch_scatter"] = _torch_scatter()
    from taxim import Taxim

    found: dict[str, Any] = {"taxim": backend, "shadows": shadows}
    try:
        taxim = Taxim(backend=backend, device=device)
        sensor, meshes = tacgen.Sensor("virtual_gelsight").description, shipped_meshes()
        heights = []  # distances to the highest point of the gel, mm
        for i, pose, _ in random_frames(np.random.default_rng(1), meshes, n):
            gap_mm = gap_map(meshes[i].vertices_mm, meshes[i].faces, pose, sensor)
            heights.append(cv2.resize(np.minimum(gap_mm, 50.0), (taxim.width, taxim.height)))
        found["size"] = f"{taxim.width}x{taxim.height}"
        one_by_one = [taxim.convert_height_map(height) for height in heights]
        ways = {"frames_per_s": one_by_one,
                "at_once_per_s": [taxim.convert_height_map(np.stack(heights))]}  # fmt: skip
        for way, given in ways.items():
            times_s = []
            for _ in range(5):
                start = time.perf_counter()
                images = [taxim.render_direct(height, shadows, 1.0) for height in given]
                np.asarray(taxim.img_to_numpy(images[-1]))  # waits for all of them
                times_s.append(time.perf_counter() - start)
            found[way] = n / float(np.median(times_s[2:]))
    except (ImportError, RuntimeError, TypeError, ValueError) as error:  # ours are measured already
        found["error"] = str(error)[:300]
    return found


def main(out: Path, device: str) -> int:
    """Check, measure, print and write after each figure."""
    is_gpu = device != "cpu"
    start, is_same = (
        time.perf_counter(),
        compare_all(256 if is_gpu else 8, device, shipped_meshes()),
    )
    found: dict[str, Any] = {"device": wp.get_device(device).name, "is_same": is_same, "rates": []}
    backends = ("torch", "jax") if importlib.util.find_spec("taxim") is not None else ()

    def rates() -> Iterator[dict[str, Any]]:
        for n in (64, 1024, 4096) if is_gpu else (4,):
            for name, on in product(SENSORS, (False, True)):
                yield measure(name, n, device, shadows=on)
            for backend, on in product(backends if n < 1024 else (), (False, True)):
                yield measure_taxim(backend, device, n, shadows=on)

    for rate in rates():
        found["rates"].append({**rate, "at_s": round(time.perf_counter() - start)})
        print(found["rates"][-1], flush=True)  # noqa: T201
        out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return 0 if is_same else 1


if __name__ == "__main__":
    given = sys.argv[1:] + ["batch_gpu.json", "cuda"][len(sys.argv) - 1 :]
    sys.exit(main(Path(given[0]), given[1]))
