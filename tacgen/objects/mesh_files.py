"""The mesh files inside an object's folder: a surface as PLY, its convex parts as NPZ."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.core.errors import ObjectError
from tacgen.core.records import Mesh, frozen_array
from tacgen.core.safe_io import check_archive

MAX_FILE_BYTES = 512 << 20
MAX_PARTS = 256


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
    right_shape = vertices_mm.ndim == 2 and vertices_mm.shape[1:] == (3,) and faces.ndim == 2
    if not right_shape or faces.shape[1:] != (3,) or len(faces) == 0:
        msg = f"{path}: holds no triangles; import it anew with `tacgen objects add --force`"
        raise ObjectError(msg)
    if not np.isfinite(vertices_mm).all() or faces.min() < 0 or faces.max() >= len(vertices_mm):
        msg = f"{path}: has coordinates or faces that are no numbers; import it anew"
        raise ObjectError(msg)
    return Mesh(frozen_array(vertices_mm), frozen_array(faces, np.int32))
