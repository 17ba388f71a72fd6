"""Press images with forces: the camera's pictures and the gauge's readings to a press log.

Volume comes from the gel's shape, reconstructed by a lookup table, or from the contact circle of
a ball of known radius; shear from the sum of the tracked markers' motion.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from tacgen.core.errors import PressError
from tacgen.core.types import BoolArray, FloatArray
from tacgen.optics.dots import MIN_TRACKED, Dots, Image, dots_at_rest, dots_in, find_spots, follow
from tacgen.optics.reconstruct import Reconstructor
from tacgen.optics.table import LookupTable
from tacgen.presses.circles import find_circle
from tacgen.presses.experiments import grouped
from tacgen.presses.geometry import cap_volume_from_circle_mm3
from tacgen.presses.press_folder import COORDINATES, STAGE, PressFolder


@dataclass(frozen=True, slots=True)
class MeasuredLog:
    """The press log of a folder of images, how its volumes were found, and warnings.

    ``volume_stderr_share`` is the typical relative standard error of a volume by a table, whose
    error is alike in all of them; 0 without a table. ``marker_pitch_mm`` is that of the dots whose
    motion was summed, NaN without dots: as the folder has it, or as the gel at rest shows it.
    """

    frame: pd.DataFrame
    method: str
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
    if n_bounds:
        why = "where the contact is steeper than the table reaches"
        fix = "press less deep, with a larger ball, or give a table that reaches further"
        warnings.append(f"{listing}: the volumes of {n_bounds} pictures are too low, {why}; {fix}")
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
    method = "table" if table is not None else "circle"
    shares = (stderrs / volumes)[(volumes > 0) & np.isfinite(stderrs)]
    share = float(np.median(shares)) if shares.size else 0.0
    return MeasuredLog(frame, method, pitch_mm, share, tuple(warnings))


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
