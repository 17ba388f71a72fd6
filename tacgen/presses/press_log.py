"""Press logs: the samples of ball presses, read from CSV or Parquet and checked once.

Columns are ``trial``, ``time_s``, ``force_normal_n``, ``volume_mm3`` and the optional ones below;
any other column is a covariate. What makes a whole file useless raises;
what makes one press unusable drops that press, with the reason in ``PressLog.dropped``.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tacgen.contact.noise import sample_noise
from tacgen.core.errors import PressError
from tacgen.core.files import sha256_of
from tacgen.core.records import PRESS_LOG, frozen_array, similar_columns
from tacgen.core.types import (
    GELS_K_N_MM3_PER_N,
    PUBLISHED_K_N_MM3_PER_N,
    BoolArray,
    FloatArray,
    IntArray,
)
from tacgen.presses.geometry import ball_volume_mm3
from tacgen.presses.headers import FORCE_UNITS_N, split_header, units_of
from tacgen.presses.independent_rows import independent_rows
from tacgen.presses.lab_table import (
    LogFormat,
    LogTable,
    clock_gaps,
    read_log_table,
    trial_number_problems,
)
from tacgen.presses.rules import LOG

REQUIRED = ("trial", "time_s", "force_normal_n", "volume_mm3")
SHEAR_FORCES = ("force_shear_x_n", "force_shear_y_n")
SHEAR_MOTIONS = ("shear_x_mm", "shear_y_mm")
SHEAR = (*SHEAR_FORCES, *SHEAR_MOTIONS)
OPTIONAL_NUMBERS = ("radius_mm", "x_mm", "y_mm", *SHEAR)
CONTRACT = (*REQUIRED, "indenter", *OPTIONAL_NUMBERS)
PLAIN = LogFormat()


OTHER_UNITS = MappingProxyType(
    {
        "volume_mm3": ("cm3", "m3", "um3"),
        "depth_mm": ("m", "cm", "um"),
        "time_s": ("ms", "us", "ns", "h", "d"),
    }
)
"""That a quantity is often in where its header does not say so."""
UNIT_WORDS = MappingProxyType({"n": "newtons", "mn": "millinewtons", "gf": "grams", "kgf": "kg"})


Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class DroppedTrial:
    """A press that is not used: which, where, why, and the fix."""

    trial: int
    rows: tuple[int, int]
    reason: str
    fix: str
    path: str = ""

    def __str__(self) -> str:
        first, last = self.rows
        where = f"row {first}" if first == last else f"rows {first} to {last}"
        return f"{self.path}: {where}: trial {self.trial} is dropped: {self.reason}; {self.fix}"


@dataclass(frozen=True, slots=True)
class PressLog:
    """A checked press log: equally long, read-only columns, whole trials in one block each.

    ``trial`` is int64, other numbers float64, text str. The required columns are finite. Optional
    numbers and numeric covariates are NaN where the file is empty; the shear columns are NaN for
    all samples of a trial or for none.
    """

    columns: Columns
    path: Path
    rows: IntArray  # (N,), each sample's row in the file as a spreadsheet counts: the header is 1
    dropped: tuple[DroppedTrial, ...] = ()
    warnings: tuple[str, ...] = ()  # what the reader of any result should know about this log
    session_clock: bool = True  # whether time_s runs on from trial to trial: drift has a meaning
    sha256: str = ""  # of the file's bytes
    volume_stderr_share: float = 0.0  # relative standard error that all volumes share
    marker_pitch_mm: float = math.nan  # of the markers whose motion is summed

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    @property
    def trials(self) -> IntArray:
        """Trial numbers in the order in which they were pressed."""
        numbers, first = np.unique(self.columns["trial"], return_index=True)
        ordered: IntArray = numbers[np.argsort(first)]
        return ordered

    @property
    def has_shear(self) -> bool:
        """Whether a trial holds both shear force and shear motion."""
        return all(name in self for name in SHEAR) and bool(self._shear_mask().any())

    @property
    def covariates(self) -> tuple[str, ...]:
        """Columns beyond the contract's, in the file's order."""
        return tuple(name for name in self.columns if name not in CONTRACT)

    def select(self, mask: BoolArray) -> "PressLog":
        """The samples where ``mask`` (N,) holds; notes on the file stay."""
        rows = frozen_array(self.rows[mask], np.int64)
        return replace(self, columns=_frozen(self.columns, mask), rows=rows)

    def with_shear(self) -> "PressLog":
        """The trials whose shear force and shear motion are known."""
        return self.select(self._shear_mask())

    def _shear_mask(self) -> BoolArray:
        known = [np.isfinite(self.columns[name]) for name in SHEAR]
        return np.asarray(np.logical_and.reduce(known))


def read_press_log(
    path: Path, log_format: LogFormat = PLAIN, *, radius_mm: float | None = None
) -> PressLog:
    """Read and check a press log: CSV, or Parquet by its suffix (``.parquet``, ``.pq``).

    Presses with ``depth_mm`` and no ``volume_mm3`` are of a ball, of ``radius_mm`` or the column
    of that name: the volume is the ball's below the gel's surface at rest. Rows of presses that
    are not in the order of their time are sorted.

    Raises ``PressError`` with every problem of the file at once: unreadable or empty, missing or
    doubled columns, cells that are not numbers, another unit or sign, most samples unusable.
    """
    log = press_log_of(read_log_table(Path(path), log_format), radius_mm=radius_mm)
    if "volume_mm3" not in log:
        msg = (
            f"{path}: depth_mm suffices instead of volume_mm3 for a ball of known radius; give "
            "--radius-mm, a column radius_mm, or volume_mm3"
        )
        raise PressError(msg)
    return log


def press_log_of(table: LogTable, *, radius_mm: float | None = None) -> PressLog:
    """The press log in a table that is read already; as ``read_press_log``.

    Depths may have no ``trial`` and no ``time_s``: their presses are parted by ``curve``, blank
    lines or pauses of the clock, or are one. Those of a ball of unknown radius have no
    ``volume_mm3``.
    """
    table = _with_presses(table)
    table.require("trial", "time_s", "force_normal_n", "volume_mm3 or depth_mm")
    table, spikes = _without_spikes(table)
    path, frame = table.path, table.frame
    problems = [*table.problems, *trial_number_problems(frame["trial"], path)]
    PressError.raise_if(problems or value_problems(table))
    frame = frame.astype({"trial": np.int64})
    order, moved = row_order(frame["trial"].to_numpy(), frame["time_s"].to_numpy())
    frame = frame.iloc[order]
    columns: dict[str, NDArray[Any]] = {
        name: values.to_numpy() if values.dtype.kind in "fi" else np.asarray(values, dtype=str)
        for name, values in frame.items()
    }
    notes = [*table.notes, *table.unclear, *spikes, *([f"{path}: {moved}"] if moved else [])]
    if "time_s" in table.columns:
        notes += _check_clock_unit(table, columns)
    of_depths, rows = "volume_mm3" not in columns, frame.index.to_numpy()
    if of_depths:
        columns["depth_mm"], found = _from_contact(columns)
        notes += [f"{path}: {note}" for note in found]
    columns, is_known, filled = _with_ball_volumes(columns, radius_mm)
    if is_known and filled.any():
        _check_ball({name: values[filled] for name, values in columns.items()}, path)
        of = "" if filled.all() else f" in {len(np.unique(columns['trial'][filled]))} presses"
        notes.append(f"{path}: no volume_mm3{of}: volumes are those of the ball at depth_mm")
    peak, compliance = typical_load(columns)
    notes += compliance_doubts(compliance if is_known else math.nan, peak, table)
    log = _checked(columns, path, rows, "depth_mm" if of_depths else "volume_mm3")
    similar = similar_columns(frame, PRESS_LOG, str(path))
    independent, found = independent_rows(log.columns)
    notes += [*similar, *log.warnings, *(f"{path}: {note}" for note in found)]
    log = log.select(independent)
    if not is_known:
        kept = {name: values for name, values in log.columns.items() if name != "volume_mm3"}
        log = replace(log, columns=MappingProxyType(kept))
    clock = log.session_clock and "time_s" in table.columns
    return replace(log, warnings=tuple(notes), session_clock=clock)


def _without_spikes(table: LogTable) -> tuple[LogTable, list[str]]:
    """NaN for readings that are no readings, such as -999 or 9999 N; a note where there are."""
    frame, notes = table.frame.copy(), []
    for name in [n for n in ("force_normal_n", "volume_mm3", "depth_mm") if n in frame]:
        size = frame[name].abs()
        usual = size.quantile(LOG.usual_share)
        spikes = size > LOG.spike_factor * usual
        if usual > 0 and spikes.any():
            notes.append(
                f"{table.path}: {name} is {frame[name][spikes].iloc[0]:.4g} in {spikes.sum()} "
                f"samples, the others are within {usual:.3g}: taken as empty cells"
            )
            frame[name] = frame[name].mask(spikes)
    return replace(table, frame=frame), notes


def _with_presses(table: LogTable) -> LogTable:
    """A table of depths with a number for each press, and with rows as time where it has no clock.

    A press log needs both from the file.
    """
    frame, notes, path = table.frame.copy(), list(table.notes), table.path
    if "depth_mm" not in frame or "volume_mm3" in frame:
        return table
    if "time_s" not in frame:
        frame["time_s"] = np.arange(len(frame), dtype=np.float64)
        notes.append(
            f"{path}: no column time_s: rows are taken in the file's order, one a second, so that "
            "times of effects that a diagnosis finds are in rows"
        )
    if "curve" in frame:
        frame["trial"] = pd.factorize(frame["curve"])[0].astype(np.float64)
    elif "trial" not in frame:
        by, number = next(iter(table.parted.items()), ("", np.zeros(len(frame))))
        frame["trial"] = np.asarray(number, dtype=np.float64)
        parts = f"{by} part its rows into {int(number[-1]) + 1}" if by else "all rows are one press"
        notes.append(f"{path}: no column trial: {parts}")
    added = [name for name in ("trial", "time_s") if name not in table.frame]
    frame = frame[[*added, *(name for name in frame if name not in added)]]
    return replace(table, frame=frame, notes=tuple(notes))


def _from_contact(columns: Columns) -> tuple[FloatArray, list[str]]:
    """``depth_mm`` (N,) counted from where the force begins, in presses that count an approach."""
    depth, blocks = columns["depth_mm"], _trial_blocks(columns["trial"])
    contact = np.array([_contact_depth(depth[b], columns["force_normal_n"][b]) for b in blocks])
    seen = np.isfinite(contact)
    deepest = np.array([depth[b].max() for b, one in zip(blocks, seen, strict=True) if one])
    way = contact[seen]
    if 2 * seen.sum() < len(blocks) or np.median(way / (deepest - way)) < LOG.least_approach_share:
        return depth, []
    note = (
        f"depth_mm grows by {np.median(way):.3g} mm (median of {len(way)} presses) before there is "
        "a force: depths are counted from there"
    )
    return depth - np.repeat(np.where(seen, contact, 0.0), [len(b) for b in blocks]), [note]


def _contact_depth(depth_mm: FloatArray, force_n: FloatArray) -> float:
    """The depth at which a press (N,) begins to have a force; NaN where no approach is seen.

    Within noise of the first rows, force is none; beyond, it is F₀ + c (d − d₀)^p, whatever the
    indenter and the law, up to a share of its peak.
    """
    known = np.flatnonzero(np.isfinite(depth_mm) & np.isfinite(force_n))
    if known.size <= 2 * LOG.least_approach_rows:
        return math.nan
    known = known[: int(np.argmax(depth_mm[known])) + 1]
    depth, force = depth_mm[known], force_n[known]
    if depth.size <= 2 * LOG.least_approach_rows:
        return math.nan
    noise = sample_noise(force[:, None], np.array([0, force.size]))
    first = np.arange(force.size) < LOG.least_approach_rows
    for _ in range(3):
        zero = float(np.median(force[first]))
        reach = LOG.approach_sigmas * noise + 1e-9 * float(np.ptp(force))
        near = np.flatnonzero(np.abs(force - zero) <= reach)
        touch = int(near[-1]) + 1 if near.size else 0
        first = np.arange(force.size) < max(touch, LOG.least_approach_rows)
    peak = float(force.max()) - zero
    if touch < LOG.least_approach_rows or peak < 2.0 * reach or touch >= force.size:
        return math.nan
    stop = int(np.argmax(force - zero > LOG.onset_share * peak))
    width = max(depth[stop] - depth[touch - 1], 1e-9)
    rows = (depth > depth[touch - 1] - 2.0 * width) & (np.arange(force.size) <= stop)
    if depth[touch - 1] - depth[0] < 0.5 * width or rows.sum() < LOG.least_approach_rows:
        return math.nan

    def misfit(at: FloatArray) -> FloatArray:
        shape = np.maximum(depth[rows] - at[0], 0.0) ** at[1]
        load = force[rows] - zero
        return np.asarray(load - shape * (shape @ load) / max(float(shape @ shape), 1e-300))

    low, high = depth[touch - 1] - width, depth[stop] - 1e-3 * width
    start = [depth[touch - 1], 1.5]
    found = least_squares(misfit, start, bounds=([low, 1.0], [high, 3.0]), x_scale=[width, 1.0])
    return float(found.x[0])


def _with_ball_volumes(
    columns: dict[str, NDArray[Any]], radius_mm: float | None
) -> tuple[dict[str, NDArray[Any]], bool, BoolArray]:
    """Columns with the volume of a ball at ``depth_mm`` in presses that have no volume.

    Whether its radius is known, else the volume is that of one of 1 mm; and the rows (N,) that
    were filled. ``radius_mm`` goes before the column. Negative depths are no contact.
    """
    trial, nothing = columns["trial"], np.full(len(columns["trial"]), np.nan)
    volume, depth = columns.get("volume_mm3", nothing), columns.get("depth_mm", nothing)
    filled = ~np.isin(trial, trial[np.isfinite(volume)]) & np.isin(trial, trial[np.isfinite(depth)])
    if not filled.any():
        return {**columns, "volume_mm3": volume}, True, filled
    radius = columns.get("radius_mm", nothing)
    if radius_mm is not None:
        radius = np.full(len(trial), radius_mm)
    is_known = bool((radius[filled & np.isfinite(depth)] > 0).all())
    if not is_known and np.isfinite(volume).any():  # those that are measured count alone
        return columns, True, np.zeros_like(filled)
    ball = ball_volume_mm3(depth, radius if is_known else 1.0)
    columns = {**columns, "volume_mm3": np.where(filled, ball, volume)}
    return columns | ({"radius_mm": radius} if is_known else {}), is_known, filled


def _check_ball(columns: Columns, path: Path) -> None:
    """Raise ``PressError`` where a ball is pressed deeper than it is wide."""
    depth, radius = columns["depth_mm"], columns["radius_mm"]
    beyond = np.flatnonzero(depth > 2.0 * radius)
    if len(beyond) > 0.01 * len(depth):
        msg = (
            f"{path}: depth_mm reaches {np.nanmax(depth):.3g}, more than the ball's diameter of "
            f"{2 * radius[beyond[0]]:.3g} mm: count it from the gel's surface, or check --radius-mm"
        )
        raise PressError(msg)


def row_order(trial: IntArray, time_s: FloatArray) -> tuple[IntArray, str]:
    """Rows (N,) with every press in one block in the order of its time, and a note if they moved.

    Rows are shuffled where the clock goes backwards in many steps: of several presses under one
    number it does so once for each.
    """
    _, first, label = np.unique(trial, return_index=True, return_inverse=True)
    grouped = np.argsort(first[label], kind="stable")

    def steps(values: FloatArray) -> FloatArray:
        """From row to row of one press."""
        return np.asarray(np.diff(values[grouped])[np.diff(label[grouped]) == 0])

    clock = steps(time_s)
    backwards = clock < 0
    if backwards.sum() > LOG.shuffled_share * len(backwards):
        start = np.full(len(first), np.inf)
        np.fmin.at(start, label, time_s)
        rank = np.argsort(np.lexsort((first, start)))
        by_time = np.lexsort((time_s, rank[label]))
        return by_time, "the rows of presses are not in the order of their time; sorted"
    if (np.diff(grouped) != 1).any() and not backwards.any():
        joined = steps(np.arange(len(trial), dtype=np.float64)) != 1
        typical = np.median(clock[clock > 0]) if (clock > 0).any() else 0.0
        if joined.any() and not (clock[joined] > LOG.gap_factor * typical).any():
            return grouped, "the rows of presses alternate; those of each are joined"
    return np.arange(len(trial)), ""


def value_problems(table: LogTable) -> list[str]:
    """Signs and units that the values of a log cannot have, a line each."""
    problems = []
    path, force = table.path, table.frame["force_normal_n"].to_numpy()
    response = "volume_mm3" if "volume_mm3" in table.frame else "depth_mm"
    values = table.frame[response].to_numpy()
    known = np.isfinite(force) & np.isfinite(values)
    if known.sum() > 2:
        low, high = np.percentile(values[known], (1.0, 99.0))
        is_far = low > LOG.position_share * high and high > LOG.position_mm
        is_far &= high - low > LOG.plausible_depths_mm[0]  # a depth that is held moves by less
        if response == "depth_mm" and is_far:
            return [
                f"{path}: depth_mm lies between {low:.4g} and {high:.4g}, like a stage's position: "
                "count it from the gel's surface, growing as the gel is pressed"
            ]
        load, pushed = force[known], values[known]
        # In the air a stage is far above the gel: contact is the side that the force follows.
        inside, outside = (_correlation(load, np.maximum(s * pushed, 0.0)) for s in (1.0, -1.0))
        if low < 0 and abs(outside) > abs(inside):
            short = response.partition("_")[0]
            problems.append(
                f"{path}: {response} is negative in contact (down to {low:.3g}); flip the sign: "
                f"--flip {short}"
            )
        # Of holds alone no zero is seen: a force may sag as the gel gives way.
        is_hold = load.min() > 0 and low > LOG.rest_volume_share * high
        if max(inside, outside, key=abs) < -LOG.sign_correlation and not is_hold:
            problems.append(
                f"{path}: force_normal_n is negative in contact (down to {load.min():.3g} N); flip "
                "the sign: --flip force"
            )
    peak = float(np.nanmax(np.abs(values))) if known.any() else 0.0
    if response == "depth_mm" and not table.columns[response].is_given and known.any():
        least, most = LOG.plausible_depths_mm
        unit = "m" if 0 < peak < least else "um" if peak > most else ""
        if unit:
            problems.append(
                f"{path}: depth_mm reaches {peak:.3g}: this looks like {unit}; "
                f"{_true_unit(table, response, unit)}"
            )
    return problems


def _correlation(one: FloatArray, other: FloatArray) -> float:
    """Of two quantities (N,); 0 where one is constant."""
    one, other = one - one.mean(), other - other.mean()
    spread = float(np.sqrt((one**2).sum() * (other**2).sum()))
    return float((one * other).sum()) / spread if spread > 0 else 0.0


def _true_unit(table: LogTable, name: str, unit: str) -> str:
    header = split_header(table.columns[name].header)[0]
    return f'say which it is: --column {name}="{header} [{unit}]" (or another unit)'


def _check_clock_unit(table: LogTable, columns: Columns) -> list[str]:
    """A warning where a clock is odd for seconds; raises where it can be no clock in seconds."""
    time_s, blocks = columns["time_s"], _trial_blocks(columns["trial"])
    spans = [float(np.ptp(time_s[b])) for b in blocks if np.isfinite(time_s[b]).all()]
    if not spans or table.columns["time_s"].is_given:
        return []
    span, start = float(np.median(spans)), float(np.nanmin(time_s))
    steps = np.diff(time_s)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    said = f"{table.path}: a press lasts {span:.3g} s by time_s (median), from {start:.4g} s"
    if span > LOG.longest_press_s or start > LOG.latest_clock_s or 0 < span < LOG.shortest_press_s:
        units, usual = units_of("time_s"), LOG.usual_press_s / max(span, 1e-9)
        unit = min(OTHER_UNITS["time_s"], key=lambda u: abs(math.log(units[u] / usual)))
        msg = f"{said}: this looks like {unit}; {_true_unit(table, 'time_s', unit)}"
        raise PressError(msg)
    if span > LOG.odd_press_s and step >= LOG.odd_step_s:
        return [
            f"{said}, a sample every {step:.3g} s; if it is in ms, "
            f"{_true_unit(table, 'time_s', 'ms')}"
        ]
    return []


def _checked(columns: Columns, path: Path, rows: IntArray, response: str) -> PressLog:
    blocks, keep = _trial_blocks(columns["trial"]), np.ones(len(rows), dtype=bool)
    found = _Findings(columns, path, rows, blocks, keep, response)
    for check in CHECKS:
        for block in found.in_use:
            if reason := check.test(found, block):
                found.drop(block, check, reason)
    # One line for what is the same of very many presses, after the first few.
    more = len(found.warnings) - LOG.max_warned
    if more > 0:
        del found.warnings[LOG.max_warned :]
        found.warn(f"{more} more presses have empty cells or gaps in their clock likewise")
    _warn_of_tied_times(found)
    session_clock = _runs_on(found)
    _warn_of_empty_covariates(found)
    dropped = tuple(sorted(found.dropped, key=lambda each: each.rows))
    if found.keep.sum() <= (1 - LOG.max_dropped_share) * (len(rows) - found.copied):
        reasons = [str(trial) for trial in dropped[: LOG.max_listed]]
        if len(dropped) > LOG.max_listed:
            reasons.append(f"… and {len(dropped) - LOG.max_listed} more")
        what = f"only {found.keep.sum()} of {len(rows)} samples can be used"
        what = what if found.keep.any() else "no usable press remains"
        reasons += found.warnings[: LOG.max_listed]
        raise PressError.from_problems([f"{path}: {what}", *reasons])
    return PressLog(
        columns=_frozen(columns, found.keep),
        path=path,
        rows=frozen_array(rows[found.keep], np.int64),
        dropped=dropped,
        warnings=tuple(found.warnings),
        session_clock=session_clock,
        sha256=sha256_of(path),
    )


def _frozen(columns: Columns, mask: BoolArray) -> Columns:
    frozen = {name: frozen_array(values[mask], values.dtype) for name, values in columns.items()}
    return MappingProxyType(frozen)


@dataclass
class _Findings:
    """What the checks have found so far; a block holds the indices of one trial's samples."""

    columns: Columns
    path: Path
    rows: IntArray  # (N,), in the file
    blocks: list[IntArray]
    keep: BoolArray
    response: str  # the column that the volume comes from
    dropped: list[DroppedTrial] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    copied: int = 0  # samples of presses that are copies: nothing is lost with them
    first: dict[bytes | int, IntArray] = field(default_factory=dict)  # press by samples, by number

    @property
    def in_use(self) -> list[IntArray]:
        return [block for block in self.blocks if self.keep[block].any()]

    @cached_property
    def typical(self) -> tuple[float, float]:
        """As ``typical_load``, of the presses in use when first asked for; unknown of two."""
        in_use = self.in_use
        return typical_load(self.columns, in_use) if len(in_use) > 2 else (math.nan, math.nan)

    def kept(self, block: IntArray) -> IntArray:
        return block[self.keep[block]]

    def trial(self, block: IntArray) -> int:
        return int(self.columns["trial"][block[0]])

    def drop(self, block: IntArray, check: "Check", reason: str) -> None:
        if self.keep[block].any():
            self.keep[block] = False
            self.copied += len(block) if check.loses_nothing else 0
            span = int(self.rows[block].min()), int(self.rows[block].max())
            own = DroppedTrial(self.trial(block), span, reason, check.fix, str(self.path))
            self.dropped.append(own)

    def warn(self, text: str) -> None:
        self.warnings.append(f"{self.path}: {text}")


@dataclass(frozen=True, slots=True)
class Check:
    """What makes a press unusable: a ``test`` of its samples' indices, which says why, and the fix.

    A test may also drop single samples, or warn.
    """

    test: Callable[[_Findings, IntArray], str]
    fix: str
    loses_nothing: bool = False  # a press that is dropped is there a second time


def _trial_blocks(trial: IntArray) -> list[IntArray]:
    """Runs of consecutive samples of one trial."""
    return np.split(np.arange(len(trial)), np.flatnonzero(np.diff(trial)) + 1)


def typical_load(columns: Columns, blocks: list[IntArray] | None = None) -> tuple[float, float]:
    """Medians over presses: peak force, N, and volume per force, mm³/N; NaN where unknown."""
    both = _peaks_and_compliances(columns, blocks or _trial_blocks(columns["trial"]))
    peak, compliance = (
        float(np.nanmedian(one)) if np.isfinite(one).any() else math.nan for one in both
    )
    return peak, compliance


def compliance_doubts(compliance: float, peak: float, table: LogTable) -> list[str]:
    """A note where a log's mm³/N are far from any published gel's; raises where no gel has them.

    ``peak`` is that of the force; ``compliance`` is NaN where the ball is unknown. Units that would
    make a gel of it are said, the nearest to published ones first; ``--force-unit n`` says that
    newtons are right.
    """
    (least, most), (low, high) = LOG.read_k_n_mm3_per_n, LOG.doubtful_k_n_mm3_per_n
    is_unknown = math.isnan(compliance)
    is_gel = is_unknown or least <= compliance <= most
    is_too_large = peak > LOG.max_plausible_force_n
    is_usual = is_unknown or low <= compliance <= high
    if table.columns["force_normal_n"].is_given or (is_gel and is_usual and not is_too_large):
        return []
    others = _other_units(compliance, peak, table)
    said = f"{table.path}: force_normal_n reaches {peak:.4g} (median over presses)"
    said += "" if is_unknown else f" at {compliance:.2g} mm³/N, where published gels have 1 to 10"
    if is_gel and not (is_too_large and others):
        fixes = [text for _, k_n, text in others if 1.0 <= k_n <= 10.0]
        said += "" if GELS_K_N_MM3_PER_N[0] <= compliance or is_unknown else " and gels 0.3 to 60"
        said += ": is it another gel, or another unit?"
        return [f"{said} If so, give {' or '.join(fixes)}" if fixes else said]
    fixes = [text for _, _, text in others[:3]]
    what = (
        "these are hardly newtons"
        if is_gel
        else "gels have {:g} to {:g}".format(*GELS_K_N_MM3_PER_N)
    )
    asked = f"give {' or '.join(fixes)}, or" if fixes else "check the units of both, or give"
    msg = f"{said}: {what}; {asked} --force-unit n if they are newtons"
    raise PressError(msg)


def _other_units(compliance: float, peak: float, table: LogTable) -> list[tuple[float, float, str]]:
    """How far from a published gel other units take a log, its mm³/N in them, and the option.

    The nearest come first.
    """
    found = []
    for unit, newtons in FORCE_UNITS_N.items():
        if unit != "n" and peak * newtons <= LOG.max_plausible_force_n:
            found.append((compliance / newtons, f"--force-unit {unit} ({UNIT_WORDS[unit]}"))
    gauge = split_header(table.columns["force_normal_n"].header)[0]
    found.append((compliance / 1e3, f'--column force_normal_n="{gauge} [kN]" (kilonewtons'))
    name = "volume_mm3" if "volume_mm3" in table.frame else "depth_mm"
    power = 1 if name == "volume_mm3" else 2  # of a ball's volume that grows with its depth
    column = table.columns[name]
    for unit in OTHER_UNITS[name] if not column.unit else ():
        option = f'--column {name}="{column.header} [{unit}]" ({unit}'
        found.append((compliance * units_of(name)[unit] ** power, option))
    if math.isnan(compliance):
        return [(0.0, k_n, f"{text})") for k_n, text in found if text.startswith("--force-unit")]
    low, high = GELS_K_N_MM3_PER_N
    likely = [
        (abs(math.log(k_n / PUBLISHED_K_N_MM3_PER_N)), k_n, f"{option}: {k_n:.2g} mm³/N)")
        for k_n, option in found
        if low <= k_n <= high
    ]
    return sorted(likely, key=lambda one: round(one[0], 1))  # of equals, a force's unit first


def _peaks_and_compliances(
    columns: Columns, blocks: list[IntArray]
) -> tuple[FloatArray, FloatArray]:
    """Peak force of each block, and its volume per force there; NaN where nothing is known.

    Both are counted from the block's least load, where the gel is at rest there: a gauge that was
    not tared is no other unit. In a hold it is not: the force falls at one volume, or stays.
    """
    peak, compliance = np.full(len(blocks), np.nan), np.full(len(blocks), np.nan)
    for index, block in enumerate(blocks):
        force, volume = columns["force_normal_n"][block], columns["volume_mm3"][block]
        known = np.isfinite(force) & np.isfinite(volume)
        if not known.any():
            continue
        force, volume = force[known], volume[known]
        peak[index] = force.max()
        rest = force <= np.quantile(force, LOG.rest_share)
        zero = np.array([np.median(force[rest]), np.median(volume[rest])])
        loaded = force - zero[0] >= 0.5 * (force.max() - zero[0])
        least = LOG.rest_volume_share * volume.max()
        is_force_held = zero[0] > LOG.held_share * peak[index] and zero[1] > least
        if is_force_held or np.median(volume[loaded]) - zero[1] < least:
            zero = np.zeros(2)
            loaded = force >= 0.5 * force.max()
        load = np.median(force[loaded]) - zero[0]
        if load > 0:
            compliance[index] = (np.median(volume[loaded]) - zero[1]) / load
    return peak, compliance


def _empty_cells(found: _Findings, block: IntArray) -> str:
    """Empty or infinite cells: a few drop their samples, many the press."""
    required = (*REQUIRED[:-1], found.response)
    names = (*required, *(name for name in SHEAR if name in found.columns))
    finite = {name: np.isfinite(found.columns[name][block]) for name in names}
    finite = {name: known for name, known in finite.items() if name in required or known.any()}
    bad = ~np.logical_and.reduce(list(finite.values()))
    if not bad.any():
        return ""
    guilty = ", ".join(name for name, known in finite.items() if not known.all())
    where = ", ".join(str(row) for row in found.rows[block[bad][: LOG.max_listed]])
    what = f"{guilty} is empty, NaN or infinite in {bad.sum()} of {len(bad)} samples"
    if bad.mean() > LOG.max_empty_share:
        return f"{what} (row {where})"
    found.keep[block] &= ~bad
    fix = "these samples are dropped, fill the cells or delete the rows"
    found.warn(f"row {where}: trial {found.trial(block)}: {what}; {fix}")
    return ""


def _clock_goes_back(found: _Findings, block: IntArray) -> str:
    kept = found.kept(block)
    steps = np.diff(found.columns["time_s"][kept])
    back = np.flatnonzero(steps < 0)
    if back.size:
        more = f" and {back.size - 1} more" if back.size > 1 else ""
        return f"time_s goes backwards at row {found.rows[kept[back[0] + 1]]}{more}"
    gaps = np.flatnonzero(clock_gaps(steps))
    if gaps.size:
        found.warn(
            f"row {found.rows[kept[gaps[0] + 1]]}: trial {found.trial(block)}: the clock jumps by "
            f"{steps[gaps[0]]:.3g} s ({gaps.size} such gaps): what depends on the load's history "
            "is not known across it"
        )
    return ""


def _is_copy(found: _Findings, block: IntArray) -> str:
    force, volume = (found.columns[name][block] for name in REQUIRED[2:])
    original = found.first.setdefault(force.tobytes() + volume.tobytes(), block)
    if original is block or len(block) <= 3:
        return ""
    return f"it is a copy of trial {found.trial(original)} (from row {found.rows[original[0]]})"


def _number_is_taken(found: _Findings, block: IntArray) -> str:
    trial = found.trial(block)
    row = found.rows[found.first.setdefault(trial, block)[0]]
    known = f"trial {trial} is already at row {row}, so it is not known which press this one is"
    return known if row != found.rows[block[0]] else ""


def _constant_force(found: _Findings, block: IntArray) -> str:
    force, volume = (found.columns[name][found.kept(block)] for name in REQUIRED[2:])
    if len(force) < 2 or np.ptp(force) != 0.0:
        return ""
    what = f"the force never changes ({force[0]:g} N)"
    is_pressed = min(np.median(volume), volume[-1]) > 0.5 * volume.max()
    if not (force[0] > 0 and is_pressed):
        return what
    found.warn(
        f"row {found.rows[block[0]]}: trial {found.trial(block)}: {what}: read as a load that is "
        "held; if it was not, check the gauge"
    )
    return ""


def _no_force(found: _Findings, block: IntArray) -> str:
    is_pressed = (found.columns["force_normal_n"][found.kept(block)] > 0).any()
    return "" if is_pressed else "the force is never positive"


def _no_contact(found: _Findings, block: IntArray) -> str:
    is_touched = (found.columns["volume_mm3"][found.kept(block)] != 0).any()
    what = f"the {found.response.partition('_')[0]} is always 0: no contact was seen"
    return "" if is_touched else what


def _other_unit(found: _Findings, block: IntArray) -> str:
    peak, one = (float(of[0]) for of in _peaks_and_compliances(found.columns, [block]))
    typical_peak, typical = found.typical
    stiff = one < typical / LOG.outlier_factor and peak > typical_peak * LOG.outlier_factor
    soft = one > typical * LOG.outlier_factor and peak < typical_peak / LOG.outlier_factor
    return (
        f"its force peaks at {peak:.3g}, the others at {typical_peak:.3g} (median), and volume "
        f"per force is {one:.2g} against {typical:.2g} mm³/N: it looks like another unit (grams?)"
        if typical > 0 and (stiff or soft)
        else ""
    )


CHECKS = (
    Check(_empty_cells, "fill the cells or delete the press"),
    Check(
        _clock_goes_back,
        "sort the rows by trial and time, and give each press its own trial number",
    ),
    Check(_is_copy, "delete one of the two", loses_nothing=True),
    Check(_number_is_taken, "give each press its own trial number, in one block of rows"),
    Check(_constant_force, "check the gauge"),
    Check(_no_force, "zero the gauge, check its sign"),
    Check(_no_contact, "press deeper"),
    Check(_other_unit, "write its force in newtons"),
)
"""Applied in this order, each to the presses that those before have left."""


def _warn_of_tied_times(found: _Findings) -> None:
    """A warning where many samples of a press share a time: the clock's step hides their order."""
    times_s = [found.columns["time_s"][found.kept(block)] for block in found.in_use]
    shares = [float((np.diff(one) == 0).mean()) for one in times_s if len(one) > 1]
    tied = sum(share > LOG.most_tied_share for share in shares)
    if tied:
        found.warn(
            f"samples of {tied} presses share their time ({max(shares):.0%} in one of them): what "
            "depends on time or on the load's history does not show in this clock; record it "
            "with its parts of a second"
        )


def _runs_on(found: _Findings) -> bool:
    """Whether the clock does from press to press; a warning where not."""
    times_s = [found.columns["time_s"][found.kept(block)] for block in found.in_use]
    runs = all(after[0] >= before[-1] for before, after in pairwise(times_s))
    if not runs:
        found.warn(
            "time_s does not run on from trial to trial (it starts again, or presses overlap): "
            "drift with session time is not known; record one clock for the whole session"
        )
    return runs


def _warn_of_empty_covariates(found: _Findings) -> None:
    """A warning for covariates with empty cells: tests of them use the other samples."""
    for name, values in found.columns.items():
        if name in ("radius_mm", *SHEAR) or not found.keep.any():
            continue
        kept = values[found.keep]
        empty = np.isnan(kept) if kept.dtype.kind == "f" else kept == ""
        if kept.dtype.kind in "fU" and empty.any():
            row = found.rows[np.flatnonzero(found.keep)[np.argmax(empty)]]
            found.warn(f"row {row}: {name} is empty in {empty.sum()} of {len(kept)} samples")
