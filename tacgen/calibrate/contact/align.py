"""One road from what a log holds to force and volume that count from the same zero.

Depths become volumes of their ball, whose radius is fitted where nobody stated it. A depth that is
counted from a few hundredths of a millimetre too early or too late bends V against F, so that the
depth's and the gauge's zero are fitted, press by press, but only where presses show that they begin
elsewhere than logged: a zero that is fitted in vain costs most of a compliance's certainty.
Elsewhere V = k_n F_n needs that what gauge and gel read at rest before a press is subtracted.

``limits_of`` is what a log lacks, and which press would tell.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from scipy.optimize import brentq, least_squares, minimize_scalar
from scipy.special import fdtrc

from tacgen.calibrate.contact.rules import ALIGN
from tacgen.calibrate.contact.slope_fit import neighbours
from tacgen.contact.effects import LoadHistory
from tacgen.contact.noise import sample_noise
from tacgen.core.errors import PressError
from tacgen.core.records import frozen_array
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.presses.geometry import ball_depth_mm, ball_volume_mm3
from tacgen.presses.press_log import SHEAR, PressLog


@dataclass(frozen=True, slots=True)
class ContactPoint:
    """Shifts of one trial: depth = logged depth + ``depth_mm``, force = logged − ``force_n``.

    ``k_stderr_share`` is the relative standard error of a compliance fitted together with them.
    """

    trial: int
    depth_mm: float
    force_n: float
    k_stderr_share: float = 0.0


def align(
    log: PressLog, *, free_contact_point: bool | None = None
) -> tuple[PressLog, tuple[ContactPoint, ...]]:
    """The log with a volume for every sample, and the contact points that were fitted, if any.

    With ``free_contact_point`` those of all presses are, by default those of presses whose volume
    is that of a known ball at its depth, where they show that they begin elsewhere than logged.
    Raises ``PressError`` where a ball's radius is neither stated nor to be found.
    """
    if "volume_mm3" not in log:
        log = _with_fitted_balls(log)
    of_depth = [int(trial) for trial in log.trials if _is_of_depth(log, log["trial"] == trial)]
    if free_contact_point is not None:
        return free_contact_points(log, log.trials.tolist()) if free_contact_point else (log, ())
    shift = shift_beside_effects(log, of_depth)
    if shift and shift[0] != 0.0:
        return _shifted(log, np.isin(log["trial"], of_depth), *shift), ()
    if shift is None and begins_elsewhere(log, of_depth):
        note = "presses begin elsewhere than depth_mm says: the contact point of each is fitted"
        log = replace(log, warnings=(*log.warnings, f"{log.path}: {note}"))
        return free_contact_points(log, of_depth)
    return log, ()


def _is_of_depth(log: PressLog, rows: BoolArray) -> bool:
    """Whether a press's volume is that of its ball at its depth, rather than measured."""
    if "depth_mm" not in log or "radius_mm" not in log:
        return False
    depth, radius, volume = (log[n][rows] for n in ("depth_mm", "radius_mm", "volume_mm3"))
    known = np.isfinite(depth).all() and np.isfinite(radius).all() and (radius > 0).all()
    cap = ball_volume_mm3(depth, radius)
    is_held = np.ptp(depth) <= ALIGN.held_share * np.abs(depth).max()  # shows no contact point
    return bool(known and not is_held and np.abs(volume - cap).max() <= 1e-3 * cap.max())


def _shifted(log: PressLog, rows: BoolArray, shift_mm: float, stderr_mm: float) -> PressLog:
    """The log with the volumes of ``rows`` at depths that one shift makes larger."""
    note = f"{log.path}: depth_mm is {-shift_mm:.3f} mm at first contact: that is subtracted"
    radius, depth = log["radius_mm"], log["depth_mm"] + shift_mm
    volume = np.where(rows, ball_volume_mm3(depth, radius), log["volume_mm3"])
    loaded = volume[rows]
    per_mm = float(loaded @ _area_mm2(depth, radius)[rows]) / max(float(loaded @ loaded), 1e-300)
    share = math.hypot(log.volume_stderr_share, stderr_mm * per_mm)
    log = replace(log, warnings=(*log.warnings, note), volume_stderr_share=share)
    return _with_columns(log, {"volume_mm3": volume})


def shift_beside_effects(log: PressLog, trials: Sequence[int]) -> tuple[float, float] | None:
    """The shift of all depths where the gel shows effects, and its error, mm; 0 if not certain.

    Volume = k F + creep and the way back, with the k of each press and one shift of all depths, by
    instruments as in ``_fit_press``; a depth's noise is the same at all depths, so that rows are
    weighted by 1 / area. Stiffening looks like a shift: beside it, only a depth that presses begin
    with before they have a force shows one. None where presses show no effect, or are too few to
    show any.
    """
    if len(trials) < ALIGN.few_trials:
        return None
    log = without_zero(log.select(np.isin(log["trial"], trials)))
    trial, depth, radius = (log[name] for name in ("trial", "depth_mm", "radius_mm"))
    numbers = np.unique(trial, return_inverse=True)[1]
    own_press = numbers[:, None] == np.arange(len(trials))
    history = LoadHistory({name: log[name] for name in ("trial", "time_s", "force_normal_n")})
    load, span_n = history.load("normal"), history.normal_span_n
    relative = np.maximum(load / span_n, 0.0)
    taus_s = np.geomspace(
        4.0 * history.sample_period_s, 2.0 * history.trial_duration_s, ALIGN.n_taus
    )
    peak, _ = history.peak_load(load, "normal", span_n)
    memory = [history.low_pass(load, tau_s) for tau_s in taus_s]
    known = np.hstack([*memory, np.maximum(peak - load, 0.0), own_press * load])
    bends = np.hstack([relative**power for power in ALIGN.bends])

    def paired(columns: FloatArray) -> FloatArray:
        return np.hstack([neighbours(one[:, None], trial) for one in columns.T])

    pairs = np.hstack([paired(known[:, : -len(trials)]), own_press * paired(load)])
    deepest, middle = float(depth.max()), paired(depth[:, None])[:, 0]
    limit = ALIGN.most_step_share * deepest

    def fitted(parts: FloatArray) -> tuple[FloatArray, ...]:
        """Shifts (S,) of ``parts`` (N, S), and columns, instruments and volume as weighted."""
        shifts = np.zeros(parts.shape[1])
        for _ in range(ALIGN.instrument_steps):
            at = parts @ shifts
            inside = middle + at > 2.0 * ALIGN.in_contact_share * deepest
            weight = (inside / np.maximum(_area_mm2(middle + at, radius), 1e-9))[:, None]
            area = _area_mm2(depth + at, radius)[:, None]
            columns = np.hstack([-area * parts, known]) * weight
            instruments = np.hstack([-paired(area) * parts, pairs]) * weight
            volume = ball_volume_mm3(depth + at, radius) * weight[:, 0]
            found, _ = _by_instruments(columns, instruments, volume, numbers)
            shifts = shifts + np.clip(found[: len(shifts)], -limit, limit)
        return shifts, columns, instruments, volume, weight

    # Each press may begin elsewhere without any effect.
    own, columns, instruments, volume, weight = fitted(own_press.astype(np.float64))
    found, spread = _by_instruments(columns, instruments, volume, numbers)
    effects = slice(len(trials), len(trials) + ALIGN.n_taus + 1)
    is_effect = _p_of_none(found[effects], spread[effects, effects], len(trials)) < ALIGN.effect_p
    bent, bent_spread = _by_instruments(
        np.hstack([bends * weight, columns]),
        np.hstack([paired(bends) * weight, instruments]),
        volume,
        numbers,
    )
    # Stiffening shifts all presses alike; those that scatter about 0 begin elsewhere by themselves.
    is_alike = float(np.std(own)) < abs(float(np.mean(own)))
    is_bent = is_alike and _p_of_none(bent[:2], bent_spread[:2, :2], len(trials)) < ALIGN.bent_p
    if not (is_effect or is_bent):
        return None
    shifts, columns, instruments, volume, weight = fitted(np.ones((len(depth), 1)))
    found, spread = _by_instruments(columns, instruments, volume, numbers)
    left, is_next = volume - columns @ found, (np.diff(numbers) == 0) & (weight[1:, 0] > 0)
    is_next &= weight[:-1, 0] > 0
    jumps = 0.5 * float((np.diff(left)[is_next] ** 2).sum())
    if is_bent or float((left[1:][is_next] ** 2).sum()) > ALIGN.misfit**2 * jumps:
        begin = np.flatnonzero(np.diff(numbers, prepend=-1))
        unloaded = depth[begin[load[begin, 0] < ALIGN.unloaded_share * span_n]]
        zero = float(np.median(unloaded)) if len(unloaded) >= ALIGN.least_trials else 0.0
        error = ALIGN.median_stderr * float(np.std(unloaded)) / math.sqrt(max(len(unloaded), 1))
        return (-zero, error) if zero > ALIGN.clear_sigmas * error else (0.0, error)
    shift, error = float(shifts[0]), math.sqrt(spread[0, 0])
    return (shift, error) if abs(shift) > ALIGN.shifted_sigmas * error else (0.0, error)


def _by_instruments(
    columns: FloatArray, instruments: FloatArray, response: FloatArray, numbers: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Coefficients (C,) of ``columns`` (N, C), and their covariance by the scatter of presses."""
    inverse = np.linalg.pinv(instruments.T @ columns, rcond=1e-13)
    found = inverse @ (instruments.T @ response)
    scores = np.zeros((int(numbers.max()) + 1, columns.shape[1]))
    np.add.at(scores, numbers, instruments * (response - columns @ found)[:, None])
    influence = scores @ inverse.T
    return found, influence.T @ influence * len(scores) / (len(scores) - 1)


def _p_of_none(found: FloatArray, spread: FloatArray, presses: int) -> float:
    """Hotelling's p that none of the coefficients (C,) with covariance ``spread`` is other than 0.

    Source: Hotelling 1931, The generalization of Student's ratio, Ann. Math. Stat. 2.
    """
    count, statistic = len(found), float(found @ np.linalg.pinv(spread) @ found)
    rest = presses - count
    return float(fdtrc(count, rest, statistic * rest / (count * (presses - 1))))


def begins_elsewhere(log: PressLog, trials: Sequence[int]) -> bool:
    """Whether presses of known balls begin at another depth than logged.

    An F-test over all presses. The shifts also have to be small beside the depth: else they stand
    for an effect of the gel.
    """
    squares, shares, dof = list[float](), list[float](), 0
    for trial in trials:
        rows = log["trial"] == trial
        depth, radius, force = (log[n][rows] for n in ("depth_mm", "radius_mm", "force_normal_n"))
        if (depth > 0).sum() >= ALIGN.min_contact_samples:
            point, stderr_mm = _fit_press(int(trial), depth, radius, force)
            squares.append((point.depth_mm / stderr_mm) ** 2)
            shares.append(point.depth_mm / float(depth.max()))
            dof += int((depth > 0).sum()) - 4
    if not squares:
        return False
    statistic = float(np.mean(squares))
    is_shifted = fdtrc(len(squares), dof, statistic) < ALIGN.begins_elsewhere_p
    is_effect = abs(float(np.median(shares))) > ALIGN.most_shift_share
    return bool(is_shifted and not is_effect)


def free_contact_points(
    log: PressLog, trials: Sequence[int]
) -> tuple[PressLog, tuple[ContactPoint, ...]]:
    """The log with the contact point of each of ``trials`` found, and the shifts.

    Where the ball is known (``radius_mm``) its depth (``depth_mm``, or the volume's) is shifted
    and the volume recomputed; elsewhere only the force is.
    """
    volume, force = log["volume_mm3"].copy(), log["force_normal_n"].copy()
    points = []
    for trial in trials:
        rows = np.flatnonzero(log["trial"] == trial)
        radius = log["radius_mm"][rows] if "radius_mm" in log else np.array([np.nan])
        if np.isfinite(radius).all() and (radius > 0).all():
            depth = log["depth_mm"][rows] if "depth_mm" in log else None
            if depth is None or not np.isfinite(depth).all():
                depth = ball_depth_mm(volume[rows], radius)
            point, volume[rows] = _shift_depth(int(trial), depth, radius, force[rows])
        else:
            point = _shift_force(int(trial), volume[rows], force[rows])
        force[rows] -= point.force_n
        points.append(point)
    return _with_columns(log, {"volume_mm3": volume, "force_normal_n": force}), tuple(points)


def _with_columns(log: PressLog, changed: dict[str, FloatArray]) -> PressLog:
    frozen = {name: frozen_array(values) for name, values in changed.items()}
    return replace(log, columns=MappingProxyType({**log.columns, **frozen}))


def _with_fitted_balls(log: PressLog) -> PressLog:
    """Depths of balls of unknown radius with the radius that explains them best as V = k_n F.

    One for each value of ``indenter``, else ``curve``, else for all. What the fit leaves open of
    the volumes' scale is ``volume_stderr_share``.
    """
    by = next((name for name in ("indenter", "curve") if name in log), "trial")
    names = log[by] if by != "trial" else np.zeros(len(log))
    radius, shares, texts = np.full(len(log), np.nan), [], []
    for name in np.unique(names):
        rows = names == name
        radius[rows], interval, share = _fit_radius(log.select(rows))
        shares.append(share)
        low, high = (f"{end:.3g} mm" for end in interval)
        high = "no upper bound" if interval[1] >= 0.99 * ALIGN.radii_mm[1] else high
        of = f" of {by} {name}" if by != "trial" else ""
        texts.append(f"{radius[rows][0]:.3g} mm{of} (95 %: {low} to {high})")
    if radius.min() >= 0.99 * ALIGN.radii_mm[1]:
        msg = (
            f"{log.path}: the larger the ball, the better it explains these curves, and k_n grows "
            "with it; give the ball's radius with --radius-mm"
        )
        raise PressError(msg)
    note = (
        f"{log.path}: depths and no volumes: the volume is that of a ball whose radius was fitted "
        f"so that V = k_n F holds as well as it can, {', '.join(texts)}: give --radius-mm or log "
        "volume_mm3 before you believe in k_n or in stiffening"
    )
    volume = ball_volume_mm3(log["depth_mm"], radius)
    log = replace(log, warnings=(*log.warnings, note), volume_stderr_share=max(shares))
    return _with_columns(log, {"radius_mm": radius, "volume_mm3": volume})


def _fit_radius(log: PressLog) -> tuple[float, tuple[float, float], float]:
    """The radius that explains presses best, its 95 % interval, the relative error of k_n by it.

    The interval is that of the profile of the misfit, k_n and contact point of each press refitted,
    with as many samples as the residuals are independent of each other.
    Raises ``PressError`` where no press has enough samples in contact.
    """
    curves = []
    for trial in log.trials:
        rows = log["trial"] == trial
        depth, force = log["depth_mm"][rows], log["force_normal_n"][rows]
        if (depth > 0).sum() >= ALIGN.min_curve_samples:
            curves.append((depth, force))
    if not curves:
        msg = (
            f"{log.path}: row {log.rows.min()}: no press has {ALIGN.min_curve_samples} samples in "
            "contact, which the radius of an unknown ball needs; give --radius-mm"
        )
        raise PressError(msg)

    def fits(radius: float) -> list[tuple[FloatArray, float, float]]:
        return [_fit_curve(*curve, radius) for curve in curves]

    def squares(radius: float) -> float:
        return sum(float(left @ left) for left, *_ in fits(radius))

    radii = np.geomspace(*ALIGN.radii_mm, ALIGN.n_radii)
    costs = np.array([squares(radius) for radius in radii])
    near = radii[np.clip(int(np.argmin(costs)) + np.array([-1, 1]), 0, ALIGN.n_radii - 1)]
    best = minimize_scalar(squares, bounds=tuple(near), method="bounded", options={"xatol": 1e-3})
    found = fits(float(best.x))
    residuals = [left for left, *_ in found]
    count = sum(map(len, residuals)) / _rows_of_a_residual(residuals)
    freedom = max(count, ALIGN.min_curve_samples) - 1 - 3 * len(curves)
    limit = best.fun * (1.0 + 3.841 / max(freedom, 1.0))
    inside = np.append(radii[costs <= limit], best.x)
    low, high = float(inside.min()), float(inside.max())
    # The profile crosses the limit between the outermost radius inside and the next of the grid.
    if low > radii[0]:
        low = brentq(lambda r: squares(r) - limit, radii[radii < low][-1], low, rtol=1e-3)
    if high < radii[-1]:
        high = brentq(lambda r: squares(r) - limit, high, radii[radii > high][0], rtol=1e-3)
    logs = [np.log(np.median([k_n for _, k_n, _ in fits(end)])) for end in (low, high)]
    return float(best.x), (low, high), float(np.ptp(logs)) / (2 * 1.96)


def _fit_curve(
    depth_mm: FloatArray, force_n: FloatArray, radius_mm: FloatArray | float
) -> tuple[FloatArray, float, float]:
    """Residual (N,) of F = F₀ + V(d + d₀)/k of one press, its k, mm³/N, and its d₀, mm."""
    deepest = float(depth_mm.max())
    low, high = -0.5 * deepest, 0.2 * deepest
    shifts = np.linspace(low, high, ALIGN.n_starts)
    force = force_n - force_n.mean()
    for _ in range(4):
        volumes = ball_volume_mm3(depth_mm + shifts[:, None], radius_mm)
        volumes -= volumes.mean(axis=1, keepdims=True)
        stiffness = (volumes @ force) / np.maximum((volumes**2).sum(axis=1), 1e-300)
        left = force - stiffness[:, None] * volumes
        at = int(np.argmin((left**2).sum(axis=1)))
        found = left[at], 1.0 / max(float(stiffness[at]), 1e-300), float(shifts[at])
        step = shifts[1] - shifts[0]
        shifts = np.linspace(
            max(low, shifts[at] - step), min(high, shifts[at] + step), ALIGN.n_starts
        )
    return found


def _shift_depth(
    trial: int, depth_mm: FloatArray, radius_mm: FloatArray, force_n: FloatArray
) -> tuple[ContactPoint, FloatArray]:
    touching = depth_mm > 0
    if touching.sum() < ALIGN.min_contact_samples:
        zero_n = float(np.median(force_n[~touching])) if (~touching).any() else 0.0
        return ContactPoint(trial, 0.0, zero_n), ball_volume_mm3(depth_mm, radius_mm)
    point, _ = _fit_press(trial, depth_mm, radius_mm, force_n)
    return point, np.where(touching, ball_volume_mm3(depth_mm + point.depth_mm, radius_mm), 0.0)


def _fit_press(
    trial: int, depth_mm: FloatArray, radius_mm: FloatArray, force_n: FloatArray
) -> tuple[ContactPoint, float]:
    """Fit F = F₀ + V(d + d₀)/k, less a loss on the way back, to a press; and the error of d₀, mm.

    From where ``_fit_curve`` finds it. As noise of the depth would pull d₀, the steps pair each
    sample with the mean of its neighbours, whose noise is not its own; the errors (HC0) hold for
    noise that grows with the depth, and are as many times wider as residuals go on for rows.
    """
    touching = depth_mm > 0
    before = np.flatnonzero(~touching)
    rest_n = float(np.median(force_n[before])) if len(before) else 0.0
    deepest = float(depth_mm.max())
    load = force_n - rest_n
    # The median of the rows before contact knows the zero as well as so many rows.
    known_rows = len(before) / ALIGN.median_stderr**2
    _, compliance, shift = _fit_curve(depth_mm, force_n, radius_mm)
    at = np.array([shift, 1.0 / compliance, 0.0, 0.0])
    number = np.zeros(len(load), dtype=np.int64)
    inside = neighbours(depth_mm[:, None], number)[:, 0] > ALIGN.in_contact_share * deepest
    inside &= touching
    ones = np.ones(len(load))
    for _ in range(ALIGN.instrument_steps):
        volume = ball_volume_mm3(depth_mm + at[0], radius_mm)
        # Beside a loss of force on the way back, which would pull the shift.
        loss = np.maximum.accumulate(volume) - volume
        left = (load - at[1] * volume - at[2] + at[3] * loss)[inside]
        area = at[1] * _area_mm2(depth_mm + at[0], radius_mm)
        columns = np.stack([area, volume, ones, -loss], axis=1)
        paired = np.hstack([neighbours(one[:, None], number) for one in columns.T])[inside]
        matrix, score = paired.T @ columns[inside], paired.T @ left
        matrix[2, 2] += known_rows
        score[2] -= known_rows * at[2]
        inverse = np.linalg.pinv(matrix)
        change = inverse @ score
        at = at + change * min(
            1.0, ALIGN.most_step_share * deepest / max(abs(float(change[0])), 1e-300)
        )
    spread = (paired * left[:, None] ** 2).T @ paired
    spread[2, 2] += known_rows * float((left**2).mean())
    rows = _rows_of_a_residual([left]) * len(left) / max(len(left) - 4, 1)
    errors = np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse.T) * rows, 0.0))
    point = ContactPoint(trial, float(at[0]), rest_n + float(at[2]), float(errors[1] / at[1]))
    return point, max(float(errors[0]), ALIGN.least_shift_share * deepest)


def _rows_of_a_residual(residuals: Sequence[FloatArray]) -> float:
    """For how many rows residuals go on in each press, by their correlation from row to row."""
    power = sum(float(left @ left) for left in residuals)
    shared = sum(float(left[1:] @ left[:-1]) for left in residuals) / max(power, 1e-300)
    shared = min(max(shared, 0.0), 0.99)
    return (1.0 + shared) / (1.0 - shared)


def _area_mm2(depth_mm: FloatArray, radius_mm: FloatArray) -> FloatArray:
    """Area of the ball at the gel's surface at rest: dV/dd."""
    cap = np.clip(depth_mm, 0.0, radius_mm)
    return np.asarray(np.pi * cap * (2.0 * radius_mm - cap))


def _shift_force(trial: int, volume_mm3: FloatArray, force_n: FloatArray) -> ContactPoint:
    """Fit F = F₀ + V/k, robust to tails: only the force's zero can move."""
    scale = np.abs(volume_mm3).max() or 1.0, np.abs(force_n).max() or 1.0
    volume, force = volume_mm3 / scale[0], force_n / scale[1]

    def misfit(parameters: FloatArray) -> FloatArray:
        return np.asarray(force - parameters[0] - parameters[1] * volume)

    zero, _ = least_squares(misfit, [0.0, 1.0], loss="soft_l1", f_scale=ALIGN.tail_share).x
    return ContactPoint(trial, 0.0, float(zero * scale[1]))


def without_zero(log: PressLog) -> PressLog:
    """``log`` less what each measured column reads at rest, with warnings that say so.

    Where zeros differ from trial to trial, each trial's own is subtracted. Nothing changes where
    too few presses begin at rest, or all is 0 there.
    """
    trial = log["trial"]
    first = np.flatnonzero(np.diff(trial)) + 1
    bounds: IntArray = np.concatenate([[0], first, [len(trial)]]).astype(np.int64)
    rests = _rows_at_rest(log, bounds)
    if sum(rows.size > 0 for rows in rests) < ALIGN.least_trials:
        return log
    columns, notes = dict(log.columns), list(log.warnings)
    for name in ("force_normal_n", "volume_mm3", *SHEAR):
        if name in log and (zeros := _zeros(log[name], rests)) is not None:
            columns[name] = frozen_array(log[name] - np.repeat(zeros, np.diff(bounds)))
            notes.append(f"{log.path}: {_sentence(name, zeros)}")
    return replace(log, columns=columns, warnings=tuple(notes))


def _rows_at_rest(log: PressLog, bounds: IntArray) -> list[IntArray]:
    """The first rows of each trial, for as long as neither force nor volume leaves its lowest."""
    measured = [log["force_normal_n"], log["volume_mm3"]]
    noise = [sample_noise(values[:, None], bounds) for values in measured]
    return [_rest(start, stop, measured, noise) for start, stop in pairwise(bounds)]


def _rest(
    start: int, stop: int, measured: Sequence[FloatArray], noise: Sequence[float]
) -> IntArray:
    count = stop - start
    for values, sigma in zip(measured, noise, strict=True):
        own = values[start:stop]
        level = float(np.median(own[: ALIGN.least_rows]))
        reach = ALIGN.reach_sigmas * sigma + 1e-9 * float(np.ptp(own))
        is_lowest = level - float(np.quantile(own, 0.05)) <= reach
        if not is_lowest or own.max() - level <= ALIGN.pressed_sigmas * sigma:
            return np.zeros(0, dtype=np.int64)
        away = np.flatnonzero(np.abs(own - level) > reach)
        count = min(count, int(away[0]) if away.size else count)
    half = count // 2
    for values, sigma in zip(measured, noise, strict=True):
        own = values[start : start + count]
        if (
            count < ALIGN.least_rows
            or abs(own[-half:].mean() - own[:half].mean()) > ALIGN.rise_sigmas * sigma
        ):
            return np.zeros(0, dtype=np.int64)
    return np.arange(start, start + count, dtype=np.int64)


def _zeros(values: FloatArray, rests: Sequence[IntArray]) -> FloatArray | None:
    """What a column (N,) reads at rest in each trial (T,), by its rows at rest; None where it is 0.

    The same in all trials unless it wanders clearly.
    """
    seen = np.array([float(values[rows].mean()) if rows.size else np.nan for rows in rests])
    known = np.flatnonzero(np.isfinite(seen))
    if known.size < ALIGN.least_trials:
        return None
    pooled = float(np.median(seen[known]))
    own_rows = [rests[int(k)] for k in known]
    scatter = [values[rows] - values[rows].mean() for rows in own_rows]
    counts = np.array([rows.size for rows in own_rows])
    freedom = max(int((counts - 1).sum()), 1)
    sample = float(np.sqrt((np.concatenate(scatter) ** 2).sum() / freedom))
    span = float(np.nanquantile(np.abs(values - pooled), 0.99))
    between = float(seen[known].std())
    by_noise = sample / np.sqrt(float(counts.mean()))
    wanders = between > max(ALIGN.apart_sigmas * by_noise, ALIGN.least_zero_share * span)
    error = max(between, by_noise) / np.sqrt(known.size)
    if not wanders and abs(pooled) <= max(
        ALIGN.clear_sigmas * error, ALIGN.least_zero_share * span
    ):
        return None
    return np.where(np.isfinite(seen) & wanders, seen, pooled)


def _sentence(name: str, zeros: FloatArray) -> str:
    unit = {"n": "N", "mm3": "mm³", "mm": "mm"}[name.rsplit("_", 1)[1]]
    low, high = float(zeros.min()), float(zeros.max())
    if low == high:
        return (
            f"{name} is {low:.3g} {unit} at rest, before the presses: that is subtracted; "
            "tare the gauge, or the volume of a bare gel, before you record"
        )
    return (
        f"{name} at rest differs from press to press, {low:.3g} to {high:.3g} {unit}: each "
        "press's own zero is subtracted"
    )


@dataclass(frozen=True, slots=True)
class Limit:
    """What a log cannot identify, and what to press next to identify it."""

    subject: str
    cannot_tell: str
    press_next: str

    def __str__(self) -> str:
        return f"{self.cannot_tell}; {self.press_next}"


def limits_of(log: PressLog) -> tuple[Limit, ...]:
    """What the schedule of this log leaves open, the most important first."""
    checks = {
        "geometry": (
            n_balls(log) > 1,
            "one ball only: whether k_n depends on the indenter's size or shape is unknown",
            "press a second ball of at least twice the radius",
        ),
        "shear": (
            log.has_shear,
            "no trial holds both shear force and marker motion: k_s is unknown",
            "push sideways while pressing and track the markers",
        ),
        "trials": (
            len(log.trials) >= ALIGN.few_trials,
            f"{len(log.trials)} presses only: the interval rests on few repeats and is wide",
            f"press at least {ALIGN.few_trials} times, and repeat a press now and then",
        ),
        "unloading": (
            any(_is_unloaded(log, trial) for trial in log.trials),
            "no press is unloaded: hysteresis and stiffening look the same",
            "log the way back as well",
        ),
        "hold": (
            any(_is_held(log, trial) for trial in log.trials),
            f"no press is held for {ALIGN.hold_s:g} s near its peak: creep is unknown",
            "hold some presses for several seconds",
        ),
        "position": (
            _has_places(log),
            "positions on the gel are not known or all alike: whether k_n depends on them is "
            "unknown",
            "press on a grid over the gel and log x_mm and y_mm",
        ),
    }
    return tuple(Limit(name, *texts) for name, (known, *texts) in checks.items() if not known)


def n_balls(log: PressLog) -> int:
    """How many different indenters pressed, by size where it is known, else by name."""
    radii = log["radius_mm"] if "radius_mm" in log else np.array([])
    known = np.unique(np.round(radii[np.isfinite(radii)], 6)) if len(radii) else radii
    names = np.unique(log["indenter"]) if "indenter" in log else np.array([])
    return max(len(known), len(names), 1)


def _is_unloaded(log: PressLog, trial: int) -> bool:
    rows = log["trial"] == trial
    if rows.sum() < 3:
        return False
    courses = log["force_normal_n"][rows], log["volume_mm3"][rows]
    return all(bool(one[np.argmax(one) :].min() < 0.5 * one.max()) for one in courses)


def _is_held(log: PressLog, trial: int) -> bool:
    rows = log["trial"] == trial
    courses, time_s = (log["force_normal_n"][rows], log["volume_mm3"][rows]), log["time_s"][rows]
    held = [one > 0.9 * one.max() for one in courses if one.max() > 0]
    return any(bool(np.ptp(time_s[one]) >= ALIGN.hold_s) for one in held)


def _has_places(log: PressLog) -> bool:
    known = [log[name] for name in ("x_mm", "y_mm") if name in log]
    spreads = [np.nanmax(mm) - np.nanmin(mm) for mm in known if np.isfinite(mm).any()]
    return bool(spreads and max(spreads) >= ALIGN.small_spread_mm)
