"""The kernels of a batch: one source in Warp for the CPU and for CUDA.

A thread works on one row of one world: on the CPU on all of it, where the compiler makes vectors of
its inner loops, on a GPU on every n-th pixel, where neighbouring threads read neighbouring pixels.
Loops over pixels are written in C++, since Warp's own loops over arrays do not become vectors: a
Gaussian along columns takes 2.7 ms a frame so, and 0.09 ms like this. What they compute is that of
the renderer for single frames: ``contact/raster.py``, ``contact/indentation.py``,
``optics/smooth.py``, ``optics/deform.py``, ``optics/shade.py``, ``optics/effects/shadow.py``.

A kernel's first index counts the worlds of one part of the batch, which begins at ``start``.
"""

from typing import Any

import warp as wp

from tacgen.contact.gap import NO_OBJECT

wp.set_module_options({"enable_backward": False})

GAP, FORCE, POSE, MESH, N_WRONG = (wp.constant(k) for k in range(5))
"""Places in ``wrong``, which the host reads when all is drawn."""

PATCH_NONE = (1 << 30, 0, 1 << 30, 0)
"""A patch (top, bottom, left, right) of no pixel, as it is before any is found."""

_PRELUDE = """
#if defined(__CUDA_ARCH__)
    #define TACGEN_SYNC __syncthreads()
    constexpr int TILE = 1;
#else
    #define TACGEN_SYNC
    constexpr int TILE = 64;
#endif
    (void)TILE;
    // Runs a statement for the pixels c of [first, last) that are this thread's.
    #define TACGEN_ALONG(first, last) \\
        for (int c = (first) + lane; c < (last); c += TILE == 1 ? lanes : 1)
    // The same in pieces of up to TILE pixels, of which c0 is the first and n the number.
    #define TACGEN_TILES(first, last) \\
        for (int c0 = (first) + lane * TILE, n; \\
             n = wp::min(TILE, (last) - c0), c0 < (last); c0 += lanes * TILE)
"""


def _native(body: str) -> Any:
    """A function of C++ on pixels ``lane``, ``lane`` + ``lanes``, … of a row."""
    return wp.func_native(_PRELUDE + body)


Map2, Map3, Map4 = (wp.array(dtype=wp.float32, ndim=n) for n in (2, 3, 4))
Doubles3 = wp.array3d(dtype=wp.float64)
Ints3 = wp.array3d(dtype=wp.int32)
Floats = wp.array(dtype=wp.float32)
Doubles = wp.array(dtype=wp.float64)
Ints = wp.array(dtype=wp.int32)
Windows = wp.array(dtype=wp.vec4i)


# Windows of pixels: (top, bottom, left, right) ---------------------------------------------------


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


# Gap maps of meshes ------------------------------------------------------------------------------


@_native("""
    // The triangles of a cell of a mesh over a grid: lowers gaps to the nearest surface.
    const int n_rows = gap_mm.shape[1], n_columns = gap_mm.shape[2];
    const double* t = &wp::index(poses, world, 0, 0);
    const double* s = &wp::index(spheres, cell, 0);
    const double half_row = 0.5 * n_rows - 0.5, half_column = 0.5 * n_columns - 0.5;
    if (fabs((t[0]*s[0] + t[1]*s[1] + t[2]*s[2] + t[3]) * per_px) > half_column + 0.5 + 1.001 * s[3] * per_px) return;
    if (fabs((t[4]*s[0] + t[5]*s[1] + t[6]*s[2] + t[7]) * per_px) > half_row + 0.5 + 1.001 * s[3] * per_px) return;
    const double limit_mm = wp::index(limits_mm, w);
    if (t[8]*s[0] + t[9]*s[1] + t[10]*s[2] - 1.001 * s[3] > limit_mm) return;
    // Some of its faces are enough where a few pixels are.
    const int f_first = wp::index(first, cell), f_last = wp::index(first, cell + 1);
    const int step = every > 1 ? wp::clamp((f_last - f_first) / 4, 1, 8) : 1;
    for (int f = f_first + lane * step; f < f_last; f += lanes * step) {
        double x[3], y[3], z[3];
        for (int i = 0; i < 3; i++) {
            const double* p = &wp::index(vertices, wp::index(faces, f, i), 0);
            x[i] = (t[0]*p[0] + t[1]*p[1] + t[2]*p[2] + t[3]) * per_px + half_column;
            y[i] = (t[4]*p[0] + t[5]*p[1] + t[6]*p[2] + t[7]) * per_px + half_row;
            z[i] = t[8]*p[0] + t[9]*p[1] + t[10]*p[2];
        }
        const double z_low = wp::min(z[0], wp::min(z[1], z[2])), z_high = wp::max(z[0], wp::max(z[1], z[2]));
        if (z_low > limit_mm) continue;
        const double y_low = wp::min(y[0], wp::min(y[1], y[2])), y_high = wp::max(y[0], wp::max(y[1], y[2]));
        const double x_low = wp::min(x[0], wp::min(x[1], x[2])), x_high = wp::max(x[0], wp::max(x[1], x[2]));
        int r_first = (int)ceil(wp::max(0.0, y_low));
        const int r_last = (int)floor(wp::min(n_rows - 1.0, y_high));
        r_first = (r_first + every - 1) / every * every;
        if (r_first > r_last || x_high < 0 || x_low > n_columns - 1.0) continue;
        // The gel is highest at its middle, and so under a triangle where that is nearest.
        const int r_near = wp::min(wp::max(n_rows / 2, r_first), r_last);
        const double middle = n_columns / 2;
        const int c_near = (int)wp::min(wp::max(wp::min(wp::max(middle, x_low), x_high), 0.0), n_columns - 1.0);
        if (z_low - wp::index(gel_mm, r_near, c_near) > limit_mm) continue;
        const double area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0]);
        if (area == 0.0) continue;
        const double slope_x = ((z[1] - z[0]) * (y[2] - y[0]) - (z[2] - z[0]) * (y[1] - y[0])) / area;
        const double slope_y = ((z[2] - z[0]) * (x[1] - x[0]) - (z[1] - z[0]) * (x[2] - x[0])) / area;
        const double z_origin = z[0] - x[0] * slope_x - y[0] * slope_y;
        // By row, then column: both triangles of an edge compute its crossings from the same numbers.
        int a = 0, b = 1, k = 2, swap;
        #define TACGEN_AFTER(i, j) (y[j] < y[i] || (y[j] == y[i] && x[j] < x[i]))
        if (TACGEN_AFTER(a, b)) { swap = a; a = b; b = swap; }
        if (TACGEN_AFTER(b, k)) { swap = b; b = k; k = swap; }
        if (TACGEN_AFTER(a, b)) { swap = a; a = b; b = swap; }
        const double long_slope = (x[k] - x[a]) / (y[k] - y[a]);
        const double low_slope = y[b] > y[a] ? (x[b] - x[a]) / (y[b] - y[a]) : 0.0;
        const double high_slope = y[k] > y[b] ? (x[k] - x[b]) / (y[k] - y[b]) : 0.0;
        for (int r = r_first; r <= r_last; r += every) {
            const double x_long = x[a] + (r - y[a]) * long_slope;
            const double x_short = r < y[b] ? x[a] + (r - y[a]) * low_slope : x[b] + (r - y[b]) * high_slope;
            const int start = (int)wp::max(0.0, ceil(wp::min(x_long, x_short)));
            const int stop = (int)wp::min(n_columns - 1.0, floor(wp::max(x_long, x_short))) + 1;
            const double z_row = z_origin + r * slope_y;
            double* out = &wp::index(gap_mm, w, r, 0);
            const double* gel = &wp::index(gel_mm, r, 0);
            for (int c = start; c < stop; c++) {
                const double gap = wp::min(wp::max(z_row + c * slope_x, z_low), z_high) - gel[c];
    #if defined(__CUDA_ARCH__)
                wp::atomic_min(&out[c], gap);
    #else
                out[c] = wp::min(out[c], gap);
    #endif
            }
        }
    }
""")
def _rasterize(
    vertices: wp.array2d(dtype=wp.float64), faces: wp.array2d(dtype=wp.int32), first: Ints,
    spheres: wp.array2d(dtype=wp.float64), poses: Doubles3, gel_mm: wp.array2d(dtype=wp.float64),
    per_px: wp.float64, limits_mm: Doubles, every: int, gap_mm: Doubles3,
    world: int, w: int, cell: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def rasterize(
    vertices: wp.array2d(dtype=wp.float64),
    faces: wp.array2d(dtype=wp.int32),
    first: Ints,
    spheres: wp.array2d(dtype=wp.float64),
    cells_of_mesh: Ints,
    mesh_ids: Ints,
    start: int,
    poses: Doubles3,
    gel_mm: wp.array2d(dtype=wp.float64),
    per_px: wp.float64,
    limits_mm: Doubles,
    every: int,
    lanes: int,
    gap_mm: Doubles3,
):
    """Gaps (B, h, w) of each world's mesh over a grid, of which only every n-th row is drawn."""
    w, k, lane = wp.tid()
    mesh = mesh_ids[start + w]
    cell = cells_of_mesh[mesh] + k
    if cell < cells_of_mesh[mesh + 1]:
        _rasterize(
            vertices, faces, first, spheres, poses, gel_mm, per_px, limits_mm, every, gap_mm,
            start + w, w, cell, lane, lanes,
        )  # fmt: skip


@_native("""
    // The smallest of every n-th row of a map, +inf if there is none, and whether one is NaN.
    const int height = map.shape[1], width = map.shape[2];
    double least = INFINITY;
    int n_nan = 0;
    for (int r = 0; r < height; r += every) {
        const auto* row = &wp::index(map, world, r, 0);
        auto low = row[0];
        low = INFINITY;
        TACGEN_ALONG(0, width) {
            low = row[c] < low ? row[c] : low;
            n_nan += row[c] != row[c];
        }
        least = low < least ? (double)low : least;
    }
    if (n_nan) wp::atomic_min(&wp::index(wrong, 0), world);
    wp::atomic_min(&wp::index(zero_mm, w), least);
""")
def _smallest(
    map: wp.array3d(dtype=Any), every: int, zero_mm: Doubles, wrong: Ints,
    world: int, w: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def first_touch(
    gap_mm: wp.array3d(dtype=Any), start: int, every: int, zero_mm: Doubles, wrong: Ints, lanes: int
):
    """The smallest gap of each world, of every n-th row; ``wrong`` is a world with a NaN."""
    w, lane = wp.tid()
    _smallest(gap_mm, every, zero_mm, wrong, start + w, w, lane, lanes)


@wp.kernel
def limit(zero_mm: Doubles, reach_mm: wp.float64, limits_mm: Doubles):
    """What lies further than this cannot touch."""
    w = wp.tid()
    limits_mm[w] = zero_mm[w] + reach_mm


@_native("""
    // Gaps beyond first touch in whole grains.
    const int width = map.shape[2];
    auto* row = &wp::index(map, world, r, 0);
    int* out = &wp::index(grains, w, r, 0);
    auto zero = row[0];
    zero = zero_mm;
    auto none = zero;
    none = 1 << 30;
    auto scale = zero;
    scale = per_mm;
    TACGEN_ALONG(0, width) {
        auto gap = (row[c] - zero) * scale;
        gap = gap < none ? gap : none;
        out[c] = (int)(gap + (gap < 0 ? -0.5f : 0.5f));
        if (clears) row[c] = INFINITY;
    }
""")
def _to_grains(
    map: wp.array3d(dtype=Any), zero_mm: wp.float64, per_mm: wp.float64, clears: bool, grains: Ints3,
    world: int, w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def to_grains(
    gap_mm: wp.array3d(dtype=Any),
    start: int,
    zero_mm: Doubles,
    per_mm: wp.float64,
    clears: bool,
    grains: Ints3,
    lanes: int,
):
    """Gaps of each world beyond first touch, in whole grains; ``clears`` makes the map new again."""
    w, r, lane = wp.tid()
    _to_grains(gap_mm, zero_mm[w], per_mm, clears, grains, start + w, w, r, lane, lanes)


@_native("""
    // V(delta) = volume by Newton from the right: no step can miss, and the last is exact.
    const int height = grains.shape[1], width = grains.shape[2], n_beside = beside.shape[1];
    const int* around = n_beside ? &wp::index(beside, w, 0) : nullptr;
    double delta = deepest;
    int stride = 8;  // a look at every eighth row begins it near the end
    bool is_found = volume <= 0.0;
    if (is_found) delta = 0.0;
    for (int step = 0; step < 2000 && !is_found; step++) {
        const double highest = ceil(delta) < deepest + 1.0 ? ceil(delta) : deepest + 1.0;
        const int limit = (int)highest;
        long long count = 0, total = 0, count_beside = 0, total_beside = 0;
        for (int r = 0; r < height; r += stride) {
            const int* row = &wp::index(grains, w, r, 0);
            int in_row = 0;
            long long sum = 0;
            TACGEN_ALONG(0, width) {
                const bool below = row[c] < limit;
                in_row += below ? 1 : 0;
                sum += below ? row[c] : 0;
            }
            count += in_row;
            total += sum;
        }
        TACGEN_ALONG(0, n_beside) {
            const bool below = around[c] < limit;
            count_beside += below ? 1 : 0;
            total_beside += below ? around[c] : 0;
        }
    #if defined(__CUDA_ARCH__)
        __shared__ unsigned long long sums[4];
        TACGEN_SYNC;
        if (lane < 4) sums[lane] = 0;
        TACGEN_SYNC;
        atomicAdd(&sums[0], (unsigned long long)count);
        atomicAdd(&sums[1], (unsigned long long)total);
        atomicAdd(&sums[2], (unsigned long long)count_beside);
        atomicAdd(&sums[3], (unsigned long long)total_beside);
        TACGEN_SYNC;
        count = sums[0], total = sums[1], count_beside = sums[2], total_beside = sums[3];
    #endif
        const double pixels = count + count_beside * weight / stride;
        if (pixels == 0.0) {  // of an eighth of the rows, or of none at all
            delta = deepest;
            if (stride == 1) break;
            stride = 1;
            continue;
        }
        const double found = (volume / stride + total + total_beside * weight / stride) / pixels;
        const bool is_deepest = found >= deepest && delta >= deepest;
        if (stride == 8 && (is_deepest || fabs(found - delta) <= 1e-3 * fabs(delta))) {
            stride = 1;
            continue;
        }
        is_found = is_deepest || (stride == 1 && ceil(found) == ceil(delta));
        delta = found;
    }
    if (lane == 0) wp::index(out, w) = delta < deepest ? delta : deepest;
""")
def _solve(
    grains: Ints3, beside: wp.array2d(dtype=wp.int32), volume: wp.float64, deepest: wp.float64,
    weight: wp.float64, out: Doubles, w: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def solve(
    grains: Ints3,
    beside: wp.array2d(dtype=wp.int32),
    weight: wp.float64,
    asked: Doubles,
    is_depth: bool,
    gel_depth: wp.float64,
    start: int,
    lanes: int,
    delta: Doubles,
    deepest: Doubles,
):
    """δ of each world and the largest there can be, in grains.

    ``asked`` is its volume in pixels × grains or, with ``is_depth``, δ beyond first touch. Points
    ``beside`` the window, of the same zero, stand for ``weight`` pixels each; the object may touch
    there first: then the gel is pressed through sooner.
    """
    w, lane = wp.tid()
    first = wp.int32(0)
    for k in range(beside.shape[1]):
        first = wp.min(first, beside[w, k])
    most = gel_depth + wp.float64(first)
    if lane == 0:
        deepest[w] = most
    wanted = asked[start + w]
    if is_depth:
        if lane == 0:
            delta[w] = wp.min(wanted + wp.float64(first), most)
            if wanted <= wp.float64(0.0):
                delta[w] = wp.float64(0.0)
    else:
        _solve(grains, beside, wanted, most, weight, delta, w, lane, lanes)


@wp.kernel
def check_poses(
    poses: wp.array3d(dtype=Any), tolerance: wp.float64, wrong: Ints, out: Doubles3
):
    """Poses (N, 4, 4) in double precision; ``wrong`` is a world whose pose is no rigid motion."""
    w = wp.tid()
    for i in range(4):
        for j in range(4):
            out[w, i, j] = wp.float64(poses[w, i, j])
    is_right = bool(True)
    for i in range(3):
        is_right = is_right and wp.abs(out[w, i, 3]) < wp.float64(1.0e300)
        for j in range(3):
            product = wp.float64(0.0)
            for k in range(3):
                product += out[w, k, i] * out[w, k, j]
            if i == j:
                product -= wp.float64(1.0)
            is_right = is_right and wp.abs(product) <= tolerance
    for j in range(4):
        last = out[w, 3, j]
        if j == 3:
            last -= wp.float64(1.0)
        is_right = is_right and wp.abs(last) <= tolerance
    minor_x = out[w, 1, 1] * out[w, 2, 2] - out[w, 1, 2] * out[w, 2, 1]
    minor_y = out[w, 1, 0] * out[w, 2, 2] - out[w, 1, 2] * out[w, 2, 0]
    minor_z = out[w, 1, 0] * out[w, 2, 1] - out[w, 1, 1] * out[w, 2, 0]
    turn = out[w, 0, 0] * minor_x - out[w, 0, 1] * minor_y + out[w, 0, 2] * minor_z
    if not (is_right and turn > wp.float64(0.0)):
        wp.atomic_min(wrong, POSE, w)


@wp.kernel
def check_ids(ids: wp.array(dtype=Any), n_meshes: int, wrong: Ints, out: Ints):
    """Indices of meshes; ``wrong`` is a world for which there is none."""
    w = wp.tid()
    mesh = int(ids[w])
    out[w] = mesh
    if mesh < 0 or mesh >= n_meshes:
        wp.atomic_min(wrong, MESH, w)
        out[w] = 0


@wp.kernel
def check_force(force_n: wp.array(dtype=Any), factor: wp.float64, wrong: Ints, asked: Doubles):
    """What the law asks of each gel; ``wrong`` is a world whose force is none."""
    w = wp.tid()
    force = wp.float64(force_n[w])
    asked[w] = force * factor
    if not (force >= wp.float64(0.0) and force < wp.float64(1.0e300)):
        wp.atomic_min(wrong, FORCE, w)
        asked[w] = wp.float64(0.0)


@wp.kernel
def gather_beside(
    gap_mm: Doubles3,
    outside: wp.array2d(dtype=wp.bool),
    zero_mm: Doubles,
    reach_mm: wp.float64,
    per_mm: wp.float64,
    beside: wp.array2d(dtype=wp.int32),
):
    """Gaps of the gel around the window, in grains beyond first touch in it, or around it."""
    w = wp.tid()
    infinite = wp.float64(wp.inf)
    n_columns = gap_mm.shape[2]
    zero, limit_mm = wp.float64(zero_mm[w]), zero_mm[w] + reach_mm
    if zero == infinite:
        for r in range(gap_mm.shape[1]):
            for c in range(n_columns):
                if outside[r, c]:
                    zero = wp.min(zero, gap_mm[w, r, c])
    for r in range(gap_mm.shape[1]):
        for c in range(n_columns):
            grains = wp.int32(NO_OBJECT)
            if outside[r, c] and gap_mm[w, r, c] < limit_mm:
                gap = (gap_mm[w, r, c] - zero) * per_mm + wp.float64(0.5)
                grains = wp.int32(wp.clamp(gap, wp.float64(-NO_OBJECT), wp.float64(NO_OBJECT)))
            beside[w, r * n_columns + c] = grains
            gap_mm[w, r, c] = infinite


@wp.kernel
def results(
    delta: Doubles,
    deepest: Doubles,
    zero_mm: Doubles,
    grain_mm: wp.float64,
    start: int,
    indentation_mm: Floats,
    saturated: wp.array(dtype=wp.bool),
):
    """δ of each world, 0 where nothing touches in the window, and whether it is the largest."""
    w = wp.tid()
    if zero_mm[w] < wp.float64(wp.inf) and delta[w] > wp.float64(0.0):
        indentation_mm[start + w] = wp.float32(delta[w] * grain_mm)
    else:
        indentation_mm[start + w] = 0.0
    saturated[start + w] = delta[w] >= deepest[w]


@_native("""
    const int width = given.shape[2];
    const float* row = &wp::index(given, world, r, 0);
    float* out = &wp::index(depth_mm, world, r, 0);
    bool* touched = &wp::index(mask, world, r, 0);
    int left = width, right = 0, n_nan = 0;
    float deepest = 0.0f;
    TACGEN_ALONG(0, width) {
        out[c] = row[c] > 0.0f ? row[c] : 0.0f;
        touched[c] = row[c] > 0.0f;
        n_nan += row[c] != row[c];
        deepest = row[c] > deepest ? row[c] : deepest;
        left = row[c] > 0.0f && c < left ? c : left;
        right = row[c] > 0.0f ? c + 1 : right;
    }
    if (n_nan) wp::atomic_min(&wp::index(wrong, 0), world);
    if (left < right) {
        wp::atomic_max(&wp::index(deepest_mm, w), deepest);
        wp::vec4i& patch = wp::index(patches, w);
        wp::atomic_min(&patch[0], r);
        wp::atomic_max(&patch[1], r + 1);
        wp::atomic_min(&patch[2], left);
        wp::atomic_max(&patch[3], right);
    }
""")
def _take_depth(
    given: Map3, depth_mm: Map3, mask: wp.array3d(dtype=wp.bool), patches: Windows,
    deepest_mm: Floats, wrong: Ints, world: int, w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def take_depth(
    given: Map3, start: int, lanes: int, depth_mm: Map3, mask: wp.array3d(dtype=wp.bool),
    patches: Windows, deepest_mm: Floats, wrong: Ints,
):  # fmt: skip
    """An indentation (N, H, W) that is known, instead of one that is solved for."""
    w, r, lane = wp.tid()
    _take_depth(
        given, depth_mm, mask, patches, deepest_mm, wrong, start + w, w, r, lane, lanes
    )


@wp.kernel
def results_of_depth(
    deepest_mm: Floats, gel_depth_mm: wp.float32, start: int, indentation_mm: Floats,
    saturated: wp.array(dtype=wp.bool),
):  # fmt: skip
    """As ``results``."""
    w = wp.tid()
    indentation_mm[start + w] = deepest_mm[w]
    saturated[start + w] = deepest_mm[w] >= gel_depth_mm


# The imprint, and how the gel bends around it ----------------------------------------------------


@_native("""
    // Indentation of a row; returns what it holds through bounds: its patch and its deepest pixel.
    const int width = grains.shape[2];
    const int* row = &wp::index(grains, w, r, 0);
    float* out = &wp::index(depth_mm, world, r, 0);
    bool* touched = &wp::index(mask, world, r, 0);
    int left = width, right = 0;
    TACGEN_ALONG(0, width) {
        const double depth = (delta - row[c]) * grain_mm;
        out[c] = depth > 0.0 ? (float)depth : 0.0f;
    }
    TACGEN_ALONG(0, width) {
        touched[c] = out[c] > 0.0f;
        left = out[c] > 0.0f && c < left ? c : left;
        right = out[c] > 0.0f ? c + 1 : right;
    }
    if (left < right) {
        int* patch = &wp::index(patches, w)[0];
        wp::atomic_min(&patch[0], r);
        wp::atomic_max(&patch[1], r + 1);
        wp::atomic_min(&patch[2], left);
        wp::atomic_max(&patch[3], right);
    }
""")
def _indent(
    grains: Ints3, delta: wp.float64, grain_mm: wp.float64, depth_mm: Map3,
    mask: wp.array3d(dtype=wp.bool), patches: Windows, world: int, w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def indent(
    grains: Ints3,
    delta: Doubles,
    grain_mm: wp.float64,
    start: int,
    lanes: int,
    depth_mm: Map3,
    mask: wp.array3d(dtype=wp.bool),
    patches: Windows,
):
    """Indentation (N, H, W) of each pixel, whether it is above 0, and the window of those."""
    w, r, lane = wp.tid()
    _indent(grains, delta[w], grain_mm, depth_mm, mask, patches, start + w, w, r, lane, lanes)


@_native("""
    // A row of the surface: the indentation within the patch, 0 around it.
    float* out = &wp::index(surface, w, r, 0);
    const float* depth = &wp::index(depth_mm, world, r, 0);
    const bool is_in = r >= top && r < bottom;
    TACGEN_ALONG(first, last) out[c] = is_in && c >= left && c < right ? depth[c] : 0.0f;
""")
def _place(
    depth_mm: Map3, world: int, top: int, bottom: int, left: int, right: int, first: int, last: int,
    surface: Map3, w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def place(depth_mm: Map3, start: int, patches: Windows, margin: int, lanes: int, surface: Map3):
    """The surface of each world: its indentation, and gel at rest around it."""
    w, r, lane = wp.tid()
    p = patches[w]
    frame = grown(p, margin, 4, surface.shape[1], surface.shape[2])
    if r >= frame[0] and r < frame[1]:
        _place(
            depth_mm, start + w, p[0], p[1], p[2], p[3], frame[2], frame[3], surface,
            w, r, lane, lanes,
        )  # fmt: skip


@_native("""
    // Means of blocks of 2×2 pixels; beyond the window its edges go on.
    const int above = wp::clamp(2 * r - 4, 0, bottom - top - 1);
    const int below = wp::clamp(2 * r - 3, 0, bottom - top - 1);
    const float* up = &wp::index(fine, w, top + above, left);
    const float* down = &wp::index(fine, w, top + below, left);
    float* out = &wp::index(coarse, w, r, 0);
    const int end = right - left - 1, n_blocks = (end + 2) / 2 + 4;
    #define TACGEN_MEAN(even, odd) (0.25f * ((up[even] + down[even]) + (up[odd] + down[odd])))
    #if !defined(__CUDA_ARCH__)
    for (int c = 2; 2 * c - 3 <= end; c++) out[c] = TACGEN_MEAN(2 * c - 4, 2 * c - 3);
    #endif
    TACGEN_ALONG(0, n_blocks) {
        if (TILE > 1 && c == 2) c = end / 2 + 1;  // but for the edges, done already
        const int even = wp::clamp(2 * c - 4, 0, end), odd = wp::clamp(2 * c - 3, 0, end);
        out[c] = TACGEN_MEAN(even, odd);
    }
""")
def _halve(
    fine: Map3, top: int, bottom: int, left: int, right: int, coarse: Map3,
    w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def halve(
    fine: Map3, patches: Windows, margin: int, step: int, level: int, height: int, width: int,
    lanes: int, coarse: Map3,
):  # fmt: skip
    """Means of 2×2 pixels of a window that was halved ``level`` times before."""
    w, r, lane = wp.tid()
    window = blocks(grown(patches[w], margin, step, height, width), level)
    if r < blocks(window, 1)[1]:
        _halve(fine, window[0], window[1], window[2], window[3], coarse, w, r, lane, lanes)


@_native("""
    // One row blurred along itself; beyond the window its edges go on.
    const int radius = kernel.shape[0] - 1;
    const float* k = &wp::index(kernel, 0);
    const float* row = &wp::index(source, w, r, 0);
    float* out = &wp::index(target, w, r, 0);
    TACGEN_TILES(left, right) {
        float sum[TILE];
        if (c0 - radius < left || c0 + n + radius > right) {
            float line[TILE + 128];
            const int beyond = TILE == 1 ? 0 : radius;
            for (int i = -beyond; i < n + beyond; i++)
                line[beyond + i] = row[wp::clamp(c0 + i, left, right - 1)];
            for (int i = 0; i < n; i++) sum[i] = k[0] * line[beyond + i];
            for (int j = 1; j <= radius; j++) {
                if (TILE == 1) {
                    sum[0] += k[j] * (row[wp::max(c0 - j, left)] + row[wp::min(c0 + j, right - 1)]);
                } else {
                    const float* low = line + radius - j;
                    const float* high = line + radius + j;
                    for (int i = 0; i < n; i++) sum[i] += k[j] * (low[i] + high[i]);
                }
            }
        } else {
            for (int i = 0; i < n; i++) sum[i] = k[0] * row[c0 + i];
            for (int j = 1; j <= radius; j++) {
                const float* low = row + c0 - j;
                const float* high = row + c0 + j;
                for (int i = 0; i < n; i++) sum[i] += k[j] * (low[i] + high[i]);
            }
        }
        for (int i = 0; i < n; i++) out[c0 + i] = sum[i];
    }
""")
def _blur_along(
    source: Map3, left: int, right: int, kernel: Floats, target: Map3,
    w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@_native("""
    // One row of the sum along columns; beyond the window its edges go on.
    const int radius = kernel.shape[0] - 1;
    const float* k = &wp::index(kernel, 0);
    const float* row = &wp::index(source, w, r, 0);
    float* out = &wp::index(target, w, r, 0);
    TACGEN_TILES(left, right) {
        float sum[TILE];
        for (int i = 0; i < n; i++) sum[i] = k[0] * row[c0 + i];
        for (int j = 1; j <= radius; j++) {
            const float* low = &wp::index(source, w, wp::max(r - j, top), c0);
            const float* high = &wp::index(source, w, wp::min(r + j, bottom - 1), c0);
            for (int i = 0; i < n; i++) sum[i] += k[j] * (low[i] + high[i]);
        }
        for (int i = 0; i < n; i++) out[c0 + i] = sum[i];
    }
""")
def _blur_down(
    source: Map3, top: int, bottom: int, left: int, right: int, kernel: Floats, target: Map3,
    w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def blur_along(
    source: Map3, patches: Windows, margin: int, step: int, level: int, height: int, width: int,
    kernel: Floats, lanes: int, target: Map3,
):  # fmt: skip
    """A Gaussian along the rows of a window."""
    w, r, lane = wp.tid()
    window = blocks(grown(patches[w], margin, step, height, width), level)
    if r >= window[0] and r < window[1]:
        _blur_along(source, window[2], window[3], kernel, target, w, r, lane, lanes)


@wp.kernel
def blur_down(
    source: Map3, patches: Windows, margin: int, step: int, level: int, height: int, width: int,
    kernel: Floats, lanes: int, target: Map3,
):  # fmt: skip
    """A Gaussian along the columns of a window."""
    w, r, lane = wp.tid()
    window = blocks(grown(patches[w], margin, step, height, width), level)
    if r >= window[0] and r < window[1]:
        _blur_down(
            source, window[0], window[1], window[2], window[3], kernel, target, w, r, lane, lanes
        )


@_native("""
    // One row between the middles of the blocks that ``_halve`` made, three quarters from the near.
    const int at = r - top, near = at / 2 + 2, far = at % 2 ? near + 1 : near - 1;
    const float* close = &wp::index(coarse, w, near, 0);
    const float* other = &wp::index(coarse, w, far, 0);
    float* out = &wp::index(fine, w, r, left);
    const int width = right - left;
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
    coarse: Map3, top: int, left: int, right: int, fine: Map3,
    w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def double(
    coarse: Map3, patches: Windows, margin: int, step: int, level: int, height: int, width: int,
    lanes: int, fine: Map3,
):  # fmt: skip
    """Interpolates blocks back, to a window that was halved ``level`` times."""
    w, r, lane = wp.tid()
    window = blocks(grown(patches[w], margin, step, height, width), level)
    if r >= window[0] and r < window[1]:
        _double(coarse, window[0], window[2], window[3], fine, w, r, lane, lanes)


@_native("""
    const float* depth = &wp::index(depth_mm, world, r, 0);
    float* out = &wp::index(surface, w, r, 0);
    TACGEN_ALONG(left, right) {
        const float share = (depth[c] - loose) * per_mm;
        const float hold = share < 0.0f ? 0.0f : share > 1.0f ? 1.0f : share;
        out[c] += hold * (depth[c] - out[c]);
    }
""")
def _keep_contact(
    depth_mm: Map3, world: int, loose: wp.float32, per_mm: wp.float32, left: int, right: int,
    surface: Map3, w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def keep_contact(
    depth_mm: Map3, start: int, patches: Windows, deepest_mm: Floats, loose: wp.float32,
    firm: wp.float32, lanes: int, surface: Map3,
):  # fmt: skip
    """Holds the surface to the object where it is pressed deep: by shares of the deepest."""
    w, r, lane = wp.tid()
    p = patches[w]
    if r >= p[0] and r < p[1]:
        deep = deepest_mm[w]
        _keep_contact(
            depth_mm, start + w, loose * deep, 1.0 / ((firm - loose) * deep), p[2], p[3], surface,
            w, r, lane, lanes,
        )  # fmt: skip


@wp.kernel
def deepest_of(delta: Doubles, grain_mm: wp.float64, least: wp.float32, deepest_mm: Floats):
    """The deepest indentation of each world."""
    w = wp.tid()
    deepest_mm[w] = wp.max(wp.float32(delta[w] * grain_mm), least)


@_native("""
    // The gel's height where it is deformed; what is less than least_mm is none.
    const float* deformation = &wp::index(surface, w, r, 0);
    const float* rest = &wp::index(rest_mm, r, 0);
    float* out = &wp::index(height_mm, w, r, 0);
    int first = 1 << 30, last = 0;
    float deepest = 0.0f;
    TACGEN_ALONG(left, right) {
        const float d = deformation[c] >= least_mm ? deformation[c] : 0.0f;
        out[c] = rest[c] - d;
        first = d > 0.0f && c < first ? c : first;
        last = d > 0.0f ? c + 1 : last;
        deepest = d > deepest ? d : deepest;
    }
    if (last > 0) {
        int* patch = &wp::index(patches, w)[0];
        wp::atomic_min(&patch[0], r);
        wp::atomic_max(&patch[1], r + 1);
        wp::atomic_min(&patch[2], first);
        wp::atomic_max(&patch[3], last);
        wp::atomic_min(&wp::index(spans, w, r, 0), first);
        wp::atomic_max(&wp::index(spans, w, r, 1), last);
        wp::atomic_max(&wp::index(deepest_mm, w), deepest);
    }
""")
def _settle(
    surface: Map3, rest_mm: Map2, least_mm: wp.float32, left: int, right: int, height_mm: Map3,
    patches: Windows, spans: Ints3, deepest_mm: Floats, w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@_native("""
    const float* rest = &wp::index(rest_mm, r, 0);
    float* out = &wp::index(height_mm, w, r, 0);
    TACGEN_ALONG(left, right) out[c] = rest[c];
""")
def _rest(
    rest_mm: Map2, left: int, right: int, height_mm: Map3, w: int, r: int, lane: int, lanes: int
): ...


@wp.kernel
def begin(
    rest_mm: Map2, changed: Windows, lanes: int, height_mm: Map3, spans: Ints3, patches: Windows
):
    """Brings the height of each world back to rest, where it was ``changed``."""
    w, r, lane = wp.tid()
    window = changed[w]
    if r >= window[0] and r < window[1]:
        _rest(rest_mm, window[2], window[3], height_mm, w, r, lane, lanes)
    if lane == 0:
        spans[w, r, 0] = 1 << 30
        spans[w, r, 1] = 0
    if lane == 0 and r == 0:
        patches[w] = wp.vec4i(1 << 30, 0, 1 << 30, 0)


@wp.kernel
def clear_changed(changed: Windows, deepest_mm: Floats):
    """Nothing is deformed yet."""
    w = wp.tid()
    changed[w] = wp.vec4i(1 << 30, 0, 1 << 30, 0)
    deepest_mm[w] = 0.0


@wp.kernel
def settle(
    surface: Map3, patches: Windows, margin: int, rest_mm: Map2, least_mm: wp.float32, lanes: int,
    height_mm: Map3, changed: Windows, spans: Ints3, deepest_mm: Floats,
):  # fmt: skip
    """The height of the gel, the window and the columns of each row that are not at rest."""
    w, r, lane = wp.tid()
    window = grown(patches[w], margin, 1, surface.shape[1], surface.shape[2])
    if r >= window[0] and r < window[1]:
        _settle(
            surface, rest_mm, least_mm, window[2], window[3], height_mm, changed, spans, deepest_mm,
            w, r, lane, lanes,
        )  # fmt: skip


# Colour ------------------------------------------------------------------------------------------


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
    // Coordinates in the table: along[i] of the slope, around[i] of its direction.
    const int n_rows = height_mm.shape[1], n_columns = height_mm.shape[2];
    const int r_up = wp::max(r - 1, 0), r_down = wp::min(r + 1, n_rows - 1);
    const float* here = &wp::index(height_mm, w, r, 0);
    const float* up = &wp::index(height_mm, w, r_up, 0);
    const float* down = &wp::index(height_mm, w, r_down, 0);
    const float per_row = r_down > r_up ? 1.0f / (mm_per_px * (r_down - r_up)) : 0.0f;
    const float per_column = 0.5f / mm_per_px;
    #define TACGEN_SLOPES \
        float gx[TILE], gy[TILE]; \
        for (int i = 0; i < n; i++) gy[i] = (down[c0 + i] - up[c0 + i]) * per_row; \
        const int i_first = c0 == 0 ? 1 : 0, i_last = c0 + n == n_columns ? n - 1 : n; \
        for (int i = i_first; i < i_last; i++) \
            gx[i] = (here[c0 + i + 1] - here[c0 + i - 1]) * per_column; \
        if (c0 == 0) gx[0] = n_columns > 1 ? (here[1] - here[0]) * 2.0f * per_column : 0.0f; \
        if (c0 + n == n_columns && n_columns > 1) \
            gx[n - 1] = (here[n_columns - 1] - here[n_columns - 2]) * 2.0f * per_column;
    // Arc tangent of y / x, both at least 0 (Cephes atanf).
    auto arc = [](float y, float x) {
        const float small = y < x ? y : x, large = y < x ? x : y;
        const bool far = small > 0.41421356f * large;
        const float top = far ? small - large : small, bottom = far ? small + large : large;
        const float q = top / (bottom > 1e-30f ? bottom : 1e-30f), z = q * q;
        float p = 8.05374449538e-2f * z - 1.38776856032e-1f;
        p = p * z + 1.99777106478e-1f;
        p = p * z - 3.33329491539e-1f;
        float angle = p * z * q + q;
        angle = far ? angle + 0.78539816f : angle;
        return y > x ? 1.5707963f - angle : angle;
    };
    #define TACGEN_COORDINATES \
        float along[TILE], around[TILE]; \
        int node[TILE]; \
        for (int i = 0; i < n; i++) { \
            const float x = gx[i], y = gy[i]; \
            float angle = arc(fabsf(y), fabsf(x)); \
            angle = x < 0.0f ? 3.14159265f - angle : angle; \
            angle = y < 0.0f ? -angle : angle; \
            const float p = arc(sqrtf(x * x + y * y), 1.0f) * per_slope; \
            const float q = (angle + 3.14159265f) * per_direction; \
            const int k = wp::min((int)p, last_slope), l = wp::min((int)q, n_direction - 1); \
            along[i] = interpolates ? wp::min(p - k, 1.0f) : 0.0f; \
            around[i] = interpolates ? wp::min(q - l, 1.0f) : 0.0f; \
            node[i] = (k * (n_direction + 1) + l) * node_floats; \
        }
"""


@_native(
    _SLOPES
    + """
    // Taxim's quadratic in position between nodes of slope and direction, on the background.
    const float* table = &wp::index(nodes, 0);
    const float* back = &wp::index(background, r, 0, 0);
    float* out = &wp::index(image, w, r, 0, 0);
    const int node_floats = 24, to_around = interpolates ? 24 : 0;
    const int to_along = interpolates ? 24 * (n_direction + 1) : 0;
    const int last_slope = interpolates ? n_slope - 2 : n_slope - 1;
    const float v = (r + 0.5f) / n_rows - 0.5f;
    TACGEN_TILES(first, last) {
        TACGEN_SLOPES
        TACGEN_COORDINATES
        for (int i = 0; i < n; i++) {
            const float* node00 = table + node[i];
            const float* node01 = node00 + to_around;
            const float* node10 = node00 + to_along;
            const float* node11 = node10 + to_around;
            const float w11 = along[i] * around[i], w10 = along[i] - w11, w01 = around[i] - w11;
            const float w00 = 1.0f - along[i] - w01, u = (c0 + i + 0.5f) / n_columns - 0.5f;
            float feature[24];
            for (int j = 0; j < 24; j++)
                feature[j] = (w00 * node00[j] + w01 * node01[j]) + (w10 * node10[j] + w11 * node11[j]);
            float grey[4];
            for (int j = 0; j < 4; j++)
                grey[j] = (feature[j] * u * u + (feature[8 + j] * u + feature[16 + j]) * v)
                    + (feature[4 + j] * v * v + (feature[12 + j] * u + feature[20 + j]));
            for (int j = 0; j < 3; j++) out[3 * (c0 + i) + j] = back[3 * (c0 + i) + j] + grey[j];
        }
    }
"""
)
def _shade_quadratic(
    height_mm: Map3, mm_per_px: wp.float32, nodes: Floats, n_slope: int, n_direction: int,
    per_slope: wp.float32, per_direction: wp.float32, interpolates: bool, background: Map3,
    image: Map4, w: int, r: int, first: int, last: int, lane: int, lanes: int,
): ...  # fmt: skip


@_native(
    _SLOPES
    + """
    // Light of any course in position, between nodes of row, column, slope and direction.
    const float* table = &wp::index(nodes, 0);
    const float* back = &wp::index(background, r, 0, 0);
    const float* rest = &wp::index(rest_mm, r, 0);
    float* out = &wp::index(image, w, r, 0, 0);
    const bool interpolates = true;
    const int node_floats = 4, last_slope = n_slope - 2;
    const int to_slope = (n_direction + 1) * 4, to_column = n_slope * to_slope;
    const int to_row = node_columns * to_column;
    const float down_at = (r + 0.5f) / n_rows * (node_rows - 1);
    const int row = wp::min((int)down_at, node_rows - 2);
    const float share_down = down_at - row;
    const float* over = &wp::index(contact, row, 0);
    const float* under = &wp::index(contact, row + 1, 0);
    TACGEN_TILES(first, last) {
        TACGEN_SLOPES
        TACGEN_COORDINATES
        for (int i = 0; i < n; i++) {
            const float at = (c0 + i + 0.5f) / n_columns * (node_columns - 1);
            const int column = wp::min((int)at, node_columns - 2);
            const float share = at - column, p = along[i], q = around[i];
            const float w11 = p * share, w10 = p - w11, w01 = share - w11, w00 = 1.0f - p - w01;
            const float* here = table + node[i] + row * to_row + column * to_column;
            const float* below = here + to_row;
            float pair[8];
            for (int j = 0; j < 8; j++) {
                const float level = (w00 * here[j] + w01 * here[to_column + j])
                    + (w10 * here[to_slope + j] + w11 * here[to_column + to_slope + j]);
                const float next = (w00 * below[j] + w01 * below[to_column + j])
                    + (w10 * below[to_slope + j] + w11 * below[to_column + to_slope + j]);
                pair[j] = level + share_down * (next - level);
            }
            float* pixel = out + 3 * (c0 + i);
            for (int j = 0; j < 3; j++)
                pixel[j] = back[3 * (c0 + i) + j] + (pair[j] + q * (pair[4 + j] - pair[j]));
            const float depth = rest[c0 + i] - here_mm[c0 + i];
            if (depth > 0.0f) {  // what the contact itself adds
                const float cosine = 1.0f / sqrtf(1.0f + gx[i] * gx[i] + gy[i] * gy[i]);
                const float nx = gx[i] * cosine, ny = gy[i] * cosine;
                const float shown = depth / (depth + contact_depth_mm);
                float mixed[24];
                for (int j = 0; j < 24; j++)
                    mixed[j] = over[12 * column + j]
                        + share_down * (under[12 * column + j] - over[12 * column + j]);
                for (int j = 0; j < 3; j++) {
                    const float a = mixed[j] + nx * mixed[4 + j] + ny * mixed[8 + j];
                    const float b = mixed[12 + j] + nx * mixed[16 + j] + ny * mixed[20 + j];
                    pixel[j] += shown * ((1.0f - share) * a + share * b);
                }
            }
        }
    }
""".replace("here_mm[", "(&wp::index(height_mm, w, r, 0))[")
)
def _shade_response(
    height_mm: Map3, mm_per_px: wp.float32, nodes: Floats, n_slope: int, n_direction: int,
    node_rows: int, node_columns: int, per_slope: wp.float32, per_direction: wp.float32,
    rest_mm: Map2, contact: Map2, contact_depth_mm: wp.float32, background: Map3,
    image: Map4, w: int, r: int, first: int, last: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.struct
class TableOnDevice:
    """An image model made ready: Taxim's quadratic, or a response with what a contact adds."""

    is_response: bool
    interpolates: bool
    nodes: Floats
    n_slope: int
    n_direction: int
    node_rows: int
    node_columns: int
    per_slope: wp.float32
    per_direction: wp.float32
    mm_per_px: wp.float32
    contact_depth_mm: wp.float32
    contact: Map2
    contact_rest_mm: Map2
    background: Map3


@wp.kernel
def shade(height_mm: Map3, spans: Ints3, table: TableOnDevice, lanes: int, image: Map4):
    """Grey levels of the pixels that are not at rest, and of their neighbours."""
    w, r, lane = wp.tid()
    span = lit_span(spans, w, r, height_mm.shape[2])
    if span[0] < span[1]:
        if table.is_response:
            _shade_response(
                height_mm, table.mm_per_px, table.nodes, table.n_slope, table.n_direction,
                table.node_rows, table.node_columns, table.per_slope, table.per_direction,
                table.contact_rest_mm, table.contact, table.contact_depth_mm, table.background,
                image, w, r, span[0], span[1], lane, lanes,
            )  # fmt: skip
        else:
            _shade_quadratic(
                height_mm, table.mm_per_px, table.nodes, table.n_slope, table.n_direction,
                table.per_slope, table.per_direction, table.interpolates, table.background,
                image, w, r, span[0], span[1], lane, lanes,
            )  # fmt: skip


# Shadows -----------------------------------------------------------------------------------------


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
    slope: wp.float32


@wp.func
def seen(changed: wp.vec4i, deep_mm: wp.float32, lights: Lights, mm_per_px: wp.float32, h: int, w: int):
    """The window of a world that may differ from the picture at rest."""
    margin = int(1)
    if lights.n > 0:
        margin += int(wp.ceil(deep_mm / lights.slope / mm_per_px)) + 1
    return grown(changed, margin, 1, h, w)


@_native("""
    const float* row = &wp::index(height_mm, w, r, 0);
    TACGEN_ALONG(left, right) wp::index(turned_mm, w, c, r) = row[c];
""")
def _turn(
    height_mm: Map3, left: int, right: int, turned_mm: Map3, w: int, r: int, lane: int, lanes: int
): ...


@wp.kernel
def turn(
    height_mm: Map3, changed: Windows, relief_mm: Floats, lights: Lights, mm_per_px: wp.float32,
    lanes: int, turned_mm: Map3,
):  # fmt: skip
    """The height with rows and columns exchanged."""
    w, r, lane = wp.tid()
    window = seen(
        changed[w], relief_mm[w], lights, mm_per_px, height_mm.shape[1], height_mm.shape[2]
    )
    if r >= window[0] and r < window[1]:
        _turn(height_mm, window[2], window[3], turned_mm, w, r, lane, lanes)


@_native("""
    // The lowest relief met on the way from the light, lifted by the ray's rise, goes along from row
    // to row: what is above it is hidden.
    const float weight = fabsf(across_px), stay = 1.0f - weight;
    const int side = across_px >= 0.0f ? 1 : -1, width = right - left, n_rows = bottom - top;
    TACGEN_ALONG(0, width + 2) wp::index(met, w, led, 0, c) = wp::index(met, w, led, 1, c) = 1e6f;
    TACGEN_SYNC;
    for (int i = 0; i < n_rows; i++) {
        const int r = is_downwards ? top + i : bottom - 1 - i;
        const float* row = &wp::index(relief, w, r, left);
        float* __restrict out = &wp::index(hidden, w, led, r * relief.shape[2] + left);
        const float* centre = &wp::index(met, w, led, i % 2, 1);
        const float* aside = centre + side;
        float* __restrict after = &wp::index(met, w, led, 1 - i % 2, 1);
        const float lift = i > 0 ? rise : 0.0f;
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
    relief: Map3, top: int, bottom: int, left: int, right: int, across_px: wp.float32,
    rise: wp.float32, is_downwards: int, per_mm: wp.float32, met: Map4, hidden: Map3,
    w: int, led: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def sweep(
    height_mm: Map3, turned_mm: Map3, changed: Windows, relief_mm: Floats, lights: Lights,
    mm_per_px: wp.float32, per_mm: wp.float32, lanes: int, met: Map4, hidden: Map3,
):  # fmt: skip
    """How much of each light is hidden from each pixel."""
    w, led, lane = wp.tid()
    p = seen(changed[w], relief_mm[w], lights, mm_per_px, height_mm.shape[1], height_mm.shape[2])
    across, rise, down = lights.across_px[led], lights.rise_mm[led], lights.is_downwards[led]
    if p[0] < p[1]:
        if lights.is_turned[led] > 0:
            _sweep(
                turned_mm, p[2], p[3], p[0], p[1], across, rise, down, per_mm, met, hidden,
                w, led, lane, lanes,
            )  # fmt: skip
        else:
            _sweep(
                height_mm, p[0], p[1], p[2], p[3], across, rise, down, per_mm, met, hidden,
                w, led, lane, lanes,
            )  # fmt: skip


# The picture -------------------------------------------------------------------------------------


@_native("""
    // The row of the picture: at rest outside the columns seen, else lit, hidden, noisy and rounded.
    const int height = rest_rgb.shape[0], width = rest_rgb.shape[1];
    wp::uint8* out = &wp::index(rgb, world, r, 0, 0);
    const wp::uint8* still = &wp::index(rest_rgb, r, 0, 0);
    const float* rest = &wp::index(rest_image, r, 0, 0);
    const float* rest_lit = &wp::index(lit_at_rest, r, 0, 0);
    float* lit = &wp::index(image, w, r, 0, 0);
    const bool is_seen = r >= top && r < bottom;
    for (int c0 = lane * TILE, n; n = wp::min(TILE, width - c0), c0 < width; c0 += lanes * TILE) {
        const bool is_plain = !is_seen || c0 + n <= left || c0 >= right;
        if (is_plain && sigma <= 0.0f) {
            for (int i = 3 * c0; i < 3 * (c0 + n); i++) out[i] = still[i];
            continue;
        }
        float grey[3 * TILE];
        for (int i = 0; i < 3 * n; i++) grey[i] = rest[3 * c0 + i];
        if (!is_plain) {
            const int from = wp::max(left - c0, 0), to = wp::min(right - c0, n);
            for (int i = 3 * from; i < 3 * to; i++) grey[i] = rest_lit[3 * c0 + i];
            const int lit_from = wp::max(first - c0, 0), lit_to = wp::min(last - c0, n);
            for (int i = 3 * lit_from; i < 3 * lit_to; i++) grey[i] = lit[3 * c0 + i];
            for (int led = 0; led < n_leds; led++) {
                const float* dark = &wp::index(hidden, w, led, 0);
                const float* unlit_here = &wp::index(unlit, r, c0, 0);
                const float* shares = &wp::index(share, led, 0);
                float part[TILE], darkest = 0.0f;
                if (wp::index(turned, led) > 0)
                    for (int i = from; i < to; i++) part[i] = dark[(c0 + i) * height + r];
                else
                    for (int i = from; i < to; i++) part[i] = dark[r * width + c0 + i];
                for (int i = from; i < to; i++) darkest = part[i] > darkest ? part[i] : darkest;
                for (int i = from; i < to && darkest > 0.0f; i++)
                    for (int j = 0; j < 3; j++) {
                        const float light = grey[3 * i + j] - unlit_here[3 * i + j];
                        grey[3 * i + j] -= shares[j] * part[i] * (light > 0.0f ? light : 0.0f);
                    }
            }
        }
        if (sigma > 0.0f)
            for (int i = 0; i < 3 * n; i++) {  // a hash of what the value is, for 12 random bits
                wp::uint32 x = seed + 0x9E3779B9u * (3u * ((wp::uint32)(world * height + r) * width + c0) + i);
                x = (x ^ (x >> 16)) * 0x7FEB352Du;
                x = (x ^ (x >> 15)) * 0x846CA68Bu;
                grey[i] += sigma * wp::index(quantiles, (int)((x ^ (x >> 16)) >> 20));
            }
        for (int i = 0; i < 3 * n; i++) {
            const float level = grey[i] + 0.5f;
            out[3 * c0 + i] = (wp::uint8)(int)(level < 0.0f ? 0.0f : level > 255.0f ? 255.0f : level);
        }
    }
""")
def _expose(
    image: Map4, lit_at_rest: Map3, rest_image: Map3, rest_rgb: wp.array3d(dtype=wp.uint8),
    top: int, bottom: int, left: int, right: int, first: int, last: int, n_leds: int, turned: Ints,
    share: Map2, unlit: Map3, hidden: Map3, sigma: wp.float32, quantiles: Floats, seed: wp.uint32,
    rgb: wp.array4d(dtype=wp.uint8), world: int, w: int, r: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.struct
class AtRest:
    """Pictures of the gel at rest: lit, and finished; float, and rounded. And the camera's noise."""

    lit: Map3
    image: Map3
    rgb: wp.array3d(dtype=wp.uint8)
    sigma: wp.float32
    quantiles: Floats


@wp.kernel
def expose(
    image: Map4, spans: Ints3, changed: Windows, relief_mm: Floats, at_rest: AtRest, lights: Lights,
    mm_per_px: wp.float32, hidden: Map3, seed: wp.uint32, start: int, lanes: int,
    rgb: wp.array4d(dtype=wp.uint8),
):  # fmt: skip
    """The pictures (N, H, W, 3)."""
    w, r, lane = wp.tid()
    height, width = at_rest.rgb.shape[0], at_rest.rgb.shape[1]
    p = seen(changed[w], relief_mm[w], lights, mm_per_px, height, width)
    span = lit_span(spans, w, r, width)
    left, right = p[2], p[3]
    if lights.n == 0:
        left, right = span[0], span[1]
    _expose(
        image, at_rest.lit, at_rest.image, at_rest.rgb, p[0], p[1], left, right, span[0], span[1],
        lights.n, lights.is_turned, lights.share, lights.unlit, hidden, at_rest.sigma,
        at_rest.quantiles, seed, rgb, start + w, w, r, lane, lanes,
    )  # fmt: skip
