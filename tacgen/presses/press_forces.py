"""Press images with forces: the camera's pictures and the gauge's readings to a press log.

Volume comes from the gel's shape, reconstructed by a lookup table, or from the contact circle of
a ball of known radius; shear from the sum of the tracked markers' motion.
"""

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from tacgen.core.errors import PressError, SensorError
from tacgen.core.types import BoolArray, FloatArray
from tacgen.optics.dots import MIN_TRACKED, Dots, Image, dots_at_rest, dots_in, find_spots, follow
from tacgen.optics.reconstruct import Reconstructor
from tacgen.optics.table import LookupTable
from tacgen.presses.circles import find_circle
from tacgen.presses.experiments import grouped
from tacgen.presses.geometry import cap_volume_from_circle_mm3
from tacgen.presses.press_folder import COORDINATES, STAGE, PressFolder
from tacgen.presses.rules import IMAGES
from tacgen.sensor.read_image import ImageReader
from tacgen.sensor.recorded import Recording
from tacgen.sensor.recordings import readings_of


@dataclass(frozen=True, slots=True)
class MeasuredLog:
    """The press log of images with forces, and warnings.

    ``volume_stderr_share`` is the typical relative standard error of a volume by a table, whose
    error is alike in all of them; 0 without a table. ``marker_pitch_mm`` is that of the dots whose
    motion was summed, NaN without dots: as the folder has it, or as the gel at rest shows it.
    """

    frame: pd.DataFrame
    marker_pitch_mm: float
    volume_stderr_share: float
    warnings: tuple[str, ...]


def measure_presses(folder: PressFolder, table: LookupTable | None = None) -> MeasuredLog:
    """Turn press images with forces into a press log.

    With a ``table`` of this sensor volumes come from the reconstructed shape, without it from the
    contact circle, and ``radius_mm`` is needed.

    Raises ``PressError`` if there is neither a table nor a ball's radius, or no picture shows a
    contact.
    """
    warnings: list[str] = []
    rows, listing = _with_trials(folder), folder.path / "presses.csv"
    if table is None:
        if not np.isfinite(folder.numbers("radius_mm")).any():
            fix = "give the ball's radius or the sensor's table.npz"
            msg = f"{listing}: no radius_mm and no --table, so the volume is not known; {fix}"
            raise PressError(msg)
        doubt = "a circle 2 % too wide is a volume 8 % too large; --table gives better ones"
        warnings.append(f"{folder.path}: volumes are from contact circles: {doubt}")
    spots = find_spots(folder.background)
    at_rest = spots.mask(spots.usable) if spots.usable.sum() >= MIN_TRACKED else None
    reconstructor = (
        Reconstructor(table, folder.background, folder.dome_radius_mm) if table else None
    )
    volumes, stderrs = np.full((2, len(rows)), np.nan)
    n_bounds = 0
    for index in range(len(rows)):
        picture = folder.picture(index)
        hidden = dots_in(picture, at_rest) if at_rest is not None else None
        problem = "shows no contact"
        if reconstructor is not None:
            shape = reconstructor.shape_of(picture, hidden)
            volumes[index], stderrs[index] = shape.volume_mm3, shape.volume_stderr_mm3()
            n_bounds += shape.is_lower_bound
        else:
            volumes[index], problem = _ball_volume(folder, index, picture, hidden)
        if not volumes[index] > 0:
            fix = "it is not in the log: press again, or check background.png"
            warnings.append(f"{listing}: row {index + 2}: {rows['file'][index]} {problem}; {fix}")
    warnings += _bound_warnings(str(listing), n_bounds)
    frame = _log_frame(rows, volumes)
    pitch_mm = np.nan
    if at_rest is not None:
        dots = dots_at_rest(folder.background, str(folder.path / "background.png"))
        pitch_mm = folder.dot_pitch_mm or dots.spacing_px * folder.mm_per_px
        frame[["shear_x_mm", "shear_y_mm"]] = _marker_sums(folder, frame, dots)
    frame = frame[volumes > 0].reset_index(drop=True)
    if frame.empty:
        msg = f"{folder.path}: no picture shows a contact; check background.png"
        raise PressError(msg)
    shares = (stderrs / volumes)[(volumes > 0) & np.isfinite(stderrs)]
    share = float(np.median(shares)) if shares.size else 0.0
    return MeasuredLog(frame, pitch_mm, share, tuple(warnings))


def measure_recording(reader: ImageReader, recording: Recording) -> MeasuredLog:
    """Turn a recording of pictures and a gauge, whose z is along the presses, into a press log.

    A press is what is read without a pause of ``IMAGES.pause_s``, and the gel at rest about it.
    Where the gauge's clock is off by more than a picture's interval, its forces are taken so much
    earlier or later; a smaller lag may be the gel's creep.

    Raises ``PressError`` if there is no gauge or no picture shows a contact.
    """
    wrench, rows, warnings = recording.wrench, [], [*recording.notes]
    if wrench is None:
        msg = f"{recording.name}: no forces beside the pictures; record a WrenchStamped with them"
        raise PressError(msg)
    try:
        for _, _, row in readings_of(reader, recording):
            rows.append(row)
    except SensorError as error:
        if not rows:
            raise
        warnings.append(f"{error}; the {len(rows)} pictures before are used")
    read = pd.DataFrame(rows).sort_values("time_s", kind="stable", ignore_index=True)
    times_s = read["time_s"].to_numpy()
    lag_s = wrench.lag_s(times_s, read["force_normal_n"].to_numpy(np.float64))
    is_apart = math.isfinite(lag_s) and abs(lag_s) > np.median(np.diff(times_s))
    said = "does not show" if np.isnan(lag_s) else f"is {lag_s:.3f} s"
    said += ": forces are taken so much later" if is_apart else ""
    warnings.append(f"{recording.name}: the lag of {wrench.topic} behind the pictures {said}")
    force_n = wrench.at(times_s + (lag_s if is_apart else 0.0))
    volume = read["volume_mm3"].to_numpy(np.float64)
    if np.isfinite(rest_n := force_n[volume == 0]).any():
        zero_n = np.nanmedian(rest_n, axis=0)
        force_n = force_n - zero_n
        at_rest = ", ".join(f"{force:.3g}" for force in zero_n)
        warnings.append(
            f"{recording.name}: without contact the gauge reads {at_rest} N: subtracted"
        )
    seen = ["time_s", "volume_mm3", "shear_sum_x_mm", "shear_sum_y_mm"]
    log = read[seen].set_axis(["time_s", "volume_mm3", "shear_x_mm", "shear_y_mm"], axis=1)
    log[["force_shear_x_n", "force_shear_y_n", "force_normal_n"]] = force_n
    touches = times_s[volume > 0]
    if not len(touches):
        msg = f"{recording.name}: no picture shows a contact; check the background"
        raise PressError(msg)
    trial = np.cumsum(np.diff(touches, prepend=-np.inf) > IMAGES.pause_s)
    presses = pd.DataFrame({"trial": trial, "time_s": touches})
    near_s = IMAGES.pause_s / 2
    log = pd.merge_asof(log, presses, on="time_s", direction="nearest", tolerance=near_s)
    log = log.dropna(subset=["trial", "volume_mm3", "force_normal_n"]).dropna(axis=1, how="all")
    warnings += _bound_warnings(recording.name, int(read["lower_bound"].eq(True).sum()))
    shares = (read["volume_stderr_mm3"] / read["volume_mm3"])[volume > 0]
    frame = log.astype({"trial": int})
    return MeasuredLog(frame, reader.dot_pitch_mm, float(shares.median()), tuple(warnings))


def _bound_warnings(where: str, count: int) -> list[str]:
    why = "where the contact is steeper than the table reaches"
    fix = "press less deep, with a larger ball, or give a table that reaches further"
    return [f"{where}: the volumes of {count} pictures are too low, {why}; {fix}"] * (count > 0)


def _ball_volume(
    folder: PressFolder, index: int, picture: Image, hidden: BoolArray | None
) -> tuple[float, str]:
    """Volume below the contact circle, the ball's cap and the dome's; or 0 and what is wrong."""
    circle_px = float(folder.numbers("contact_radius_px")[index])
    if not np.isfinite(circle_px):
        circle = find_circle(picture, folder.background, hidden)
        if circle.problem:
            return 0.0, circle.problem
        circle_px = circle.edge_px
    circle_mm = circle_px * folder.mm_per_px
    radius_mm = folder.numbers("radius_mm")[index]
    volume = float(cap_volume_from_circle_mm3(circle_mm, radius_mm))
    if folder.dome_radius_mm > 0:
        volume += float(cap_volume_from_circle_mm3(circle_mm, folder.dome_radius_mm))
    return volume, ""


def _with_trials(folder: PressFolder) -> pd.DataFrame:
    """The list of pictures; where it has no trials, pictures of one press are a trial."""
    if "trial" in folder.table:
        return folder.table
    count = len(folder.table)
    trial = grouped(
        (folder.picture(index) for index in range(count)),
        folder.background,
        circle_px=np.column_stack([folder.numbers(name) for name in COORDINATES]),
        stage_px=np.column_stack([folder.numbers(name) for name in STAGE]) / folder.mm_per_px,
        ball_radius_mm=folder.numbers("radius_mm"),
        trial=np.full(count, np.nan),
    )
    return folder.table.assign(trial=trial)


def _log_frame(rows: pd.DataFrame, volumes: FloatArray) -> pd.DataFrame:
    """Columns that a press log shares with the list of images, and all its covariates."""
    frame = rows.drop(columns=["file", *COORDINATES], errors="ignore")
    frame["trial"] = frame["trial"].astype(int)
    if "time_s" not in frame:
        frame["time_s"] = np.arange(len(rows), dtype=float)
    frame["volume_mm3"] = volumes
    return frame


def _marker_sums(folder: PressFolder, frame: pd.DataFrame, dots: Dots) -> FloatArray:
    """Sum of the dots' motion (N, 2), mm, followed through each trial's pictures in time order."""
    sums = np.zeros((len(frame), 2))
    for _, trial in frame.groupby("trial"):
        order = trial.sort_values("time_s", kind="stable").index.tolist()
        motion, _ = follow(dots, [folder.picture(i) for i in order])
        sums[order] = motion.sum(axis=1) * folder.mm_per_px
    return sums
