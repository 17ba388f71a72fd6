"""A user's mesh file as a closed surface in mm, standing at the origin, and its convex parts."""

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import coacd
import manifold3d
import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from tacgen.core.arrays import FloatArray
from tacgen.core.errors import ObjectError
from tacgen.core.records import Mesh, frozen_array
from tacgen.objects.load import MAX_FILE_BYTES
from tacgen.objects.meshes import from_manifold, hull, to_manifold, volume_mm3
from tacgen.physics.gripper import default_gripper

UP_AXES = ("x", "y", "z")
FORMATS = ("obj", "stl", "ply", "glb")
SMALLEST_MM, LARGEST_MM = 2.0, 1000.0
MAX_TRIANGLES = 2_000_000  # limits the time and memory of the import
MANY_TRIANGLES = 200_000  # from here on frames become slower
MAX_LINE_BYTES = 1 << 16  # of a text mesh: a face with thousands of corners
MAX_INSTANCES = 10_000  # of meshes in a GLB; each takes a tenth of a millisecond and a copy
MERGE_MM = 1e-5  # corners within it are one: roundoff of single precision at 100 mm
SLIVER_SHARE = 1e-6  # of the largest body's volume: smaller bodies are roundoff
MAX_HOLE_SHARE = 0.6  # a hole is filled if its rim is at most this share of the mesh's diagonal
MAX_PARTS = 24  # PyBullet's time a step grows with the parts
MAX_PART_VERTICES = 512  # a cylinder's 256 sections; a grasp takes 0.15 s, with 128 vertices 0.12
ELEVATIONS_DEG = (-85.0, -55.0, -30.0, -10.0, 10.0, 30.0, 55.0, 85.0)
"""Where a hull is thinned. None at 0, so that a round side ends in an upright facet at its widest;
the outermost near 90, so that a round bottom stands on a small facet."""
DETAIL_MM = 0.2  # finest detail that the search for cuts between convex parts sees
MOST_TO_CUT = 4000  # triangles that the search sees: its time grows with them
CONVEX_SHARE = 0.01  # of its volume that a convex mesh may lack: roundoff, engraving, dimples
CONCAVITIES = (0.05, 0.02, 0.01)
"""CoACD's threshold, from a coarse to a fine cut: concavity left, as a share of the size."""


def import_surface(
    path: Path, *, scale: float = 1.0, up: str | None = None
) -> tuple[Mesh, list[str]]:
    """Read, check, repair and place a mesh: the closed surface, and notes on what was done.

    ``scale`` is the mm that one unit of the file stands for, 1000 for a mesh in metres; ``up`` the
    file's axis that points up: by default y in a GLB, as glTF has it, and z elsewhere.

    Raises ``ObjectError`` if it is not a closed surface of a size that a gripper can hold, after
    what can safely be repaired; the message says how to fix it.
    """
    path = Path(path)
    loaded = _read(path)
    vertices, faces = np.asarray(loaded.vertices, dtype=np.float64), np.asarray(loaded.faces)
    _check_numbers(path, vertices, faces)
    # What no triangle uses may lie anywhere, beyond any number that can be worked with too.
    used, corners = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used] * scale, corners.reshape(faces.shape)
    up = up or ("y" if path.suffix.lower() == ".glb" else "z")
    # A cyclic change of axes, which mirrors nothing, turns the file's `up` to z.
    vertices = np.roll(vertices, {"x": -1, "y": 1, "z": 0}[up], axis=1)
    _check_size(path, vertices, scale)
    mesh, notes = _closed(path, vertices, faces)
    if len(mesh.faces) > MANY_TRIANGLES:
        notes.append(
            f"{len(mesh.faces)} triangles: frames take longer than with up to {MANY_TRIANGLES}; "
            "a decimated mesh would do"
        )
    return placed(mesh), notes


def meshes_in(path: Path) -> list[Path]:
    """The mesh itself, or the mesh files of a folder by name; an ``ObjectError`` if it has none."""
    if not path.is_dir():
        return [path]
    found = sorted(one for one in path.iterdir() if one.suffix.lower().lstrip(".") in FORMATS)
    if not found:
        msg = f"{path}: holds no mesh file; give one with {', '.join(FORMATS)}"
        raise ObjectError(msg)
    return found


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
    elif kind not in FORMATS:
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
    notes = []
    vertices_mm, faces = _merged(vertices_mm, faces)
    if len(faces) == 0:
        msg = f"{path}: holds no triangle that is more than a line; export it anew"
        raise ObjectError(msg)
    whole = to_manifold(Mesh(vertices_mm, faces))
    if whole.status() != manifold3d.Error.NoError:
        surface = trimesh.Trimesh(vertices_mm, faces, process=False)
        surface.update_faces(surface.unique_faces())
        if not surface.is_winding_consistent:
            trimesh.repair.fix_winding(surface)
            notes.append("faces turned to agree with their neighbours")
        filled, longest_mm = _fill_small_holes(surface)
        if filled:
            notes.append(
                f"{filled} hole(s) filled, the largest with a rim of {longest_mm:.1f} mm: the "
                "surface there is not the object's"
            )
        whole = to_manifold(Mesh(np.array(surface.vertices), np.array(surface.faces)))
        if whole.status() != manifold3d.Error.NoError:
            raise ObjectError(_open_problem(path, surface))
    mesh, about = _around_bodies(path, whole)
    # The file keeps single precision: what is computed is computed from that.
    return Mesh(frozen_array(mesh.vertices_mm.astype(np.float32)), mesh.faces), notes + about


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


def _open_problem(path: Path, surface: trimesh.Trimesh) -> str:
    _, counts = np.unique(surface.edges_sorted, axis=0, return_counts=True)
    return (
        f"{path}: is not a closed surface: {int((counts == 1).sum())} open edges and "
        f"{int((counts > 2).sum())} edges with more than two faces; close it, for instance by "
        "MeshLab's `Close Holes` or Blender's `3D Print Toolbox: Make Manifold`"
    )


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
    around = {k: [j for j in kept if j != k and _is_inside(outward[k], outward[j])] for k in kept}
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


def _is_inside(body: manifold3d.Manifold, other: manifold3d.Manifold) -> bool:
    low, high = (np.reshape(one.bounding_box(), (2, 3)) for one in (body, other))
    if (low[0] < high[0]).any() or (low[1] > high[1]).any():
        return False
    return bool((body - other).volume() <= SLIVER_SHARE * body.volume())


def _fill_small_holes(surface: trimesh.Trimesh) -> tuple[int, float]:
    """Close holes with short rims by a fan, in place: how many, and the longest rim, mm."""
    limit_mm = MAX_HOLE_SHARE * float(np.linalg.norm(surface.extents))
    longest_mm = 0.0
    open_edges = trimesh.grouping.group_rows(surface.edges_sorted, require_count=1)
    if len(open_edges) == 0:
        return 0, 0.0
    # An open edge runs one way round its hole; the fan's face runs the other way.
    follow = {int(end): int(start) for start, end in surface.edges[open_edges]}
    vertices, faces, filled = surface.vertices.tolist(), surface.faces.tolist(), 0
    while follow:
        start, at = follow.popitem()
        rim = [start, at]
        while at != start and at in follow:
            at = follow.pop(at)
            rim.append(at)
        rim = rim[:-1]
        points = surface.vertices[rim]
        length_mm = float(np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).sum())
        if at != start or len(rim) < 3 or length_mm > limit_mm:
            continue
        vertices.append(points.mean(axis=0).tolist())
        middle = len(vertices) - 1
        faces += [[rim[i], rim[(i + 1) % len(rim)], middle] for i in range(len(rim))]
        filled, longest_mm = filled + 1, max(longest_mm, length_mm)
    surface.vertices, surface.faces = np.array(vertices), np.array(faces)
    return filled, longest_mm


def convex_parts(surface: Mesh) -> Iterator[tuple[Mesh, ...]]:
    """Convex hulls that follow ``surface``, from few to at most ``MAX_PARTS``.

    A convex surface has its own hull. CoACD only finds where to cut others: a part is the hull of
    its cut faces and of all the surface's vertices within it.

    Source: Wei et al. 2022, Approximate Convex Decomposition for 3D Meshes with
    Collision-Aware Concavity and Tree Search.
    """
    if volume_mm3(hull(surface.vertices_mm)) <= (1 + CONVEX_SHARE) * volume_mm3(surface):
        yield (_even_hull(surface.vertices_mm),)
        return
    coacd.set_log_level("error")
    # The search's time grows with the triangles.
    tolerance_mm, whole = DETAIL_MM, to_manifold(surface)
    while (coarse_solid := whole.simplify(tolerance_mm)).num_tri() > MOST_TO_CUT:
        tolerance_mm *= 1.5
    coarse = from_manifold(coarse_solid)
    for concavity in CONCAVITIES:
        parts = coacd.run_coacd(
            coacd.Mesh(np.array(coarse.vertices_mm), np.array(coarse.faces)),
            threshold=concavity,
            max_convex_hull=MAX_PARTS,
            mcts_iterations=100,
            mcts_nodes=15,
            seed=0,
        )
        yield tuple(_detailed(vertices, surface) for vertices, _ in parts)


def _detailed(part_mm: NDArray[np.float64], surface: Mesh) -> Mesh:
    """The hull of a part cut from the coarse surface, with the vertices of ``surface`` in it."""
    low, high = part_mm.min(axis=0) - DETAIL_MM, part_mm.max(axis=0) + DETAIL_MM
    points = surface.vertices_mm
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    for *normal, offset in ConvexHull(part_mm).equations:
        points = points[points @ np.array(normal) + offset <= DETAIL_MM]
    return _even_hull(np.concatenate([part_mm, points]))


def _even_hull(points_mm: NDArray[np.float64]) -> Mesh:
    """The hull of points (n, 3), of at most ``MAX_PART_VERTICES`` of them.

    Where there are more, those stay that reach farthest in directions evenly around z, as many as
    possible and the same above and below: pads meet it alike on both sides, at any yaw. A collapse
    of edges would leave them touching it off axis.
    """
    corners_mm = kept = hull(points_mm).vertices_mm
    around = MAX_PART_VERTICES
    while len(kept) > MAX_PART_VERTICES:
        around //= 2
        azimuths = (np.arange(around) + 0.5) * 2 * np.pi / around
        farthest = {
            int(np.argmax(corners_mm @ [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]))
            for e in np.radians(ELEVATIONS_DEG)
            for a in azimuths
        }
        kept = corners_mm[sorted(farthest)]
    return hull(kept)
