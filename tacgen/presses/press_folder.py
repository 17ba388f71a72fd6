"""Press images: a folder of pictures with a list, or Taxim's ``dataPack.npz``."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.errors import PressError
from tacgen.core.files import sha256_of
from tacgen.core.records import PRESSES, similar_columns
from tacgen.core.safe_io import IMAGE_SUFFIXES, check_archive, read_rgb, rgb_of_array
from tacgen.core.schema import read_yaml
from tacgen.core.types import BoolArray, FloatArray
from tacgen.presses.lab_table import (
    missing_columns,
    read_table,
    trial_number_problems,
)
from tacgen.presses.press_images import PressImages
from tacgen.presses.press_log import SHEAR_FORCES
from tacgen.presses.rules import IMAGES

COORDINATES = ("center_x_px", "center_y_px", "contact_radius_px")
STAGE = ("x_mm", "y_mm")
"""Where a stage says a press was: a ruler for the scale."""

NUMBERS = ("radius_mm", *COORDINATES, *STAGE, "trial", "time_s", "force_normal_n", *SHEAR_FORCES)

WITH_BALLS = ("file", "radius_mm")
WITH_FORCES = ("file", "force_normal_n")
"""What a list of presses needs: for a table, and for a press log."""

TAXIM_FULL_MM_PER_PX, TAXIM_FULL_WIDTH_PX = 0.0295, 640
"""Scale of Taxim's sensor at its full width; a smaller picture of it has larger pixels."""

TAXIM_BALL_RADIUS_MM = 2.0  # Source: Taxim, branch data-collection: a ball of 4 mm diameter

_DATAPACK = ("f0", "imgs", "touch_center", "touch_radius")


@dataclass(frozen=True, slots=True)
class PressFolder:
    """A folder of press images, read and checked; pictures are loaded on demand."""

    path: Path
    table: pd.DataFrame  # presses.csv, one row a press: known columns as numbers, others as text
    background: NDArray[np.uint8]  # (H, W, 3), RGB, the gel with nothing on it
    mm_per_px: float
    dome_radius_mm: float = 0.0  # 0 for a flat gel
    sensor: str = ""
    dot_pitch_mm: float = 0.0  # 0 where it is not known
    sources: tuple[str, ...] = ()  # names of the background and, if there is one, of the list

    def numbers(self, name: str) -> FloatArray:
        """A column (N,); NaN where it is empty or absent."""
        if name not in self.table:
            return np.full(len(self.table), np.nan)
        return np.asarray(self.table[name].to_numpy(np.float64))

    def picture(self, index: int) -> NDArray[np.uint8]:
        """One picture (H, W, 3), RGB.

        Raises ``PressError`` where it cannot be read or is of another size than the background.
        """
        path = self.path / self.table["file"].iloc[index]
        image = read_rgb(path, PressError)
        if image.shape != self.background.shape:
            (height, width, _), (rows, columns, _) = image.shape, self.background.shape
            sizes = f"{width}×{height} px, the background {columns}×{rows}"
            row = f"(row {index + 2}) " if "presses.csv" in self.sources else ""
            msg = f"{path}: {row}is {sizes}: take all at one resolution"
            raise PressError(msg)
        return image


def read_press_folder(
    path: Path,
    required: tuple[str, ...] = WITH_BALLS,
    *,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
) -> PressFolder:
    """Read the background, ``presses.csv`` and ``sensor.yaml`` of a folder.

    ``required`` are the columns that the list must have; ``mm_per_px`` and ``ball_radius_mm``
    replace what the files hold. Without a list every picture but the background is a press of a
    ball of ``ball_radius_mm``. The background is ``background.png``, or ``.jpg`` or ``.jpeg``.

    Raises ``PressError`` that lists everything that is missing or wrong.
    """
    path, problems = Path(path), []
    table_path, sensor_path = path / "presses.csv", path / "sensor.yaml"
    background_path, pictures = _pictures(path)
    is_listed = table_path.is_file()
    needs_list = not is_listed and (required != WITH_BALLS or ball_radius_mm is None)
    fixes = {
        background_path: "take a picture of the gel with nothing on it",
        table_path: f"list the presses in it: {', '.join(required)}"
        + ("; or give --ball-radius-mm, if all are of one ball" if required == WITH_BALLS else ""),
        sensor_path: "write `mm_per_px: <size of a pixel>` into it, or give --mm-per-px",
    }
    needed = {table_path: needs_list, sensor_path: mm_per_px is None}
    for file, fix in fixes.items():
        if needed.get(file, True) and not file.is_file():
            problems.append(f"{file}: missing; {fix}")
    sensor = (mm_per_px or np.nan, 0.0, "", 0.0)
    if sensor_path.is_file():
        sensor = _read_sensor(sensor_path, mm_per_px, problems)
    background, table = np.zeros((0, 0, 3), np.uint8), pd.DataFrame()
    if background_path.is_file():
        background = read_rgb(background_path, PressError)
        wide_mm = sensor[0] * background.shape[1]
        if not (np.isnan(wide_mm) or IMAGES.widths_mm[0] <= wide_mm <= IMAGES.widths_mm[1]):
            made = f"mm_per_px = {sensor[0]:g} makes the picture {wide_mm:.3g} mm wide"
            known = f"a tactile sensor sees {IMAGES.widths_mm[0]:g} to {IMAGES.widths_mm[1]:g} mm"
            problems.append(f"{sensor_path}: {made}; {known}: give the size of one pixel in mm")
    if is_listed:
        table = _read_list(table_path, required, ball_radius_mm, problems)
    elif not needs_list:
        table = pd.DataFrame({"file": pictures, "radius_mm": float(ball_radius_mm or 0.0)})
        first = table["radius_mm"].iloc[:1]
        problems += _radius_problems(first, first.isna(), Path("--ball-radius-mm"), True)
        if not pictures:
            problems.append(f"{path}: no picture beside the background; add the presses")
    PressError.raise_if(problems)
    sources = (background_path.name, *([table_path.name] if is_listed else []))
    return PressFolder(path, table, background, *sensor, sources)


def _pictures(folder: Path) -> tuple[Path, list[str]]:
    """The background of a folder, and the names of its other pictures."""
    files = folder.iterdir() if folder.is_dir() else ()
    found = sorted(
        one.name
        for one in files
        if one.suffix.lower() in IMAGE_SUFFIXES and not one.name.startswith(".") and one.is_file()
    )
    backgrounds = [name for name in found if Path(name).stem.lower() == "background"]
    backgrounds.sort(key=lambda name: not name.lower().endswith(".png"))
    background = folder / (backgrounds or ["background.png"])[0]
    return background, [name for name in found if name not in backgrounds]


def read_presses(
    path: Path, *, mm_per_px: float | None = None, ball_radius_mm: float | None = None
) -> PressImages:
    """Read the presses at ``path``, a folder or a ``dataPack.npz``.

    ``mm_per_px`` and ``ball_radius_mm`` replace what the files hold; for a dataPack, which holds
    neither, the default is Taxim's own sensor and ball.

    Raises ``PressError`` that lists everything that keeps the set from being read.
    """
    path = Path(path)
    for name, value in (("mm_per_px", mm_per_px), ("ball_radius_mm", ball_radius_mm)):
        if value is not None and not (np.isfinite(value) and value > 0):
            msg = f"{name} = {value:g} must be a positive number"
            raise PressError(msg)
    if path.is_dir():
        return _images_of(
            read_press_folder(path, mm_per_px=mm_per_px, ball_radius_mm=ball_radius_mm)
        )
    if path.is_file():
        return _read_datapack(path, mm_per_px, ball_radius_mm)
    fix = "give a folder of pictures with background.png, or a Taxim dataPack.npz"
    msg = f"{path}: there are no presses; {fix}"
    raise PressError(msg)


def _read_datapack(
    path: Path, mm_per_px: float | None, ball_radius_mm: float | None
) -> PressImages:
    try:
        check_archive(path)
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in _DATAPACK if name not in archive.files]
            if missing:
                msg = f"{path}: not a Taxim dataPack: {', '.join(missing)} missing"
                raise PressError(msg)
            arrays = {name: archive[name] for name in _DATAPACK}
            names = _names_of(archive, np.atleast_1d(arrays["imgs"]).shape[0])
    except (OSError, ValueError, BadZipFile) as error:
        fix = "arrays of Python objects can run code and are not read: save them as plain arrays"
        msg = f"{path}: cannot be read as a dataPack ({error}); {fix}"
        raise PressError(msg) from None
    problems = _datapack_problems(path, arrays)
    PressError.raise_if(problems)
    count, height, width = arrays["imgs"].shape[:3]
    stacked = arrays["imgs"].reshape(count * height, width, 3)
    stacked = rgb_of_array(stacked[..., ::-1], f"{path}: imgs", PressError)
    images = stacked.reshape(count, height, width, 3)
    warnings = []
    if mm_per_px is None:
        mm_per_px = TAXIM_FULL_MM_PER_PX * TAXIM_FULL_WIDTH_PX / width
        warnings.append(
            f"mm_per_px is not in a dataPack; taken as {mm_per_px:.4f} (Taxim's "
            f"{TAXIM_FULL_MM_PER_PX} at {TAXIM_FULL_WIDTH_PX} px); --mm-per-px sets it"
        )
    if ball_radius_mm is None:
        ball_radius_mm = TAXIM_BALL_RADIUS_MM
        taken = f"taken as {ball_radius_mm:g} mm; --ball-radius-mm sets it"
        warnings.append(f"the ball's radius is not in a dataPack; {taken}")
    return PressImages(
        images=images,
        background=rgb_of_array(arrays["f0"][..., ::-1], f"{path}: f0", PressError),
        names=names,
        center_px=arrays["touch_center"].astype(np.float64),
        radius_px=arrays["touch_radius"].astype(np.float64).reshape(count),
        ball_radius_mm=np.full(count, ball_radius_mm),
        mm_per_px=float(mm_per_px),
        sensor="taxim",
        warnings=tuple(warnings),
        sha256={path.name: sha256_of(path)},
    )


def _names_of(archive: np.lib.npyio.NpzFile, count: int) -> tuple[str, ...]:
    """The names in a dataPack; numbers where there are none or they are Python objects."""
    try:
        names = tuple(str(name) for name in np.ravel(archive["names"]))
    except (KeyError, ValueError):
        names = ()
    return names if len(names) == count else tuple(f"imgs[{k}]" for k in range(count))


def _datapack_problems(path: Path, arrays: dict[str, NDArray[Any]]) -> list[str]:
    images = arrays["imgs"]
    if images.ndim != 4 or images.shape[-1] != 3:
        return [f"{path}: imgs has shape {images.shape}, not (N, H, W, 3)"]
    count = len(images)
    wanted = {"f0": images.shape[1:], "touch_center": (count, 2), "touch_radius": (count,)}
    found = {name: arrays[name].shape for name in wanted}
    found["touch_radius"] = (arrays["touch_radius"].size,)
    return [
        f"{path}: {name} has shape {found[name]}, not {shape}: every press needs an image of the "
        "background's size, a centre and a radius"
        for name, shape in wanted.items()
        if found[name] != shape
    ]


def _images_of(folder: PressFolder) -> PressImages:
    images, problems = [], []
    for index in range(len(folder.table)):
        try:
            images.append(folder.picture(index))
        except PressError as error:
            problems.append(str(error))
    PressError.raise_if(problems)
    names = tuple(folder.table["file"])
    listing = str(folder.path / "presses.csv")
    return PressImages(
        images=np.stack(images),
        background=folder.background,
        names=names,
        center_px=np.column_stack([folder.numbers(name) for name in COORDINATES[:2]]),
        radius_px=folder.numbers("contact_radius_px"),
        ball_radius_mm=folder.numbers("radius_mm"),
        mm_per_px=folder.mm_per_px,
        dome_radius_mm=folder.dome_radius_mm,
        sensor=folder.sensor,
        stage_mm=np.column_stack([folder.numbers(name) for name in STAGE]),
        trial=folder.numbers("trial"),
        dot_pitch_mm=folder.dot_pitch_mm,
        warnings=tuple(similar_columns(folder.table.columns, PRESSES, listing)),
        sha256={
            Path(name).name: sha256_of(folder.path / name) for name in (*folder.sources, *names)
        },
    )


def _read_sensor(
    path: Path, mm_per_px: float | None, problems: list[str]
) -> tuple[float, float, str, float]:
    """Scale (NaN where it is wrong), dome radius, name and pitch of the dots (0 for none)."""
    data = read_yaml(path).data
    scale: Any = mm_per_px if mm_per_px is not None else data.get("mm_per_px")
    dome: Any = data.get("dome_radius_mm") or 0.0
    for name, value, least in (("mm_per_px", scale, 1e-6), ("dome_radius_mm", dome, 0.0)):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not np.isfinite(value) or value < least:
            problems.append(f"{path}: {name} = {value!r} must be a positive number of mm")
            return np.nan, 0.0, "", 0.0
    markers = data.get("markers")
    pitch: Any = markers.get("pitch_mm") if isinstance(markers, dict) else None
    known = isinstance(pitch, (int, float)) and np.isfinite(pitch) and pitch > 0
    return float(scale), float(dome), str(data.get("name", "")), float(pitch) if known else 0.0


def _read_list(
    path: Path, required: tuple[str, ...], ball_radius_mm: float | None, problems: list[str]
) -> pd.DataFrame:
    """``presses.csv`` with every column."""
    table = read_table(path)
    is_given = ball_radius_mm is not None
    frame, wrong = table.with_numbers(n for n in NUMBERS if not (is_given and n == "radius_mm"))
    if is_given:
        frame["radius_mm"] = ball_radius_mm
    problems += missing_columns(frame, path, required, PRESSES)
    problems += wrong
    if "trial" in frame:
        problems += trial_number_problems(frame["trial"].to_numpy(), path, frame.index)
    if "radius_mm" in frame:
        empty = np.zeros(len(frame), bool) if is_given else table.cells["radius_mm"] == ""
        problems += _radius_problems(frame["radius_mm"], empty, path, "radius_mm" in required)
    if "file" in frame:
        problems += _file_problems(frame["file"], path)
    return frame.reset_index(drop=True)


def _radius_problems(
    radii: pd.Series, is_empty: BoolArray, path: Path, required: bool
) -> Iterator[str]:
    smallest, largest = IMAGES.balls_mm
    for (row, radius), empty in zip(radii.items(), is_empty, strict=True):
        where = f"{path}: row {row}: radius_mm"
        if radius < smallest or radius > largest:
            fix = f"give the radius in mm, {smallest:g} to {largest:g}"
            yield f"{where} = {radius:g} is not a ball's; {fix}"
        elif required and empty:
            yield f"{where} is empty; give the ball's radius in mm"


def _file_problems(names: pd.Series, path: Path) -> Iterator[str]:
    repeated = names.duplicated()
    for row, name in names.items():
        where = f"{path}: row {row}"
        if not name:
            yield f"{where}: file is empty; name the press's picture"
        elif repeated[row]:
            yield f"{where}: {name} is listed twice; list each press once"
        elif not os.path.isfile(path.parent / name):  # is_file raises on names too long
            missing = f"{path.parent / name}: missing (row {row} of presses.csv)"
            yield f"{missing}; add the picture or delete the row"
