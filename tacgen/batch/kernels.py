# mypy: ignore-errors
# ruff: noqa: UP018, RUF046
"""The kernels of a batch: one source in Warp, whose types are not Python's, for CPU and CUDA.

A thread works on one row of one world: on the CPU on all of it, where the compiler makes vectors of
its inner loops, on a GPU on every n-th pixel, where neighbouring threads read neighbouring pixels.
Loops over pixels are in C++, since Warp's own loops over arrays do not become vectors: a Gaussian
along columns takes 2.7 ms a frame so, and 0.09 ms like this. What they compute is that of the
renderer for single frames: ``contact/raster.py``, ``contact/indentation.py``,
``optics/smooth.py``, ``optics/deform.py``, ``optics/shade.py``, ``optics/effects/shadow.py``.

Windows are (top, bottom, left, right). A kernel's first index counts the B worlds of one part of
the batch, which begins at world ``start``.
"""

from typing import Any

import warp as wp

from tacgen.contact.gap import NO_OBJECT

wp.set_module_options({"enable_backward": False})

MAP, FORCE, POSE, MESH = (wp.constant(i) for i in range(4))
"""Places in ``wrong``: the first world of which that is wrong."""
HALVE, ALONG, DOWN, DOUBLE = (wp.constant(i) for i in range(4))
"""What ``resample`` does."""

_PRELUDE = """
#if defined(__CUDA_ARCH__)
    #define TACGEN_SYNC __syncthreads()
    #define TACGEN_ALONE  // what one thread writes, another one reads after TACGEN_SYNC
    constexpr int TILE = 1;
#else
    #define TACGEN_SYNC
    #define TACGEN_ALONE __restrict  // no other pointer leads there: the loop becomes vectors
    constexpr int TILE = 64;
#endif
    (void)TILE;
    // For the pixels c of [first, last) that are this thread's.
    #define TACGEN_ALONG(first, last) \\
        for (int c = (first) + lane; c < (last); c += TILE == 1 ? lanes : 1)
    // The same in pieces of up to TILE pixels, of which c0 is the first and n the number.
    #define TACGEN_TILES(first, last) \\
        for (int c0 = (first) + lane * TILE, n; \\
             n = wp::min(TILE, (last) - c0), c0 < (last); c0 += lanes * TILE)
    // Grows the window of a world by pixels [left, right) of row r.
    #define TACGEN_GROW(windows) { \\
        auto& grown = wp::index(windows, w); \\
        wp::atomic_min(&grown[0], r), wp::atomic_max(&grown[1], r + 1); \\
        wp::atomic_min(&grown[2], left), wp::atomic_max(&grown[3], right); }
"""


def native(body: str) -> Any:
    """A function of C++ for a thread ``lane`` of ``lanes``."""
    return wp.func_native(_PRELUDE + body)


Floats, Map2, Map3, Map4 = (wp.array(dtype=wp.float32, ndim=n) for n in (1, 2, 3, 4))
Doubles, Doubles2, Doubles3 = (wp.array(dtype=wp.float64, ndim=n) for n in (1, 2, 3))
Ints, Ints2, Ints3 = (wp.array(dtype=wp.int32, ndim=n) for n in (1, 2, 3))
Windows = wp.array(dtype=wp.vec4i)


@wp.struct
class Worlds:
    """What is known of the worlds: results (N, …), and the maps (B, H, W) of those at work."""

    lanes: int
    start: int
    mm_per_px: wp.float32
    grain_mm: wp.float64
    wrong: Ints
    asked: Doubles  # volume in pixels × grains, or δ in grains, (N,)
    rgb: wp.array4d(dtype=wp.uint8)
    grey: Map4  # instead of rgb where it is not empty: grey levels before they are rounded
    depth_mm: Map3
    contact_mask: wp.array3d(dtype=wp.bool)
    indentation_mm: Floats
    saturated: wp.array(dtype=wp.bool)
    beside_mm3: Doubles  # volume lost around the window
    zero_mm: Doubles  # gap of first touch
    grains: Ints3  # gaps beyond it
    delta: Doubles  # in grains, as is the largest there can be
    deepest: Doubles
    patches: Windows  # where the gel is indented
    deepest_mm: Floats
    surface: Map3  # how far it lies below rest
    height_mm: Map3
    changed: Windows  # where that is not at rest
    spans: Ints3  # and in which columns of each row
    relief_mm: Floats  # how deep it is there
    image: Map4
    rest_mm: Map2
    lit_at_rest: Map3
    image_at_rest: Map3
    rgb_at_rest: wp.array3d(dtype=wp.uint8)
    noise_grey: wp.float32
    quantiles: Floats
    n_markers: int
    marker_radius_px: wp.float32
    markers_at_rest_mm: Map2
    sheared_mm: Map3  # their motion by shear, and where they are, (N, M, 2)
    markers_mm: Map3


@wp.func
def grown(patch: wp.vec4i, margin: int, step: int, height: int, width: int) -> wp.vec4i:
    """The patch, grown by a margin and then to whole steps of pixels."""
    window = wp.vec4i(0, 0, 0, 0)
    if patch[0] < patch[1]:
        top, left = wp.max(patch[0] - margin, 0), wp.max(patch[2] - margin, 0)
        bottom, right = wp.min(patch[1] + margin, height), wp.min(patch[3] + margin, width)
        bottom = wp.min(bottom + (step - bottom % step) % step, height)
        right = wp.min(right + (step - right % step) % step, width)
        window = wp.vec4i(top - top % step, bottom, left - left % step, right)
    return window


@wp.func
def blocks(window: wp.vec4i, level: int) -> wp.vec4i:
    """The window, ``level`` times halved: blocks from 0 on, two of them beyond each edge."""
    out = window
    if window[0] < window[1]:
        for _ in range(level):
            out = wp.vec4i(0, (out[1] - out[0] + 1) / 2 + 4, 0, (out[3] - out[2] + 1) / 2 + 4)
    return out


# What is given -----------------------------------------------------------------------------------


@wp.kernel
def check_force(force_n: wp.array(dtype=Any), factor: wp.float64, p: Worlds):
    """What the law asks of each gel, by its force."""
    w = wp.tid()
    force = wp.float64(force_n[w])
    p.asked[w] = force * factor
    if not (force >= wp.float64(0.0) and force < wp.float64(1.0e300)):
        wp.atomic_min(p.wrong, FORCE, w)
        p.asked[w] = wp.float64(0.0)


@wp.kernel
def check_ids(ids: wp.array(dtype=Any), n_meshes: int, wrong: Ints, out: Ints):
    """Indices of meshes."""
    w = wp.tid()
    out[w] = int(ids[w])
    if wp.int64(ids[w]) < wp.int64(0) or wp.int64(ids[w]) >= wp.int64(n_meshes):
        wp.atomic_min(wrong, MESH, w)
        out[w] = 0


@wp.kernel
def check_poses(poses: wp.array3d(dtype=Any), tolerance: wp.float64, wrong: Ints, out: Doubles3):
    """Poses in double precision, which are to be rigid motions."""
    w = wp.tid()
    m = wp.mat44d()
    for i in range(4):
        for j in range(4):
            m[i, j] = wp.float64(poses[w, i, j])
            out[w, i, j] = m[i, j]
    turn = wp.mat33d(
        m[0, 0], m[0, 1], m[0, 2], m[1, 0], m[1, 1], m[1, 2], m[2, 0], m[2, 1], m[2, 2]
    )
    off = wp.transpose(turn) * turn - wp.identity(3, dtype=wp.float64)
    worst = wp.abs(m[3, 3] - wp.float64(1.0))
    is_finite = bool(True)
    for i in range(3):
        worst = wp.max(worst, wp.abs(m[3, i]))
        is_finite = is_finite and wp.isfinite(m[i, 3])
        for j in range(3):
            worst = wp.max(worst, wp.abs(off[i, j]))
            is_finite = is_finite and wp.isfinite(m[i, j])
    if not (is_finite and worst <= tolerance and wp.determinant(turn) > wp.float64(0.0)):
        wp.atomic_min(wrong, POSE, w)


# Gap maps of meshes ------------------------------------------------------------------------------


@wp.struct
class Meshes:
    """All meshes, each cut into cells, and which of them is where in the worlds."""

    vertices_mm: Doubles2
    faces: Ints2
    first: Ints  # face of each cell
    spheres_mm: Doubles2
    cells: Ints  # the first of each mesh
    ids: Ints
    poses: Doubles3


@wp.struct
class Grid:
    """Points of the gel that gaps are taken at, every n-th row of them."""

    gel_mm: Doubles2
    gap_mm: Doubles3
    per_px: wp.float64
    zero_mm: Doubles  # what lies ``reach_mm`` beyond cannot touch
    reach_mm: wp.float64
    every: int
    lanes: int


@native("""
    // The triangles of a cell of a mesh: lowers gaps to the nearest surface.
    const int n_rows = g.gap_mm.shape[1], n_columns = g.gap_mm.shape[2], lanes = g.lanes;
    const double* t = &wp::index(m.poses, world, 0, 0);
    const double* s = &wp::index(m.spheres_mm, cell, 0);
    const double half_row = 0.5 * n_rows - 0.5, half_column = 0.5 * n_columns - 0.5;
    const double per_px = g.per_px, radius = 1.001 * s[3];
    #define TACGEN_AXIS(i, p) (t[4*i] * p[0] + t[4*i + 1] * p[1] + t[4*i + 2] * p[2])
    if (fabs((TACGEN_AXIS(0, s) + t[3]) * per_px) > half_column + 0.5 + radius * per_px) return;
    if (fabs((TACGEN_AXIS(1, s) + t[7]) * per_px) > half_row + 0.5 + radius * per_px) return;
    const double limit_mm = wp::index(g.zero_mm, w) + g.reach_mm;
    if (TACGEN_AXIS(2, s) - radius > limit_mm) return;
    // Some of its faces are enough where a few pixels are.
    const int f_first = wp::index(m.first, cell), f_last = wp::index(m.first, cell + 1);
    const int step = g.every > 1 ? wp::clamp((f_last - f_first) / 4, 1, 8) : 1;
    for (int f = f_first + lane * step; f < f_last; f += lanes * step) {
        double x[3], y[3], z[3];
        for (int i = 0; i < 3; i++) {
            const double* p = &wp::index(m.vertices_mm, wp::index(m.faces, f, i), 0);
            x[i] = (TACGEN_AXIS(0, p) + t[3]) * per_px + half_column;
            y[i] = (TACGEN_AXIS(1, p) + t[7]) * per_px + half_row;
            z[i] = TACGEN_AXIS(2, p);
        }
        #define TACGEN_LEAST(v) wp::min(v[0], wp::min(v[1], v[2]))
        #define TACGEN_MOST(v) wp::max(v[0], wp::max(v[1], v[2]))
        const double z_low = TACGEN_LEAST(z), z_high = TACGEN_MOST(z);
        const double x_low = TACGEN_LEAST(x), x_high = TACGEN_MOST(x);
        const int r_start = (int)ceil(wp::max(0.0, TACGEN_LEAST(y)));
        const int r_first = (r_start + g.every - 1) / g.every * g.every;
        const int r_last = (int)floor(wp::min(n_rows - 1.0, TACGEN_MOST(y)));
        if (z_low > limit_mm || r_first > r_last || x_high < 0 || x_low > n_columns - 1.0) continue;
        // The gel is highest at its middle, and so under a triangle where that is nearest.
        const int r_near = wp::clamp(n_rows / 2, r_first, r_last);
        const double near = wp::clamp(n_columns / 2.0, x_low, x_high);
        const int c_near = (int)wp::clamp(near, 0.0, n_columns - 1.0);
        if (z_low - wp::index(g.gel_mm, r_near, c_near) > limit_mm) continue;
        const double xb = x[1] - x[0], yb = y[1] - y[0], zb = z[1] - z[0];
        const double xc = x[2] - x[0], yc = y[2] - y[0], zc = z[2] - z[0];
        const double area = xb * yc - xc * yb;
        if (area == 0.0) continue;
        const double slope_x = (zb * yc - zc * yb) / area, slope_y = (zc * xb - zb * xc) / area;
        const double z_origin = z[0] - x[0] * slope_x - y[0] * slope_y;
        // By row, then column: both triangles of an edge find its crossings by the same numbers.
        int a = 0, b = 1, k = 2, swap;
        #define TACGEN_SORT(i, j) \\
            if (y[j] < y[i] || (y[j] == y[i] && x[j] < x[i])) { swap = i; i = j; j = swap; }
        TACGEN_SORT(a, b) TACGEN_SORT(b, k) TACGEN_SORT(a, b)
        const double long_slope = (x[k] - x[a]) / (y[k] - y[a]);
        const double low_slope = y[b] > y[a] ? (x[b] - x[a]) / (y[b] - y[a]) : 0.0;
        const double high_slope = y[k] > y[b] ? (x[k] - x[b]) / (y[k] - y[b]) : 0.0;
        for (int r = r_first; r <= r_last; r += g.every) {
            const double x_long = x[a] + (r - y[a]) * long_slope;
            const double x_short =
                r < y[b] ? x[a] + (r - y[a]) * low_slope : x[b] + (r - y[b]) * high_slope;
            const int start = (int)wp::max(0.0, ceil(wp::min(x_long, x_short)));
            const int stop = (int)wp::min(n_columns - 1.0, floor(wp::max(x_long, x_short))) + 1;
            const double z_row = z_origin + r * slope_y;
            double* out = &wp::index(g.gap_mm, w, r, 0);
            const double* gel = &wp::index(g.gel_mm, r, 0);
            for (int c = start; c < stop; c++) {
                const double gap = wp::clamp(z_row + c * slope_x, z_low, z_high) - gel[c];
    #if defined(__CUDA_ARCH__)
                wp::atomic_min(&out[c], gap);
    #else
                out[c] = wp::min(out[c], gap);
    #endif
            }
        }
    }
""")
def _rasterize(m: Meshes, g: Grid, world: int, w: int, cell: int, lane: int): ...


@wp.kernel
def rasterize(m: Meshes, g: Grid, start: int):
    """Gaps of each world's mesh over a grid."""
    w, k, lane = wp.tid()
    mesh = m.ids[start + w]
    if m.cells[mesh] + k < m.cells[mesh + 1]:
        _rasterize(m, g, start + w, w, m.cells[mesh] + k, lane)


@wp.kernel
def gather_beside(g: Grid, outside: wp.array2d(dtype=wp.bool), per_mm: wp.float64, beside: Ints2):
    """Gaps of the gel around the window, in grains beyond first touch in it, or around it."""
    w = wp.tid()
    infinite = wp.float64(wp.inf)
    zero, limit_mm = wp.float64(g.zero_mm[w]), g.zero_mm[w] + g.reach_mm
    n_columns = g.gap_mm.shape[2]
    if zero == infinite:
        for r in range(g.gap_mm.shape[1]):
            for c in range(n_columns):
                if outside[r, c]:
                    zero = wp.min(zero, g.gap_mm[w, r, c])
    for r in range(g.gap_mm.shape[1]):
        for c in range(n_columns):
            grains = wp.int32(NO_OBJECT)
            if outside[r, c] and g.gap_mm[w, r, c] < limit_mm:
                gap = (g.gap_mm[w, r, c] - zero) * per_mm + wp.float64(0.5)
                grains = wp.int32(wp.clamp(gap, wp.float64(-NO_OBJECT), wp.float64(NO_OBJECT)))
            beside[w, r * n_columns + c] = grains
            g.gap_mm[w, r, c] = infinite


# From gaps to the indentation --------------------------------------------------------------------


@native("""
    double least = INFINITY;
    int n_wrong = 0;
    for (int r = 0; r < map.shape[1]; r += every) {
        const auto* row = &wp::index(map, world, r, 0);
        auto low = row[0];
        low = INFINITY;
        TACGEN_ALONG(0, map.shape[2]) {
            low = row[c] < low ? row[c] : low;
            n_wrong += !(row[c] > -INFINITY);
        }
        least = low < least ? (double)low : least;
    }
    if (n_wrong) wp::atomic_min(&wp::index(p.wrong, 0), world);
    wp::atomic_min(&wp::index(p.zero_mm, w), least);
""")
def _first_touch(
    map: wp.array3d(dtype=Any), p: Worlds, every: int, world: int, w: int, lane: int, lanes: int
): ...


@wp.kernel
def first_touch(gap_mm: wp.array3d(dtype=Any), start: int, every: int, lanes: int, p: Worlds):
    """The smallest gap of each world, of every n-th row; +inf if there is none."""
    w, lane = wp.tid()
    _first_touch(gap_mm, p, every, start + w, w, lane, lanes)


@native("""
    const int lanes = p.lanes;
    auto* row = &wp::index(map, world, r, 0);
    int* out = &wp::index(p.grains, w, r, 0);
    auto zero = row[0], scale = zero, none = zero;
    zero = wp::index(p.zero_mm, w), scale = 1.0 / p.grain_mm, none = 1 << 30;
    TACGEN_ALONG(0, map.shape[2]) {
        auto gap = (row[c] - zero) * scale;
        gap = gap < none ? gap : none;
        out[c] = (int)(gap + 0.5f);
        if (clears) row[c] = INFINITY;
    }
""")
def _to_grains(
    map: wp.array3d(dtype=Any), p: Worlds, clears: bool, world: int, w: int, r: int, lane: int
): ...


@wp.kernel
def to_grains(gap_mm: wp.array3d(dtype=Any), start: int, clears: bool, p: Worlds):
    """Gaps of each world beyond first touch, in grains; ``clears`` makes the map new again."""
    w, r, lane = wp.tid()
    _to_grains(gap_mm, p, clears, start + w, w, r, lane)


@native("""
    // V(delta) = volume by Newton from the right: no step can miss, and the last is exact.
    const int n_beside = beside.shape[1];
    const int* around = n_beside ? &wp::index(beside, w, 0) : nullptr;
    double delta = volume > 0.0 ? deepest : 0.0;
    int stride = 8;  // a look at every eighth row begins it near the end
    bool is_found = volume <= 0.0;
    for (int step = 0; step < 2000 && !is_found; step++) {
        const int limit = (int)wp::min(ceil(delta), deepest + 1.0);
        long long count = 0, total = 0, count_beside = 0, total_beside = 0;
        for (int r = 0; r < p.grains.shape[1]; r += stride) {
            const int* row = &wp::index(p.grains, w, r, 0);
            int in_row = 0;
            long long sum = 0;
            TACGEN_ALONG(0, p.grains.shape[2]) {
                const bool below = row[c] < limit;
                in_row += below ? 1 : 0;
                sum += below ? row[c] : 0;
            }
            count += in_row, total += sum;
        }
        TACGEN_ALONG(0, n_beside) {
            const bool below = around[c] < limit;
            count_beside += below ? 1 : 0;
            total_beside += below ? around[c] : 0;
        }
    #if defined(__CUDA_ARCH__)
        __shared__ unsigned long long sums[4];
        __syncthreads();
        if (lane < 4) sums[lane] = 0;
        __syncthreads();
        atomicAdd(&sums[0], (unsigned long long)count);
        atomicAdd(&sums[1], (unsigned long long)total);
        atomicAdd(&sums[2], (unsigned long long)count_beside);
        atomicAdd(&sums[3], (unsigned long long)total_beside);
        __syncthreads();
        count = sums[0], total = sums[1], count_beside = sums[2], total_beside = sums[3];
    #endif
        const double pixels = count + count_beside * weight / stride;
        const double found = (volume / stride + total + total_beside * weight / stride) / pixels;
        const bool is_deepest = pixels == 0.0 || (found >= deepest && delta >= deepest);
        if (stride == 8 && (is_deepest || fabs(found - delta) <= 1e-3 * fabs(delta))) {
            stride = 1;
            if (pixels == 0.0) delta = deepest;
            continue;
        }
        is_found = is_deepest || (stride == 1 && ceil(found) == ceil(delta));
        delta = pixels == 0.0 ? deepest : found;
    }
    if (lane == 0) wp::index(p.delta, w) = wp::min(delta, deepest);
""")
def _solve(
    p: Worlds, beside: Ints2, weight: wp.float64, volume: wp.float64, deepest: wp.float64,
    w: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def solve(
    p: Worlds, beside: Ints2, weight: wp.float64, is_depth: bool, gel_depth: wp.float64, lanes: int
):
    """δ of each world and the largest there can be, in grains.

    What was asked for is a volume or, with ``is_depth``, δ beyond first touch. Points ``beside``
    the window, of the same zero, stand for ``weight`` pixels each; the object may touch there
    first: then the gel is pressed through sooner.
    """
    w, lane = wp.tid()
    first = wp.int32(0)
    for k in range(beside.shape[1]):
        first = wp.min(first, beside[w, k])
    deepest = gel_depth + wp.float64(first)
    asked = p.asked[p.start + w]
    if lane == 0:
        p.deepest[w] = deepest
    if not is_depth:
        _solve(p, beside, weight, asked, deepest, w, lane, lanes)
    elif lane == 0:
        p.delta[w] = wp.min(asked + wp.float64(first), deepest)
        if asked <= wp.float64(0.0):
            p.delta[w] = wp.float64(0.0)


@wp.kernel
def results(p: Worlds, least_mm: wp.float32, beside: Ints2, each_mm3: wp.float64):
    """δ of each world, 0 where nothing touches in the window, and whether it is the largest."""
    w = wp.tid()
    depth_mm = wp.float32(0.0)
    if p.zero_mm[w] < wp.float64(wp.inf) and p.delta[w] > wp.float64(0.0):
        depth_mm = wp.float32(p.delta[w] * p.grain_mm)
    p.indentation_mm[p.start + w] = depth_mm
    p.deepest_mm[w] = wp.max(depth_mm, least_mm)
    total = wp.float64(0.0)
    for k in range(beside.shape[1]):
        total += wp.max(p.delta[w] - wp.float64(beside[w, k]), wp.float64(0.0))
    touches = p.zero_mm[w] < wp.float64(wp.inf) or total > wp.float64(0.0)
    is_pressed = touches and p.asked[p.start + w] > wp.float64(0.0)
    p.saturated[p.start + w] = is_pressed and p.delta[w] >= p.deepest[w]
    p.beside_mm3[p.start + w] = total * each_mm3


_INDENT = """
    const int lanes = p.lanes;
    float* out = &wp::index(p.depth_mm, p.start + w, r, 0);
    bool* touched = &wp::index(p.contact_mask, p.start + w, r, 0);
    const int width = p.depth_mm.shape[2];
    int left = width, right = 0;
    %s
    TACGEN_ALONG(0, width) {
        touched[c] = out[c] > 0.0f;
        left = out[c] > 0.0f && c < left ? c : left;
        right = out[c] > 0.0f ? c + 1 : right;
    }
    if (left < right) TACGEN_GROW(p.patches)
"""


@native(
    _INDENT
    % """
    const int* row = &wp::index(p.grains, w, r, 0);
    const double delta = wp::index(p.delta, w), grain_mm = p.grain_mm;
    TACGEN_ALONG(0, width) {
        const double depth = (delta - row[c]) * grain_mm;
        out[c] = depth > 0.0 ? (float)depth : 0.0f;
    }"""
)
def _indent(p: Worlds, w: int, r: int, lane: int): ...


@wp.kernel
def indent(p: Worlds):
    """Indentation of each pixel, whether it is above 0, and the window of those."""
    w, r, lane = wp.tid()
    _indent(p, w, r, lane)


@native(
    _INDENT
    % """
    const float* row = &wp::index(given, p.start + w, r, 0);
    float deepest = 0.0f;
    TACGEN_ALONG(0, width) {
        if (!(fabsf(row[c]) < INFINITY)) wp::atomic_min(&wp::index(p.wrong, 0), p.start + w);
        out[c] = row[c] > 0.0f ? row[c] : 0.0f;
        deepest = out[c] > deepest ? out[c] : deepest;
    }
    wp::atomic_max(&wp::index(p.deepest_mm, w), deepest);"""
)
def _take_depth(given: Map3, p: Worlds, w: int, r: int, lane: int): ...


@wp.kernel
def take_depth(given: Map3, p: Worlds):
    """As ``indent``, of an indentation that is given."""
    w, r, lane = wp.tid()
    _take_depth(given, p, w, r, lane)


@wp.kernel
def results_of_depth(p: Worlds, gel_depth_mm: wp.float32, least_mm: wp.float32):
    """As ``results``."""
    w = wp.tid()
    p.indentation_mm[p.start + w] = p.deepest_mm[w]
    p.saturated[p.start + w] = p.deepest_mm[w] >= gel_depth_mm
    p.deepest_mm[w] = wp.max(p.deepest_mm[w], least_mm)


# How the gel bends around it ---------------------------------------------------------------------


@native("""
    const int lanes = p.lanes;
    TACGEN_ALONG(window[2], window[3])
        wp::index(p.height_mm, w, r, c) = wp::index(p.rest_mm, r, c);
""")
def _rest(p: Worlds, window: wp.vec4i, w: int, r: int, lane: int): ...


@wp.kernel
def begin(p: Worlds):
    """Brings the gel of each world back to rest."""
    w, r, lane = wp.tid()
    window = p.changed[w]
    if r >= window[0] and r < window[1]:
        _rest(p, window, w, r, lane)
    if lane == 0:
        p.spans[w, r, 0] = 1 << 30
        p.spans[w, r, 1] = 0


@wp.kernel
def clear(p: Worlds):
    """Nothing is indented or deformed yet."""
    w = wp.tid()
    p.patches[w] = wp.vec4i(1 << 30, 0, 1 << 30, 0)
    p.changed[w] = wp.vec4i(1 << 30, 0, 1 << 30, 0)
    p.deepest_mm[w] = 0.0
    p.relief_mm[w] = 0.0


@native("""
    const int lanes = p.lanes;
    float* out = &wp::index(p.surface, w, r, 0);
    const float* depth = &wp::index(p.depth_mm, p.start + w, r, 0);
    const bool is_in = r >= patch[0] && r < patch[1];
    TACGEN_ALONG(frame[2], frame[3])
        out[c] = is_in && c >= patch[2] && c < patch[3] ? depth[c] : 0.0f;
""")
def _place(p: Worlds, patch: wp.vec4i, frame: wp.vec4i, w: int, r: int, lane: int): ...


@wp.kernel
def place(p: Worlds, margin: int):
    """The surface of each world: its indentation, and gel at rest around it."""
    w, r, lane = wp.tid()
    frame = grown(p.patches[w], margin, 4, p.surface.shape[1], p.surface.shape[2])
    if r >= frame[0] and r < frame[1]:
        _place(p, p.patches[w], frame, w, r, lane)


@native("""
    // Means of blocks of 2×2 pixels; beyond the window its edges go on.
    const int last = window[1] - window[0] - 1, end = window[3] - window[2] - 1;
    const int above = wp::clamp(2 * r - 4, 0, last), below = wp::clamp(2 * r - 3, 0, last);
    const float* up = &wp::index(source, w, window[0] + above, window[2]);
    const float* down = &wp::index(source, w, window[0] + below, window[2]);
    float* TACGEN_ALONE out = &wp::index(target, w, r, 0);
    #define TACGEN_MEAN(even, odd) (0.25f * ((up[even] + down[even]) + (up[odd] + down[odd])))
    if (TILE > 1)
        for (int c = 2; 2 * c - 3 <= end; c++) out[c] = TACGEN_MEAN(2 * c - 4, 2 * c - 3);
    TACGEN_ALONG(0, (end + 2) / 2 + 4) {
        if (TILE > 1 && c == 2) c = wp::max((end + 3) / 2, 2);  // what is done already
        const int even = wp::clamp(2 * c - 4, 0, end), odd = wp::clamp(2 * c - 3, 0, end);
        out[c] = TACGEN_MEAN(even, odd);
    }
""")
def _halve(source: Map3, window: wp.vec4i, target: Map3, w: int, r: int, lane: int, lanes: int): ...


@native("""
    // One row blurred along itself; beyond the window its edges go on.
    const int radius = kernel.shape[0] - 1, beyond = TILE == 1 ? 0 : radius;
    const float* k = &wp::index(kernel, 0);
    const float* row = &wp::index(source, w, r, 0);
    float* out = &wp::index(target, w, r, 0);
    TACGEN_TILES(window[2], window[3]) {
        float sum[TILE], line[TILE + 128];
        const float* middle = row + c0;
        const bool is_edge = c0 - radius < window[2] || c0 + n + radius > window[3];
        if (is_edge) {
            for (int i = -beyond; i < n + beyond; i++)
                line[beyond + i] = row[wp::clamp(c0 + i, window[2], window[3] - 1)];
            middle = line + beyond;
        }
        for (int i = 0; i < n; i++) sum[i] = k[0] * middle[i];
        for (int j = 1; j <= radius; j++) {
            if (TILE == 1 && is_edge) {
                const int low = wp::max(c0 - j, window[2]), high = wp::min(c0 + j, window[3] - 1);
                sum[0] += k[j] * (row[low] + row[high]);
            } else {
                const float* low = middle - j;
                const float* high = middle + j;
                for (int i = 0; i < n; i++) sum[i] += k[j] * (low[i] + high[i]);
            }
        }
        for (int i = 0; i < n; i++) out[c0 + i] = sum[i];
    }
""")
def _blur_along(
    source: Map3, window: wp.vec4i, kernel: Floats, target: Map3, w: int, r: int, lane: int,
    lanes: int,
): ...  # fmt: skip


@native("""
    // One row of the sum along columns; beyond the window its edges go on.
    const int radius = kernel.shape[0] - 1;
    const float* k = &wp::index(kernel, 0);
    float* out = &wp::index(target, w, r, 0);
    TACGEN_TILES(window[2], window[3]) {
        const float* row = &wp::index(source, w, r, c0);
        float sum[TILE];
        for (int i = 0; i < n; i++) sum[i] = k[0] * row[i];
        for (int j = 1; j <= radius; j++) {
            const float* low = &wp::index(source, w, wp::max(r - j, window[0]), c0);
            const float* high = &wp::index(source, w, wp::min(r + j, window[1] - 1), c0);
            for (int i = 0; i < n; i++) sum[i] += k[j] * (low[i] + high[i]);
        }
        for (int i = 0; i < n; i++) out[c0 + i] = sum[i];
    }
""")
def _blur_down(
    source: Map3, window: wp.vec4i, kernel: Floats, target: Map3, w: int, r: int, lane: int,
    lanes: int,
): ...  # fmt: skip


@native("""
    // One row between the middles of the blocks that halving made, three quarters from the near.
    const int at = r - window[0], near = at / 2 + 2, far = at % 2 ? near + 1 : near - 1;
    const float* close = &wp::index(source, w, near, 0);
    const float* other = &wp::index(source, w, far, 0);
    float* out = &wp::index(target, w, r, window[2]);
    const int width = window[3] - window[2];
    TACGEN_TILES(0, (width + 1) / 2) {
        float mean[TILE + 2];
        for (int i = 0; i < n + 2; i++)
            mean[i] = 0.75f * close[c0 + i + 1] + 0.25f * other[c0 + i + 1];
        for (int i = 0; i < n; i++) {
            out[2 * (c0 + i)] = 0.75f * mean[i + 1] + 0.25f * mean[i];
            if (2 * (c0 + i) + 1 < width)
                out[2 * (c0 + i) + 1] = 0.75f * mean[i + 1] + 0.25f * mean[i + 2];
        }
    }
""")
def _double(
    source: Map3, window: wp.vec4i, target: Map3, w: int, r: int, lane: int, lanes: int
): ...


@wp.kernel
def resample(
    source: Map3, patches: Windows, margin: int, step: int, level: int, height: int, width: int,
    kernel: Floats, how: int, lanes: int, target: Map3,
):  # fmt: skip
    """One step of a Gaussian on a window that was halved ``level`` times."""
    w, r, lane = wp.tid()
    window = blocks(grown(patches[w], margin, step, height, width), level)
    if how == HALVE:
        if r < blocks(window, 1)[1]:
            _halve(source, window, target, w, r, lane, lanes)
    elif r >= window[0] and r < window[1]:
        if how == ALONG:
            _blur_along(source, window, kernel, target, w, r, lane, lanes)
        elif how == DOWN:
            _blur_down(source, window, kernel, target, w, r, lane, lanes)
        else:
            _double(source, window, target, w, r, lane, lanes)


@native("""
    const int lanes = p.lanes;
    const float* depth = &wp::index(p.depth_mm, p.start + w, r, 0);
    float* out = &wp::index(p.surface, w, r, 0);
    TACGEN_ALONG(window[2], window[3]) {
        const float share = (depth[c] - loose_mm) * per_mm;
        const float hold = share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
        out[c] += hold * (depth[c] - out[c]);
    }
""")
def _keep_contact(
    p: Worlds, window: wp.vec4i, loose_mm: wp.float32, per_mm: wp.float32, w: int, r: int, lane: int
): ...


@wp.kernel
def keep_contact(p: Worlds, loose: wp.float32, firm: wp.float32):
    """Holds the surface to the object where it is pressed deep: by shares of the deepest."""
    w, r, lane = wp.tid()
    window = p.patches[w]
    if r >= window[0] and r < window[1]:
        deep_mm = p.deepest_mm[w]
        _keep_contact(p, window, loose * deep_mm, 1.0 / ((firm - loose) * deep_mm), w, r, lane)


@native("""
    const int lanes = p.lanes;
    const float* deformation = &wp::index(p.surface, w, r, 0);
    const float* rest = &wp::index(p.rest_mm, r, 0);
    float* out = &wp::index(p.height_mm, w, r, 0);
    int left = 1 << 30, right = 0;
    float deepest = 0.0f;
    TACGEN_ALONG(window[2], window[3]) {
        const float d = deformation[c] >= least_mm ? deformation[c] : 0.0f;
        out[c] = rest[c] - d;
        left = d > 0.0f && c < left ? c : left;
        right = d > 0.0f ? c + 1 : right;
        deepest = d > deepest ? d : deepest;
    }
    if (right > 0) {
        TACGEN_GROW(p.changed)
        wp::atomic_min(&wp::index(p.spans, w, r, 0), left);
        wp::atomic_max(&wp::index(p.spans, w, r, 1), right);
        wp::atomic_max(&wp::index(p.relief_mm, w), deepest);
    }
""")
def _settle(p: Worlds, window: wp.vec4i, least_mm: wp.float32, w: int, r: int, lane: int): ...


@wp.kernel
def settle(p: Worlds, margin: int, least_mm: wp.float32):
    """The height of the gel, the window and the columns of each row that are not at rest."""
    w, r, lane = wp.tid()
    window = grown(p.patches[w], margin, 1, p.surface.shape[1], p.surface.shape[2])
    if r >= window[0] and r < window[1]:
        _settle(p, window, least_mm, w, r, lane)


# Colour ------------------------------------------------------------------------------------------


@wp.struct
class Table:
    """An image model made ready: Taxim's quadratic, or a response and what a contact adds to it."""

    is_response: bool
    interpolates: bool
    nodes: Floats
    n_slope: int
    n_direction: int
    node_rows: int
    node_columns: int
    per_slope: wp.float32
    per_direction: wp.float32
    contact_depth_mm: wp.float32
    contact: Map2
    contact_rest_mm: Map2
    background: Map3


@wp.func
def lit_span(spans: Ints3, w: int, r: int, width: int) -> wp.vec2i:
    """Columns [first, last) of a row of which a pixel or its neighbour is not at rest."""
    first, last = int(1 << 30), int(0)
    for near in range(wp.max(r - 1, 0), wp.min(r + 2, spans.shape[1])):
        first = wp.min(first, spans[w, near, 0])
        last = wp.max(last, spans[w, near, 1])
    out = wp.vec2i(0, 0)
    if first < last:
        out = wp.vec2i(wp.max(first - 1, 0), wp.min(last + 1, width))
    return out


_SLOPES = """
    const int lanes = p.lanes, n_rows = p.height_mm.shape[1], n_columns = p.height_mm.shape[2];
    const int r_up = wp::max(r - 1, 0), r_down = wp::min(r + 1, n_rows - 1);
    const float* here = &wp::index(p.height_mm, w, r, 0);
    const float* up = &wp::index(p.height_mm, w, r_up, 0);
    const float* down = &wp::index(p.height_mm, w, r_down, 0);
    const float* table = &wp::index(t.nodes, 0);
    const float* back = &wp::index(t.background, r, 0, 0);
    float* out = &wp::index(p.image, w, r, 0, 0);
    const float per_row = r_down > r_up ? 1.0f / (p.mm_per_px * (r_down - r_up)) : 0.0f;
    const float per_column = 0.5f / p.mm_per_px;
    const int n_direction = t.n_direction, last_slope = t.n_slope - (t.interpolates ? 2 : 1);
    const float per_slope = t.per_slope, per_direction = t.per_direction;
    const float interpolates = t.interpolates ? 1.0f : 0.0f;
    // Arc tangent of y / x, both at least 0 (Cephes atanf).
    auto arc = [](float y, float x) {
        const float small = y < x ? y : x, large = y < x ? x : y;
        const bool far = small > 0.41421356f * large;
        const float top = far ? small - large : small, bottom = far ? small + large : large;
        const float q = top / (bottom > 1e-30f ? bottom : 1e-30f), z = q * q;
        float series = 8.05374449538e-2f * z - 1.38776856032e-1f;
        series = series * z + 1.99777106478e-1f;
        series = series * z - 3.33329491539e-1f;
        float angle = series * z * q + q;
        angle = far ? angle + 0.78539816f : angle;
        return y > x ? 1.5707963f - angle : angle;
    };
    // Slopes gx, gy of a tile; its nodes in the table, and the shares p1, q1 of the next ones.
    #define TACGEN_LOOK_UP(node_floats) \\
        float gx[TILE], gy[TILE], p1[TILE], q1[TILE]; \\
        int node[TILE]; \\
        for (int i = 0; i < n; i++) gy[i] = (down[c0 + i] - up[c0 + i]) * per_row; \\
        const int i_first = c0 == 0 ? 1 : 0, i_last = c0 + n == n_columns ? n - 1 : n; \\
        for (int i = i_first; i < i_last; i++) \\
            gx[i] = (here[c0 + i + 1] - here[c0 + i - 1]) * per_column; \\
        if (c0 == 0) gx[0] = n_columns > 1 ? (here[1] - here[0]) * 2.0f * per_column : 0.0f; \\
        if (c0 + n == n_columns && n_columns > 1) \\
            gx[n - 1] = (here[n_columns - 1] - here[n_columns - 2]) * 2.0f * per_column; \\
        for (int i = 0; i < n; i++) { \\
            const float x = gx[i], y = gy[i]; \\
            float angle = arc(fabsf(y), fabsf(x)); \\
            angle = x < 0.0f ? 3.14159265f - angle : angle; \\
            angle = y < 0.0f ? -angle : angle; \\
            const float slope = arc(sqrtf(x * x + y * y), 1.0f) * per_slope; \\
            const float turn = (angle + 3.14159265f) * per_direction; \\
            const int k = wp::min((int)slope, last_slope); \\
            const int l = wp::min((int)turn, n_direction - 1); \\
            p1[i] = interpolates * wp::min(slope - k, 1.0f); \\
            q1[i] = interpolates * wp::min(turn - l, 1.0f); \\
            node[i] = (k * (n_direction + 1) + l) * node_floats; \\
        }
"""


@native(
    _SLOPES
    + """
    // A quadratic in position between nodes of slope and direction, on the background.
    const int next = t.interpolates ? 24 : 0, deeper = next * (n_direction + 1);
    const float v = (r + 0.5f) / n_rows - 0.5f;
    TACGEN_TILES(span[0], span[1]) {
        TACGEN_LOOK_UP(24)
        for (int i = 0; i < n; i++) {
            const float* a = table + node[i];
            const float* b = a + deeper;
            const float w11 = p1[i] * q1[i], w10 = p1[i] - w11, w01 = q1[i] - w11;
            const float w00 = 1.0f - p1[i] - w01, u = (c0 + i + 0.5f) / n_columns - 0.5f;
            float f[24], grey[4];
            for (int j = 0; j < 24; j++)
                f[j] = (w00 * a[j] + w01 * a[next + j]) + (w10 * b[j] + w11 * b[next + j]);
            for (int j = 0; j < 4; j++)
                grey[j] = (f[j] * u * u + (f[8 + j] * u + f[16 + j]) * v)
                    + (f[4 + j] * v * v + (f[12 + j] * u + f[20 + j]));
            for (int j = 0; j < 3; j++) out[3 * (c0 + i) + j] = back[3 * (c0 + i) + j] + grey[j];
        }
    }
"""
)
def _shade_quadratic(p: Worlds, t: Table, span: wp.vec2i, w: int, r: int, lane: int): ...


@native(
    _SLOPES
    + """
    // Light of any course in position, between nodes of row, column, slope and direction.
    const float* rest = &wp::index(t.contact_rest_mm, r, 0);
    const int deeper = (n_direction + 1) * 4, aside = t.n_slope * deeper;
    const int to_row = t.node_columns * aside, both = aside + deeper;
    const float at_row = (r + 0.5f) / n_rows * (t.node_rows - 1);
    const int row = wp::min((int)at_row, t.node_rows - 2);
    const float share_down = at_row - row;
    const float* over = &wp::index(t.contact, row, 0);
    const float* under = &wp::index(t.contact, row + 1, 0);
    TACGEN_TILES(span[0], span[1]) {
        TACGEN_LOOK_UP(4)
        for (int i = 0; i < n; i++) {
            const float at = (c0 + i + 0.5f) / n_columns * (t.node_columns - 1);
            const int column = wp::min((int)at, t.node_columns - 2);
            const float share = at - column, w11 = p1[i] * share;
            const float w10 = p1[i] - w11, w01 = share - w11, w00 = 1.0f - p1[i] - w01;
            const float* a = table + node[i] + row * to_row + column * aside;
            const float* b = a + to_row;
            float pair[8];
            for (int j = 0; j < 8; j++) {
                const float level =
                    (w00 * a[j] + w01 * a[aside + j]) + (w10 * a[deeper + j] + w11 * a[both + j]);
                const float below =
                    (w00 * b[j] + w01 * b[aside + j]) + (w10 * b[deeper + j] + w11 * b[both + j]);
                pair[j] = level + share_down * (below - level);
            }
            float* pixel = out + 3 * (c0 + i);
            for (int j = 0; j < 3; j++)
                pixel[j] = back[3 * (c0 + i) + j] + (pair[j] + q1[i] * (pair[4 + j] - pair[j]));
            const float depth = rest[c0 + i] - here[c0 + i];
            if (depth <= 0.0f) continue;
            const float cosine = 1.0f / sqrtf(1.0f + gx[i] * gx[i] + gy[i] * gy[i]);
            const float nx = gx[i] * cosine, ny = gy[i] * cosine;
            const float shown = depth / (depth + t.contact_depth_mm);
            float f[24];
            for (int j = 0; j < 24; j++)
                f[j] = over[12 * column + j]
                    + share_down * (under[12 * column + j] - over[12 * column + j]);
            for (int j = 0; j < 3; j++) {
                const float left = f[j] + nx * f[4 + j] + ny * f[8 + j];
                const float right = f[12 + j] + nx * f[16 + j] + ny * f[20 + j];
                pixel[j] += shown * ((1.0f - share) * left + share * right);
            }
        }
    }
"""
)
def _shade_response(p: Worlds, t: Table, span: wp.vec2i, w: int, r: int, lane: int): ...


@wp.kernel
def shade(p: Worlds, t: Table):
    """Grey levels of the pixels that are not at rest, and of their neighbours."""
    w, r, lane = wp.tid()
    span = lit_span(p.spans, w, r, p.height_mm.shape[2])
    if span[0] < span[1]:
        if t.is_response:
            _shade_response(p, t, span, w, r, lane)
        else:
            _shade_quadratic(p, t, span, w, r, lane)


# Shadows, and the picture ------------------------------------------------------------------------


@wp.struct
class Lights:
    """Lights for shadows: each ``is_turned`` where its shadows run along columns of the image."""

    n: int
    is_turned: Ints
    is_downwards: Ints
    across_px: Floats
    rise_mm: Floats
    share: Map2
    unlit: Map3
    per_depth_px: wp.float32
    per_mm: wp.float32
    turned_mm: Map3
    hidden: Map3
    met: Map4


@wp.func
def seen(p: Worlds, lights: Lights, w: int) -> wp.vec4i:
    """The window of a world that may differ from the picture at rest."""
    margin = int(1)
    if lights.n > 0:
        margin += int(wp.ceil(p.relief_mm[w] * lights.per_depth_px)) + 1
    return grown(p.changed[w], margin, 1, p.height_mm.shape[1], p.height_mm.shape[2])


@native("""
    const int lanes = p.lanes;
    const float* row = &wp::index(p.height_mm, w, r, 0);
    TACGEN_ALONG(window[2], window[3]) wp::index(turned_mm, w, c, r) = row[c];
""")
def _turn(p: Worlds, window: wp.vec4i, turned_mm: Map3, w: int, r: int, lane: int): ...


@wp.kernel
def turn(p: Worlds, lights: Lights):
    """The height with rows and columns exchanged."""
    w, r, lane = wp.tid()
    window = seen(p, lights, w)
    if r >= window[0] and r < window[1]:
        _turn(p, window, lights.turned_mm, w, r, lane)


@native("""
    // The lowest relief met on the way from the light, lifted by the ray's rise, goes along from
    // row to row: what is above it is hidden.
    const float across_px = wp::index(lights.across_px, led), per_mm = lights.per_mm;
    const float weight = fabsf(across_px), stay = 1.0f - weight;
    const int side = across_px >= 0.0f ? 1 : -1, width = right - left;
    TACGEN_ALONG(0, width + 2)
        wp::index(lights.met, w, led, 0, c) = wp::index(lights.met, w, led, 1, c) = 1e6f;
    TACGEN_SYNC;
    for (int i = 0; i < bottom - top; i++) {
        const int r = wp::index(lights.is_downwards, led) ? top + i : bottom - 1 - i;
        const float* row = &wp::index(relief, w, r, left);
        float* TACGEN_ALONE out = &wp::index(lights.hidden, w, led, r * relief.shape[2] + left);
        const float* centre = &wp::index(lights.met, w, led, i % 2, 1);
        const float* aside = centre + side;
        float* TACGEN_ALONE after = &wp::index(lights.met, w, led, 1 - i % 2, 1);
        const float lift = i > 0 ? wp::index(lights.rise_mm, led) : 0.0f;
        TACGEN_ALONG(0, width) {
            const float level = (stay * centre[c] + weight * aside[c]) + lift;
            const float shade = (row[c] - level) * per_mm;
            out[c] = shade < 0.0f ? 0.0f : shade > 1.0f ? 1.0f : shade;
            after[c] = row[c] < level ? row[c] : level;
        }
        TACGEN_SYNC;
    }
""")
def _sweep(
    relief: Map3, lights: Lights, top: int, bottom: int, left: int, right: int, w: int, led: int,
    lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def sweep(p: Worlds, lights: Lights, lanes: int):
    """How much of each light is hidden from each pixel."""
    w, led, lane = wp.tid()
    s = seen(p, lights, w)
    if s[0] < s[1]:
        if lights.is_turned[led] > 0:
            _sweep(lights.turned_mm, lights, s[2], s[3], s[0], s[1], w, led, lane, lanes)
        else:
            _sweep(p.height_mm, lights, s[0], s[1], s[2], s[3], w, led, lane, lanes)


@native("""
    // Motion away from the indentation, of which a marker sees some points spread evenly over it.
    const auto& patch = wp::index(p.patches, w);
    const int height = wp::max(patch[1] - patch[0], 0), width = wp::max(patch[3] - patch[2], 0);
    const double scale = p.mm_per_px, x = wp::index(p.markers_at_rest_mm, m, 0);
    const double y = wp::index(p.markers_at_rest_mm, m, 1);
    const double half_row = 0.5 * p.depth_mm.shape[1] - 0.5, half = 0.5 * p.depth_mm.shape[2] - 0.5;
    double along_x = 0.0, along_y = 0.0;
    int every = wp::max(1, (int)sqrt((double)height * width / most_points)), count = 0;
    for (; count == 0 && every > 0; every = every > 1 ? 1 : 0)
        for (int r = patch[0] + every / 2; r < patch[0] + height; r += every)
            for (int c = patch[2] + every / 2; c < patch[2] + width; c += every) {
                const double depth = wp::index(p.depth_mm, p.start + w, r, c);
                count += depth > 0.0 ? 1 : 0;
                const double dx = x - (c - half) * scale, dy = y - (r - half_row) * scale;
                const double fall = decay * (dx * dx + dy * dy);
                if (depth <= 0.0 || fall > 30.0) continue;
                const double weight = gain * depth * scale * scale * every * every * exp(-fall);
                along_x += weight * dx, along_y += weight * dy;
            }
    const float* sheared = &wp::index(p.sheared_mm, p.start + w, m, 0);
    wp::index(p.markers_mm, p.start + w, m, 0) = (float)(x + along_x + sheared[0]);
    wp::index(p.markers_mm, p.start + w, m, 1) = (float)(y + along_y + sheared[1]);
""")
def _spread(p: Worlds, most_points: int, decay: wp.float64, gain: wp.float64, w: int, m: int): ...


@wp.kernel
def spread(p: Worlds, most_points: int, decay: wp.float64, gain: wp.float64):
    """Places of the markers."""
    w, m = wp.tid()
    _spread(p, most_points, decay, gain, w, m)


@native("""
    // At rest outside the columns seen, else lit, hidden, noisy and rounded.
    const int lanes = p.lanes, height = p.rgb_at_rest.shape[0], width = p.rgb_at_rest.shape[1];
    const int world = p.start + w;
    wp::uint8* out = &wp::index(p.rgb, world, r, 0, 0);
    const wp::uint8* still = &wp::index(p.rgb_at_rest, r, 0, 0);
    const float* rest = &wp::index(p.image_at_rest, r, 0, 0);
    const float* rest_lit = &wp::index(p.lit_at_rest, r, 0, 0);
    const float* lit = &wp::index(p.image, w, r, 0, 0);
    const bool is_row = r >= window[0] && r < window[1], is_rounded = p.grey.shape[0] == 0;
    const float sigma = p.noise_grey, radius = p.marker_radius_px;
    float dots[2 * 128];  // places x, y of those that this row meets, in pixels
    int n_dots = 0;
    for (int m = 0; m < p.n_markers; m++) {
        const float y = wp::index(p.markers_mm, world, m, 1) / p.mm_per_px + 0.5f * height - 0.5f;
        if (fabsf(r - y) > radius + 0.5f || n_dots == 128) continue;
        const float x = wp::index(p.markers_mm, world, m, 0) / p.mm_per_px + 0.5f * width - 0.5f;
        dots[2 * n_dots] = x, dots[2 * n_dots + 1] = y;
        n_dots++;
    }
    TACGEN_TILES(0, width) {
        const bool is_still = !is_row || c0 + n <= window[2] || c0 >= window[3];
        bool is_dotted = false;
        for (int m = 0; m < n_dots; m++)
            is_dotted |= dots[2 * m] > c0 - radius - 1.0f && dots[2 * m] < c0 + n + radius;
        if (is_still && sigma <= 0.0f && !is_dotted && is_rounded) {
            for (int i = 3 * c0; i < 3 * (c0 + n); i++) out[i] = still[i];
            continue;
        }
        float grey[3 * TILE];
        for (int i = 0; i < 3 * n; i++) grey[i] = rest[3 * c0 + i];
        const int from = is_still ? n : wp::max(window[2] - c0, 0), to = wp::min(window[3] - c0, n);
        for (int i = 3 * from; i < 3 * to; i++) grey[i] = rest_lit[3 * c0 + i];
        const int lit_from = wp::max(span[0] - c0, 0), lit_to = wp::min(span[1] - c0, n);
        for (int i = 3 * lit_from; i < 3 * lit_to; i++) grey[i] = lit[3 * c0 + i];
        for (int led = 0; led < lights.n && from < to; led++) {
            const float* dark = &wp::index(lights.hidden, w, led, 0);
            const float* unlit = &wp::index(lights.unlit, r, c0, 0);
            const float* share = &wp::index(lights.share, led, 0);
            float part[TILE], darkest = 0.0f;
            if (wp::index(lights.is_turned, led))
                for (int i = from; i < to; i++) part[i] = dark[(c0 + i) * height + r];
            else
                for (int i = from; i < to; i++) part[i] = dark[r * width + c0 + i];
            for (int i = from; i < to; i++) darkest = part[i] > darkest ? part[i] : darkest;
            for (int i = from; i < to && darkest > 0.0f; i++)
                for (int j = 0; j < 3; j++) {
                    const float light = grey[3 * i + j] - unlit[3 * i + j];
                    grey[3 * i + j] -= share[j] * part[i] * (light > 0.0f ? light : 0.0f);
                }
        }
        for (int m = 0; m < n_dots && is_dotted; m++)
            for (int i = 0; i < n; i++) {
                const float dx = c0 + i - dots[2 * m], dy = r - dots[2 * m + 1];
                const float cover = wp::clamp(radius + 0.5f - sqrtf(dx * dx + dy * dy), 0.0f, 1.0f);
                const float shown = 1.0f - cover * (1.0f - ink_transmission);
                for (int j = 0; j < 3; j++) grey[3 * i + j] *= shown;
            }
        for (int i = 0; i < 3 * n && !is_rounded; i++)
            wp::index(p.grey, world, r, c0 + i / 3, i % 3) = grey[i];
        const wp::uint32 first = 3u * ((wp::uint32)(world * height + r) * width + c0);
        for (int i = 0; i < 3 * n && sigma > 0.0f; i++) {  // 12 random bits: a hash of the place
            wp::uint32 x = seed + 0x9E3779B9u * (first + i);
            x = (x ^ (x >> 16)) * 0x7FEB352Du;
            x = (x ^ (x >> 15)) * 0x846CA68Bu;
            grey[i] += sigma * wp::index(p.quantiles, (int)((x ^ (x >> 16)) >> 20));
        }
        for (int i = 0; i < 3 * n && is_rounded; i++) {
            const float level = grey[i] + 0.5f;
            out[3 * c0 + i] = (wp::uint8)(int)wp::clamp(level, 0.0f, 255.0f);
        }
    }
""")
def _expose(
    p: Worlds, lights: Lights, window: wp.vec4i, span: wp.vec2i, ink_transmission: wp.float32,
    seed: wp.uint32, w: int, r: int, lane: int,
): ...  # fmt: skip


@wp.kernel
def expose(p: Worlds, lights: Lights, ink_transmission: wp.float32, seed: wp.uint32):
    """The pictures."""
    w, r, lane = wp.tid()
    window = seen(p, lights, w)
    span = lit_span(p.spans, w, r, p.height_mm.shape[2])
    if lights.n == 0:
        window = wp.vec4i(window[0], window[1], span[0], span[1])
    _expose(p, lights, window, span, ink_transmission, seed, w, r, lane)


def _of_types(kernel: Any, argument: str, ndim: int, *dtypes: Any) -> dict[Any, Any]:
    """The kernel for arrays of these types: compiled together, and found without a search."""
    arrays = {dtype: {argument: wp.array(dtype=dtype, ndim=ndim)} for dtype in dtypes}
    return {dtype: wp.overload(kernel, given) for dtype, given in arrays.items()}


FIRST_TOUCH = _of_types(first_touch, "gap_mm", 3, wp.float32, wp.float64)
TO_GRAINS = _of_types(to_grains, "gap_mm", 3, wp.float32, wp.float64)
_NUMBERS = (wp.int32, wp.int64, wp.float32, wp.float64)
CHECK_FORCE = _of_types(check_force, "force_n", 1, *_NUMBERS)
CHECK_POSES = _of_types(check_poses, "poses", 3, *_NUMBERS)
CHECK_IDS = _of_types(check_ids, "ids", 1, wp.int32, wp.int64)
