"""Where each printed dot was during the presses of a log: ``markers.csv``, or found in pictures.

Columns are ``press`` (the log's trial), ``frame`` (running number of the press's sample, from 0) or
``time_s``, ``marker`` (any number that a dot keeps) and its place: ``x_px``, ``y_px`` (column and
row) or ``x_mm``, ``y_mm`` (gel frame).
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from tacgen.contact.gel import px_to_mm
from tacgen.contact.shear import marker_grid_mm, turned
from tacgen.core.errors import PressError
from tacgen.core.records import Sensor
from tacgen.core.sensors import no_markers
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.optics.dots import LEAST_SEEN, dots_at_rest, follow
from tacgen.presses.lab_table import read_table
from tacgen.presses.press_folder import PressFolder
from tacgen.presses.press_log import PressLog
from tacgen.presses.rules import LOG

AT_REST = 0.02  # of a press's largest force: below it, its dots are where they rest
AXES = {
    "y is mirrored (it points up; rows count down): write (x, -y)": ((1, 0), (0, -1)),
    "x is mirrored: write (-x, y)": ((-1, 0), (0, 1)),
    "they are turned by 180°: write (-x, -y)": ((-1, 0), (0, -1)),
    "x and y are swapped: write (y, x)": ((0, 1), (1, 0)),
    "x and y are swapped and mirrored: write (-y, -x)": ((0, -1), (-1, 0)),
    "they are turned by 90°: write (-y, x)": ((0, -1), (1, 0)),
    "they are turned by 90°: write (y, -x)": ((0, 1), (-1, 0)),
}
"""In which axes tracks may be written, with the matrix that turns them into the gel's."""


@dataclass(frozen=True, slots=True)
class MarkerTracks:
    """Places of the sensor's markers in F frames of presses, in the order of the sensor's grid.

    ``places_mm`` (F, M, 2) are in the gel frame, NaN where a dot is lost; ``rest_mm`` (M, 2) where
    it is at rest, measured, and ``grid_mm`` (M, 2) where the sensor's file has it. ``load`` holds
    columns (F,) of the log at the times of the frames.
    """

    path: Path
    press: IntArray
    time_s: FloatArray
    places_mm: FloatArray
    rest_mm: FloatArray
    grid_mm: FloatArray
    pitch_mm: float
    load: dict[str, FloatArray]
    warnings: tuple[str, ...] = ()


def read_marker_tracks(path: Path, sensor: Sensor, log: PressLog) -> MarkerTracks:
    """Read ``markers.csv`` and join it with its press log.

    Lost and swapped dots are left out, with a warning that names press and frame.

    Raises ``PressError`` where columns are missing or no numbers, a frame has no sample in the log,
    a dot is given twice, or the dots are not those of the sensor's grid.
    """
    grid = _grid_of(sensor)
    names = ("press", "frame", "time_s", "marker", "x_px", "y_px", "x_mm", "y_mm")
    table, problems = read_table(path).with_numbers(names)
    for group in (("press",), ("frame", "time_s"), ("marker",), ("x_px", "x_mm"), ("y_px", "y_mm")):
        if not any(name in table for name in group):
            problems.append(
                f"{path}: column {' or '.join(group)} is missing: write one row for each dot of "
                "each frame, with press, frame (or time_s), marker, x_px, y_px (or x_mm, y_mm)"
            )
    PressError.raise_if(problems)
    by_frame = "frame" in table
    clock = table["frame" if by_frame else "time_s"]
    empty = ~np.isfinite(table["press"] + clock + table["marker"])
    if empty.any():
        msg = f"{path}: row {table.index[np.argmax(empty)]}: press, frame or marker is empty"
        raise PressError(msg)
    in_px = "x_px" in table
    xy = np.column_stack([table["x_px" if in_px else "x_mm"], table["y_px" if in_px else "y_mm"]])
    if in_px:
        xy = px_to_mm(xy, sensor.shape_px, sensor.mm_per_px)
    frames, at = np.unique(np.column_stack([table["press"], clock]), axis=0, return_inverse=True)
    ids, dot = np.unique(table["marker"], return_inverse=True)
    at, where = at.ravel(), _Names(path, frames, by_frame=by_frame)
    count = np.zeros((len(frames), len(ids)), np.int64)
    np.add.at(count, (at, dot), 1)
    if (count > 1).any():
        frame, twice = np.argwhere(count > 1)[0]
        msg = (
            f"{where(frame)}: marker {ids[twice]:g} is given {count[frame, twice]} times; keep one"
        )
        raise PressError(msg)
    _check_count(len(ids), len(grid), sensor, where(int(count.sum(axis=1).argmax())))
    places = np.full((len(frames), len(ids), 2), np.nan)
    places[at, dot] = xy
    return _joined(places, where, ids, sensor, log)


def tracks_in_pictures(folder: PressFolder, sensor: Sensor, log: PressLog) -> MarkerTracks:
    """The same from a folder of press images, by the dots that are found in them.

    Raises ``PressError`` where the gel at rest shows no dots, or not those of the sensor's grid.
    """
    grid, listing = _grid_of(sensor), folder.path / "presses.csv"
    background, scale = folder.path / "background.png", (sensor.shape_px, sensor.mm_per_px)
    dots = dots_at_rest(folder.background, str(background))
    _check_count(len(dots), len(grid), sensor, str(background))
    press, time_s = folder.numbers("trial"), folder.numbers("time_s")
    if not np.isfinite(press).all():
        msg = f"{listing}: column trial is missing or empty: tracks need the press of each picture"
        raise PressError(msg)
    time_s = np.where(np.isfinite(time_s), time_s, np.arange(len(press), dtype=np.float64))
    order = np.lexsort((time_s, press))
    frames = np.column_stack([press, time_s])[order]
    places = np.full((len(press), len(dots), 2), np.nan)
    where = _Names(listing, frames, by_frame=False)
    for number in np.unique(press):
        rows = np.flatnonzero(frames[:, 0] == number)
        motion, seen = follow(dots, [folder.picture(int(order[row])) for row in rows])
        places[rows] = px_to_mm(dots.places_px + motion, *scale)
        if (seen < LEAST_SEEN * len(dots)).any():
            bad = rows[seen < LEAST_SEEN * len(dots)]
            places[bad] = np.nan
    at_rest_mm = px_to_mm(dots.places_px, *scale)
    ids = np.arange(len(dots), dtype=np.float64)
    return _joined(places, where, ids, sensor, log, at_rest_mm)


@dataclass(frozen=True, slots=True)
class _Names:
    """Names a frame in messages: file, press and frame or time."""

    path: Path
    frames: FloatArray
    by_frame: bool

    def __call__(self, index: int) -> str:
        press, clock = self.frames[index]
        return f"{self.path}: press {press:g}, {'frame' if self.by_frame else 'time_s'} {clock:g}"

    def several(self, indices: IntArray) -> str:
        """Names of a few frames, and how many more there are."""
        shown = [self(int(one)).removeprefix(f"{self.path}: ") for one in indices[: LOG.max_listed]]
        more = len(indices) - len(shown)
        return "; ".join(shown) + (f"; and {more} more frames" if more else "")


def _grid_of(sensor: Sensor) -> FloatArray:
    if sensor.markers is None:
        raise PressError(no_markers(sensor.name))
    return marker_grid_mm(sensor)


def _check_count(found: int, n_grid: int, sensor: Sensor, where: str) -> None:
    if LEAST_SEEN * n_grid <= found <= n_grid or sensor.markers is None:
        return
    rows, columns = sensor.markers.rows, sensor.markers.columns
    msg = (
        f"{where}: {found} dots, but {sensor.name} has {n_grid} ({rows} × {columns}): give the "
        "sensor that was pressed, or correct `markers:` in its file"
    )
    raise PressError(msg)


def _joined(
    places: FloatArray,
    where: _Names,
    ids: FloatArray,
    sensor: Sensor,
    log: PressLog,
    rest_mm: FloatArray | None = None,
) -> MarkerTracks:
    """Tracks with their loads, dots in the order of the grid, what is wrong left out."""
    grid, pitch_mm = _grid_of(sensor), sensor.markers.pitch_mm if sensor.markers else np.nan
    time_s, load = _loads(where, log)
    kept = np.isfinite(time_s)  # the log drops presses, and says so
    frames, time_s, places = where.frames[kept], time_s[kept], places[kept]
    load = {name: values[kept] for name, values in load.items()}
    where = replace(where, frames=frames)
    warnings: list[str] = []
    if not np.isfinite(places).any():
        msg = f"{where.path}: no dots in any frame of a press that the log has"
        raise PressError(msg)
    if rest_mm is None:
        peak = {k: load["force_normal_n"][frames[:, 0] == k].max() for k in np.unique(frames[:, 0])}
        share = load["force_normal_n"] / np.array([max(peak[k], 1e-9) for k in frames[:, 0]])
        resting = np.abs(share) <= AT_REST
        if not resting.any():
            msg = (
                f"{where.path}: no frame is of a gel at rest (force below "
                f"{AT_REST:.0%} of the press's largest): record each press from before "
                "contact"
            )
            raise PressError(msg)
        rest_mm = _median(places[resting])
    seen = np.isfinite(rest_mm).all(axis=1)
    order = _on_grid(rest_mm[seen], grid, pitch_mm, where.path)
    column = np.full(len(grid), -1)
    column[order] = np.flatnonzero(seen)
    known = column >= 0
    sorted_places = np.full((len(frames), len(grid), 2), np.nan)
    sorted_places[:, known] = places[:, column[known]]
    rest = np.full_like(grid, np.nan)
    rest[known] = rest_mm[column[known]]
    labels = np.where(known, ids[np.maximum(column, 0)], np.nan)
    if not known.all():
        warnings.append(
            f"{where.path}: {(~known).sum()} of {len(grid)} dots of {sensor.name} are in no frame"
        )
    lost = known & ~np.isfinite(sorted_places).all(axis=2)
    warnings += _lost_dots(lost, known, labels, where)
    warnings += _swapped_dots(sorted_places, rest, pitch_mm, labels, where)
    return MarkerTracks(
        where.path,
        frames[:, 0].astype(np.int64),
        time_s,
        sorted_places,
        rest,
        grid,
        pitch_mm,
        load,
        tuple(warnings),
    )


def _loads(where: _Names, log: PressLog) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Time and the log's numbers at each frame; ``PressError`` for frames without a sample."""
    needed = ("force_normal_n", "force_shear_x_n", "force_shear_y_n", "radius_mm", "x_mm", "y_mm")
    if lacking := [name for name in needed if name not in log]:
        msg = (
            f"{log.path}: lacks {', '.join(lacking)}: the shear field of a press follows from its "
            "forces, its ball's radius and the contact's place"
        )
        raise PressError(msg)
    dropped, frames = {one.trial: one for one in log.dropped}, where.frames
    names = [n for n in log.columns if log[n].dtype.kind == "f" and n != "time_s"]
    load = {name: np.full(len(frames), np.nan) for name in names}
    time_s, problems = np.full(len(frames), np.nan), []
    for press in np.unique(frames[:, 0]):
        mine = np.flatnonzero(frames[:, 0] == press)
        samples = np.flatnonzero(log["trial"] == press)
        if not len(samples):
            if int(press) not in dropped:
                problems.append(f"{where(mine[0])}: the log has no trial {press:g}")
            continue
        clock = log["time_s"][samples]
        if where.by_frame:
            # Rows of a trial that reading left out still count.
            number = (log.rows[samples] - log.rows[samples].min()).astype(np.float64)
            wrong = (frames[mine, 1] < 0) | (frames[mine, 1] > number.max())
            time_s[mine] = np.interp(frames[mine, 1], number, clock)
        else:
            step = np.median(np.diff(clock)) if len(clock) > 1 else 0.0
            wrong = (frames[mine, 1] < clock[0] - step) | (frames[mine, 1] > clock[-1] + step)
            time_s[mine] = frames[mine, 1]
        if wrong.any():
            problems.append(
                f"{where(mine[np.argmax(wrong)])}: the log has no such sample: trial {press:g} has "
                f"{len(samples)}, from {clock[0]:g} to {clock[-1]:g} s"
            )
        for name in names:
            load[name][mine] = np.interp(time_s[mine], clock, log[name][samples])
    PressError.raise_if(problems)
    return time_s, load


def _median(places: FloatArray) -> FloatArray:
    """Median place (M, 2) of each dot over frames; NaN where it is never seen."""
    rest = np.full(places.shape[1:], np.nan)
    seen = np.isfinite(places).all(axis=2).any(axis=0)
    rest[seen] = np.nanmedian(places[:, seen], axis=0)
    return rest


def rigid_fit(places_mm: FloatArray, grid_mm: FloatArray) -> tuple[float, FloatArray]:
    """Turn about the grid's middle, rad, then shift (2,), mm, of the grid onto places (n, 2)."""
    a, b = grid_mm, places_mm - places_mm.mean(axis=0)
    a = a - a.mean(axis=0)
    turn = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    return float(turn), places_mm.mean(axis=0) - turned(grid_mm, float(turn)).mean(axis=0)


def _on_grid(rest_mm: FloatArray, grid: FloatArray, pitch_mm: float, path: Path) -> IntArray:
    """Which point of the grid each dot at rest is, though the grid is turned and shifted."""
    index, distance = _matched(rest_mm, grid)
    worst = int(distance.argmax())
    if _is_one_to_one(index, distance, pitch_mm):
        return index
    x, y = rest_mm[worst]
    fix = "give the sensor that was pressed, and check px against mm"
    if _is_one_to_one(*_matched((rest_mm - rest_mm.mean(axis=0))[:, ::-1], grid), pitch_mm):
        fix = "x and y are swapped, or turned by 90°: write (y, x), (-y, x) or (y, -x)"
    msg = (
        f"{path}: the dots at rest are not on the sensor's grid: one at x = {x:.2f}, y = "
        f"{y:.2f} mm is {distance[worst]:.2f} mm off (pitch {pitch_mm:g} mm): {fix}"
    )
    raise PressError(msg)


def _matched(rest_mm: FloatArray, grid: FloatArray) -> tuple[IntArray, FloatArray]:
    """The nearest point of the grid to each dot, turned and shifted onto them, and how far."""
    moved = grid
    for _ in range(LOG.grid_rounds):
        turn, shift = rigid_fit(rest_mm, grid[cKDTree(moved).query(rest_mm)[1]])
        moved = turned(grid, turn) + shift
    distance, index = cKDTree(moved).query(rest_mm)
    return np.asarray(index), np.asarray(distance)


def _is_one_to_one(index: IntArray, distance: FloatArray, pitch_mm: float) -> bool:
    is_near = bool(distance.max() <= LOG.jump_pitches * pitch_mm)
    return is_near and len(set(index.tolist())) == len(index)


def _lost_dots(lost: BoolArray, known: BoolArray, labels: FloatArray, where: _Names) -> list[str]:
    frames = np.flatnonzero(lost.any(axis=1))
    if not len(frames):
        return []
    if (lost.sum(axis=1) == known.sum()).all():
        msg = f"{where(int(frames[0]))}: no dots are seen, nor in any other frame"
        raise PressError(msg)
    empty = frames[lost[frames].sum(axis=1) == known.sum()]
    some = np.setdiff1d(frames, empty)
    lines = []
    if len(empty):
        lines.append(f"{where.path}: no dots, or too few to follow, in {where.several(empty)}")
    if len(some):
        first = ", ".join(f"{one:g}" for one in labels[lost[some[0]]][: LOG.max_listed])
        lines.append(
            f"{where.path}: dots are lost in {where.several(some)} (marker {first} in the first): "
            "left out there"
        )
    return lines


def _swapped_dots(
    places: FloatArray, rest: FloatArray, pitch_mm: float, labels: FloatArray, where: _Names
) -> list[str]:
    """Dots that do not move with their neighbours: set to NaN in ``places``, and named."""
    known = np.flatnonzero(np.isfinite(rest).all(axis=1))
    _, near = cKDTree(rest[known]).query(rest[known], k=min(9, len(known)))
    motion = places[:, known] - rest[known]
    around = np.zeros_like(motion)
    for frame in range(len(motion)):
        nearby = motion[frame][near[:, 1:]]
        seen = np.isfinite(nearby).all(axis=2).any(axis=1)
        around[frame, seen] = np.nanmedian(nearby[seen], axis=1)
    off = np.hypot(*np.moveaxis(motion - around, 2, 0))
    wrong = off > LOG.jump_pitches * pitch_mm
    frames = np.flatnonzero(wrong.any(axis=1))
    if not len(frames):
        return []
    first, who = int(frames[0]), np.flatnonzero(wrong[frames[0]])
    expected = rest[known[who]] + around[first, who]
    far = np.hypot(*np.moveaxis(places[first, known[who]][:, None] - expected[None], 2, 0))
    swapped = (far.min(axis=1) < LOG.same_place_pitches * pitch_mm).all() and len(who) > 1
    names = ", ".join(f"{one:g}" for one in labels[known[who]][: LOG.max_listed])
    what = "swapped" if swapped else "far from where their neighbours moved"
    places[:, known] = np.where(wrong[..., None], np.nan, places[:, known])
    return [
        f"{where.path}: dots are {what} in {where.several(frames)} (marker {names} in the first): "
        "left out there; let each dot keep its number"
    ]
