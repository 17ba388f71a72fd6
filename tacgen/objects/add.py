"""Add a mesh of one's own as an object: ``objects/<name>`` with its description and meshes."""

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
import yaml
from numpy.typing import NDArray

from tacgen.core.errors import ObjectError
from tacgen.core.files import atomic_folder, sha256_of
from tacgen.core.records import GraspObject, Mesh
from tacgen.core.types import FloatArray, rotation_about_z, turn_rad, twice_sine
from tacgen.objects.cutting import CONCAVITIES, convex_parts, cut_again
from tacgen.objects.description import NAME_PATTERN
from tacgen.objects.grasp_ranges import (
    DOME_RADIUS_MM,
    TouchError,
    faces_pads,
    facet_note,
    largest_grid,
    suggest_places,
    suggest_yaw,
    touch_error_mm,
    touch_errors,
)
from tacgen.objects.load import load_object, write_meshes
from tacgen.objects.mesh_import import FORMATS, UP_AXES, import_surface, placed
from tacgen.objects.meshes import mass_properties, volume_mm3
from tacgen.objects.trial import tried_ranges
from tacgen.physics.rest import toppled

DEFAULT_FRICTION = 0.4  # the largest of the shipped objects'
DENSEST_G_CM3, LIGHTEST_G_CM3 = 23.0, 0.005  # Osmium, and a little less than the lightest foam
ALLOWED_ERROR_MM = 0.6
"""Error of where the pads touch: a slip threshold moves by less than 3 %."""
MOST_ERROR_MM = 3.0  # a tenth of the dome's radius: the gel then shows another place
LIMITS_MM = (ALLOWED_ERROR_MM, MOST_ERROR_MM)  # along x and across it, up to which nothing is cut
MOST_CUTS = 6  # again, of parts that pads touch wrongly
STEPS = ("reading", "cutting into convex parts", "trying the suggested grasps")
NO_NAMES = {
    *("textured", "nontextured", "textured_simple", "model", "mesh", "object", "meshes"),
    *("untitled", "urdf", "visual", "collision", "google_16k", "google_64k", "google_512k"),
    *("poisson", "tsdf", "clouds", "merged_cloud", "textures", "materials"),
}
"""Files and folders in which meshes come, such as those of YCB and Google Scanned Objects."""
FOLDERS_ABOVE = 3  # of a mesh, which may have its object's name


@dataclass(frozen=True, slots=True)
class AddedObject:
    """The new object and what its maker should know.

    ``toppled_from`` is the surface as its file had it, where it has been rested.
    """

    object: GraspObject
    notes: tuple[str, ...]
    toppled_from: Mesh | None = None


@dataclass(frozen=True, slots=True)
class MeshFacts:
    """What a mesh does not say of an object.

    ``scale`` is mm per unit of the mesh, ``up`` the axis that points up; both are guessed where
    they are None. ``yaw_rad`` is the angle about z, in the mesh's own axes, along which the fingers
    shall close: the mesh is turned by its negative; by default that at which both pads meet it, if
    they do not along x. An object that would topple is rested as it comes to lie, unless
    ``keep_pose``.
    """

    mass_kg: float
    scale: float | None = None
    name: str | None = None
    friction: float = DEFAULT_FRICTION
    up: str | None = None
    yaw_rad: float | None = None
    keep_pose: bool = False


def add_object(
    mesh_path: Path,
    facts: MeshFacts,
    *,
    into: Path = Path("objects"),
    force: bool = False,
    on_step: Callable[[str], None] = lambda step: None,
) -> AddedObject:
    """Import a mesh into ``into/<name>``; the folder appears whole or not at all.

    The suggested places of grasps are those that the simulation could execute. ``on_step`` is
    called with each of the ``STEPS`` as it begins.

    Raises ``ObjectError`` if the arguments or the mesh cannot be used, or the object exists and not
    ``force``.
    """
    mesh_path, into = Path(mesh_path), Path(into)
    mass_kg, friction = facts.mass_kg, facts.friction
    name = object_name(mesh_path) if facts.name is None else facts.name
    _check_facts(name, facts)
    folder = into / name
    _check_target(folder, force)

    on_step(STEPS[0])
    surface, notes = import_surface(mesh_path, scale=facts.scale, up=facts.up)
    notes += _check_density(mesh_path, surface, mass_kg)
    center_mm, _ = mass_properties([(surface, 1.0)], mass_kg)
    turn = None if facts.keep_pose else toppled(surface.vertices_mm, center_mm)
    given = None if turn is None else surface
    if turn is not None:
        surface = placed(surface, turn)
        notes.insert(0, _rest_note(turn))
    _, surface, yaw_notes = _turned(surface, facts.yaw_rad)
    properties = mass_properties([(surface, 1.0)], mass_kg)
    ranges, range_notes = suggest_places(
        surface, mass_kg=mass_kg, center_y_mm=float(properties[0][1]), friction=friction
    )
    on_step(STEPS[1])
    parts, errors = _cut(surface, ranges)
    ranges, off_notes = _without_places_far_off(mesh_path, ranges, errors)
    range_notes += off_notes
    on_step(STEPS[2])
    ranges, tried = tried_ranges(
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
    places = set(itertools.product(ranges["y_mm"], ranges["z_mm"]))
    if kept := [error for error in errors if (error.y_mm, error.z_mm) in places]:
        notes.append(_touch_note(touch_error_mm(kept), parts))
    return AddedObject(load_object(folder), tuple(notes), given)


def _cut(
    surface: Mesh, ranges: Mapping[str, tuple[float, ...]]
) -> tuple[tuple[Mesh, ...], list[TouchError]]:
    """Convex parts, cut finer where pads would touch them elsewhere than the surface; the errors.

    Errors in the plane of the pad do not count up to ``MOST_ERROR_MM``: on a flat face a wave of
    0.1 mm moves the first touch by 2 mm.
    """
    cuts = []
    for concavity in CONCAVITIES:
        parts = convex_parts(surface, concavity)
        errors = touch_errors(surface, parts, ranges)
        for _ in range(MOST_CUTS):
            which = {error.part for error in errors if (error.off_mm > LIMITS_MM).any()}
            if not which or len(finer := cut_again(surface, parts, which)) == len(parts):
                break
            parts, errors = finer, touch_errors(surface, finer, ranges)
        cuts.append((parts, errors))
        if (touch_error_mm(errors) <= LIMITS_MM).all():
            break
    return min(cuts, key=lambda cut: float((touch_error_mm(cut[1]) / LIMITS_MM).max()))


def _without_places_far_off(
    mesh_path: Path, ranges: Mapping[str, tuple[float, ...]], errors: Sequence[TouchError]
) -> tuple[dict[str, tuple[float, ...]], list[str]]:
    """The ranges without places where pads touch more than ``MOST_ERROR_MM`` off, and notes.

    Raises ``ObjectError`` if no place is left.
    """
    bad = {(error.y_mm, error.z_mm) for error in errors if error.most_mm > MOST_ERROR_MM}
    if not bad:
        return dict(ranges), []
    off_mm = touch_error_mm(errors).max()
    kept = largest_grid(ranges, bad)
    if kept is None:
        msg = (
            f"{mesh_path}: wherever pads would touch it its convex parts are off by up to "
            f"{off_mm:.1f} mm, more than {MOST_ERROR_MM:g} mm; give another --yaw or --up, or "
            "simplify the mesh"
        )
        raise ObjectError(msg)
    note = (
        f"{len(bad)} places at which pads would touch its convex parts up to {off_mm:.1f} mm off "
        "are not suggested"
    )
    return kept, [note]


def _turned(surface: Mesh, yaw_rad: float | None) -> tuple[float, Mesh, list[str]]:
    """The surface turned so that the fingers close along ``yaw_rad``, chosen where it is None."""
    notes = []
    if yaw_rad:
        surface = placed(surface, rotation_about_z(-yaw_rad))
    heights = [share * float(np.ptp(surface.vertices_mm[:, 2])) for share in (0.25, 0.5, 0.75)]
    center_mm, _ = mass_properties([(surface, 1.0)], 1.0)  # of a mug its body, not its handle
    about_center = Mesh(surface.vertices_mm - [*center_mm[:2], 0.0], surface.faces)
    better_rad = suggest_yaw(about_center, heights)
    if better_rad and yaw_rad is None and not faces_pads(surface):
        surface = placed(surface, rotation_about_z(-better_rad))
        notes.append(
            f"the pads do not meet it face to face along x: turned by {-better_rad:.3f} rad about "
            "z, so that they do; --yaw 0 keeps it"
        )
        return better_rad, surface, notes
    if better_rad:
        notes.append(
            "the pads would meet larger opposite faces at another angle about z: add it with "
            f"--yaw {(yaw_rad or 0.0) + better_rad:.3f} --force"
        )
    return yaw_rad or 0.0, surface, notes


def _rest_note(turn: NDArray[np.float64]) -> str:
    axis = twice_sine(turn) / max(float(np.linalg.norm(twice_sine(turn))), 1e-12)
    angle_deg = np.degrees(turn_rad(turn))
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
    """A folder name from a file name, or where that says nothing from the nearest folder's.

    Raises ``ObjectError`` where none does.
    """
    if (named := _named_by(mesh_path)) is None:
        msg = f"{mesh_path}: its file name is no name for an object; pass --name"
        raise ObjectError(msg)
    return named[0]


def _named_by(mesh_path: Path) -> tuple[str, Path] | None:
    """An object's name, and the file or folder that has it; None where none says anything."""
    for place in (mesh_path, *mesh_path.parents[:FOLDERS_ABOVE]):
        text = place.stem if place == mesh_path else place.name
        name = re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_").lower()
        if name and name not in NO_NAMES:
            return name, place
    return None


def meshes_in(path: Path) -> tuple[list[Path], list[Path]]:
    """The mesh itself, or the mesh files of a folder by name, or else those of its folders.

    Of those that a folder names together, such as ``025_mug/google_16k/textured.obj`` and
    ``025_mug/poisson/textured.obj``, the first is taken; the second list has the others.

    Raises ``ObjectError`` if a folder has none.
    """
    if not path.is_dir():
        return [path], []
    for files in (path.iterdir(), path.rglob("*")):
        kinds = {one: one.suffix.lower().lstrip(".") for one in files}
        meshes = [one for one, kind in kinds.items() if kind in FORMATS]
        if meshes:
            meshes.sort(key=lambda one: (FORMATS.index(kinds[one]), one))
            first: dict[tuple[str, Path] | Path, Path] = {}
            for mesh in meshes:
                first.setdefault(_named_by(mesh) or mesh, mesh)
            chosen = sorted(first.values())
            return chosen, sorted(set(meshes) - set(chosen))
    msg = f"{path}: holds no mesh file; give one with {', '.join(FORMATS)}"
    raise ObjectError(msg)


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


def _check_facts(name: str, facts: MeshFacts) -> None:
    mass_kg, scale, friction = facts.mass_kg, facts.scale, facts.friction
    problems = []
    if not re.fullmatch(NAME_PATTERN, name):
        problems.append(
            f"--name {name!r} is no plain folder name; use letters, digits, `_` and `-`"
        )
    if not (np.isfinite(mass_kg) and mass_kg > 0):
        problems.append(f"--mass {mass_kg:g} is not above 0; weigh the object and give kg")
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        problems.append(f"--scale {scale:g} is not above 0; give mm per unit of the mesh")
    if not (np.isfinite(friction) and 0 <= friction <= 2):
        problems.append(f"--friction {friction:g} is not in 0 to 2; give a Coulomb coefficient")
    if not abs(facts.yaw_rad or 0.0) <= 2 * np.pi:
        problems.append(f"--yaw {facts.yaw_rad:g} is more than a turn; give radians: 90° is 1.571")
    if facts.up is not None and facts.up not in UP_AXES:
        problems.append(f"--up {facts.up!r} is no axis; give one of {', '.join(UP_AXES)}")
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
        with atomic_folder(folder, replaces=force) as fresh:
            mesh = trimesh.Trimesh(surface.vertices_mm, surface.faces, process=False)
            mesh.export(fresh / "surface.ply", encoding="binary")
            write_meshes(fresh / "collision.npz", parts)
            text = yaml.safe_dump(
                description, sort_keys=False, allow_unicode=True, default_flow_style=None, width=96
            )
            (fresh / "object.yaml").write_text(text, encoding="utf-8")
            load_object(fresh)
    except OSError as error:
        msg = f"{folder}: cannot be written: {error.strerror or error}; check the folder and disk"
        raise ObjectError(msg) from None
