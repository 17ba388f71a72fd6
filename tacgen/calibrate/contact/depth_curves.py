"""Force against depth of an unknown indenter: which ball and which k_n explain it.

A curve of force against depth holds no volume. If the indenter was a ball of radius R, its volume
follows from the depth, and V = k_n F then has to hold. Two numbers (R, k_n) and a contact point
are fitted to every curve, and one k_n to all curves together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import fdtrc

from tacgen.core.arrays import FloatArray
from tacgen.core.errors import PressError
from tacgen.presses.geometry import ball_volume_mm3
from tacgen.presses.press_log import column_names, column_problems, numeric_columns, read_table
from tacgen.report.page import templates

RADII_MM = (0.1, 100.0)
"""Indenters outside this range are no balls that a gel is pressed with."""
MIN_SAMPLES = 8  # two for each of the four parameters of a curve
N_STARTS = 13  # contact points tried along a curve: its loss has several minima
SYSTEMATIC_CORRELATION = 0.5
"""Correlation of neighbouring residuals above which they are shape, not noise."""
MIN_SHARED_P = 0.05
"""p of the F test below which one k_n for all curves is given up; the usual 5 %."""


@dataclass(frozen=True, slots=True)
class DepthCurve:
    """One curve: depth and force (N,), in the file's order."""

    name: str
    depth_mm: FloatArray
    force_n: FloatArray


@dataclass(frozen=True, slots=True)
class BallFit:
    """The ball and compliance that explain one curve best.

    ``radius_interval_mm`` and ``k_interval`` (95 %) come from the profile of the misfit: at its
    ends the other quantities are refitted. An interval that ends at a bound of ``RADII_MM`` is
    open there: the curve cannot tell. ``log_log_exponent`` is the slope of log F against log
    depth. Near 1, ``residual_correlation`` of neighbouring residuals says that the residual is not
    noise but shape that a ball on a linear gel does not have, and the intervals are too narrow.
    ``with_shared_k_n`` are radius and error with the k_n that all curves share.
    """

    radius_mm: float
    radius_interval_mm: tuple[float, float]
    k_n: float
    k_interval: tuple[float, float]
    contact_point_mm: float
    r_squared: float
    rmse_n: float
    log_log_exponent: float
    residual_correlation: float
    samples: int
    with_shared_k_n: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DepthReport:
    """Every curve's best ball by name, and the p of the F test that one k_n does for all."""

    curves: dict[str, BallFit]
    shared_k_n: float
    one_k_n_will_do: bool
    p_value: float


def is_depth_table(path: Path) -> bool:
    """Whether a file holds depths and no volumes: force–depth curves, not a press log."""
    columns = column_names(path)
    return "depth_mm" in columns and "volume_mm3" not in columns


def read_depth_curves(path: Path) -> tuple[DepthCurve, ...]:
    """Read curves from columns ``force_normal_n``, ``depth_mm`` and ``curve`` (or ``trial``).

    Raises ``PressError`` listing what is missing, not a number, or too short.
    """
    frame = read_table(path)
    label = "curve" if "curve" in frame.columns else "trial"
    problems = column_problems(frame, path, ("force_normal_n", "depth_mm"))
    PressError.raise_if(problems)
    numbers, problems = numeric_columns(frame, path, ("force_normal_n", "depth_mm"))
    names = frame[label].astype(str) if label in frame.columns else np.full(len(frame), "curve")
    curves = []
    for name in dict.fromkeys(names):
        rows = np.flatnonzero(names == name)
        depth, force = numbers["depth_mm"][rows], numbers["force_normal_n"][rows]
        empty = ~(np.isfinite(depth) & np.isfinite(force))
        if empty.any():
            problems.append(
                f"{path}: row {rows[np.argmax(empty)] + 2}: curve {name}: depth_mm or "
                "force_normal_n is empty; fill it or delete the row"
            )
        elif (depth > 0).sum() < MIN_SAMPLES or not force.max() > 0:
            problems.append(
                f"{path}: row {rows[0] + 2}: curve {name} has {(depth > 0).sum()} samples in "
                f"contact; at least {MIN_SAMPLES} with a positive force are needed"
            )
        curves.append(DepthCurve(str(name), depth, force))
    PressError.raise_if(problems)
    return tuple(curves)


def explain_curves(curves: tuple[DepthCurve, ...], radius_mm: float | None = None) -> DepthReport:
    """Find each curve's ball and k_n, and judge one k_n for all.

    ``radius_mm`` is the ball's radius where it is known; only k_n and the contact point are then
    free.
    """
    own = [_explain(curve, radius_mm) for curve in curves]
    shared_log_k, shared = _share_k(curves, own, radius_mm)
    n_samples = sum(len(curve.depth_mm) for curve in curves)
    free = 2 if radius_mm else 3
    dof = n_samples - free * len(curves)
    p_value = 1.0
    if len(curves) > 1:
        # Each curve at its own noise: a stiff curve's newtons must not drown a soft one's.
        excess = sum(
            (one["rmse_n"] ** 2 / fit.rmse_n**2 - 1.0) * fit.samples
            for one, fit in zip(shared, own, strict=True)
        )
        statistic = excess / (len(curves) - 1) / (n_samples / dof)
        p_value = float(fdtrc(len(curves) - 1, dof, max(statistic, 0.0)))
    fits = {
        curve.name: replace(fit, with_shared_k_n=one)
        for curve, fit, one in zip(curves, own, shared, strict=True)
    }
    return DepthReport(fits, float(np.exp(shared_log_k)), p_value >= MIN_SHARED_P, p_value)


def _explain(curve: DepthCurve, radius_mm: float | None) -> BallFit:
    radii = map(float, _radius_grid(radius_mm, 121))
    profile = [(float(np.log(radius)), *_fit_at_radius(curve, radius)) for radius in radii]
    log_r, best, k_log, shift = min(profile, key=lambda one: one[1])
    parameters: FloatArray = np.array([log_r, k_log, shift])
    if radius_mm is None:
        parameters = _polish(curve, parameters)
        best = _squares(curve, parameters)
    limit = best * (1.0 + 3.841 / max(len(curve.depth_mm) - 3, 1))
    inside = [(log_r, k) for log_r, cost, k, _ in profile if cost <= limit]
    inside.append((float(parameters[0]), float(parameters[1])))
    in_contact = (curve.depth_mm > 0) & (curve.force_n > 0)
    logs = np.log(curve.depth_mm[in_contact]), np.log(curve.force_n[in_contact])
    exponent, _ = np.polyfit(*logs, 1)
    spread = ((curve.force_n - curve.force_n.mean()) ** 2).sum()
    left = curve.force_n - _predict(curve, np.exp(parameters[0]), parameters[1], parameters[2])
    return BallFit(
        radius_mm=float(np.exp(parameters[0])),
        radius_interval_mm=_span([r for r, _ in inside]),
        k_n=float(np.exp(parameters[1])),
        k_interval=_span([k for _, k in inside]),
        contact_point_mm=float(parameters[2]),
        r_squared=float(1.0 - best / spread),
        rmse_n=float(np.sqrt(best / len(curve.depth_mm))),
        log_log_exponent=float(exponent),
        residual_correlation=float(
            (left[1:] * left[:-1]).mean() / max(float((left**2).mean()), 1e-300)
        ),
        samples=len(curve.depth_mm),
    )


def _radius_grid(radius_mm: float | None, size: int) -> FloatArray:
    return np.geomspace(*RADII_MM, size) if radius_mm is None else np.array([radius_mm])


def _span(logs: list[float]) -> tuple[float, float]:
    return float(np.exp(min(logs))), float(np.exp(max(logs)))


def _predict(curve: DepthCurve, radius_mm: float, k_log: float, shift_mm: float) -> FloatArray:
    return np.asarray(ball_volume_mm3(curve.depth_mm + shift_mm, radius_mm) / np.exp(k_log))


def _squares(curve: DepthCurve, parameters: FloatArray) -> float:
    predicted = _predict(curve, np.exp(parameters[0]), parameters[1], parameters[2])
    return float(((curve.force_n - predicted) ** 2).sum())


def _shift_bounds(curve: DepthCurve) -> tuple[float, float]:
    deepest = float(curve.depth_mm.max())
    return -0.5 * deepest, 0.2 * deepest


def _fit_at_radius(
    curve: DepthCurve, radius_mm: float, k_log: float | None = None
) -> tuple[float, float, float]:
    """(sum of squares, log k, contact point) of one radius; k may be given."""
    shifts = np.linspace(*_shift_bounds(curve), N_STARTS)
    for _ in range(4):
        volumes = ball_volume_mm3(curve.depth_mm + shifts[:, None], radius_mm)
        if k_log is None:
            stiffness = (volumes @ curve.force_n) / np.maximum((volumes**2).sum(axis=1), 1e-300)
        else:
            stiffness = np.full(len(shifts), np.exp(-k_log))
        costs = ((curve.force_n - stiffness[:, None] * volumes) ** 2).sum(axis=1)
        at = int(np.argmin(costs))
        step = shifts[1] - shifts[0]
        low, high = _shift_bounds(curve)
        result = float(costs[at]), float(-np.log(max(stiffness[at], 1e-300))), float(shifts[at])
        shifts = np.linspace(max(low, shifts[at] - step), min(high, shifts[at] + step), N_STARTS)
    return result


def _polish(curve: DepthCurve, parameters: FloatArray) -> FloatArray:
    low, high = _shift_bounds(curve)
    found = least_squares(
        lambda p: _predict(curve, np.exp(p[0]), p[1], p[2]) - curve.force_n,
        parameters,
        bounds=(
            [np.log(RADII_MM[0]) - 1e-9, -20.0, low - 1e-9],
            [np.log(RADII_MM[1]) + 1e-9, 20.0, high + 1e-9],
        ),
        x_scale=[1.0, 1.0, 0.1 * float(curve.depth_mm.max())],
    )
    return np.asarray(found.x)


def _share_k(
    curves: Sequence[DepthCurve], own: Sequence[BallFit], radius_mm: float | None
) -> tuple[float, list[dict[str, float]]]:
    """The log k that explains all curves best, each at its own noise; radius and RMSE there."""

    def at(k_log: float) -> list[tuple[float, float]]:
        return [_best_radius(curve, k_log, radius_mm) for curve in curves]

    def total(k_log: float) -> float:
        costs = [cost for cost, _ in at(k_log)]
        return sum(cost / fit.rmse_n**2 for cost, fit in zip(costs, own, strict=True))

    logs = np.log([fit.k_n for fit in own])
    candidates = np.linspace(logs.min() - 0.2, logs.max() + 0.2, 25)
    for _ in range(2):
        step = candidates[1] - candidates[0]
        chosen = min(map(float, candidates), key=total)
        candidates = np.linspace(chosen - step, chosen + step, 9)
    return chosen, [
        {"radius_mm": radius, "rmse_n": float(np.sqrt(cost / len(curve.depth_mm)))}
        for curve, (cost, radius) in zip(curves, at(chosen), strict=True)
    ]


def _best_radius(curve: DepthCurve, k_log: float, radius_mm: float | None) -> tuple[float, float]:
    """(sum of squares, radius) of the ball that suits a given k best."""
    radii = _radius_grid(radius_mm, 41)
    for _ in range(3):
        costs = [_fit_at_radius(curve, float(radius), k_log)[0] for radius in radii]
        best = int(np.argmin(costs))
        result = costs[best], float(radii[best])
        if radius_mm is not None:
            break
        low, high = radii[max(best - 1, 0)], radii[min(best + 1, len(radii) - 1)]
        radii = np.geomspace(low, high, 9)
    return result


def depth_text(result: Mapping[str, Any]) -> str:
    """The content of a ``DepthReport`` in a few lines for a terminal; the last is the verdict."""
    template = templates(escaped=False).get_template("depth_curves.txt")
    return template.render(result=result).rstrip()


def depth_warnings(path: Path, report: DepthReport) -> tuple[str, ...]:
    """What the reader has to know before using the law."""
    texts = [
        f"{path}: depths and no volumes: the volume is that of a ball whose radius was fitted with "
        "k_n, and a radius and k_n that grow together fit almost as well; measure the ball or "
        "log volume_mm3"
    ]
    for name, fit in report.curves.items():
        if fit.radius_interval_mm[1] >= 0.99 * RADII_MM[1]:
            texts.append(f"{path}: curve {name}: the radius has no upper bound")
        if fit.residual_correlation > SYSTEMATIC_CORRELATION:
            texts.append(
                f"{path}: curve {name}: neighbouring residuals correlate by "
                f"{fit.residual_correlation:.2f}, so the residual is not noise: this was not "
                "exactly a ball on a linear gel, and the intervals are too narrow"
            )
    if not report.one_k_n_will_do:
        texts.append(
            f"{path}: one constant k_n does not explain these curves; contact.yaml holds the best "
            "shared one with an error as wide as the curves are apart"
        )
    return tuple(texts)
