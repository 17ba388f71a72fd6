"""From an object's name to the ``GraspObject`` that the physics and the gel work with."""

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.core.errors import ObjectError
from tacgen.core.records import GraspObject, Mesh, frozen_array
from tacgen.core.resources import find_object_folder
from tacgen.core.safe_io import check_archive
from tacgen.objects.description import ObjectDescription, read_description
from tacgen.objects.meshes import mass_properties, volume_mm3

MAX_FILE_BYTES = 512 << 20  # far more than any mesh in use
MAX_PARTS = 256  # far more than the import makes


def read_surface(path: Path, scale_mm: float) -> Mesh:
    """The surface in a mesh file, one unit of which is ``scale_mm``.

    Raises ``ObjectError`` if it cannot be read, or holds no mesh.
    """
    if path.suffix == ".npz":
        return read_meshes(path, scale_mm)[0]
    import trimesh  # slow to import, and shipped objects do not need it

    _check_file(path)
    try:
        loaded = trimesh.load_mesh(path, process=False)
    except (ValueError, TypeError, KeyError, IndexError, OSError, NotImplementedError) as error:
        msg = f"{path}: cannot be read as a mesh: {error}; import it anew with `tacgen objects add`"
        raise ObjectError(msg) from None
    return _checked(path, np.asarray(loaded.vertices) * scale_mm, np.asarray(loaded.faces))


def read_meshes(path: Path, scale_mm: float) -> tuple[Mesh, ...]:
    """The meshes written by ``write_meshes``; raises ``ObjectError`` if they cannot be read."""
    _check_file(path)
    try:
        check_archive(path)
        with np.load(path, allow_pickle=False) as file:
            count = int(file["parts"])
            if not 1 <= count <= MAX_PARTS:
                msg = f"{path}: holds {count} meshes, not 1 to {MAX_PARTS}; import it anew"
                raise ObjectError(msg)
            return tuple(
                _checked(path, file[f"vertices_{i}"] * scale_mm, file[f"faces_{i}"])
                for i in range(count)
            )
    except (
        *(ValueError, KeyError, TypeError, OverflowError, OSError, EOFError),
        zipfile.BadZipFile,
    ) as error:
        msg = f"{path}: cannot be read: {error}; import it anew with `tacgen objects add --force`"
        raise ObjectError(msg) from None


def write_meshes(path: Path, meshes: Sequence[Mesh]) -> None:
    """Write a compressed .npz that ``read_meshes`` reads to the last bit."""
    arrays: dict[str, np.ndarray] = {"parts": np.array(len(meshes))}
    for i, mesh in enumerate(meshes):
        arrays[f"vertices_{i}"] = mesh.vertices_mm
        arrays[f"faces_{i}"] = mesh.faces
    # Like numpy's savez, but LZMA halves what its deflate leaves of a mesh.
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.save(content, array, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), zipfile.ZIP_LZMA)


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

    The same object gives the same arrays bit for bit. Where the description gives no inertia it is
    that of the evenly filled surface, scaled to the mass and carried to the stated centre of mass.

    Raises ``ObjectError`` if there is no such object or its files cannot be used; every problem is
    listed.
    """
    folder = find_object_folder(str(name_or_folder))
    description = read_description(folder)
    source, mass_kg = description.shape, description.mass_kg.value
    if source.builder is None:
        surface = read_surface(folder / str(source.mesh), source.scale)
        collision = read_meshes(folder / str(source.collision), source.scale)
    else:
        from tacgen.objects.solids import build_solid  # imports trimesh, which is slow

        surface, part = build_solid(source.builder, source.parameters)
        collision = (part,)
    _check_shape(surface, description, folder)
    if description.inertia_kg_mm2 is None:
        inertia = mass_properties([(surface, 1.0)], mass_kg)[1]
    else:
        inertia = np.array(description.inertia_kg_mm2.value)
    spinning = description.spinning_friction_mm
    return GraspObject(
        name=description.name,
        surface=surface,
        collision=collision,
        mass_kg=mass_kg,
        center_of_mass_mm=frozen_array(description.center_of_mass_mm.value),
        inertia_kg_mm2=frozen_array(inertia),
        friction=description.friction.value,
        spinning_friction_mm=None if spinning is None else spinning.value,
        grasp_ranges=description.grasp_ranges.axes(),
        color_rgb=description.color_rgb,
        folder=folder,
    )


def _check_shape(surface: Mesh, description: ObjectDescription, folder: Path) -> None:
    """Refuse a shape that is not the solid that its description speaks of."""
    where = folder / "object.yaml"
    vertices = surface.vertices_mm
    if volume_mm3(surface) <= 0:
        msg = f"{where}: shape encloses no volume; check its mesh"
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
    if description.inertia_kg_mm2 is not None:
        inertia = np.array(description.inertia_kg_mm2.value)
        moments = np.linalg.eigvalsh(inertia)
        if not np.array_equal(inertia, inertia.T) or moments[0] <= 0:
            problems.append(
                f"{where}: inertia_kg_mm2 is not symmetric with positive moments; correct it"
            )
        elif moments[2] > (moments[0] + moments[1]) * (1 + 1e-6):
            listed = ", ".join(f"{moment:.3g}" for moment in moments)
            problems.append(
                f"{where}: inertia_kg_mm2 has the principal moments {listed}, which no body has "
                "(each is at most the sum of the others); compute it from the mesh"
            )
    ObjectError.raise_if(problems)
