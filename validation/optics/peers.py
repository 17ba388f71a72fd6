"""Time of a tactile image in other simulators and in tacgen, from the same presses, in one run.

    python -m validation.optics.peers DIR [--python PYTHON] [--repeats N]

DIR holds the peers as their authors publish them, those of ``Taxim``, ``FOTS`` and ``tacto`` that
are there; PYTHON is the interpreter in which they are installed. Taxim and FOTS begin with the
indentation of a press and end with its image; TACTO begins with the mesh, as tacgen does beside it.
Each is run by one thread; a figure is the median over the presses of the least of N repeats. For
TACTO without a screen set PYOPENGL_PLATFORM to osmesa or egl. A peer that fails is printed with its
last line of error.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.contact.gel_response import GelLoad
from tacgen.contact.indenter import Imprint
from tacgen.core.records import Mesh, Sensor
from tacgen.core.sensors import load_sensor
from tacgen.objects import load_object
from tacgen.optics import LookupTable, load_table
from tacgen.sensor.tactile_pad import TactilePad
from validation.optics.peer_runner import least_ms

OBJECTS = ("tomato_soup_can", "golf_ball", "rubiks_cube", "strawberry", "mustard_bottle")
VOLUME_MM3 = 20.0
PEERS = {"Taxim": ("gelsight", 1), "FOTS": ("digit", 2), "tacto": ("digit", 2)}
"""A sensor of tacgen, and how many of its pixels in a row are one in the size that the peer's own
code is written for: 640 × 480 and 240 × 320."""
RUNNER = Path(__file__).with_name("peer_runner.py")


@dataclass(frozen=True, slots=True)
class Press:
    """A mesh turned against the gel, in the gel frame."""

    mesh: Mesh
    pose: NDArray[np.float64]


def presses() -> Iterator[Press]:
    """Each object with its side against the middle of the gel."""
    for name in OBJECTS:
        surface = load_object(name).surface
        side = np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]])
        pose = np.eye(4)
        pose[:3, :3] = side
        middle_mm = (surface.vertices_mm.min(axis=0) + surface.vertices_mm.max(axis=0)) / 2
        pose[:2, 3] = -(side @ middle_mm)[:2]
        yield Press(surface, pose)


def _sensor(peer: str) -> tuple[Sensor, LookupTable]:
    """A sensor in a peer's size, whose gel ends where its window does, as the peers' do."""
    name, step = PEERS[peer]
    sensor = load_sensor(name)
    size, mm_per_px = (sensor.width_px // step, sensor.height_px // step), sensor.mm_per_px * step
    table = load_table(sensor.table)
    background = cv2.resize(table.background, size, interpolation=cv2.INTER_AREA)
    return (
        replace(
            sensor,
            width_px=size[0],
            height_px=size[1],
            mm_per_px=mm_per_px,
            gel_size_mm=(mm_per_px, mm_per_px),
        ),
        replace(table, background=np.asarray(background, np.float32), mm_per_px=mm_per_px),
    )


def tacgen_ms(peer: str, *, shadows: bool, from_mesh: bool, repeats: int) -> list[float]:
    """Times of tacgen's images of the presses."""
    pad = TactilePad(*_sensor(peer), shadows=shadows)
    times = []
    for press in presses():
        given = press.mesh, press.pose, GelLoad(VOLUME_MM3)
        imprint = pad.press(*given)
        image = partial(_image_of_a_copy, pad, imprint)
        times.append(least_ms(partial(pad.render, *given) if from_mesh else image, repeats))
    return times


def _image_of_a_copy(pad: TactilePad, imprint: Imprint) -> object:
    """The image of an imprint, which a pad does not draw again while it is the same object."""
    return pad.image(replace(imprint))


def write_presses(peer: str, path: Path) -> None:
    """The indentations (n, H, W), mm, and the pressed meshes in the gel frame, mm."""
    sensor, table = _sensor(peer)
    pad = TactilePad(sensor, table)
    arrays: dict[str, Any] = {"mm_per_px": np.array(sensor.mm_per_px)}
    depths = []
    for k, press in enumerate(presses()):
        imprint = pad.press(press.mesh, press.pose, GelLoad(VOLUME_MM3))
        depths.append(imprint.depth_map_mm(sensor))
        posed = press.mesh.vertices_mm @ press.pose[:3, :3].T + press.pose[:3, 3]
        posed[:, 2] -= posed[:, 2].min() + imprint.indentation_mm
        arrays |= {f"vertices_mm_{k}": posed, f"faces_{k}": press.mesh.faces}
    np.savez(path, depth_mm=np.stack(depths), **arrays)


def peer_ms(name: str, folder: Path, python: str, repeats: int) -> dict[str, list[float]] | str:
    """Times of a peer's images, plain and with shadows where it has them; or its error."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "presses.npz"
        write_presses(name, path)
        one = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        command = [python, str(RUNNER), name, str(folder.resolve()), str(path), str(repeats)]
        ran = subprocess.run(command, capture_output=True, text=True, env=os.environ | one)
    if ran.returncode:
        return (ran.stderr.strip().splitlines() or ["no message"])[-1]
    found: dict[str, list[float]] = json.loads(ran.stdout.splitlines()[-1])
    return found


HEAD = """| peer | size | from | shadows | its ms | tacgen's ms | ratio |
|---|---|---|---|---|---|---|
"""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="Time of a tactile image in other simulators.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--repeats", type=int, default=20)
    given = parser.parse_args()
    there = [name for name in PEERS if (given.folder / name).is_dir()]
    if not there:
        parser.error(f"{given.folder}: holds none of the folders {', '.join(PEERS)}")
    sys.stdout.write(HEAD)
    for name in there:
        found = peer_ms(name, given.folder / name, given.python, given.repeats)
        if isinstance(found, str):
            sys.stdout.write(f"{name} did not run: {found}\n")
            continue
        for kind, times in found.items():
            sys.stdout.write(_line(name, kind, float(np.median(times)), given.repeats))
            sys.stdout.flush()


def _line(name: str, kind: str, theirs_ms: float, repeats: int) -> str:
    sensor, from_mesh, shadows = _sensor(name)[0], name == "tacto", kind == "shadows"
    own = tacgen_ms(name, shadows=shadows, from_mesh=from_mesh, repeats=repeats)
    ours_ms = float(np.median(own))
    cells = (
        name,
        f"{sensor.width_px}×{sensor.height_px}",
        "mesh" if from_mesh else "indentation",
        "yes" if shadows else "no",
        f"{theirs_ms:.1f}",
        f"{ours_ms:.2f}",
        f"{theirs_ms / ours_ms:.0f}",
    )
    return f"| {' | '.join(cells)} |\n"


if __name__ == "__main__":
    main()
