"""Frames of random grasps, drawn by a batch and by one sensor."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import trimesh

import tacgen
from tacgen.batch.arrays import on_host
from tacgen.core.errors import ContactError

SAME_PLACE_PX = 1e-3  # of a marker: by so much its edge changes by less than a grey level


class Difference(NamedTuple):
    """Largest and mean difference in grey levels, largest in δ, and which frames differ else."""

    most_grey: int
    mean_grey: float
    most_delta_mm: float
    other: list[Any]


Frame = tuple[int, Any, float]


def random_frames(rng: np.random.Generator, meshes: Sequence[Any], n: int) -> list[Frame]:
    """(mesh, pose, force) of n objects, turned anyhow, whose middle is near the gel's."""
    frames = []
    for _ in range(n):
        mesh = int(rng.integers(len(meshes)))
        pose = trimesh.transformations.random_rotation_matrix(rng.random(3))
        middle_mm = np.asarray(meshes[mesh].vertices_mm).mean(axis=0)
        pose[:3, 3] = rng.uniform((-5, -5, -40), (5, 5, 40)) - pose[:3, :3] @ middle_mm
        frames.append((mesh, pose, float(rng.choice([0.05, 1.0, 8.0, 25.0, 200.0]))))
    return frames


def compare(
    name: str,
    meshes: Sequence[Any],
    frames: Sequence[Frame],
    *,
    shear_n: Any = None,
    turn: Any = None,
    device: str = "cpu",
    **options: Any,
) -> Difference:
    """The difference between a batch of frames and the same ones of ``Sensor``."""
    sensor = tacgen.Sensor(name, **options)
    batch = tacgen.BatchSensor(name, len(frames), device, **options)
    for mesh in meshes:
        batch.add_mesh(mesh)
    given = [np.array(one) for one in zip(*frames, strict=True)]
    given += [one for one in (shear_n, turn) if one is not None]
    if device.startswith("cuda"):
        import warp as wp

        given = [wp.array(one, device=device) for one in given]
    out = batch.render_meshes(*given)
    rgb, mask, delta_mm, saturated = (
        on_host(one) for one in (out.rgb, out.contact_mask, out.indentation_mm, out.saturated)
    )
    shear_n = np.zeros((len(frames), 2)) if shear_n is None else shear_n
    turn = np.zeros(len(frames)) if turn is None else turn
    found, other = [], []
    for k, (mesh, pose, force) in enumerate(frames):
        try:
            frame = sensor.render(meshes[mesh], pose, force, shear_n[k], torsion_n_mm=turn[k])
        except ContactError:  # beside the gel
            assert not mask[k].any()
            continue
        grey = np.abs(frame.rgb.astype(int) - rgb[k])
        off_mm = abs(frame.indentation_mm - float(delta_mm[k]))
        found.append((grey.max(), grey.mean(), off_mm))
        is_same = np.array_equal(frame.contact_mask, mask[k])
        if frame.markers_px is not None:
            height, width = sensor.description.shape_px
            places_px = on_host(out.markers_mm)[k] / sensor.description.mm_per_px
            off_px = frame.markers_px - places_px - (width / 2 - 0.5, height / 2 - 0.5)
            is_same &= bool(np.abs(off_px).max() < SAME_PLACE_PX)
        if not (is_same and frame.saturated == saturated[k]):
            other.append((k, frame.status, frame.saturated, bool(saturated[k])))
    most_grey, mean_grey, most_delta_mm = np.max(found, axis=0)
    return Difference(int(most_grey), float(mean_grey), float(most_delta_mm), other)
