# ruff: noqa: UP018, RUF046  # in Warp int(0) is a variable, 0 a constant
"""What a GPU computes of a batch, in Warp: one thread a pixel of a world.

It is what the pad of a single sensor computes: ``contact/raster.py``, ``contact/indentation.py``,
``optics/smooth.py``, ``optics/deform.py``, ``optics/shade.py``, ``optics/effects/shadow.py``.
A kernel's first index counts the B worlds of one part of the batch, which begins at world
``start``.
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import warp as wp

from tacgen.contact.gap import NO_OBJECT

wp.set_module_options({"enable_backward": False})
Decorator: TypeAlias = Callable[[Callable[..., Any]], Any]
kernel: Decorator = wp.kernel
function: Decorator = wp.func

_NONE, _FAR = wp.constant(NO_OBJECT), wp.constant(wp.float64(NO_OBJECT))
_ZERO, _HALF, _ONE = (wp.constant(wp.float64(x)) for x in (0.0, 0.5, 1.0))
_INFINITE = wp.constant(wp.float64(wp.inf))
_PI = wp.constant(wp.float32(3.14159265))
_MIX_0, _MIX_1, _MIX_2 = (wp.constant(wp.uint32(x)) for x in (0x9E3779B9, 0x7FEB352D, 0x846CA68B))
"""Multipliers of a hash that spreads all bits of a place: Wellons, hash-prospector."""


@wp.struct
class Worlds:
    """What is known of the worlds: results (N, …), and the maps (B, H, W) of those at work."""

    start: int
    mm_per_px: wp.float32
    grain_mm: wp.float64
    wrong: wp.array[wp.int32]  # the first world of which the given map is wrong
    asked: wp.array[wp.float64]  # volume in pixels × grains, or δ in grains, (N,)
    rgb: wp.array4d[wp.uint8]
    grey: wp.array4d[wp.float32]  # instead of rgb where it is not empty: before they are rounded
    depth_mm: wp.array3d[wp.float32]
    contact_mask: wp.array3d[wp.bool]
    indentation_mm: wp.array[wp.float32]
    saturated: wp.array[wp.bool]
    beside_mm3: wp.array[wp.float64]  # volume lost around the window
    zero_mm: wp.array[wp.float64]  # gap of first touch
    gap_mm: wp.array3d[wp.float64]
    grains: wp.array3d[wp.int32]  # gaps beyond it
    delta: wp.array[wp.float64]  # in grains, as is the largest there can be
    deepest: wp.array[wp.float64]
    patches: wp.array[wp.vec4i]  # top, left, −bottom, −right of where the gel is indented
    deepest_mm: wp.array[wp.float32]
    surface: wp.array3d[wp.float32]  # how far it lies below rest
    image: wp.array4d[wp.float32]
    rest_mm: wp.array2d[wp.float32]
    lit_at_rest: wp.array3d[wp.float32]
    noise_grey: wp.float32
    quantiles: wp.array[wp.float32]
    n_markers: int
    marker_radius_px: wp.float32
    markers_at_rest_mm: wp.array2d[wp.float32]
    sheared_mm: wp.array3d[wp.float32]  # their motion by shear, and where they are, (N, M, 2)
    markers_mm: wp.array3d[wp.float32]


# Gap maps of meshes ------------------------------------------------------------------------------


@wp.struct
class Meshes:
    """All meshes, each about its middle, and which of them is where in the worlds."""

    handles: wp.array[wp.uint64]
    middle_mm: wp.array[wp.vec3d]
    radius_mm: wp.array[wp.float64]
    vertices_mm: wp.array[wp.vec3d]
    faces: wp.array2d[wp.int32]
    first_face: wp.array[wp.int32]
    ids: wp.array[wp.int32]
    poses: wp.array[wp.mat44d]


@kernel
def cast_rays(
    m: Meshes,
    start: int,
    pixel_mm: wp.float64,
    gel_mm: wp.array2d[wp.float64],
    gap_mm: wp.array3d[wp.float64],
) -> None:
    """Gaps of each world's mesh over points of the gel, ``pixel_mm`` apart.

    A ray in single precision finds the triangle, whose plane is met in double precision.
    """
    w, r, c = wp.tid()
    x = (wp.float64(c) - _HALF * wp.float64(gap_mm.shape[2] - 1)) * pixel_mm
    y = (wp.float64(r) - _HALF * wp.float64(gap_mm.shape[1] - 1)) * pixel_mm
    mesh, t = m.ids[start + w], m.poses[start + w]
    middle = wp.transform_point(t, m.middle_mm[mesh])
    away = wp.vec3d(x - middle[0], y - middle[1], -m.radius_mm[mesh] - _ONE)
    gap_mm[w, r, c] = _INFINITE
    if away[0] * away[0] + away[1] * away[1] > m.radius_mm[mesh] * m.radius_mm[mesh]:
        return
    back = wp.transpose(t)
    origin, along = wp.transform_vector(back, away), wp.vec3d(t[2, 0], t[2, 1], t[2, 2])
    longest = wp.float32(-away[2] + m.radius_mm[mesh] + _ONE)
    hit = wp.mesh_query_ray(m.handles[mesh], wp.vec3f(origin), wp.vec3f(along), longest)
    if not hit.result:
        return
    face = m.first_face[mesh] + hit.face
    p = m.vertices_mm[m.faces[face, 0]]
    q, s = m.vertices_mm[m.faces[face, 1]], m.vertices_mm[m.faces[face, 2]]
    normal = wp.cross(q - p, s - p)
    facing = wp.dot(normal, along)
    if facing != _ZERO:
        heights = wp.vec3d(wp.dot(along, p), wp.dot(along, q), wp.dot(along, s))
        height = away[2] + wp.dot(normal, p - origin) / facing
        height = wp.clamp(height, wp.min(heights), wp.max(heights))
        gap_mm[w, r, c] = middle[2] + height - gel_mm[r, c]


@kernel
def take_gaps(given_mm: wp.array3d[wp.float32], p: Worlds) -> None:
    """A gap map (N, H, W) that is known; NaN and −inf are wrong."""
    w, r, c = wp.tid()
    gap = wp.float64(given_mm[p.start + w, r, c])
    if not gap > -_INFINITE:
        wp.atomic_min(p.wrong, 0, p.start + w)
        gap = _INFINITE
    p.gap_mm[w, r, c] = gap


@kernel
def first_touch(gap_mm: wp.array3d[wp.float64], zero_mm: wp.array[wp.float64]) -> None:
    """The smallest gap of each world; +inf if there is none."""
    w, r, c = wp.tid()
    if gap_mm[w, r, c] < zero_mm[w]:
        wp.atomic_min(zero_mm, w, gap_mm[w, r, c])


@kernel
def first_touch_beside(
    gap_mm: wp.array3d[wp.float64],
    outside: wp.array2d[wp.bool],
    p: Worlds,
    zero_mm: wp.array[wp.float64],
) -> None:
    """First touch around the window, where there is no object in it."""
    w, r, c = wp.tid()
    if p.zero_mm[w] == _INFINITE and outside[r, c] and gap_mm[w, r, c] < zero_mm[w]:
        wp.atomic_min(zero_mm, w, gap_mm[w, r, c])


@kernel
def to_grains(
    gap_mm: wp.array3d[wp.float64],
    mask: wp.array2d[wp.bool],
    zero_mm: wp.array[wp.float64],
    per_mm: wp.float64,
    grains: wp.array3d[wp.int32],
) -> None:
    """Gaps beyond first touch, in grains, where the mask is."""
    w, r, c = wp.tid()
    grains[w, r, c] = _NONE
    if mask[r, c] and gap_mm[w, r, c] < _INFINITE:
        gap = (gap_mm[w, r, c] - zero_mm[w]) * per_mm + _HALF
        grains[w, r, c] = wp.int32(wp.clamp(gap, -_FAR, _FAR))


# From gaps to the indentation --------------------------------------------------------------------


@kernel
def least_grains(grains: wp.array3d[wp.int32], first: wp.array[wp.float64]) -> None:
    """The smallest gap of each world, if it is below 0; a thread a row."""
    w, r = wp.tid()
    least = int(0)
    for c in range(grains.shape[2]):
        least = wp.min(least, grains[w, r, c])
    if least < 0:
        wp.atomic_min(first, w, wp.float64(least))


@kernel
def begin_solve(
    p: Worlds, is_depth: bool, gel_depth: wp.float64, beside: wp.array[wp.float64]
) -> None:
    """The largest δ there can be: the object may touch beside the window first, by ``beside``."""
    w = wp.tid()
    asked = p.asked[p.start + w]
    p.deepest[w] = gel_depth + beside[w]
    p.delta[w] = p.deepest[w]
    if is_depth:
        p.delta[w] = wp.min(asked + beside[w], p.deepest[w])
    if asked <= _ZERO:
        p.delta[w] = _ZERO


@kernel
def sum_below(p: Worlds, grains: wp.array3d[wp.int32], sums: wp.array2d[wp.int64]) -> None:
    """Count and sum of the gaps below δ, added to each world's; a thread a row."""
    w, r = wp.tid()
    limit = wp.min(wp.ceil(p.delta[w]), p.deepest[w] + _ONE)
    count, total = wp.int64(0), wp.int64(0)
    for c in range(grains.shape[2]):
        if wp.float64(grains[w, r, c]) < limit:
            count += wp.int64(1)
            total += wp.int64(grains[w, r, c])
    if count > wp.int64(0):
        wp.atomic_add(sums, w, 0, count)
        wp.atomic_add(sums, w, 1, total)


@kernel
def newton_step(
    p: Worlds,
    window: wp.array2d[wp.int64],
    beside: wp.array2d[wp.int64],
    weight: wp.float64,
    n_open: wp.array[wp.int32],
) -> None:
    """V(δ) = volume by Newton from the right: no step can miss, and the last is exact.

    Points beside the window stand for ``weight`` pixels each. ``n_open`` is of worlds not done.
    """
    w = wp.tid()
    count = wp.float64(window[w, 0]) + weight * wp.float64(beside[w, 0])
    total = wp.float64(window[w, 1]) + weight * wp.float64(beside[w, 1])
    for k in range(2):
        window[w, k] = wp.int64(0)
        beside[w, k] = wp.int64(0)
    if p.asked[p.start + w] <= _ZERO:
        return
    if count == _ZERO:
        p.delta[w] = p.deepest[w]
        return
    found = (p.asked[p.start + w] + total) / count
    if wp.ceil(found) != wp.ceil(p.delta[w]) and (
        found < p.deepest[w] or p.delta[w] < p.deepest[w]
    ):
        wp.atomic_add(n_open, 0, 1)
    p.delta[w] = wp.min(found, p.deepest[w])


@kernel
def results(
    p: Worlds, least_mm: wp.float32, beside: wp.array3d[wp.int32], each_mm3: wp.float64
) -> None:
    """δ of each world, 0 where nothing touches in the window, and whether it is the largest."""
    w = wp.tid()
    depth_mm, total = wp.float32(0.0), wp.float64(0.0)
    if p.zero_mm[w] < _INFINITE and p.delta[w] > _ZERO:
        depth_mm = wp.float32(p.delta[w] * p.grain_mm)
    for r in range(beside.shape[1]):
        for c in range(beside.shape[2]):
            total += wp.max(p.delta[w] - wp.float64(beside[w, r, c]), _ZERO)
    touches = p.zero_mm[w] < _INFINITE or total > _ZERO
    is_pressed = touches and p.asked[p.start + w] > _ZERO
    p.indentation_mm[p.start + w] = depth_mm
    p.deepest_mm[w] = wp.max(depth_mm, least_mm)
    p.saturated[p.start + w] = is_pressed and p.delta[w] >= p.deepest[w]
    p.beside_mm3[p.start + w] = total * each_mm3


@function
def put_depth(p: Worlds, depth_mm: wp.float32, w: int, r: int, c: int) -> None:
    """The indentation of a pixel, and the window of those that have one."""
    p.depth_mm[p.start + w, r, c] = depth_mm
    p.surface[w, r, c] = depth_mm
    p.contact_mask[p.start + w, r, c] = depth_mm > 0.0
    patch, own = p.patches[w], wp.vec4i(r, c, -r - 1, -c - 1)
    grows = own[0] < patch[0] or own[1] < patch[1] or own[2] < patch[2] or own[3] < patch[3]
    if depth_mm > 0.0 and grows:
        wp.atomic_min(p.patches, w, own)


@kernel
def indent(p: Worlds) -> None:
    """Indentation of each pixel, whether it is above 0, and the window of those."""
    w, r, c = wp.tid()
    depth = (p.delta[w] - wp.float64(p.grains[w, r, c])) * p.grain_mm
    put_depth(p, wp.float32(wp.max(depth, _ZERO)), w, r, c)


@kernel
def take_depth(given_mm: wp.array3d[wp.float32], p: Worlds) -> None:
    """As ``indent``, of an indentation that is given."""
    w, r, c = wp.tid()
    given = given_mm[p.start + w, r, c]
    if not wp.isfinite(given):
        wp.atomic_min(p.wrong, 0, p.start + w)
        given = wp.float32(0.0)
    put_depth(p, wp.max(given, 0.0), w, r, c)
    if given > p.deepest_mm[w]:
        wp.atomic_max(p.deepest_mm, w, given)


@kernel
def results_of_depth(p: Worlds, gel_depth_mm: wp.float32, least_mm: wp.float32) -> None:
    """As ``results``."""
    w = wp.tid()
    p.indentation_mm[p.start + w] = p.deepest_mm[w]
    p.saturated[p.start + w] = p.deepest_mm[w] >= gel_depth_mm
    p.deepest_mm[w] = wp.max(p.deepest_mm[w], least_mm)


@kernel
def press(
    p: Worlds, pixels: int, before_rows: int, before_columns: int, cells: wp.array3d[wp.float64]
) -> None:
    """Sum of the indentation over each cell of ``pixels`` × ``pixels``."""
    w, r, c = wp.tid()
    top, left = r * pixels - before_rows, c * pixels - before_columns
    total = wp.float64(0.0)
    for y in range(wp.max(top, 0), wp.min(top + pixels, p.rest_mm.shape[0])):
        for x in range(wp.max(left, 0), wp.min(left + pixels, p.rest_mm.shape[1])):
            total += wp.float64(p.depth_mm[p.start + w, y, x])
    cells[w, r, c] = total


# How the gel bends around it: Gaussians of the whole image, beyond which its edges go on ----------


@kernel
def halve(source: wp.array3d[wp.float32], target: wp.array3d[wp.float32]) -> None:
    """Means of blocks of 2×2 pixels, with two more blocks beyond each edge."""
    w, r, c = wp.tid()
    last, end = source.shape[1] - 1, source.shape[2] - 1
    up, down = wp.clamp(2 * r - 4, 0, last), wp.clamp(2 * r - 3, 0, last)
    even, odd = wp.clamp(2 * c - 4, 0, end), wp.clamp(2 * c - 3, 0, end)
    left = source[w, up, even] + source[w, down, even]
    target[w, r, c] = 0.25 * (left + (source[w, up, odd] + source[w, down, odd]))


@kernel
def blur(
    source: wp.array3d[wp.float32],
    weights: wp.array[wp.float32],
    is_down: int,
    target: wp.array3d[wp.float32],
) -> None:
    """A Gaussian along rows, or down columns."""
    w, r, c = wp.tid()
    total = weights[0] * source[w, r, c]
    for j in range(1, weights.shape[0]):
        if is_down == 1:
            low, high = wp.max(r - j, 0), wp.min(r + j, source.shape[1] - 1)
            total += weights[j] * (source[w, low, c] + source[w, high, c])
        else:
            low, high = wp.max(c - j, 0), wp.min(c + j, source.shape[2] - 1)
            total += weights[j] * (source[w, r, low] + source[w, r, high])
    target[w, r, c] = total


@kernel
def double(source: wp.array3d[wp.float32], target: wp.array3d[wp.float32]) -> None:
    """Between the middles of the blocks that ``halve`` made, three quarters from the near."""
    w, r, c = wp.tid()
    near_row, near = r // 2 + 2, c // 2 + 2
    far_row, far = near_row + 2 * (r % 2) - 1, near + 2 * (c % 2) - 1
    close = 0.75 * source[w, near_row, near] + 0.25 * source[w, far_row, near]
    aside = 0.75 * source[w, near_row, far] + 0.25 * source[w, far_row, far]
    target[w, r, c] = 0.75 * close + 0.25 * aside


@kernel
def keep_contact(p: Worlds, loose: wp.float32, firm: wp.float32) -> None:
    """Holds the surface to the object where it is pressed deep: by shares of the deepest."""
    w, r, c = wp.tid()
    deep_mm, depth_mm = p.deepest_mm[w], p.depth_mm[p.start + w, r, c]
    hold = wp.clamp((depth_mm - loose * deep_mm) / ((firm - loose) * deep_mm), 0.0, 1.0)
    p.surface[w, r, c] += hold * (depth_mm - p.surface[w, r, c])


# Colour ------------------------------------------------------------------------------------------


@wp.struct
class Table:
    """An image model made ready: Taxim's quadratic, or a response and what a contact adds to it."""

    is_response: bool
    next: int  # 1: between nodes of slope and direction, 0: at the one below
    quadratic: wp.array4d[wp.float32]  # slope, direction, feature, (R, G, B, 0)
    response: wp.array4d[wp.float32]  # place (node_columns · row + column), slope, direction, RGB0
    n_slope: int
    n_direction: int
    node_rows: int
    node_columns: int
    per_slope: wp.float32
    per_direction: wp.float32
    contact_depth_mm: wp.float32
    contact: wp.array4d[wp.float32]  # row, column, (1, nx, ny), (R, G, B, 0)
    contact_rest_mm: wp.array2d[wp.float32]
    background: wp.array3d[wp.float32]


@function
def height(p: Worlds, least_mm: wp.float32, w: int, r: int, c: int) -> wp.float32:
    """The gel's surface; what is below ``least_mm`` is no deformation."""
    down_mm = p.surface[w, r, c]
    if down_mm < least_mm:
        return p.rest_mm[r, c]
    return p.rest_mm[r, c] - down_mm


@function
def quadratic(t: Table, k: int, n: int, channel: int, u: wp.float32, v: wp.float32) -> wp.float32:
    """A node's polynomial in the place in the image."""
    a, b = t.quadratic[k, n, 0, channel], t.quadratic[k, n, 1, channel]
    c, d = t.quadratic[k, n, 2, channel], t.quadratic[k, n, 3, channel]
    e, f = t.quadratic[k, n, 4, channel], t.quadratic[k, n, 5, channel]
    return a * u * u + b * v * v + c * u * v + d * u + e * v + f


@wp.struct
class Place:
    """Of a pixel among a table's nodes of slope, direction and place: the first, and the shares."""

    slope: int
    direction: int
    row: int
    column: int
    steep: wp.float32
    turned: wp.float32
    down: wp.float32
    aside: wp.float32
    u: wp.float32
    v: wp.float32


@function
def place_of(p: Worlds, t: Table, gx: wp.float32, gy: wp.float32, r: int, c: int) -> Place:
    """Where slopes at a pixel are in the table."""
    at = Place()
    at.u = (wp.float32(c) + 0.5) / wp.float32(p.rest_mm.shape[1])
    at.v = (wp.float32(r) + 0.5) / wp.float32(p.rest_mm.shape[0])
    row, column = at.v * wp.float32(t.node_rows - 1), at.u * wp.float32(t.node_columns - 1)
    at.row = wp.min(int(row), t.node_rows - 2)
    at.column = wp.min(int(column), t.node_columns - 2)
    at.down = row - wp.float32(at.row)
    at.aside = column - wp.float32(at.column)
    slope = wp.atan(wp.sqrt(gx * gx + gy * gy)) * t.per_slope
    turn = (wp.atan2(gy, gx) + _PI) * t.per_direction
    at.slope = wp.min(int(slope), t.n_slope - 1 - t.next)
    at.direction = wp.min(int(turn), t.n_direction - 1)
    share = wp.float32(t.next)
    at.steep = share * wp.min(slope - wp.float32(at.slope), 1.0)
    at.turned = share * wp.min(turn - wp.float32(at.direction), 1.0)
    return at


@function
def response(t: Table, at: Place, k: int, n: int, channel: int) -> wp.float32:
    """A node's light, between the four places around a pixel."""
    over = at.row * t.node_columns + at.column
    under = over + t.node_columns
    upper = wp.lerp(t.response[over, k, n, channel], t.response[over + 1, k, n, channel], at.aside)
    lower = wp.lerp(
        t.response[under, k, n, channel], t.response[under + 1, k, n, channel], at.aside
    )
    return wp.lerp(upper, lower, at.down)


@function
def of_node(t: Table, at: Place, k: int, n: int, channel: int) -> wp.float32:
    """Light at a node of slope and direction."""
    if t.is_response:
        return response(t, at, k, n, channel)
    return quadratic(t, k, n, channel, at.u - 0.5, at.v - 0.5)


@function
def of_contact(t: Table, at: Place, j: int, channel: int) -> wp.float32:
    """What a contact adds for a part j of the normal."""
    upper = wp.lerp(
        t.contact[at.row, at.column, j, channel],
        t.contact[at.row, at.column + 1, j, channel],
        at.aside,
    )
    lower = wp.lerp(
        t.contact[at.row + 1, at.column, j, channel],
        t.contact[at.row + 1, at.column + 1, j, channel],
        at.aside,
    )
    return wp.lerp(upper, lower, at.down)


@kernel
def shade(p: Worlds, t: Table, least_mm: wp.float32) -> None:
    """Grey levels of each pixel by its slopes."""
    w, r, c = wp.tid()
    up, below = wp.max(r - 1, 0), wp.min(r + 1, p.rest_mm.shape[0] - 1)
    left, right = wp.max(c - 1, 0), wp.min(c + 1, p.rest_mm.shape[1] - 1)
    moved = wp.max(wp.max(p.surface[w, up, c], p.surface[w, below, c]), p.surface[w, r, c])
    moved = wp.max(moved, wp.max(p.surface[w, r, left], p.surface[w, r, right]))
    if moved < least_mm:  # at rest, to the last bit
        for channel in range(3):
            p.image[w, r, c, channel] = p.lit_at_rest[r, c, channel]
        return
    gx = height(p, least_mm, w, r, right) - height(p, least_mm, w, r, left)
    gy = height(p, least_mm, w, below, c) - height(p, least_mm, w, up, c)
    gx = gx / (p.mm_per_px * wp.float32(wp.max(right - left, 1)))
    gy = gy / (p.mm_per_px * wp.float32(wp.max(below - up, 1)))
    at = place_of(p, t, gx, gy, r, c)
    pressed_mm = t.contact_rest_mm[r, c] - height(p, least_mm, w, r, c)
    for channel in range(3):
        here = of_node(t, at, at.slope, at.direction, channel)
        steeper = of_node(t, at, at.slope + t.next, at.direction, channel)
        level = wp.lerp(here, steeper, at.steep)
        here = of_node(t, at, at.slope, at.direction + t.next, channel)
        steeper = of_node(t, at, at.slope + t.next, at.direction + t.next, channel)
        level = wp.lerp(level, wp.lerp(here, steeper, at.steep), at.turned)
        if pressed_mm > 0.0:
            normal = wp.vec2f(gx, gy) / wp.sqrt(1.0 + gx * gx + gy * gy)
            added = of_contact(t, at, 0, channel) + normal[0] * of_contact(t, at, 1, channel)
            added = added + normal[1] * of_contact(t, at, 2, channel)
            level = level + pressed_mm / (pressed_mm + t.contact_depth_mm) * added
        p.image[w, r, c, channel] = t.background[r, c, channel] + level


# Shadows, and the picture ------------------------------------------------------------------------


@wp.struct
class Lights:
    """Lights for shadows: each ``is_turned`` where its shadows run along columns of the image."""

    n: int
    is_turned: wp.array[wp.int32]
    is_downwards: wp.array[wp.int32]
    across_px: wp.array[wp.float32]
    rise_mm: wp.array[wp.float32]
    share: wp.array2d[wp.float32]
    unlit: wp.array3d[wp.float32]
    per_mm: wp.float32
    met: wp.array4d[wp.float32]  # (B, lights, 2, places): lowest relief met, of two rows in turn
    hidden: wp.array4d[wp.float32]


@kernel
def sweep(p: Worlds, lights: Lights, least_mm: wp.float32, i: int) -> None:
    """One row of shadows: the lowest relief met on the way from the light goes from row to row.

    It is lifted by the ray's rise; what is above it is hidden.
    """
    w, led, k = wp.tid()
    n_rows, n_columns = p.rest_mm.shape[0], p.rest_mm.shape[1]
    steps, width = n_rows, n_columns
    if lights.is_turned[led] == 1:
        steps, width = n_columns, n_rows
    if i >= steps or k >= width:
        return
    at = i
    if lights.is_downwards[led] == 0:
        at = steps - 1 - i
    r, c = at, k
    if lights.is_turned[led] == 1:
        r, c = k, at
    across, side = lights.across_px[led], int(1)
    if across < 0.0:
        side = -1
    level = wp.float32(1.0e6)
    if i > 0:
        weight = wp.abs(across)
        aside = wp.float32(1.0e6)
        if k + side >= 0 and k + side < width:
            aside = lights.met[w, led, i % 2, k + side]
        level = ((1.0 - weight) * lights.met[w, led, i % 2, k] + weight * aside) + lights.rise_mm[
            led
        ]
    relief = height(p, least_mm, w, r, c)
    lights.hidden[w, led, r, c] = wp.clamp((relief - level) * lights.per_mm, 0.0, 1.0)
    lights.met[w, led, 1 - i % 2, k] = wp.min(relief, level)


@kernel
def spread(p: Worlds, most_points: int, decay: wp.float64, gain: wp.float64) -> None:
    """Places of the markers: away from the indentation, of which each sees some points."""
    w, m = wp.tid()
    patch = p.patches[w]
    n_rows, n_columns = wp.max(-patch[2] - patch[0], 0), wp.max(-patch[3] - patch[1], 0)
    scale = wp.float64(p.mm_per_px)
    x, y = wp.float64(p.markers_at_rest_mm[m, 0]), wp.float64(p.markers_at_rest_mm[m, 1])
    half_row = _HALF * wp.float64(p.rest_mm.shape[0] - 1)
    half_column = _HALF * wp.float64(p.rest_mm.shape[1] - 1)
    along_x, along_y, count = wp.float64(0.0), wp.float64(0.0), int(0)
    every = wp.max(1, int(wp.sqrt(wp.float64(n_rows * n_columns) / wp.float64(most_points))))
    for _ in range(2):
        if count == 0:
            for r in range(patch[0] + every // 2, patch[0] + n_rows, every):
                for c in range(patch[1] + every // 2, patch[1] + n_columns, every):
                    depth = wp.float64(p.depth_mm[p.start + w, r, c])
                    if depth > _ZERO:
                        count += 1
                        dx = x - (wp.float64(c) - half_column) * scale
                        dy = y - (wp.float64(r) - half_row) * scale
                        area = scale * scale * wp.float64(every * every)
                        weight = gain * depth * area * wp.exp(-decay * (dx * dx + dy * dy))
                        along_x += weight * dx
                        along_y += weight * dy
            every = 1
    p.markers_mm[p.start + w, m, 0] = wp.float32(x + along_x) + p.sheared_mm[p.start + w, m, 0]
    p.markers_mm[p.start + w, m, 1] = wp.float32(y + along_y) + p.sheared_mm[p.start + w, m, 1]


@kernel
def expose(p: Worlds, lights: Lights, ink_transmission: wp.float32, seed: wp.uint32) -> None:
    """The pictures: lit, hidden, dotted, noisy and rounded."""
    w, r, c = wp.tid()
    world, n_rows, n_columns = p.start + w, p.rest_mm.shape[0], p.rest_mm.shape[1]
    grey = wp.vec3f(p.image[w, r, c, 0], p.image[w, r, c, 1], p.image[w, r, c, 2])
    for led in range(lights.n):
        hidden = lights.hidden[w, led, r, c]
        if hidden > 0.0:
            for channel in range(3):
                light = wp.max(grey[channel] - lights.unlit[r, c, channel], 0.0)
                grey[channel] = grey[channel] - lights.share[led, channel] * hidden * light
    for m in range(p.n_markers):
        x = p.markers_mm[world, m, 0] / p.mm_per_px + 0.5 * wp.float32(n_columns - 1)
        y = p.markers_mm[world, m, 1] / p.mm_per_px + 0.5 * wp.float32(n_rows - 1)
        away = wp.length(wp.vec2f(wp.float32(c) - x, wp.float32(r) - y))
        cover = wp.clamp(p.marker_radius_px + 0.5 - away, 0.0, 1.0)
        grey = grey * (1.0 - cover * (1.0 - ink_transmission))
    for channel in range(3):
        if p.grey.shape[0] > 0:
            p.grey[world, r, c, channel] = grey[channel]
        else:
            level = grey[channel]
            if p.noise_grey > 0.0:  # 12 random bits: a hash of the place
                place = ((world * n_rows + r) * n_columns + c) * 3 + channel
                x32 = seed + _MIX_0 * wp.uint32(place)
                x32 = (x32 ^ (x32 >> wp.uint32(16))) * _MIX_1
                x32 = (x32 ^ (x32 >> wp.uint32(15))) * _MIX_2
                x32 = (x32 ^ (x32 >> wp.uint32(16))) >> wp.uint32(20)
                level += p.noise_grey * p.quantiles[int(x32)]
            p.rgb[world, r, c, channel] = wp.uint8(int(wp.clamp(level + 0.5, 0.0, 255.0)))
