"""Which presses of a log can be trusted: checks on its columns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.units import STANDARD_GRAVITY_M_S2

MAX_EMPTY_SHARE = 0.5
"""Up to this share of a trial's samples may be empty before the whole trial is left out: what is
measured beside them is as good as ever."""

MAX_WARNED = 5
"""Presses whose empty cells or gaps are spelled out."""

MAX_PLAUSIBLE_FORCE_N = 100.0
"""Above what a gripper presses on a gel with: the WSG-50 ends at 80 N."""

PLAUSIBLE_COMPLIANCE_MM3_PER_N = (0.15, 150.0)
"""Published gels are between 1 and 10 mm³/N (DESIGN: 5.1 and 8.7); an order of magnitude more."""

OUTLIER_FACTOR = 25.0
"""A trial this many times softer or stiffer than the median one was logged in another unit."""

GAP_FACTOR = 25.0
"""A step of the clock this many times the trial's median step is a gap."""

SHEAR_NAMES = ("force_shear_x_n", "force_shear_y_n", "shear_x_mm", "shear_y_mm")

Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class DroppedTrial:
    """A press that was left out: which, where, why, and how to mend it."""

    trial: int
    rows: tuple[int, int]
    reason: str
    mend: str
    path: str = ""

    def __str__(self) -> str:
        first, last = self.rows
        where = f"row {first}" if first == last else f"rows {first} to {last}"
        return f"{self.path}: {where}: trial {self.trial} is left out: {self.reason}; {self.mend}"


@dataclass(frozen=True, slots=True)
class CheckedTrials:
    """Samples to keep (N,), presses left out, warnings, and whether one clock runs through."""

    keep: NDArray[np.bool_]
    dropped: tuple[DroppedTrial, ...]
    warnings: tuple[str, ...]
    session_clock: bool


@dataclass(slots=True)
class _Findings:
    """What the checks have found so far."""

    columns: Columns
    rows: NDArray[np.int64]
    path: Path
    keep: NDArray[np.bool_]
    dropped: list[DroppedTrial] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def drop(self, block: slice, reason: str, mend: str) -> None:
        if self.keep[block].any():
            span = (int(self.rows[block.start]), int(self.rows[block.stop - 1]))
            trial = int(self.columns["trial"][block.start])
            self.keep[block] = False
            self.dropped.append(DroppedTrial(trial, span, reason, mend, str(self.path)))

    def warn(self, text: str) -> None:
        self.warnings.append(f"{self.path}: {text}")


def check_trials(columns: Columns, rows: NDArray[np.int64], path: Path) -> CheckedTrials:
    """Judge every press of a log; ``rows`` (N,) are the samples' rows in the file."""
    found = _Findings(columns, rows, path, np.ones(len(rows), dtype=bool))
    blocks = trial_blocks(columns["trial"])
    for block in blocks:
        _check_cells(found, block)
        _check_clock(found, block)
    _shorten(found)
    _check_repeats(found, blocks)
    for block in blocks:
        _check_contact(found, block)
    _check_stray_units(found, blocks)
    session_clock = _check_session_clock(found, blocks)
    _check_covariates(found)
    dropped = tuple(sorted(found.dropped, key=lambda each: each.rows))
    return CheckedTrials(found.keep, dropped, tuple(found.warnings), session_clock)


def trial_blocks(trial: NDArray[np.int64]) -> list[slice]:
    """Runs of consecutive samples of one trial."""
    edges = np.flatnonzero(np.diff(trial)) + 1
    starts, stops = np.r_[0, edges], np.r_[edges, len(trial)]
    return [slice(int(start), int(stop)) for start, stop in zip(starts, stops, strict=True)]


def force_unit_problem(columns: Columns, path: Path) -> str:
    """What is said where the forces of the whole log cannot be newtons; empty where they can."""
    peak, compliance = _peaks_and_compliances(columns, trial_blocks(columns["trial"]))
    if not np.isfinite(compliance).any():
        return ""
    typical_peak, typical = float(np.nanmedian(peak)), float(np.nanmedian(compliance))
    softest, stiffest = PLAUSIBLE_COMPLIANCE_MM3_PER_N[1], PLAUSIBLE_COMPLIANCE_MM3_PER_N[0]
    suspicious = typical_peak > MAX_PLAUSIBLE_FORCE_N or (typical_peak > 20 and typical < stiffest)
    unit, newtons, option = "grams", STANDARD_GRAVITY_M_S2 * 1e-3, "gf"
    if typical_peak * newtons > MAX_PLAUSIBLE_FORCE_N:
        unit, newtons, option = "millinewtons", 1e-3, "mn"
    if not suspicious or typical / newtons > softest:
        return ""
    row = int(np.nanargmax(columns["force_normal_n"])) + 2
    return (
        f"{path}: row {row}: force_normal_n reaches {np.nanmax(peak):.4g} (median over presses "
        f"{typical_peak:.4g}) at {typical:.2g} mm³ a unit of force: these look like {unit}, not "
        f"newtons; multiply the force columns by {newtons:.6g}, or say --force-unit {option} "
        "(--force-unit n if they are newtons)"
    )


def _peaks_and_compliances(
    columns: Columns, blocks: list[slice]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Peak force of each block, and its volume per force there; NaN where nothing is known."""
    peak, compliance = np.full(len(blocks), np.nan), np.full(len(blocks), np.nan)
    for index, block in enumerate(blocks):
        force, volume = columns["force_normal_n"][block], columns["volume_mm3"][block]
        known = np.isfinite(force) & np.isfinite(volume)
        if known.any():
            loaded = known & (force >= 0.5 * force[known].max())
            peak[index] = force[known].max()
            if peak[index] > 0:
                compliance[index] = np.median(volume[loaded]) / np.median(force[loaded])
    return peak, compliance


def _check_cells(found: _Findings, block: slice) -> None:
    """Empty or infinite cells: a few leave their samples out, many the trial."""
    finite = {name: np.isfinite(found.columns[name][block])
              for name in ("time_s", "force_normal_n", "volume_mm3")}  # fmt: skip
    shear = {name: np.isfinite(found.columns[name][block])
             for name in SHEAR_NAMES if name in found.columns}  # fmt: skip
    finite |= {name: known for name, known in shear.items() if known.any()}
    bad = ~np.logical_and.reduce(list(finite.values()))
    if not bad.any():
        return
    guilty = ", ".join(name for name, known in finite.items() if not known.all())
    where = ", ".join(str(row) for row in found.rows[block][bad][:5])
    what = f"{guilty} is empty, NaN or infinite in {bad.sum()} of {len(bad)} samples"
    if bad.mean() > MAX_EMPTY_SHARE:
        found.drop(block, f"{what} (row {where})", "fill the cells or delete the press")
        return
    found.keep[block] &= ~bad
    trial = found.columns["trial"][block.start]
    found.warn(
        f"row {where}: trial {trial}: {what}; these samples are left out, fill the cells "
        "or delete the rows"
    )


def _shorten(found: _Findings) -> None:
    """Say what is the same of very many presses in a line, after the first few."""
    more = len(found.warnings) - MAX_WARNED
    if more > 0:
        del found.warnings[MAX_WARNED:]
        found.warn(f"{more} more presses have empty cells or gaps in their clock likewise")


def _check_clock(found: _Findings, block: slice) -> None:
    """Time that runs backwards leaves the press out; a gap is said."""
    kept = np.flatnonzero(found.keep[block]) + block.start
    steps = np.diff(found.columns["time_s"][kept])
    if (steps < 0).any():
        row = found.rows[kept[1:][steps < 0][0]]
        count = int((steps < 0).sum())
        found.drop(
            block,
            f"time_s goes backwards at row {row}" + (f" and {count - 1} more" if count > 1 else ""),
            "sort the rows by trial and time, and give each press its own trial number",
        )
        return
    if not (steps > 0).any():
        return
    gaps = steps > GAP_FACTOR * np.median(steps[steps > 0])
    if gaps.any():
        first = kept[1:][gaps][0]
        found.warn(
            f"row {found.rows[first]}: trial {found.columns['trial'][block.start]}: the clock "
            f"jumps by {steps[gaps][0]:.3g} s ({gaps.sum()} such gaps): what depends on the load's "
            "history is not known across it"
        )


def _check_repeats(found: _Findings, blocks: list[slice]) -> None:
    """Copies of a press under any number, and numbers that stand for several presses."""
    seen: dict[bytes, slice] = {}
    by_trial: dict[int, list[slice]] = {}
    for block in blocks:
        if not found.keep[block].any():
            continue
        trial = int(found.columns["trial"][block.start])
        measured = np.array(
            [found.columns[name][block] for name in ("force_normal_n", "volume_mm3")]
        )
        original = seen.setdefault(measured.tobytes(), block)
        if original is not block and block.stop - block.start > 3:
            twin = found.columns["trial"][original.start]
            found.drop(
                block,
                f"it is a copy of trial {twin} (from row {found.rows[original.start]})",
                "delete one of the two",
            )
        else:
            by_trial.setdefault(trial, []).append(block)
    for trial, parts in by_trial.items():
        for part in parts[1:]:
            first = found.rows[parts[0].start]
            found.drop(
                part,
                f"trial {trial} already stands at row {first}, and which press this one is "
                "cannot be told",
                "give each press its own trial number, in one block of rows",
            )


def _check_contact(found: _Findings, block: slice) -> None:
    """A press without a load or without an imprint says nothing."""
    kept = np.flatnonzero(found.keep[block]) + block.start
    if not len(kept):
        return
    force, volume = found.columns["force_normal_n"][kept], found.columns["volume_mm3"][kept]
    if len(kept) > 1 and np.ptp(force) == 0.0:
        found.drop(block, f"the force never changes ({force[0]:g} N)", "check the gauge")
    elif not (force > 0).any():
        found.drop(block, "the force is never positive", "zero the gauge, check its sign")
    elif not (volume != 0).any():
        found.drop(block, "the volume is always 0: no contact was seen", "check the images")


def _check_stray_units(found: _Findings, blocks: list[slice]) -> None:
    """Single presses logged in another unit than the rest."""
    blocks = [block for block in blocks if found.keep[block].any()]
    if not blocks:
        return
    peak, compliance = _peaks_and_compliances(found.columns, blocks)
    typical_peak, typical = np.nanmedian(peak), np.nanmedian(compliance)
    if typical > PLAUSIBLE_COMPLIANCE_MM3_PER_N[1]:
        found.warn(
            f"volume per force is {typical:.3g} mm³/N, far above any gel's: is it in mm³ and N, "
            "or in px³ or kgf?"
        )
    if len(blocks) < 3 or not typical > 0:
        return
    for block, one_peak, one in zip(blocks, peak, compliance, strict=True):
        stiff = one < typical / OUTLIER_FACTOR and one_peak > typical_peak * OUTLIER_FACTOR
        soft = one > typical * OUTLIER_FACTOR and one_peak < typical_peak / OUTLIER_FACTOR
        if stiff or soft:
            found.drop(
                block,
                f"its force peaks at {one_peak:.3g}, the others at {typical_peak:.3g} (median), "
                f"and volume per force is {one:.2g} against {typical:.2g} mm³/N: it looks like "
                "another unit (grams?)",
                "write its force in newtons",
            )


def _check_session_clock(found: _Findings, blocks: list[slice]) -> bool:
    """Whether time runs on from press to press; said where it does not."""
    kept = [np.flatnonzero(found.keep[block]) + block.start for block in blocks]
    time_s = found.columns["time_s"]
    spans = [(time_s[rows[0]], time_s[rows[-1]]) for rows in kept if len(rows)]
    runs = all(after[0] >= before[1] for before, after in pairwise(spans))
    if not runs:
        found.warn(
            "time_s does not run on from trial to trial (it starts again, or presses overlap): "
            "drift with session time cannot be told; record one clock for the whole session"
        )
    return runs


def _check_covariates(found: _Findings) -> None:
    """Covariates with empty cells are said: tests of them use the other samples."""
    for name, values in found.columns.items():
        if name in ("radius_mm", *SHEAR_NAMES) or not found.keep.any():
            continue
        kept = values[found.keep]
        empty = np.isnan(kept) if kept.dtype.kind == "f" else kept == ""
        if kept.dtype.kind in "fU" and empty.any():
            row = found.rows[found.keep][np.argmax(empty)]
            found.warn(f"row {row}: {name} is empty in {empty.sum()} of {len(kept)} samples")
