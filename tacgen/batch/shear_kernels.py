# mypy: ignore-errors
"""Kernels of the shear of many gels: what ``contact/shear_field.py`` solves for one.

A block of threads works on one world. The sweeps of the solve go along wave fronts, on which no
point is a neighbour of another, so that they find what they find one point after another.
"""

import warp as wp

from tacgen.batch.kernels import Doubles, Doubles2, Doubles3, Ints, Ints3, Map3, Worlds, native
from tacgen.contact.shear_field import GRAIN, GROSS_SLIP, LEAST_SEEN

wp.set_module_options({"enable_backward": False})

Doubles4 = wp.array(dtype=wp.float64, ndim=4)
SLIP, LEAST, GRAIN_N_MM2 = (wp.constant(wp.float64(x)) for x in (GROSS_SLIP, LEAST_SEEN, GRAIN))
ZERO, TINY = (wp.constant(wp.float64(x)) for x in (0.0, 1e-12))


@wp.struct
class Gels:
    """The lattice of a sensor's gel, and the shear of N gels, of which the B of a part are at work.

    Maps of more than the lattice's rows and columns have a margin of one around it.
    """

    pixels: int  # a cell's side, and how many pixels it begins before the image
    before_rows: int
    before_columns: int
    cell_mm: wp.float64
    pixel_mm2: wp.float64
    x_mm: Doubles
    y_mm: Doubles
    stiff: Doubles3
    squares: Doubles2
    shown: Doubles3  # part of a force at each point that the markers' sum has of it
    alpha: wp.float64
    beta: wp.float64
    over: wp.float64
    skin: wp.float64
    tolerance: wp.float64
    most_sweeps: int
    friction: wp.float64
    compliance_mm3_per_n: wp.float64
    force_n: Doubles
    along: Doubles2  # force along x and y that the law makes of it, moment, N·mm
    is_sheared: Ints
    sheet: Doubles4
    held: Doubles4
    sheet_before: Doubles4  # (B, …), as are those that follow
    held_before: Doubles4
    pressure: Doubles3
    limit: Doubles3
    sticks: Ints3
    seen: wp.array(dtype=wp.vec2d)
    center_mm: wp.array(dtype=wp.vec2d)


@native("""
    // Volume under the cells of a row of the lattice, in pixels × mm.
    const int columns = g.x_mm.shape[0], n = g.pixels;
    const auto& patch = wp::index(p.patches, w);
    const int top = wp::max(r * n - g.before_rows, patch[0]);
    const int bottom = wp::min((r + 1) * n - g.before_rows, patch[1]);
    for (int c = lane; c < columns; c += p.lanes) {
        const int left = wp::max(c * n - g.before_columns, patch[2]);
        const int right = wp::min((c + 1) * n - g.before_columns, patch[3]);
        double sum = 0.0;
        for (int y = top; y < bottom; y++)
            for (int x = left; x < right; x++) sum += wp::index(p.depth_mm, p.start + w, y, x);
        wp::index(g.pressure, w, r, c) = sum;
    }
""")
def _press(p: Worlds, g: Gels, w: int, r: int, lane: int): ...


@wp.kernel
def press(p: Worlds, g: Gels):
    """How the indentation weighs on each cell; and the frame before, from which the gel goes on."""
    w, r, lane = wp.tid()
    _press(p, g, w, r, lane)
    world = p.start + w
    for c in range(1 + lane, g.x_mm.shape[0] + 1, p.lanes):
        for axis in range(2):
            if g.is_sheared[world] == 0:
                g.sheet[world, r + 1, c, axis] = ZERO
                g.held[world, r + 1, c, axis] = ZERO
            g.sheet_before[w, r + 1, c, axis] = g.sheet[world, r + 1, c, axis]
            g.held_before[w, r + 1, c, axis] = g.held[world, r + 1, c, axis]
            g.held[world, r + 1, c, axis] = ZERO


@native("""
    const int rows = g.y_mm.shape[0], columns = g.x_mm.shape[0], wide = columns + 2;
    const double skin = g.skin, alpha = g.alpha, beta = g.beta, over = g.over;
    const double* stiff = &wp::index(g.stiff, 0, 0, 0);
    const double* squares = &wp::index(g.squares, 0, 0);
    const double* sheet_before = &wp::index(g.sheet_before, w, 0, 0, 0);
    const double* held_before = &wp::index(g.held_before, w, 0, 0, 0);
    const double* limit = &wp::index(g.limit, w, 0, 0);
    double* sheet = &wp::index(g.sheet, world, 0, 0, 0);
    double* held = &wp::index(g.held, world, 0, 0, 0);
    int* sticks = &wp::index(g.sticks, w, 0, 0);
    double slide[3] = {0.0, 0.0, 0.0};
    double sums[13];  // Σ t, Σ r × t, twice Σ k, k x, k y, k r²; largest change, and motion
    auto add = [&](int first, double k, double x, double y) {
        sums[first] += k, sums[first + 1] += k * x;
        sums[first + 2] += k * y, sums[first + 3] += k * (x * x + y * y);
    };
    auto relax = [&](int r, int c) {  // one point: see contact.shear_field._sweep
        const int i = r * wide + c;
        const double *o = sheet + 2 * i, *a = o - 2 * wide, *b = o + 2 * wide;
        const double ex = 1.0 / stiff[2 * i], ey = 1.0 / stiff[2 * i + 1];
        double al = squares[i], ar = squares[i + 1];
        double bl = squares[i + wide], br = squares[i + wide + 1];
        const double own = beta * (al + ar + bl + br);
        al *= a[0] - a[-2] + o[0] - o[-2] + o[-1] - a[-1] + o[1] - a[1];
        ar *= a[2] - a[0] + o[2] - o[0] + o[1] - a[1] + o[3] - a[3];
        bl *= o[0] - o[-2] + b[0] - b[-2] + b[-1] - o[-1] + b[1] - o[1];
        br *= o[2] - o[0] + b[2] - b[0] + b[1] - o[1] + b[3] - o[3];
        double wx = own * o[0] + alpha * (a[0] + b[0] + o[-2] + o[2]) - beta * (al - ar + bl - br);
        double wy = own * o[1] + alpha * (a[1] + b[1] + o[-1] + o[3]) - beta * (al + ar - bl - br);
        wx *= ex, wy *= ey;
        if (limit[i] >= 0.0) {
            const double x = wp::index(g.x_mm, c - 1) - center[0];
            const double y = wp::index(g.y_mm, r - 1) - center[1];
            double alone = 1.0 / (skin + (1.0 - skin) * wp::max(ex, ey)), along = alone;
            const double ahead_x = slide[0] - slide[2] * y + sheet_before[2 * i] - wx;
            const double ahead_y = slide[1] + slide[2] * x + sheet_before[2 * i + 1] - wy;
            double tx = (skin * held_before[2 * i] + ahead_x) / (skin + (1.0 - skin) * ex);
            double ty = (skin * held_before[2 * i + 1] + ahead_y) / (skin + (1.0 - skin) * ey);
            const double size = sqrt(tx * tx + ty * ty);
            sticks[i] = size <= limit[i];
            if (sticks[i]) {
                const int aside = sticks[i - 1] + sticks[i + 1];
                const double near = 0.25 * (sticks[i - wide] + sticks[i + wide] + aside);
                along = 1.0 + (stiff[2 * i] - 1.0) * (1.0 - near);
            } else {
                const double share = limit[i] / size;
                tx *= share, ty *= share, alone *= share, along *= share;
            }
            held[2 * i] = tx, held[2 * i + 1] = ty;
            wx += (1.0 - skin) * tx * ex, wy += (1.0 - skin) * ty * ey;
            sums[0] += tx, sums[1] += ty, sums[2] += x * ty - y * tx;
            add(3, alone, x, y);
            add(7, along, x, y);
        }
        wx = over * (wx - sheet[2 * i]), wy = over * (wy - sheet[2 * i + 1]);
        sheet[2 * i] += wx, sheet[2 * i + 1] += wy;
        sums[11] = wp::max(sums[11], wp::max(fabs(wx), fabs(wy)));
        sums[12] = wp::max(sums[12], wp::max(fabs(sheet[2 * i]), fabs(sheet[2 * i + 1])));
    };
    auto size_of = [&](const double* l) {
        return sqrt(l[0] * l[0] + l[1] * l[1] + (l[2] / arm_mm) * (l[2] / arm_mm));
    };
    const double wanted[3] = {load[0], load[1], load[2]};
    const double enough = g.tolerance * size_of(wanted);
    TACGEN_SYNC;
    for (int sweep = 0; sweep < g.most_sweeps; sweep++) {
        for (int k = 0; k < 13; k++) sums[k] = 0.0;
        for (int wave = 0; wave < columns + 2 * (rows - 1); wave++) {
            for (int r = lane; r < rows; r += lanes)
                if (wave >= 2 * r && wave < 2 * r + columns) relax(r + 1, wave - 2 * r + 1);
            TACGEN_SYNC;
        }
    #if defined(__CUDA_ARCH__)
        __shared__ double parts[13][64], totals[13];
        for (int k = 0; k < 13; k++) parts[k][lane] = sums[k];
        TACGEN_SYNC;
        if (lane < 13) {
            double sum = 0.0;
            for (int l = 0; l < lanes; l++)
                sum = lane < 11 ? sum + parts[lane][l] : wp::max(sum, parts[lane][l]);
            totals[lane] = sum;
        }
        TACGEN_SYNC;
        for (int k = 0; k < 13; k++) sums[k] = totals[k];
    #endif
        const double off[3] = {load[0] - sums[0], load[1] - sums[1], load[2] - sums[2]};
        if (size_of(off) <= enough && sums[11] <= g.tolerance * sums[12]) break;
        // What force and moment lack moves the object, in turn by itself and with what sticks.
        const double* k = sums + (sweep % 2 ? 3 : 7);
        const double mx = k[1] / k[0], my = k[2] / k[0];
        const double spin = k[3] - k[0] * (mx * mx + my * my);
        const double turn = (off[2] - (mx * off[1] - my * off[0]))
            / wp::max(spin, 0.05 * arm_mm * arm_mm * k[0]);
        const double along_x = off[0] / k[0] + turn * my, along_y = off[1] / k[0] - turn * mx;
        slide[0] += along_x, slide[1] += along_y, slide[2] += turn;
        for (int r = 1 + lane; r <= rows && sweep % 2 == 0; r += lanes)
            for (int c = 1; c <= columns; c++)
                if (sticks[r * wide + c]) {
                    sheet[2 * (r * wide + c)] +=
                        along_x - turn * (wp::index(g.y_mm, r - 1) - center[1]);
                    sheet[2 * (r * wide + c) + 1] +=
                        along_y + turn * (wp::index(g.x_mm, c - 1) - center[0]);
                }
        TACGEN_SYNC;
    }
    TACGEN_SYNC;
    for (int r = 1 + lane; r <= rows; r += lanes)
        for (int i = 2 * (r * wide + 1); i < 2 * (r * wide + columns + 1); i++) {
            sheet[i] = rint(sheet[i] / grain) * grain;
            held[i] = rint(held[i] / grain) * grain;
        }
""")
def _solve(
    g: Gels, load: wp.vec3d, center: wp.vec2d, arm_mm: wp.float64, grain: wp.float64, world: int,
    w: int, lane: int, lanes: int,
): ...  # fmt: skip


@wp.kernel
def shear(p: Worlds, g: Gels, lanes: int):
    """The shear of each gel after one more frame: see ``contact.shear_field.ShearField.step``."""
    w, lane = wp.tid()
    world = p.start + w
    rows, columns = g.y_mm.shape[0], g.x_mm.shape[0]
    total, center = wp.float64(0.0), wp.vec2d(ZERO, ZERO)
    for r in range(rows):
        for c in range(columns):
            total += g.pressure[w, r, c]
            center += g.pressure[w, r, c] * wp.vec2d(g.x_mm[c], g.y_mm[r])
    before = g.is_sheared[world] != 0
    asked = wp.vec3d(g.along[world, 0], g.along[world, 1], g.along[world, 2])
    pulled = asked[0] != ZERO or asked[1] != ZERO or asked[2] != ZERO
    is_sheared = total > ZERO and (before or pulled)
    if is_sheared:
        center = center / total
        shown_mm3 = total * g.pixel_mm2
        share = shown_mm3 / (shown_mm3 + p.beside_mm3[world])
        normal_n = g.force_n[world]
        per_cell = g.cell_mm * g.cell_mm
        to_pressure = share * wp.max(normal_n, wp.float64(1e-9)) / (total * per_cell)
        friction = wp.float64(g.friction)
        if normal_n <= ZERO:
            friction = wp.float64(wp.inf)
        arm, seen = wp.float64(0.0), wp.vec2d(ZERO, ZERO)
        for r in range(rows):
            for c in range(columns):
                part = g.pressure[w, r, c] / total
                x, y = g.x_mm[c] - center[0], g.y_mm[r] - center[1]
                arm += part * wp.sqrt(x * x + y * y)
                seen += part * wp.vec2d(g.shown[r, c, 0], g.shown[r, c, 1])
        for r in range(lane, rows, lanes):
            for c in range(columns):
                touches = g.pressure[w, r, c] > ZERO
                g.limit[w, r + 1, c + 1] = wp.float64(-1.0)
                g.sticks[w, r + 1, c + 1] = int(touches)
                if touches:
                    g.limit[w, r + 1, c + 1] = friction * to_pressure * g.pressure[w, r, c]
        load = asked * (share / per_cell)
        # Howe & Cutkosky 1996: the limit surface as an ellipsoid.
        most = wp.max(friction * to_pressure * total, TINY)
        across = load[2] / wp.max(friction * to_pressure * total * arm, TINY)
        along = wp.sqrt(load[0] * load[0] + load[1] * load[1]) / most
        demand = wp.sqrt(along * along + across * across)
        load = load * wp.min(wp.float64(1.0), SLIP / wp.max(demand, TINY))
        _solve(g, load, center, wp.max(arm, g.cell_mm), GRAIN_N_MM2, world, w, lane, lanes)
        if lane == 0:
            g.center_mm[w] = center
            g.seen[w] = wp.max(seen, wp.vec2d(LEAST, LEAST))
    if lane == 0:
        g.is_sheared[world] = int(is_sheared)


@wp.func
def moved(g: Gels, world: int, w: int, r: int, c: int):
    """How far a point of the lattice has moved along the gel, mm."""
    out = wp.vec2d(ZERO, ZERO)
    for axis in range(2):
        u = g.sheet[world, r + 1, c + 1, axis] + g.skin * g.held[world, r + 1, c + 1, axis]
        out[axis] = g.compliance_mm3_per_n * u / g.seen[w][axis]
    return out


@wp.kernel
def carry(p: Worlds, g: Gels, poses: Doubles3):
    """Moves each object with the gel under it: see ``sensor.gel_shear.GelShear.object_motion``."""
    w = wp.tid()
    world = p.start + w
    if g.is_sheared[world] == 0:
        return
    center, shift = g.center_mm[w], wp.vec2d(ZERO, ZERO)
    total, turned, second = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
    for r in range(g.y_mm.shape[0]):
        for c in range(g.x_mm.shape[0]):
            weight = g.pressure[w, r, c]
            if weight > ZERO:
                at = wp.vec2d(g.x_mm[c], g.y_mm[r]) - center
                u = moved(g, world, w, r, c)
                total += weight
                shift += weight * u
                turned += weight * (at[0] * u[1] - at[1] * u[0])
                second += weight * wp.dot(at, at)
    shift = shift / total
    angle = turned / wp.max(second, TINY * total)
    cos, sin = wp.cos(angle), wp.sin(angle)
    for k in range(4):
        x, y = wp.float64(poses[world, 0, k]), wp.float64(poses[world, 1, k])
        if k == 3:
            x, y = x - center[0], y - center[1]
        poses[world, 0, k] = cos * x - sin * y
        poses[world, 1, k] = sin * x + cos * y
    poses[world, 0, 3] = poses[world, 0, 3] + center[0] + shift[0]
    poses[world, 1, 3] = poses[world, 1, 3] + center[1] + shift[1]


@wp.kernel
def carry_markers(p: Worlds, g: Gels, sheared_mm: Map3):
    """How far shear has moved each marker: bilinear between points; beyond them the border's."""
    w, m = wp.tid()
    world = p.start + w
    out = wp.vec2d(ZERO, ZERO)
    if g.is_sheared[world] != 0:
        last_row, last_column = g.y_mm.shape[0] - 1, g.x_mm.shape[0] - 1
        x = (wp.float64(p.markers_at_rest_mm[m, 0]) - g.x_mm[0]) / g.cell_mm
        y = (wp.float64(p.markers_at_rest_mm[m, 1]) - g.y_mm[0]) / g.cell_mm
        x = wp.clamp(x, ZERO, wp.float64(last_column))
        y = wp.clamp(y, ZERO, wp.float64(last_row))
        c, r = wp.min(int(x), wp.max(last_column - 1, 0)), wp.min(int(y), wp.max(last_row - 1, 0))
        right, down = wp.min(c + 1, last_column), wp.min(r + 1, last_row)
        fx, fy = x - wp.float64(c), y - wp.float64(r)
        one = wp.float64(1.0)
        upper = (one - fx) * moved(g, world, w, r, c) + fx * moved(g, world, w, r, right)
        lower = (one - fx) * moved(g, world, w, down, c) + fx * moved(g, world, w, down, right)
        out = (one - fy) * upper + fy * lower
    sheared_mm[world, m, 0] = wp.float32(out[0])
    sheared_mm[world, m, 1] = wp.float32(out[1])
