"""Press images with forces: the camera's pictures and the gauge's readings to a press log.

Volume comes from the gel's shape, reconstructed by a lookup table, or from the contact circle of
a ball of known radius; shear from the sum of the tracked markers' motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.errors import PressError
from tacgen.core.safe_io import read_bgr
from tacgen.optics.reconstruct import Reconstructor
from tacgen.optics.table import LookupTable
from tacgen.presses.ball import cap_volume_from_circle_mm3
from tacgen.presses.circles import find_circle
from tacgen.presses.markers import MIN_DOTS, dot_mask, dot_places_px, dots_at_rest, follow
from tacgen.presses.press_folder import BALLS_MM, read_sensor_file, scale_problems
from tacgen.presses.press_log import SHEAR_FORCES, numeric_columns, read_table

Image = NDArray[np.uint8]
Floats = NDArray[Any]

CARRIED = ("trial", "time_s", "indenter", "radius_mm", "x_mm", "y_mm", "force_normal_n",
           *SHEAR_FORCES)  # fmt: skip
NUMBERS = ("radius_mm", "center_x_px", "center_y_px", "contact_radius_px", "trial", "time_s",
           "x_mm", "y_mm", "force_normal_n", *SHEAR_FORCES)  # fmt: skip


@dataclass(frozen=True, slots=True)
class ForceImages:
    """A folder of press images with forces, read and checked; pictures are loaded on demand."""

    folder: Path
    background: Image
    table: pd.DataFrame
    mm_per_px: float
    dome_radius_mm: float
    marker_pitch_mm: float

    def picture(self, index: int) -> Image:
        """One picture (H, W, 3), RGB.

        Raises
        ------
        PressError
            Where it cannot be read or is of another size than the background.
        """
        path = self.folder / str(self.table["file"].iloc[index])
        picture = _read_rgb(path)
        if picture.shape != self.background.shape:
            seen, wanted = picture.shape[1::-1], self.background.shape[1::-1]
            msg = (
                f"{path}: {seen[0]}×{seen[1]} px where background.png has {wanted[0]}×{wanted[1]}; "
                "take all with one camera setting"
            )
            raise PressError(msg)
        return picture


@dataclass(frozen=True, slots=True)
class MeasuredLog:
    """The press log of a set of images, how its volumes were found, and what was left out."""

    frame: pd.DataFrame
    method: str
    marker_pitch_mm: float
    warnings: tuple[str, ...]


def read_force_images(folder: Path) -> ForceImages:
    """Read ``presses.csv``, ``background.png`` and ``sensor.yaml`` of a folder.

    Raises
    ------
    PressError
        Listing what is missing or not a number.
    """
    folder = Path(folder)
    listing, sensor_file = folder / "presses.csv", folder / "sensor.yaml"
    missing = [str(path) for path in (listing, sensor_file, folder / "background.png")
               if not path.is_file()]  # fmt: skip
    if missing:
        msg = f"{folder}: no press images with forces: {', '.join(missing)} missing"
        raise PressError(msg)
    frame = read_table(listing)
    problems = [
        f"{listing}: column {name!r} is missing; {mend}"
        for name, mend in (
            ("file", "name each press's picture"),
            ("force_normal_n", "write the gauge's reading beside each picture"),
        )
        if name not in frame.columns
    ]
    numbers, cells = numeric_columns(frame, listing, NUMBERS)
    sensor = read_sensor_file(sensor_file, None, problems)
    if sensor is None:
        raise PressError.from_problems([*problems, *cells])
    mm_per_px, dome_radius_mm, _, pitch_mm = sensor
    background = _read_rgb(folder / "background.png")
    problems += scale_problems(sensor_file, mm_per_px, background.shape[1])
    problems += [*cells, *_row_problems(frame.assign(**numbers), listing)]
    if problems:
        raise PressError.from_problems(problems)
    return ForceImages(
        folder=folder,
        background=background,
        table=frame.assign(**numbers),
        mm_per_px=mm_per_px,
        dome_radius_mm=dome_radius_mm,
        marker_pitch_mm=pitch_mm or np.nan,
    )


def _row_problems(frame: pd.DataFrame, listing: Path) -> list[str]:
    """Pictures that are not there or listed twice, and radii that no ball has."""
    problems = []
    if "file" in frame:
        for index, name in enumerate(frame["file"]):
            if not (listing.parent / str(name)).is_file():
                problems.append(f"{listing}: row {index + 2}: {name} is not in the folder")
        problems += [
            f"{listing}: row {index + 2}: {frame['file'].iloc[index]} is listed twice; list each "
            "picture once"
            for index in np.nonzero(frame["file"].duplicated())[0]
        ]
    if "radius_mm" in frame:
        wrong = frame["radius_mm"].notna() & ~frame["radius_mm"].between(*BALLS_MM)
        problems += [
            f"{listing}: row {index + 2}: radius_mm = {radius:g} is no ball that a gel can feel; "
            f"give the radius in mm, {BALLS_MM[0]:g} to {BALLS_MM[1]:g}"
            for index, radius in enumerate(frame["radius_mm"])
            if wrong.iloc[index]
        ]
    return problems


def measure_presses(images: ForceImages, table: LookupTable | None = None) -> MeasuredLog:
    """Turn press images with forces into a press log.

    Parameters
    ----------
    images : ForceImages
    table : LookupTable, optional
        Of this sensor: volumes then come from the reconstructed shape. Without it they come from
        the contact circle, and ``radius_mm`` is needed.

    Raises
    ------
    PressError
        If there is neither a table nor a ball's radius, or no picture shows a contact.
    """
    warnings: list[str] = []
    rows = images.table.reset_index(drop=True)
    method = "table" if table is not None else "circle"
    if table is None and not ("radius_mm" in rows and np.isfinite(rows["radius_mm"]).any()):
        msg = (
            f"{images.folder / 'presses.csv'}: no radius_mm and no --table: the volume cannot be "
            "told from the pictures; give the ball's radius or the sensor's table.npz"
        )
        raise PressError(msg)
    if table is None:
        warnings.append(
            f"{images.folder}: volumes are from contact circles: a circle 2 % too wide is a volume "
            "8 % too large; --table gives better ones"
        )
    has_dots = len(dot_places_px(images.background)) >= MIN_DOTS
    reconstructor = (
        Reconstructor(table, images.background, images.dome_radius_mm) if table else None
    )
    at_rest = dot_mask(images.background) if has_dots else None
    volumes = np.full(len(rows), np.nan)
    for index in range(len(rows)):
        picture = images.picture(index)
        hidden = (dot_mask(picture) | at_rest) if at_rest is not None else None
        problem = "shows no contact"
        if reconstructor is not None:
            volumes[index] = reconstructor.shape_of(picture, hidden).volume_mm3
        else:
            volumes[index], problem = _ball_volume(images, rows.iloc[index], picture, hidden)
        if not volumes[index] > 0:
            warnings.append(
                f"{images.folder / 'presses.csv'}: row {index + 2}: {rows['file'][index]} "
                f"{problem}; left out: press again, or check background.png"
            )
    frame = _log_frame(rows, volumes)
    if has_dots:
        sums = _marker_sums(images, rows)
        frame["shear_x_mm"], frame["shear_y_mm"] = sums[:, 0], sums[:, 1]
    frame = frame[volumes > 0].reset_index(drop=True)
    if frame.empty:
        msg = f"{images.folder}: no picture shows a contact; check background.png"
        raise PressError(msg)
    return MeasuredLog(frame, method, images.marker_pitch_mm, tuple(warnings))


def _ball_volume(
    images: ForceImages, row: pd.Series, picture: Image, hidden: NDArray[np.bool_] | None
) -> tuple[float, str]:
    """Volume below the contact circle, the ball's cap and the dome's; or 0 and what is wrong."""
    circle_px = float(row.get("contact_radius_px", np.nan))
    if not np.isfinite(circle_px):
        circle = find_circle(picture, images.background, hidden)
        if circle.problem:
            return 0.0, circle.problem
        circle_px = circle.edge_px
    circle_mm = circle_px * images.mm_per_px
    volume = float(cap_volume_from_circle_mm3(circle_mm, row["radius_mm"]))
    if images.dome_radius_mm > 0:
        volume += float(cap_volume_from_circle_mm3(circle_mm, images.dome_radius_mm))
    return volume, ""


def _log_frame(rows: pd.DataFrame, volumes: Floats) -> pd.DataFrame:
    """Columns that a press log shares with the list of images, and all its covariates."""
    skipped = {"file", "center_x_px", "center_y_px", "contact_radius_px"}
    frame = rows[[name for name in rows.columns if name not in skipped]].copy()
    if "trial" not in frame:
        frame["trial"] = np.arange(len(rows))
    frame["trial"] = frame["trial"].astype(int)
    if "time_s" not in frame:
        frame["time_s"] = np.arange(len(rows), dtype=float)
    frame["volume_mm3"] = volumes
    return frame


def _marker_sums(images: ForceImages, rows: pd.DataFrame) -> Floats:
    """Sum of the dots' motion (N, 2), mm, followed through each trial's pictures in time order."""
    dots = dots_at_rest(images.background, str(images.folder / "background.png"))
    trials = rows["trial"] if "trial" in rows else pd.Series(np.arange(len(rows)))
    sums = np.zeros((len(rows), 2))
    for _, index in trials.groupby(trials).groups.items():
        order = list(index)
        if "time_s" in rows:
            order.sort(key=lambda i: float(rows["time_s"][i]))
        motion, _ = follow(dots, [images.picture(i) for i in order])
        sums[order] = motion.sum(axis=1) * images.mm_per_px
    return sums


def _read_rgb(path: Path) -> Image:
    bgr = read_bgr(path)
    if bgr is None:
        msg = f"{path}: cannot be read as an image; save it as PNG"
        raise PressError(msg)
    return np.ascontiguousarray(bgr[..., ::-1])
