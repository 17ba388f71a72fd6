"""A user's mesh file as a closed surface in mm, standing at the origin."""

import io
import json
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tacgen.core.errors import ObjectError
from tacgen.core.records import Mesh, frozen_array
from tacgen.core.types import FloatArray
from tacgen.objects.healing import Healed, heal
from tacgen.objects.load import MAX_FILE_BYTES
from tacgen.objects.meshes import (
    from_manifold,
    mass_properties,
    to_manifold,
    volume_mm3,
)
from tacgen.objects.urdf import read_urdf
from tacgen.physics.gripper import default_gripper

UP_AXES = ("x", "y", "z")
FORMATS = ("obj", "stl", "ply", "glb", "urdf")
SMALLEST_MM, LARGEST_MM = 2.0, 1000.0
MAX_TRIANGLES = 2_000_000  # limits the time and memory of the import
MANY_TRIANGLES = 200_000  # from here on frames become slower
MAX_LINE_BYTES = 1 << 16  # of a text mesh: a face with thousands of corners
MAX_INSTANCES = 10_000  # of meshes in a GLB; each takes a tenth of a millisecond and a copy
MERGE_MM = 1e-5  # corners within it are one: roundoff of single precision at 100 mm
SLIVER_SHARE = 1e-6  # of the largest body's volume: smaller bodies are roundoff


def import_surface(
    path: Path, *, scale: float | None = None, up: str | None = None
) -> tuple[Mesh, list[str]]:
    """Read, check, repair and place a mesh: the closed surface, and notes on what was done.

    ``scale`` is the mm that one unit of the file stands for: by default 1000 in a URDF, which is in
    metres, and 1 elsewhere; ``up`` the file's axis that points up: by default y in a GLB, as glTF
    has it, and z elsewhere.

    Raises ``ObjectError`` if it is not a closed surface of a size that a gripper can hold, after
    what can safely be repaired; the message says how to fix it.
    """
    path, notes = Path(path), list[str]()
    if path.suffix.lower() == ".urdf" and path.is_file():
        loaded, notes = read_urdf(path, _read)
    else:
        loaded = _read(path)
    if scale is None:
        scale = 1000.0 if path.suffix.lower() == ".urdf" else 1.0
    vertices, faces = np.asarray(loaded.vertices, dtype=np.float64), np.asarray(loaded.faces)
    _check_numbers(path, vertices, faces)
    # What no triangle uses may lie anywhere, beyond any number that can be worked with too.
    used, corners = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used] * scale, corners.reshape(faces.shape)
    up = up or ("y" if path.suffix.lower() == ".glb" else "z")
    # A cyclic change of axes, which mirrors nothing, turns the file's `up` to z.
    vertices = np.roll(vertices, {"x": -1, "y": 1, "z": 0}[up], axis=1)
    _check_size(path, vertices, scale)
    mesh, about = _closed(path, vertices, faces)
    notes += about
    if len(mesh.faces) > MANY_TRIANGLES:
        notes.append(
            f"{len(mesh.faces)} triangles: frames take longer than with up to {MANY_TRIANGLES}; "
            "a decimated mesh would do"
        )
    return placed(mesh), notes


def placed(mesh: Mesh, rotation: FloatArray | None = None) -> Mesh:
    """The mesh, turned by ``rotation`` (3, 3), with the middle of its footprint at the origin."""
    vertices = mesh.vertices_mm if rotation is None else mesh.vertices_mm @ rotation.T
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    footprint = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return Mesh(frozen_array(vertices - footprint), mesh.faces)


def _read(path: Path) -> trimesh.Trimesh:
    kind = path.suffix.lower().lstrip(".")
    problem = ""
    if not path.is_file():
        problem = "no such file; give a mesh file"
    elif kind not in FORMATS or kind == "urdf":
        problem = f"not a mesh tacgen reads; give one of {', '.join(FORMATS)}"
    elif path.stat().st_size > MAX_FILE_BYTES:
        problem = f"larger than {MAX_FILE_BYTES >> 20} MiB; simplify the mesh first"
    if problem:
        msg = f"{path}: {problem}"
        raise ObjectError(msg)
    data = path.read_bytes()
    if problem := _unfolds_to_too_much(kind, data):
        msg = f"{path}: {problem}"
        raise ObjectError(msg)
    try:
        # From memory, where a part that says it is larger than the file takes no more than that;
        # without a resolver: nothing but this file is opened, whatever it refers to.
        file = io.BytesIO(data)
        loaded = trimesh.load(file, file_type=kind, force="mesh", process=False)
    except Exception as error:
        # The readers raise whatever a damaged file leads them to.
        msg = f"{path}: cannot be read as {kind.upper()}: {error}; export it anew"
        raise ObjectError(msg) from None
    if not isinstance(loaded, trimesh.Trimesh) or len(loaded.faces) == 0:
        msg = f"{path}: holds no triangles; export it as a triangle mesh"
        raise ObjectError(msg)
    return loaded


def _unfolds_to_too_much(kind: str, data: bytes) -> str:
    """Why a small file would take minutes or gigabytes to read; empty where it would not."""
    if kind == "obj":
        longest = max(map(len, data.split(b"\n")))
        return f"has a line of {longest} bytes; export it anew" * (longest > MAX_LINE_BYTES)
    if kind != "glb" or data[:4] != b"glTF":
        return ""
    try:
        tree = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        meshes = [_triangles_of(tree, mesh) for mesh in tree.get("meshes", ())]
        used = [node["mesh"] for node in tree.get("nodes", ()) if "mesh" in node]
        triangles = sum(meshes[number] for number in used)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return "cannot be read as GLB: its table of contents is broken; export it anew"
    if len(used) > MAX_INSTANCES:
        return f"places {len(used)} meshes, more than {MAX_INSTANCES}; join them into one mesh"
    return _too_many(triangles) if triangles > MAX_TRIANGLES else ""


def _triangles_of(tree: Any, mesh: Any) -> int:
    """Triangles of a glTF mesh, as its table of contents says."""
    counts = [
        tree["accessors"][part.get("indices", part["attributes"]["POSITION"])]["count"]
        for part in mesh["primitives"]
    ]
    return sum(int(count) for count in counts) // 3


def _too_many(triangles: int) -> str:
    fix = "decimate it, for instance in MeshLab or Blender"
    return f"{triangles} triangles, more than {MAX_TRIANGLES}; {fix}"


def _check_numbers(path: Path, vertices: NDArray[np.float64], faces: NDArray[Any]) -> None:
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        msg = f"{path}: its corners are not points in space; export it as a triangle mesh"
        raise ObjectError(msg)
    problems = []
    bad = int((~np.isfinite(vertices).all(axis=1)).sum())
    if bad:
        problems.append(f"{path}: {bad} vertices have coordinates that are no numbers; export anew")
    if len(faces) > MAX_TRIANGLES:
        problems.append(f"{path}: {_too_many(len(faces))}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        problems.append(f"{path}: has triangles whose corners do not exist; export it anew")
    ObjectError.raise_if(problems)


def _check_size(path: Path, vertices_mm: NDArray[np.float64], scale: float) -> None:
    size, stroke_mm = np.ptp(vertices_mm, axis=0), default_gripper().stroke_mm
    problem = ""
    if size.min() <= 0:
        problem = "flat; give a solid object"
    elif size.max() < SMALLEST_MM:
        problem = (
            f"too small; if the mesh is in metres, pass --scale {1000 * scale:g}, "
            f"if in inches, --scale {25.4 * scale:g}"
        )
    elif size.max() > LARGEST_MM or _narrowest_mm(vertices_mm) > stroke_mm:
        problem = (
            f"too large for a gripper that opens {stroke_mm:.0f} mm; --scale is mm per unit of the "
            f"mesh: 1 for mm, 1000 for metres, and {scale:g} was given"
        )
    if problem:
        msg = f"{path}: is {' × '.join(f'{extent:.4g}' for extent in size)} mm, {problem}"
        raise ObjectError(msg)


def _narrowest_mm(vertices_mm: NDArray[np.float64]) -> float:
    """Least distance between two parallel planes around the points: along a normal of their hull.

    Where two edges are nearest to each other the true width is a little less.

    Source: Houle & Toussaint 1988, Computing the width of a set.
    """
    if len(vertices_mm) < 4:
        return 0.0
    corners = vertices_mm[ConvexHull(vertices_mm, qhull_options="QJ").vertices]
    normals = ConvexHull(corners, qhull_options="QJ").equations[:, :3]
    return min(float(np.ptp(corners @ normal)) for normal in normals)


def _closed(
    path: Path, vertices_mm: NDArray[np.float64], faces: NDArray[Any]
) -> tuple[Mesh, list[str]]:
    """The surface around what the mesh encloses, faces outward, and notes on what was changed.

    Corners are merged, never moved: a sliver stays, as taking it out would open the surface.
    """
    vertices_mm, faces = _merged(vertices_mm, faces)
    if len(faces) == 0:
        msg = f"{path}: holds no triangle that is more than a line; export it anew"
        raise ObjectError(msg)
    whole, healed = to_manifold(Mesh(vertices_mm, faces)), None
    if whole.status() != manifold3d.Error.NoError:
        healed = heal(vertices_mm, faces)
        if healed.problem:
            msg = f"{path}: {healed.problem}"
            raise ObjectError(msg)
        whole = to_manifold(healed.mesh)
    mesh, notes = _around_bodies(path, whole)
    # The file keeps single precision: what is computed is computed from that.
    mesh = Mesh(frozen_array(mesh.vertices_mm.astype(np.float32)), mesh.faces)
    return mesh, _healing_notes(healed, Mesh(vertices_mm, faces), mesh) + notes


def _healing_notes(healed: Healed | None, given: Mesh, closed: Mesh) -> list[str]:
    """What was changed, and by how much: volume and centre of mass."""
    if healed is None:
        return []
    notes = ["faces turned to agree with their neighbours"] if healed.turned else []
    if healed.rims:
        # Of faces that are not closed, about the middle of the whole.
        middle = given.vertices_mm.min(axis=0) / 2 + given.vertices_mm.max(axis=0) / 2
        centered = Mesh(given.vertices_mm - middle, given.faces)
        volumes = volume_mm3(centered), volume_mm3(closed)
        moved = mass_properties([(closed, 1.0)], 1.0)[0] - middle
        moved -= mass_properties([(centered, 1.0)], 1.0)[0]
        notes.append(
            f"{healed.rims} hole(s) or cracks filled, the largest with a rim of "
            f"{healed.longest_rim_mm:.1f} mm; {100 * healed.invented:.2g} % of the surface is not "
            f"the object's; volume {abs(volumes[0]) / 1000:.4g} → {volumes[1] / 1000:.4g} cm³, "
            f"centre of mass moved by {np.linalg.norm(moved):.2g} mm"
        )
    return notes


def _merged(
    vertices_mm: NDArray[np.float64], faces: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Corners that are within ``MERGE_MM`` in one, without triangles that become lines."""
    grid = np.round(vertices_mm / MERGE_MM)
    _, first, same = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    corners = same.reshape(-1)[faces]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    used, corners = np.unique(corners, return_inverse=True)
    return vertices_mm[first[used]], corners.reshape(-1, 3)


def _around_bodies(path: Path, whole: manifold3d.Manifold) -> tuple[Mesh, list[str]]:
    """The surface of all bodies of a closed mesh together, and notes.

    Each body is turned outward by itself. One that lies inside another is a cavity where its faces
    look the other way than those of the outermost around it; else it is solid.
    """
    bodies = [body for body in whole.decompose() if abs(body.volume()) > 0]
    sizes = [abs(body.volume()) for body in bodies]
    largest = max(sizes, default=0.0)
    kept = [k for k, size in enumerate(sizes) if size > SLIVER_SHARE * largest]
    if not kept:
        msg = f"{path}: encloses no volume; give a solid object with its faces outward"
        raise ObjectError(msg)
    inward = {k for k in kept if bodies[k].volume() < 0}
    outward = {k: _turned(bodies[k]) if k in inward else bodies[k] for k in kept}
    boxes = np.array([np.reshape(bodies[k].bounding_box(), (2, 3)) for k in kept])
    around = {
        k: [j for j in _boxed(kept, boxes, low, high) if j != k and _is_in(outward[k], outward[j])]
        for k, (low, high) in zip(kept, boxes, strict=True)
    }
    cavities = set()
    if len(bodies) == 1 and not inward:
        return from_manifold(whole), []
    solid = manifold3d.Manifold()
    for k in sorted(kept, key=lambda k: len(around[k])):
        outermost = max(around[k], key=lambda j: sizes[j], default=k)
        if (k in inward) != (outermost in inward):
            cavities.add(k)
            solid -= outward[k]
        else:
            solid += outward[k]
    turned = inward - cavities
    notes = [f"{len(turned)} of {len(kept)} bodies turned outward"] if turned else []
    if len(kept) > 1:
        notes.append(f"{len(kept)} separate bodies united")
    if cavities:
        hollow = sum(sizes[k] for k in cavities)
        notes.append(f"{len(cavities)} closed cavities of {hollow / 1000:.3g} cm³ kept")
    pieces = sum(piece.volume() > 0 for piece in solid.decompose())
    if pieces > 1:
        notes.append(f"{pieces} pieces apart from each other are one rigid body")
    return from_manifold(solid), notes


def _turned(body: manifold3d.Manifold) -> manifold3d.Manifold:
    """Inside out: the same surface with its faces the other way."""
    mesh = body.to_mesh64()
    points = np.asarray(mesh.vert_properties)[:, :3]
    faces = np.asarray(mesh.tri_verts).astype(np.int64)[:, ::-1]
    return to_manifold(Mesh(points, frozen_array(faces, np.int32)))


def _boxed(bodies: list[int], boxes: FloatArray, low: FloatArray, high: FloatArray) -> list[int]:
    """The bodies whose boxes (n, 2, 3) hold another: of thousands a few."""
    holds = (boxes[:, 0] <= low).all(axis=1) & (boxes[:, 1] >= high).all(axis=1)
    return [bodies[place] for place in np.flatnonzero(holds)]


def _is_in(body: manifold3d.Manifold, other: manifold3d.Manifold) -> bool:
    return bool((body - other).volume() <= SLIVER_SHARE * body.volume())
