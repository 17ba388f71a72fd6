"""Force against depth: which ball, which k_n and which power of the force explain it.

A curve of force against depth holds no volume. A ball of radius R has one at each depth, and
V = k_n F (F / F_ref)^(p − 1) then has to hold. R is fitted where it is unknown, with p = 1: a ball
of another radius and another power look alike. Where R is known, p is fitted.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import chdtrc

from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.core.arrays import FloatArray
from tacgen.core.errors import PressError
from tacgen.core.records import Estimate
from tacgen.presses.geometry import ball_volume_mm3
from tacgen.presses.lab_table import LogTable
from tacgen.presses.press_log import MAX_DROPPED_SHARE, PressLog
from tacgen.report.page import templates

RADII_MM = (0.1, 100.0)  # indenters outside this range are no balls that a gel is pressed with
POWERS = (0.5, 3.0)  # of the force; measured gels lie between 1.1 and 1.4
MIN_SAMPLES = 8  # two for each of the four parameters of a curve
N_SHAPES = 121  # radii, or powers, of a curve's profile: 6 % apart, or 0.02
N_STARTS = 13  # contact points tried along a curve: its loss has several minima
SYSTEMATIC_CORRELATION = 0.5
"""Correlation of neighbouring residuals above which they are shape, not noise."""
MIN_SHARED_P = 0.05
"""p of Cochran's test below which one k_n for all curves is given up; the usual 5 %."""
MIN_AT_REST = 3  # rows before the contact that state the gauge's zero
LEAST_ZERO_SHARE = 0.005  # of the force's span: a zero below that is not worth a word
RISE_SHARE = 0.01  # of the largest force: up to there a curve has not risen
RISE_EXPECTED_SHARE = 0.03  # of it: a fit that expects more there puts the contact too early


@dataclass(frozen=True, slots=True)
class DepthCurve:
    """One curve: depth and force (N,), in the order of time; the ball's radius where known.

    ``zero_n`` is what the gauge read before the contact; it is subtracted already.
    """

    name: str
    depth_mm: FloatArray
    force_n: FloatArray
    radius_mm: float | None = None
    zero_n: float = 0.0


@dataclass(frozen=True, slots=True)
class BallFit:
    """The ball, compliance and power of the force that explain one curve best.

    Intervals (95 %) come from the profile of the misfit, at whose ends the other quantities are
    refitted, with as many samples as the residuals are independent of each other. One that ends at
    a bound of ``RADII_MM`` is open there: the curve cannot tell. ``k_n`` is V/F at the report's
    reference force. ``log_log_exponent`` is the slope of log F against log depth. Near 1,
    ``residual_correlation`` of neighbouring residuals says that the residual is not noise but
    shape. ``rmse_linear_n`` is the error with V = k_n F. ``early_n`` is the force that the fit
    expects where the measured one has not risen yet, ``rise_mm`` that depth.
    """

    radius_mm: float
    radius_interval_mm: tuple[float, float]
    k_n: float
    k_interval: tuple[float, float]
    power: float
    power_interval: tuple[float, float]
    contact_point_mm: float
    r_squared: float
    rmse_n: float
    rmse_linear_n: float
    log_log_exponent: float
    residual_correlation: float
    rise_mm: float
    early_n: float
    samples: int

    def force_n(self, depth_mm: FloatArray, reference_n: float) -> FloatArray:
        """What it expects at depths (N,); ``reference_n`` is the report's."""
        stiffness = (self.k_n * reference_n ** (1.0 - self.power)) ** (-1.0 / self.power)
        return _predict(depth_mm, self.radius_mm, self.power, stiffness, self.contact_point_mm)


@dataclass(frozen=True, slots=True)
class Pooled:
    """A quantity over all curves: its value, and the standard deviation of another curve's.

    ``p_value`` is of curves that differ by their own errors alone (Cochran's Q).

    Source: DerSimonian & Laird 1986, Meta-analysis in clinical trials.
    """

    value: float
    scatter: float
    p_value: float

    @classmethod
    def of(cls, values: Sequence[float], stderr: Sequence[float]) -> "Pooled":
        """The pooled value of values (N,) with standard errors (N,)."""
        value, weight = np.array(values), 1.0 / np.array(stderr) ** 2
        q = float((weight * (value - np.average(value, weights=weight)) ** 2).sum())
        free = len(value) - 1
        spare = weight.sum() - (weight**2).sum() / weight.sum()
        between = max(q - free, 0.0) / spare if free else 0.0
        weight = 1.0 / (1.0 / weight + between)
        scatter = math.sqrt(1.0 / weight.sum() + between)
        p_value = float(chdtrc(free, q)) if free else 1.0
        return cls(float(np.average(value, weights=weight)), scatter, p_value)


@dataclass(frozen=True, slots=True)
class DepthReport:
    """Every curve's best ball by name, and the law of all of them."""

    curves: dict[str, BallFit]
    shared_k_n: float  # mm³/N at ``reference_n``
    k_interval: tuple[float, float]  # 95 %, of another curve's k_n
    reference_n: float  # half of the largest force
    power: float  # of the force; 1 for V = k_n F
    power_scatter: float  # by which curves scatter
    one_k_n_will_do: bool
    p_value: float  # of curves that share one k_n


def holds_depths(table: LogTable) -> bool:
    """Whether a table holds depths and no volumes: force–depth curves, not a press log."""
    return "depth_mm" in table.cells and "volume_mm3" not in table.cells


def read_depth_curves(log: PressLog) -> tuple[tuple[DepthCurve, ...], list[str]]:
    """The presses of a log of depths as curves, and those that are not used, a sentence each.

    Raises ``PressError`` where most samples are of presses with too few.
    """
    curves, left_out, unused = [], [], 0
    for trial in log.trials:
        rows = log["trial"] == trial
        depth, force = log["depth_mm"][rows], log["force_normal_n"][rows]
        name = str(log["curve"][rows][0]) if "curve" in log else str(trial)
        touching = int((depth > 0).sum())
        if touching < MIN_SAMPLES or not force.max() > 0:
            unused += int(rows.sum())
            left_out.append(
                f"{log.path}: row {log.rows[rows].min()}: curve {name} has {touching} samples in "
                f"contact; at least {MIN_SAMPLES} with a positive force are needed"
            )
            continue
        radius = log["radius_mm"][rows] if "radius_mm" in log else np.array([np.nan])
        one_ball = np.isfinite(radius).all() and np.ptp(radius) == 0 and radius[0] > 0
        zero_n = _zero_n(depth, force)
        ball_mm = float(radius[0]) if one_ball else None
        curves.append(DepthCurve(name, depth, force - zero_n, ball_mm, zero_n))
    PressError.raise_if(left_out if unused >= MAX_DROPPED_SHARE * len(log) else [])
    return tuple(curves), left_out


def _zero_n(depth_mm: FloatArray, force_n: FloatArray) -> float:
    """What a gauge reads before the contact, N; 0 where too few rows say it.

    Rows without depth are at rest where their forces scatter alone: else the contact came earlier.
    """
    at_rest = force_n[depth_mm <= 0]
    if len(at_rest) < MIN_AT_REST:
        return 0.0
    zero_n, span_n = float(np.median(at_rest)), float(np.ptp(force_n))
    scatter_n = 1.4826 * float(np.median(np.abs(at_rest - zero_n)))
    noise_n = 1.4826 * float(np.median(np.abs(np.diff(force_n, 2)))) / math.sqrt(6.0)
    return zero_n if scatter_n <= max(2.0 * noise_n, RISE_SHARE * span_n) else 0.0


def explain_curves(curves: tuple[DepthCurve, ...], radius_mm: float | None = None) -> DepthReport:
    """Find each curve's ball and k_n, and what holds for all.

    ``radius_mm`` is the ball's radius where the curves do not know it; where it is known, a power
    of the force is fitted, and kept if it differs from 1 by more than it scatters.
    """
    radii = known_radii(curves, radius_mm)
    reference_n = 0.5 * max(float(curve.force_n.max()) for curve in curves)
    shapes = np.geomspace(*RADII_MM, N_SHAPES)
    power = Pooled(1.0, 0.0, 1.0)
    if None not in radii:
        shapes = np.append(np.linspace(*POWERS, N_SHAPES), 1.0)
        bent = [
            _explain(curve, shapes, radius, reference_n)
            for curve, radius in zip(curves, radii, strict=True)
        ]
        power = Pooled.of(
            [fit.power for fit in bent], [_stderr(fit.power_interval) for fit in bent]
        )
        if abs(power.value - 1.0) <= 1.96 * power.scatter:
            shapes, power = np.array([1.0]), Pooled(1.0, 0.0, 1.0)
    own = [
        _explain(curve, shapes, radius, reference_n)
        for curve, radius in zip(curves, radii, strict=True)
    ]
    logs = [(math.log(low), math.log(high)) for low, high in (fit.k_interval for fit in own)]
    k_log = Pooled.of([math.log(fit.k_n) for fit in own], [_stderr(log) for log in logs])
    ends = (math.exp(k_log.value + sign * 1.96 * k_log.scatter) for sign in (-1, 1))
    return DepthReport(
        curves={curve.name: fit for curve, fit in zip(curves, own, strict=True)},
        shared_k_n=math.exp(k_log.value),
        k_interval=(next(ends), next(ends)),
        reference_n=reference_n,
        power=power.value,
        power_scatter=power.scatter,
        one_k_n_will_do=k_log.p_value >= MIN_SHARED_P,
        p_value=k_log.p_value,
    )


def known_radii(curves: tuple[DepthCurve, ...], radius_mm: float | None) -> list[float | None]:
    """The ball's radius of each curve, mm; None for all where it is not known of all."""
    radii = [radius_mm or curve.radius_mm for curve in curves]
    return radii if None not in radii else [None] * len(curves)


def _stderr(interval: tuple[float, float]) -> float:
    return max((interval[1] - interval[0]) / (2 * 1.96), 1e-6)


def _explain(
    curve: DepthCurve, shapes: FloatArray, radius_mm: float | None, reference_n: float
) -> BallFit:
    """The best fit of a curve; ``shapes`` are powers where the radius is known, else radii."""

    def fit(shape: float) -> tuple[float, float, float]:
        return _fit_shape(curve, *((radius_mm, shape) if radius_mm else (shape, 1.0)))

    profile = [(float(shape), *fit(float(shape))) for shape in shapes]
    shape, squares, stiffness, shift_mm = min(profile, key=lambda one: one[1])
    near = shapes[np.argsort(np.abs(shapes - shape))[:3]]
    if len(near) == 3:
        ends = float(near.min()), float(near.max())
        found = minimize_scalar(lambda one: fit(one)[0], bounds=ends, method="bounded")
        if found.fun < squares:
            shape, (squares, stiffness, shift_mm) = float(found.x), fit(float(found.x))

    radius, power = (radius_mm, shape) if radius_mm else (shape, 1.0)
    count = len(curve.depth_mm)
    expected = _predict(curve.depth_mm, radius, power, stiffness, shift_mm)
    left = curve.force_n - expected
    correlation = float((left[1:] * left[:-1]).mean() / max(float((left**2).mean()), 1e-300))
    independent = count * (1 - max(correlation, 0.0)) / (1 + max(correlation, 0.0))
    variance = squares / (max(independent, MIN_SAMPLES) - 3)
    k_n = reference_n ** (power - 1.0) * stiffness**-power
    fitted, free = (k_n, shift_mm, power), radius_mm is not None and len(shapes) > 1
    errors = _standard_errors(curve, fitted, free, radius, reference_n)
    log_k, _, bend = math.sqrt(variance) * errors
    k_interval = k_n * math.exp(-1.96 * log_k), k_n * math.exp(1.96 * log_k)
    span = (power - 1.96 * bend, power + 1.96 * bend)
    if radius_mm is None:
        limit = squares + 3.841 * variance
        inside = [one for one in profile if one[1] <= limit] + [(shape, 0.0, stiffness, 0.0)]
        span = (min(one[0] for one in inside), max(one[0] for one in inside))
        compliances = [1.0 / one[2] for one in inside]
        k_interval = min(*compliances, k_interval[0]), max(*compliances, k_interval[1])
    pushed = (curve.depth_mm > 0) & (curve.force_n > 0)
    exponent, _ = np.polyfit(np.log(curve.depth_mm[pushed]), np.log(curve.force_n[pushed]), 1)
    risen = int(np.argmax(curve.force_n > RISE_SHARE * curve.force_n.max()))
    linear = min(one[1] for one in profile if radius_mm is None or one[0] == 1.0)
    return BallFit(
        radius_mm=radius,
        radius_interval_mm=(radius, radius) if radius_mm else span,
        k_n=k_n,
        k_interval=k_interval,
        power=power,
        power_interval=span if radius_mm else (1.0, 1.0),
        contact_point_mm=shift_mm,
        r_squared=float(1.0 - squares / ((curve.force_n - curve.force_n.mean()) ** 2).sum()),
        rmse_n=math.sqrt(squares / count),
        rmse_linear_n=math.sqrt(linear / count),
        log_log_exponent=float(exponent),
        residual_correlation=correlation,
        rise_mm=float(curve.depth_mm[risen]),
        early_n=float(expected[max(risen - 1, 0)]),
        samples=count,
    )


def _standard_errors(
    curve: DepthCurve,
    fitted: tuple[float, float, float],
    power_free: bool,
    radius_mm: float,
    reference_n: float,
) -> FloatArray:
    """Errors (3,) of log k_n, contact point and power in a fit, per unit of its noise."""

    def force_n(log_k: float, shift_mm: float, power: float) -> FloatArray:
        stiffness = (math.exp(log_k) * reference_n ** (1.0 - power)) ** (-1.0 / power)
        return _predict(curve.depth_mm, radius_mm, power, stiffness, shift_mm)

    steps = np.diag([1e-4, 1e-4 * float(curve.depth_mm.max()), 1e-4])[: 3 if power_free else 2]
    at = np.array([math.log(fitted[0]), *fitted[1:]])
    design = np.stack(
        [(force_n(*(at + step)) - force_n(*(at - step))) / (2 * step.max()) for step in steps]
    )
    inverse = np.linalg.pinv(design @ design.T)
    # A zero that is the median of rows at rest is off by π/2 of the variance of their mean.
    at_rest = int((curve.depth_mm <= 0).sum())
    variance = 0.5 * math.pi / at_rest if at_rest >= MIN_AT_REST else 0.0
    by_zero = (inverse @ design).sum(axis=1) ** 2 * variance
    errors = np.sqrt(np.diag(inverse) + by_zero)
    return np.append(errors, 0.0)[:3]


def _predict(
    depth_mm: FloatArray, radius_mm: float, power: float, stiffness: float, shift_mm: float
) -> FloatArray:
    volume = ball_volume_mm3(depth_mm + shift_mm, radius_mm)
    return np.asarray(stiffness * volume ** (1.0 / power))


def _fit_shape(curve: DepthCurve, radius_mm: float, power: float) -> tuple[float, float, float]:
    """(sum of squares, stiffness, contact point) of one radius and power of the force."""
    deepest = float(curve.depth_mm.max())
    low, high = -0.5 * deepest, 0.2 * deepest
    shifts = np.linspace(low, high, N_STARTS)
    for _ in range(4):
        shapes = ball_volume_mm3(curve.depth_mm + shifts[:, None], radius_mm) ** (1.0 / power)
        stiffness = (shapes @ curve.force_n) / np.maximum((shapes**2).sum(axis=1), 1e-300)
        costs = ((curve.force_n - stiffness[:, None] * shapes) ** 2).sum(axis=1)
        at = int(np.argmin(costs))
        step = shifts[1] - shifts[0]
        result = float(costs[at]), max(float(stiffness[at]), 1e-300), float(shifts[at])
        shifts = np.linspace(max(low, shifts[at] - step), min(high, shifts[at] + step), N_STARTS)
    return result


def law_of(report: DepthReport, provenance: Mapping[str, Any]) -> ContactLaw:
    """V = k_n F, or a power of the force as ``stiffening``; the errors hold another curve's."""
    scatter = report.shared_k_n * math.log(report.k_interval[1] / report.shared_k_n) / 1.96
    effects: tuple[FittedEffect, ...] = ()
    if report.power != 1.0:
        # 1 + amount ((F / F_ref)^exponent − 1) / exponent is the power where both are p − 1.
        bend = Estimate(report.power - 1.0, report.power_scatter, "1")
        reference = Estimate(report.reference_n, 0.0, "N")
        parameters = {"amount": bend, "exponent": bend, "reference_n": reference}
        effects = (FittedEffect("stiffening", "normal", parameters),)
    return ContactLaw(
        law="volume_linear",
        k_n_mm3_per_n=Estimate(report.shared_k_n, scatter, "mm3/N"),
        effects=effects,
        provenance=provenance,
    )


def depth_text(result: Mapping[str, Any]) -> str:
    """The content of a ``DepthReport`` in a few lines for a terminal; the last is the verdict."""
    template = templates(escaped=False).get_template("depth_curves.txt")
    return template.render(result=result).rstrip()


def check_identified(path: Path, report: DepthReport) -> None:
    """Refuse curves that are all explained best by the largest ball, with any k_n.

    Raises ``PressError`` with the fix.
    """
    if all(fit.radius_mm >= 0.99 * RADII_MM[1] for fit in report.curves.values()):
        msg = (
            f"{path}: the larger the ball, the better it explains these curves, and k_n grows with "
            "it; give the ball's radius with --radius-mm"
        )
        raise PressError(msg)


def depth_warnings(path: Path, report: DepthReport, radius_mm: float | None) -> tuple[str, ...]:
    """What the reader has to know before using the law."""
    texts = []
    if radius_mm is None:
        texts.append(
            f"{path}: depths and no volumes: the volume is that of a ball whose radius was fitted "
            "with k_n, and a radius and k_n that grow together fit almost as well; give "
            "--radius-mm or log volume_mm3"
        )
    for name, fit in report.curves.items():
        if fit.radius_interval_mm[1] >= 0.99 * RADII_MM[1]:
            texts.append(f"{path}: curve {name}: the radius has no upper bound")
        if fit.residual_correlation > SYSTEMATIC_CORRELATION:
            texts.append(
                f"{path}: curve {name}: neighbouring residuals correlate by "
                f"{fit.residual_correlation:.2f}, so the residual is not noise: this was not "
                "exactly a ball on a gel with this law"
            )
        largest_n = fit.early_n / RISE_EXPECTED_SHARE
        if largest_n > 2 * report.reference_n:
            texts.append(
                f"{path}: curve {name}: its contact point is {-fit.contact_point_mm:.2f} mm, but "
                f"the force rises at {fit.rise_mm:.2f} mm only, where the fit expects "
                f"{fit.early_n:.2f} N; check depth_mm's zero and the radius"
            )
    if not report.one_k_n_will_do:
        texts.append(
            f"{path}: one constant k_n does not explain these curves; contact.yaml holds their "
            "mean with an error as wide as they scatter"
        )
    return tuple(texts)
