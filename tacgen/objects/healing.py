"""Faces that enclose nothing as they are, made into closed bodies: cut apart, turned, capped."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tacgen.core.compiled import njit
from tacgen.core.records import Mesh, frozen_array
from tacgen.core.types import FloatArray
from tacgen.objects.meshes import solid_angles

SHEET_SHARE = 0.25
"""Of the surface that would be invented, from which on the faces are sheets: a flat one takes half,
a bowl without thickness a third, a scanned can without its bottom an eighth."""
CONTAINER_SHARE = 0.6  # of the diagonal, from which on a rim at the top is a container's opening
NEAR_TOP = 0.1  # of the height
UPRIGHT = 0.7  # of a cap's area that faces up or down
MOST_HIDDEN = 50  # of the largest caps, of which it is found out whether they lie inside the rest
MOST_RIM = 300  # corners of a rim that are triangulated at once: the time grows by their cube
SHAPE_WEIGHT = 1e-4  # of squared edges beside the area: of equal areas the compact triangles


@dataclass(frozen=True, slots=True)
class Healed:
    """Closed bodies, and what it took.

    ``problem`` says why there are none; ``invented`` is the share of the surface that is new.
    """

    mesh: Mesh
    turned: bool = False
    rims: int = 0
    longest_rim_mm: float = 0.0
    invented: float = 0.0
    problem: str = ""


def heal(vertices_mm: FloatArray, faces: NDArray[np.integer]) -> Healed:
    """Close what the faces nearly enclose; corners are kept, none is moved.

    Faces are cut apart at edges of more than two, those of each piece turned alike, and its rims
    capped by triangles of the least area, which zip a crack up and span a hole. A flat sheet
    becomes a body without volume.

    Source: Barequet & Sharir 1995, Filling gaps in the boundary of a polyhedron.
    """
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    faces = faces[np.sort(first)]
    piece, flip = _pieces(faces, _areas_mm2(vertices_mm[faces]))
    faces = np.where(flip[:, None], faces[:, ::-1], faces)
    # Each piece has corners of its own.
    corners = np.stack([np.repeat(piece, 3), faces.reshape(-1)], axis=1)
    own, faces = np.unique(corners, axis=0, return_inverse=True)
    points, faces = vertices_mm[own[:, 1]], faces.reshape(-1, 3)

    caps, longest_mm = list[NDArray[np.int64]](), 0.0
    size_mm = np.ptp(vertices_mm, axis=0)
    limit_mm = CONTAINER_SHARE * float(np.linalg.norm(size_mm))
    for rim in _rims(faces):
        ends = points[rim]
        length_mm = float(np.linalg.norm(np.roll(ends, -1, axis=0) - ends, axis=1).sum())
        cap = rim[_spanned(ends)]
        if length_mm > limit_mm and _opens_upward(points[cap], ends, vertices_mm[:, 2]):
            problem = (
                "is open at the top, a container whose walls have no thickness; give them some, for"
                " instance by Blender's `Solidify`"
            )
            return Healed(Mesh(points, frozen_array(faces, np.int32)), problem=problem)
        caps.append(cap)
        longest_mm = max(longest_mm, length_mm)
    new = np.concatenate([np.zeros((0, 3), np.int64), *caps])
    owner = np.repeat([int(own[cap[0, 0], 0]) for cap in caps], [len(cap) for cap in caps])
    shown = _are_shown(points, np.concatenate([faces, new]), np.append(piece, owner), caps)
    given_mm2 = _areas_mm2(points[faces]).sum()
    new_mm2 = (_areas_mm2(points[new]) * np.repeat(shown, [len(cap) for cap in caps])).sum()
    invented = float(new_mm2 / (given_mm2 + new_mm2))
    return Healed(
        Mesh(points, frozen_array(np.append(faces, new, axis=0), np.int32)),
        turned=bool(flip.any()),
        rims=len(caps),
        longest_rim_mm=longest_mm,
        invented=invented,
        problem=_open_problem(faces, invented) if invented > SHEET_SHARE else "",
    )


def _are_shown(
    points_mm: FloatArray,
    faces: NDArray[np.integer],
    piece: NDArray[np.integer],
    caps: list[NDArray[np.int64]],
) -> NDArray[np.bool_]:
    """Whether each cap lies outside of all other pieces, by its largest triangle's middle."""
    shown = np.ones(len(caps), dtype=bool)
    sizes = [float(_areas_mm2(points_mm[cap]).sum()) for cap in caps]
    for k in np.argsort(sizes)[::-1][:MOST_HIDDEN]:
        largest = caps[k][np.argmax(_areas_mm2(points_mm[caps[k]]))]
        angle = solid_angles(points_mm[faces] - points_mm[largest].mean(axis=0))
        own = piece[np.flatnonzero((faces == largest).all(axis=1))[0]]
        shares = np.abs(np.bincount(piece.astype(np.int64), angle)) / (4 * np.pi)
        shown[k] = not (np.delete(shares, own) > 0.5).any()
    return shown


def _open_problem(faces: NDArray[np.integer], invented: float) -> str:
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    return (
        f"is not a closed surface: {int((counts % 2 == 1).sum())} open edges, and "
        f"{100 * invented:.0f} % of the surface would be invented to close it; close it, for "
        "instance by MeshLab's `Close Holes` or Blender's `3D Print Toolbox: Make Manifold`, or "
        "give sheets a thickness by Blender's `Solidify`"
    )


def _areas_mm2(corners_mm: FloatArray) -> FloatArray:
    a, b, c = np.moveaxis(corners_mm, 1, 0)
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)


def _directed(faces: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Edges (3 n,) of faces (n, 3) by number, and +1 or −1 for the way in which each runs."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    low, high = edges.min(axis=1), edges.max(axis=1)
    _, number = np.unique(low * (int(high.max()) + 1) + high, return_inverse=True)
    return number.reshape(-1), np.where(edges[:, 0] == low, 1, -1)


def _pieces(
    faces: NDArray[np.integer], areas_mm2: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The piece of each face (n,), joined by edges of two faces, and whether to turn it round.

    Faces of a piece are turned to agree with the larger part of it. A face is two nodes of a graph,
    one a side; sides that agree are joined, so that the two sides of a piece fall apart unless it
    has only one, as a Möbius strip; that is left as it is.
    """
    number, way = _directed(faces)
    order = np.argsort(number, kind="stable")
    starts = np.flatnonzero(np.diff(number[order], prepend=-1))
    starts = starts[np.diff(starts, append=len(order)) == 2]
    one, other = order[starts], order[starts + 1]
    count, a, b = len(faces), one // 3, other // 3
    agree = way[one] != way[other]
    left = np.concatenate([a, a + count])
    right = np.concatenate([np.where(agree, b, b + count), np.where(agree, b + count, b)])
    graph = coo_matrix((np.ones(len(left), bool), (left, right)), shape=(2 * count, 2 * count))
    label = connected_components(graph, directed=False)[1]
    _, piece = np.unique(np.minimum(label[:count], label[count:]), return_inverse=True)
    piece = piece.reshape(-1)
    is_back = label[:count] > label[count:]
    balance_mm2 = np.bincount(piece, np.where(is_back, -areas_mm2, areas_mm2))
    is_one_sided = label[:count] == label[count:]
    return piece, np.where(is_one_sided, False, is_back == (balance_mm2[piece] >= 0))


def _rims(faces: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Loops of corners around holes, in the order of the faces that are missing.

    No corner comes twice in a loop.
    """
    number, way = _directed(faces)
    net = np.bincount(number, way)
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    follow: dict[int, list[int]] = {}
    left = net.copy()
    for k in np.flatnonzero((net[number] != 0) & (np.sign(net[number]) == way)):
        if left[number[k]]:
            left[number[k]] -= way[k]
            follow.setdefault(int(edges[k, 1]), []).append(int(edges[k, 0]))
    loops = []
    while follow:
        path = [next(iter(follow))]
        place = {path[0]: 0}
        while path[-1] in follow:
            at = path[-1]
            after = follow[at].pop()
            if not follow[at]:
                del follow[at]
            if after in place:  # the loop since then is done
                start = place[after]
                loop, path = path[start:], path[: start + 1]
                for corner in loop[1:]:
                    del place[corner]
                if len(loop) > 2:
                    loops.append(np.array(loop, np.int64))
            else:
                place[after] = len(path)
                path.append(after)
    return loops


def _opens_upward(cap_mm: FloatArray, rim_mm: FloatArray, heights_mm: FloatArray) -> bool:
    a, b, c = np.moveaxis(cap_mm, 1, 0)
    area = np.cross(b - a, c - a).sum(axis=0)
    near_mm = heights_mm.max() - NEAR_TOP * np.ptp(heights_mm)
    return bool(abs(area[2]) > UPRIGHT * np.linalg.norm(area) and rim_mm[:, 2].min() > near_mm)


def _spanned(rim_mm: FloatArray) -> NDArray[np.int64]:
    """Triangles (n − 2, 3) of the least area on a rim (n, 3); a long one is first shortened."""
    left = np.arange(len(rim_mm))
    ears = []
    while len(left) > MOST_RIM:
        ends = rim_mm[left]
        across_mm = np.linalg.norm(np.roll(ends, -1, axis=0) - np.roll(ends, 1, axis=0), axis=1)
        tip = int(np.argmin(across_mm))
        ears.append([left[tip - 1], left[tip], left[(tip + 1) % len(left)]])
        left = np.delete(left, tip)
    split = _least_area(np.ascontiguousarray(rim_mm[left]))
    spans = [(0, len(left) - 1)]
    while spans:
        i, k = spans.pop()
        if k - i > 1:
            j = int(split[i, k])
            ears.append([left[i], left[j], left[k]])
            spans += [(i, j), (j, k)]
    return np.array(ears, np.int64)


@njit(cache=True)
def _least_area(rim_mm: np.ndarray) -> np.ndarray:
    """The corner (n, n) between two others with which they span the least area."""
    count = len(rim_mm)
    cost, split = np.zeros((count, count)), np.zeros((count, count), np.int64)
    for span in range(2, count):
        for i in range(count - span):
            k, least = i + span, np.inf
            for j in range(i + 1, k):
                ux, uy, uz = rim_mm[j] - rim_mm[i]
                vx, vy, vz = rim_mm[k] - rim_mm[i]
                nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
                area = 0.5 * np.sqrt(nx * nx + ny * ny + nz * nz)
                edges = ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz
                total = cost[i, j] + cost[j, k] + area + SHAPE_WEIGHT * edges
                if total < least:
                    least, split[i, k] = total, j
            cost[i, k] = least
    return split
