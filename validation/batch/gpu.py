"""A batch on a GPU: the same pictures, then its speed: ``python -m validation.batch.gpu [OUT.json]``.

Nothing is built but Warp's kernels. Frames a second, by CUDA events around whole batches, of gap
maps and of posed meshes, at 64, 1024 and 4096 worlds, 320 × 240 and 640 × 480, with shadows; and of
Taxim's GPU port (package taxim, with its torch backend) on the same gap maps, where it is there.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

import tacgen
from tacgen.contact import gap_map
from validation.batch.__main__ import compare_all, shipped_meshes
from validation.batch.frames import random_frames

WORLDS, SENSORS, REPEATS = (64, 1024, 4096), ("gelsight_mini", "gelsight"), 10
SAME_FRAMES = 256
TAXIM_WORLDS = 64  # more do not fit beside its own maps


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


def measure_taxim(*, shadows: bool) -> dict[str, Any]:
    """Frames a second of Taxim's GPU port, pressed by the depth that it is given."""
    try:
        import torch
        from taxim import Taxim
    except ImportError as error:
        return {"taxim": f"not there: {error}"}
    taxim = Taxim(backend="torch", device="cuda")
    sensor = tacgen.Sensor("virtual_gelsight").description
    meshes = shipped_meshes()
    frames = random_frames(np.random.default_rng(1), meshes, TAXIM_WORLDS)
    gaps = [gap_map(meshes[i].vertices_mm, meshes[i].faces, pose, sensor) for i, pose, _ in frames]
    height_mm = np.nan_to_num(-np.stack(gaps), neginf=-10.0).astype(np.float32)
    height = torch.as_tensor(height_mm, device="cuda")

    def draw() -> None:
        taxim.render(height, with_shadow=shadows, press_depth=1.0)

    torch.cuda.synchronize()
    rate = frames_per_s(lambda: (draw(), torch.cuda.synchronize()), TAXIM_WORLDS)
    return {"taxim": "torch", "shadows": shadows, "size": "640x480", "frames_per_s": rate}


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
    found["taxim"] = [measure_taxim(shadows=shadows) for shadows in (False, True)]
    print(found["taxim"])  # noqa: T201
    out.write_text(json.dumps(found, indent=1), encoding="utf-8")
    return 0 if is_same else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "batch_gpu.json")))
