"""From an object's name to the ``GraspObject`` that the physics and the gel work with."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import QhullError

from tacgen.core.errors import ObjectError
from tacgen.core.records import GraspObject, Mesh, frozen_array
from tacgen.core.resources import find_object_folder
from tacgen.core.safe_io import check_archive
from tacgen.objects.description import ObjectDescription, read_description
from tacgen.objects.shapes import BUILDERS, Shape
from tacgen.objects.shapes.mass_properties import mass_properties, volume_mm3

MAX_FILE_BYTES = 512 << 20  # far more than any mesh in use
MAX_PARTS = 256  # far more than the import makes


def read_surface(path: Path, scale_mm: float) -> Mesh:
    """The surface in a mesh file, one unit of which is ``scale_mm``."""
    import trimesh  # slow to import, and not every object has a mesh

    _check_file(path)
    try:
        loaded = trimesh.load_mesh(path, process=False)
    except (ValueError, TypeError, KeyError, IndexError, OSError, NotImplementedError) as error:
        msg = f"{path}: cannot be read as a mesh: {error}; import it anew with `tacgen objects add`"
        raise ObjectError(msg) from None
    return _checked(path, np.asarray(loaded.vertices) * scale_mm, np.asarray(loaded.faces))


def read_parts(path: Path, scale_mm: float) -> tuple[Mesh, ...]:
    """The convex parts written by ``write_parts``."""
    _check_file(path)
    try:
        check_archive(path)
        with np.load(path, allow_pickle=False) as file:
            count = int(file["parts"])
            if not 1 <= count <= MAX_PARTS:
                msg = f"{path}: holds {count} parts, not 1 to {MAX_PARTS}; import it anew"
                raise ObjectError(msg)
            return tuple(
                _checked(path, file[f"vertices_{i}"] * scale_mm, file[f"faces_{i}"])
                for i in range(count)
            )
    except (ValueError, KeyError, TypeError, OSError, EOFError, zipfile.BadZipFile) as error:
        msg = (
            f"{path}: cannot be read as convex parts: {error}; "
            "import it anew with `tacgen objects add --force`"
        )
        raise ObjectError(msg) from None


def write_parts(path: Path, parts: Sequence[Mesh]) -> None:
    """Write convex parts so that ``read_parts`` reads the same numbers."""
    arrays: dict[str, np.ndarray] = {"parts": np.array(len(parts))}
    for i, part in enumerate(parts):
        arrays[f"vertices_{i}"] = part.vertices_mm
        arrays[f"faces_{i}"] = part.faces
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)


def _check_file(path: Path) -> None:
    if path.is_symlink() or not path.is_file():
        msg = f"{path}: no such file, or a link; import it anew with `tacgen objects add --force`"
        raise ObjectError(msg)
    if path.stat().st_size > MAX_FILE_BYTES:
        msg = f"{path}: larger than {MAX_FILE_BYTES >> 20} MiB; simplify the mesh and import it"
        raise ObjectError(msg)


def _checked(path: Path, vertices_mm: np.ndarray, faces: np.ndarray) -> Mesh:
    """A mesh record, if the arrays are one."""
    problem = ""
    if vertices_mm.shape[1:] != (3,) or faces.shape[1:] != (3,) or len(faces) == 0:
        problem = "holds no triangles; import it anew with `tacgen objects add --force`"
    elif not np.isfinite(vertices_mm).all() or faces.min() < 0 or faces.max() >= len(vertices_mm):
        problem = "has coordinates or faces that are no numbers; import it anew"
    if problem:
        msg = f"{path}: {problem}"
        raise ObjectError(msg)
    return Mesh(frozen_array(vertices_mm), frozen_array(faces, np.int32))


SIZE_TOLERANCE = 0.1
"""Seams stand out and flutes lie lower than the published size; a wrong unit is far off."""


def load_object(name_or_folder: str | Path) -> GraspObject:
    """The object of that name (``./objects`` first, then what tacgen ships) or in that folder.

    The same object gives the same arrays bit for bit. The inertia is that of the solid's own
    mass distribution, scaled to the measured mass and carried to the stated centre of mass.

    Raises ``ObjectError`` if there is no such object or its files cannot be used; every problem is
    listed.
    """
    folder = find_object_folder(str(name_or_folder))
    description = read_description(folder)
    shape = build_shape(description, folder)
    bodies = [(body.mesh, body.density_kg_m3) for body in shape.bodies]
    properties = mass_properties(bodies or [(shape.surface, 1.0)], description.mass_kg.value)
    return GraspObject(
        name=description.name,
        surface=shape.surface,
        collision=shape.collision,
        mass_kg=description.mass_kg.value,
        center_of_mass_mm=frozen_array(description.center_of_mass_mm.value),
        inertia_kg_mm2=frozen_array(properties.inertia_kg_mm2),
        friction=description.friction.value,
        spinning_friction_mm=description.spinning_friction_mm.value,
        grasp_ranges=description.grasp_ranges.axes(),
        color_rgb=description.color_rgb,
        folder=folder,
    )


def build_shape(description: ObjectDescription, folder: Path) -> Shape:
    """The shape that a description names: built, or read from the files in its folder."""
    source = description.shape
    if source.builder is not None:
        try:
            shape = BUILDERS[source.builder](**description.build_arguments())
        except (ValueError, ArithmeticError, IndexError, MemoryError, QhullError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            msg = (
                f"{folder / 'object.yaml'}: shape.parameters do not make a {source.builder}: "
                f"{reason}; check the dimensions"
            )
            raise ObjectError(msg) from None
    else:
        shape = Shape(
            read_surface(folder / str(source.mesh), source.scale),
            read_parts(folder / str(source.collision), source.scale),
        )
    _check_shape(shape, description, folder)
    return shape


def _check_shape(shape: Shape, description: ObjectDescription, folder: Path) -> None:
    """Refuse a shape that is not the solid that its description speaks of."""
    where = folder / "object.yaml"
    vertices = shape.surface.vertices_mm
    if not np.isfinite(vertices).all() or volume_mm3(shape.surface) <= 0:
        msg = f"{where}: shape encloses no volume; check its dimensions or mesh"
        raise ObjectError(msg)
    problems = []
    extent = np.ptp(vertices, axis=0)
    stated = np.array(description.dimensions_mm.value)
    if not np.allclose(extent, stated, rtol=SIZE_TOLERANCE):
        shown = [" × ".join(f"{value:.4g}" for value in size) for size in (extent, stated)]
        problems.append(
            f"{where}: shape is {shown[0]} mm, but dimensions_mm says {shown[1]}; correct either"
        )
    center = np.array(description.center_of_mass_mm.value)
    if (center < vertices.min(axis=0)).any() or (center > vertices.max(axis=0)).any():
        problems.append(
            f"{where}: center_of_mass_mm = {center.tolist()} lies outside the object; "
            "give it in the object's frame, mm"
        )
    if problems:
        raise ObjectError.from_problems(problems)
