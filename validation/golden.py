"""Hashes of what the package computes, before and after a change that is to change nothing.

``python -m validation.golden PART --out before.json`` keeps them; ``--against before.json`` lists
which differ, with exit code 1 where one does. Parts are the keys of ``PARTS``. Numbers are of one
machine and of its libraries' versions: compare on one machine.
"""

import argparse
import contextlib
import hashlib
import json
import sys
import tarfile
import tempfile
from collections.abc import Callable, Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd

import tacgen
from tacgen.core.errors import TacgenError
from tacgen.core.records import Mesh
from tacgen.core.sensors import load_sensor
from tacgen.dataset.export import FORMATS, export_dataset
from tacgen.objects import load_object
from tests.small_world import write_world
from validation.batch.frames import Frame, random_frames

Hashes = Iterator[tuple[str, str]]

WORLD = {
    "grid": "{force_n: [3, 25], y_mm: [0], z_mm: [90]}",
    "robot": "{tactile_pads: both}",
    "frames": "{mode: sequence, count: 3}",
    "optics": "{shadows: false, markers: true}",
    "dataset": "{shard_size: 2, depth: all, markers: true, force_field: [4, 5]}",
    "scene": "{frames: all, cameras: [{name: front, size_px: [48, 64],"
    " look_at: {from_mm: [300, -200, 250], to_mm: [0, 0, 40]}}]}",
}
"""Two grasps, one of which is held, with all that a dataset can store."""
ENGINES = ("pybullet", "mujoco")
OBJECTS = ("tomato_soup_can", "strawberry", "sugar_box", "scissors")
SENSORS = ("gelsight_mini", "digit")
FRAMES = 10  # of each sensor, with and without shadows: 40 in all
MOST_FORCE_N = 25.0


def array_sha256(values: Any) -> str:
    """Hash of an array's type, shape and bytes; of text where it holds objects."""
    array = np.asarray(values)
    if array.dtype == object:
        array = array.astype(str)
    digest = hashlib.sha256(f"{array.dtype.str} {array.shape} ".encode())
    digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def file_hashes(path: Path, name: str) -> Hashes:
    """Hashes of a file's content: of what is in it where the file itself holds times."""
    if path.suffix in (".h5", ".hdf5"):
        with h5py.File(path) as file:
            yield from _group_hashes(file, name)
    elif path.suffix == ".parquet":
        for column, values in pd.read_parquet(path).items():
            yield f"{name}:{column}", hashlib.sha256(repr(values.tolist()).encode()).hexdigest()
    elif path.suffix == ".tar":
        with tarfile.open(path) as archive:
            for member in archive:
                content = archive.extractfile(member)
                if content is not None:
                    yield f"{name}:{member.name}", hashlib.sha256(content.read()).hexdigest()
    else:
        yield name, hashlib.sha256(path.read_bytes()).hexdigest()


def _group_hashes(file: h5py.File, name: str) -> Hashes:
    found: dict[str, h5py.Dataset] = {}
    file.visititems(
        lambda key, one: found.update({key: one}) if isinstance(one, h5py.Dataset) else None
    )
    for key, dataset in sorted(found.items()):
        yield f"{name}:{key}", array_sha256(dataset[()])


def folder_hashes(folder: Path, name: str) -> Hashes:
    """Hashes of every file of a folder."""
    for path in sorted(one for one in folder.rglob("*") if one.is_file()):
        yield from file_hashes(path, f"{name}/{path.relative_to(folder).as_posix()}")


def collected(folder: Path) -> Hashes:
    """A small dataset of each engine, and every export of it."""
    for engine in ENGINES:
        physics = f"{{engine: {engine}, lift_mm: 40, success_rise_mm: 30}}"
        path, data = (
            write_world(folder / engine, **WORLD, physics=physics),
            folder / engine / "data",
        )
        with contextlib.chdir(folder / engine):  # its sensor is found by name
            tacgen.collect(tacgen.load_recipe(path), data, progress=False)
        yield from folder_hashes(data / "shards", f"{engine}/shards")
        for name in FORMATS:
            export_dataset(data, folder / engine / name, name)
            yield from folder_hashes(folder / engine / name, f"{engine}/{name}")


def frames_of(meshes: list[Mesh]) -> list[Frame]:
    """Objects turned anyhow near the gel, and pressed as hard as a gripper can."""
    frames = random_frames(np.random.default_rng(11), meshes, FRAMES)
    return [(mesh, pose, min(force_n, MOST_FORCE_N)) for mesh, pose, force_n in frames]


def drawn() -> Hashes:
    """Frames of ``Sensor`` and the same of ``BatchSensor`` on the CPU."""
    meshes = [load_object(name).surface for name in OBJECTS]
    frames = frames_of(meshes)
    pulls_n = np.array([[0.2 * force_n, -0.1 * force_n] for *_, force_n in frames])
    for name, on in product(SENSORS, (False, True)):
        place = f"{name}{' shadows' if on else ''}"
        markers = on and load_sensor(name).markers is not None
        sensor = tacgen.Sensor(name, shadows=on, markers=markers)
        for k, (mesh, pose, force_n) in enumerate(frames):
            try:
                frame = sensor.render(meshes[mesh], pose, force_n, pulls_n[k])
            except TacgenError as error:
                yield f"Sensor {place} {k}", str(error)
                continue
            for key in ("rgb", "depth_mm", "indentation_mm", "markers_mm", "force_field_n"):
                yield f"Sensor {place} {k} {key}", array_sha256(getattr(frame, key))
        batch = tacgen.BatchSensor(name, len(frames), "cpu", shadows=on, markers=markers)
        for one in meshes:
            batch.add_mesh(one)
        ids, poses, forces_n = (np.array(one) for one in zip(*frames, strict=True))
        out = batch.render_meshes(ids, poses, forces_n, pulls_n)
        for k, key in product(range(len(frames)), ("rgb", "depth_mm", "indentation_mm")):
            yield f"BatchSensor {place} {k} {key}", array_sha256(getattr(out, key)[k])


def simulation() -> Hashes:
    """Shards and exports of both engines, frames of ``Sensor`` and ``BatchSensor``."""
    yield from drawn()
    with tempfile.TemporaryDirectory() as folder:
        yield from collected(Path(folder))


PARTS: Mapping[str, Callable[[], Hashes]] = {"simulation": simulation}


def differences(now: Mapping[str, str], before: Mapping[str, str]) -> list[str]:
    """The names whose hashes differ, or that only one of both has."""
    return sorted(name for name in now.keys() | before.keys() if now.get(name) != before.get(name))


def main() -> int:
    """Compute the hashes of a part, and keep or compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=sorted(PARTS))
    parser.add_argument("--out", type=Path, help="keep the hashes here")
    parser.add_argument("--against", type=Path, help="list what differs from these")
    arguments = parser.parse_args()
    now = dict(PARTS[arguments.part]())
    if arguments.out:
        arguments.out.write_text(json.dumps(now, indent=0, sort_keys=True), encoding="utf-8")
    before = now
    if arguments.against:
        before = json.loads(arguments.against.read_text(encoding="utf-8"))
    different = differences(now, before)
    for name in different:
        print(name)  # noqa: T201
    print(f"{len(different)} of {len(now)} differ")  # noqa: T201
    return int(bool(different))


if __name__ == "__main__":
    sys.exit(main())
