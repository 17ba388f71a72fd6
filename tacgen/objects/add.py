"""Add a mesh of one's own as an object: ``objects/<name>`` with its description and meshes."""

import os
import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
import yaml
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.core.errors import ObjectError
from tacgen.core.files import sha256_of, sync_file
from tacgen.core.records import GraspObject, Mesh
from tacgen.objects.description import NAME_PATTERN
from tacgen.objects.grasp_ranges import (
    DOME_RADIUS_MM,
    facet_note,
    graspable,
    suggest_ranges,
    suggest_yaw,
    touch_error_mm,
)
from tacgen.objects.load import load_object, write_meshes
from tacgen.objects.mesh_import import UP_AXES, convex_parts, import_surface, placed
from tacgen.objects.meshes import mass_properties, volume_mm3
from tacgen.objects.rest import toppled
from tacgen.objects.trial import executed_ranges
from tacgen.physics.frames import rotation_about_z

DEFAULT_FRICTION = 0.4  # the largest of the shipped objects'
DENSEST_G_CM3, LIGHTEST_G_CM3 = 23.0, 0.005  # Osmium, and a little less than the lightest foam
ALLOWED_ERROR_MM = 0.6
"""Error of where the pads touch: a slip threshold moves by less than 3 %."""
MOST_ERROR_MM = 3.0  # a tenth of the dome's radius: the gel then shows another place
STEPS = ("reading", "cutting into convex parts", "trying the suggested grasps")
NO_NAMES = {"textured", "nontextured", "model", "mesh", "object", "meshes", "untitled"}


@dataclass(frozen=True, slots=True)
class AddedObject:
    """The new object and what its maker should know."""

    object: GraspObject
    notes: tuple[str, ...]


def add_object(
    mesh_path: Path,
    *,
    mass_kg: float,
    scale: float = 1.0,
    name: str | None = None,
    friction: float = DEFAULT_FRICTION,
    up: str | None = None,
    yaw_rad: float | None = None,
    keep_pose: bool = False,
    into: Path = Path("objects"),
    force: bool = False,
    on_step: Callable[[str], None] = lambda step: None,
) -> AddedObject:
    """Import a mesh into ``into/<name>``; the folder appears whole or not at all.

    ``yaw_rad`` is the angle about z, in the mesh's own axes, along which the fingers shall close:
    the mesh is turned by its negative; by default that at which both pads meet it, if they do not
    along x. An object that would topple is rested as it comes to lie, unless ``keep_pose``. The
    suggested places of grasps are those that the simulation could execute. ``on_step`` is called
    with each of the ``STEPS`` as it begins.

    Raises ``ObjectError`` if the arguments or the mesh cannot be used, or the object exists and not
    ``force``.
    """
    mesh_path, into = Path(mesh_path), Path(into)
    name = object_name(mesh_path) if name is None else name
    _check_arguments(name, mass_kg, scale, friction, up, yaw_rad)
    folder = into / name
    _check_target(folder, force)

    on_step(STEPS[0])
    surface, notes = import_surface(mesh_path, scale=scale, up=up)
    notes += _check_density(mesh_path, surface, mass_kg)
    turn = None if keep_pose else toppled(surface)
    if turn is not None:
        surface = placed(surface, turn)
        notes.insert(0, _rest_note(turn))
    yaw_rad, surface, yaw_notes = _turned(surface, yaw_rad)
    ranges, range_notes = suggest_ranges(surface, mass_kg=mass_kg, friction=friction)
    on_step(STEPS[1])
    for k, parts in enumerate(convex_parts(surface)):
        off_mm = touch_error_mm(surface, parts, ranges)
        # The finest cut has too many parts for what is only a little better.
        if off_mm.max() <= (ALLOWED_ERROR_MM if k == 0 else MOST_ERROR_MM):
            break
    if off_mm.max() > MOST_ERROR_MM:
        notes.insert(0, _touch_note(off_mm, parts) + ": expect other slip thresholds there")
    on_step(STEPS[2])
    properties = mass_properties([(surface, 1.0)], mass_kg)
    ranges, tried = executed_ranges(
        GraspObject(
            name=name,
            surface=surface,
            collision=parts,
            mass_kg=mass_kg,
            center_of_mass_mm=properties[0],
            inertia_kg_mm2=properties[1],
            friction=friction,
            spinning_friction_mm=None,
            grasp_ranges=ranges,
            folder=folder,
        )
    )
    range_notes += yaw_notes + tried
    description = describe(
        name, mesh_path, surface, mass_kg=mass_kg, friction=friction, ranges=ranges
    )
    _write(folder, surface, parts, description, force)
    notes += range_notes
    if note := facet_note(surface):
        notes.append(note)
    if off_mm.max() <= MOST_ERROR_MM:
        notes.append(_touch_note(off_mm, parts))
    return AddedObject(load_object(folder), tuple(notes))


def _turned(surface: Mesh, yaw_rad: float | None) -> tuple[float, Mesh, list[str]]:
    """The surface turned so that the fingers close along ``yaw_rad``, chosen where it is None."""
    notes = []
    if yaw_rad:
        surface = placed(surface, rotation_about_z(-yaw_rad))
    heights = [share * float(np.ptp(surface.vertices_mm[:, 2])) for share in (0.25, 0.5, 0.75)]
    better_rad = suggest_yaw(surface, heights)
    if better_rad and yaw_rad is None and not any(graspable(surface, 0.0, z) for z in heights):
        size_mm = np.ptp(surface.vertices_mm[:, 0])
        surface = placed(surface, rotation_about_z(-better_rad))
        notes.append(
            f"{size_mm:.0f} mm along x, where the pads do not meet it: turned by "
            f"{-better_rad:.3f} rad about z, so that they do; --yaw 0 keeps it"
        )
        return better_rad, surface, notes
    if better_rad:
        notes.append(
            "the pads would meet larger opposite faces at another angle about z: add it with "
            f"--yaw {(yaw_rad or 0.0) + better_rad:.3f} --force"
        )
    return yaw_rad or 0.0, surface, notes


def _rest_note(turn: NDArray[np.float64]) -> str:
    angle_deg = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1.0, 1.0)))
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    axis = axis / max(float(np.linalg.norm(axis)), 1e-12)
    return (
        "its centre of mass is not over what it stands on: rested as it topples, turned by "
        f"{angle_deg:.0f}° about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f}); look at its "
        "picture, --keep-pose keeps the mesh's own pose"
    )


def _touch_note(off_mm: FloatArray, parts: tuple[Mesh, ...]) -> str:
    return (
        f"where it is grasped the pads touch its collision shape ({len(parts)} convex) within "
        f"{off_mm[0]:.2f} mm along x, {off_mm[1]:.1f} mm across and "
        f"{np.degrees(off_mm[1] / DOME_RADIUS_MM):.1f}° of the surface"
        + ("" if off_mm.max() <= ALLOWED_ERROR_MM else f", more than {ALLOWED_ERROR_MM:g} mm")
    )


def object_name(mesh_path: Path) -> str:
    """A folder name from a file name; raises ``ObjectError`` where that says nothing."""
    stem = re.sub(r"[^A-Za-z0-9]+", "_", mesh_path.stem).strip("_").lower()
    if not stem or stem in NO_NAMES:
        msg = f"{mesh_path}: its file name is no name for an object; pass --name"
        raise ObjectError(msg)
    return stem


def describe(
    name: str,
    mesh_path: Path,
    surface: Mesh,
    *,
    mass_kg: float,
    friction: float,
    ranges: Mapping[str, tuple[float, ...]],
) -> dict[str, object]:
    """The content of ``object.yaml`` for an imported mesh."""
    center, _ = mass_properties([(surface, 1.0)], mass_kg)
    extent = np.ptp(surface.vertices_mm, axis=0)
    return {
        "name": name,
        "description": f"imported from {mesh_path.name}",
        "shape": {
            "mesh": "surface.ply",
            "collision": "collision.npz",
            "scale": 1.0,
            "source": f"{mesh_path.name}, sha256 {sha256_of(mesh_path)}",
        },
        "mass_kg": {"value": mass_kg, "source": "given when the mesh was added"},
        "center_of_mass_mm": {
            "value": [round(float(value), 3) + 0.0 for value in center],
            "source": "computed from the mesh, evenly filled; not measured",
        },
        "dimensions_mm": {
            "value": [round(float(value), 3) for value in extent],
            "source": "bounding box of the mesh",
        },
        "friction": {
            "value": friction,
            "source": "given, or 0.4 by default, when the mesh was added; calibrate it with "
            "`tacgen friction`",
        },
        "grasp_ranges": {
            **{axis: list(values) for axis, values in ranges.items()},
            "source": "suggested from mass, friction and shape; edit them",
        },
    }


def _check_arguments(
    name: str,
    mass_kg: float,
    scale: float,
    friction: float,
    up: str | None,
    yaw_rad: float | None,
) -> None:
    problems = []
    if not re.fullmatch(NAME_PATTERN, name):
        problems.append(
            f"--name {name!r} is no plain folder name; use letters, digits, `_` and `-`"
        )
    if not (np.isfinite(mass_kg) and mass_kg > 0):
        problems.append(f"--mass {mass_kg:g} is not above 0; weigh the object and give kg")
    if not (np.isfinite(scale) and scale > 0):
        problems.append(f"--scale {scale:g} is not above 0; give mm per unit of the mesh")
    if not (np.isfinite(friction) and 0 <= friction <= 2):
        problems.append(f"--friction {friction:g} is not in 0 to 2; give a Coulomb coefficient")
    if not abs(yaw_rad or 0.0) <= 2 * np.pi:
        problems.append(f"--yaw {yaw_rad:g} is more than a turn; give radians: 90° is 1.571")
    if up is not None and up not in UP_AXES:
        problems.append(f"--up {up!r} is no axis; give one of {', '.join(UP_AXES)}")
    ObjectError.raise_if(problems)


def _check_target(folder: Path, force: bool) -> None:
    problem = ""
    if folder.is_symlink() or folder.parent.is_symlink():
        problem = "is or lies in a link; tacgen writes only into a real folder"
    elif folder.exists() and not force:
        problem = "exists already; pass --force to replace it, or another --name"
    elif folder.exists() and not (folder / "object.yaml").is_file():
        problem = "is no object's folder, so it is not replaced; pass another --name"
    if problem:
        msg = f"{folder}: {problem}"
        raise ObjectError(msg)


def _check_density(mesh_path: Path, surface: Mesh, mass_kg: float) -> list[str]:
    volume_cm3 = volume_mm3(surface) / 1000
    density = 1000 * mass_kg / volume_cm3
    text = f"{mesh_path}: {mass_kg:g} kg in {volume_cm3:.4g} cm³ is {density:.3g} g/cm³"
    if density > DENSEST_G_CM3:
        msg = f"{text}, denser than any metal; give --mass in kg and check --scale"
        raise ObjectError(msg)
    return [f"{text}; check --mass and --scale"] if density < LIGHTEST_G_CM3 else []


def _write(
    folder: Path,
    surface: Mesh,
    parts: tuple[Mesh, ...],
    description: Mapping[str, object],
    force: bool,
) -> None:
    """Write and read back a folder beside its place, then rename it there."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".part", dir=folder.parent))
        try:
            fresh = work / folder.name
            fresh.mkdir()
            mesh = trimesh.Trimesh(surface.vertices_mm, surface.faces, process=False)
            mesh.export(fresh / "surface.ply", encoding="binary")
            write_meshes(fresh / "collision.npz", parts)
            text = yaml.safe_dump(
                description, sort_keys=False, allow_unicode=True, default_flow_style=None, width=96
            )
            (fresh / "object.yaml").write_text(text, encoding="utf-8")
            load_object(fresh)
            for path in fresh.iterdir():
                sync_file(path)
            sync_file(fresh)
            if force and folder.exists():
                os.replace(folder, work / "replaced")
            os.replace(fresh, folder)
            sync_file(folder.parent)
        finally:
            shutil.rmtree(work, ignore_errors=True)
    except OSError as error:
        msg = f"{folder}: cannot be written: {error.strerror or error}; check the folder and disk"
        raise ObjectError(msg) from None
