"""Readers of press images: a folder of PNGs with a list, or Taxim's ``dataPack.npz``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.errors import PressError
from tacgen.core.files import sha256_of
from tacgen.core.safe_io import MAX_SIDE_PX, check_archive, read_bgr
from tacgen.core.yaml_source import read_yaml
from tacgen.presses.press_images import PressImages

COORDINATES = ("center_x_px", "center_y_px", "contact_radius_px")
STAGE = ("x_mm", "y_mm")
"""Where a stage says a press was: a ruler for the scale."""

COLUMNS = ("file", "radius_mm", *COORDINATES)

TAXIM_FULL_MM_PER_PX, TAXIM_FULL_WIDTH_PX = 0.0295, 640
"""Scale of Taxim's sensor at its full width; a smaller picture of it has larger pixels."""

TAXIM_BALL_RADIUS_MM = 2.0
"""Source: Taxim, branch data-collection: a ball of 4 mm diameter."""

BALLS_MM = (0.1, 200.0)
WIDTHS_MM = (1.0, 150.0)
"""What ball radii and widths of a picture can be; others are in another unit."""

_DATAPACK = ("f0", "imgs", "touch_center", "touch_radius")


def read_presses(
    path: Path, *, mm_per_px: float | None = None, ball_radius_mm: float | None = None
) -> PressImages:
    """Read the presses at ``path``, a folder or a ``dataPack.npz``, as they stand in the files.

    ``mm_per_px`` and ``ball_radius_mm`` replace what the files say; for a dataPack, which says
    neither, the default is Taxim's own sensor and ball.

    Raises
    ------
    PressError
        Lists everything that keeps the set from being read.
    """
    path = Path(path)
    for name, value in (("mm_per_px", mm_per_px), ("ball_radius_mm", ball_radius_mm)):
        if value is not None and not (np.isfinite(value) and value > 0):
            msg = f"{name} = {value:g} must be a positive number"
            raise PressError(msg)
    if path.is_dir():
        return _read_folder(path, mm_per_px, ball_radius_mm)
    if path.is_file():
        return _read_datapack(path, mm_per_px, ball_radius_mm)
    msg = (
        f"{path}: there are no presses; give a folder with background.png, presses.csv and "
        "sensor.yaml, or a Taxim dataPack.npz"
    )
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
            names = _names_of(archive, len(arrays["imgs"]))
    except (OSError, ValueError, BadZipFile) as error:
        msg = (
            f"{path}: cannot be read as a dataPack ({error}); arrays of Python objects are not "
            "read because they can run code: save them as plain arrays"
        )
        raise PressError(msg) from None
    problems = _datapack_problems(path, arrays)
    if problems:
        raise PressError.from_problems(problems)
    images = np.ascontiguousarray(arrays["imgs"][..., ::-1].astype(np.uint8))
    count, _, width = images.shape[:3]
    warnings = []
    if mm_per_px is None:
        mm_per_px = TAXIM_FULL_MM_PER_PX * TAXIM_FULL_WIDTH_PX / width
        warnings.append(
            f"mm_per_px is not in a dataPack; taken as {mm_per_px:.4f} (Taxim's "
            f"{TAXIM_FULL_MM_PER_PX} at {TAXIM_FULL_WIDTH_PX} px); --mm-per-px sets it"
        )
    if ball_radius_mm is None:
        ball_radius_mm = TAXIM_BALL_RADIUS_MM
        warnings.append(
            f"the ball's radius is not in a dataPack; taken as {ball_radius_mm:g} mm; "
            "--ball-radius-mm sets it"
        )
    return PressImages(
        images=images,
        background=np.ascontiguousarray(arrays["f0"][..., ::-1].astype(np.uint8)),
        names=names,
        center_px=arrays["touch_center"].astype(np.float64),
        radius_px=arrays["touch_radius"].astype(np.float64).reshape(count),
        ball_radius_mm=np.full(count, ball_radius_mm),
        mm_per_px=float(mm_per_px),
        sensor="taxim",
        found=np.zeros(count, dtype=bool),
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


def _datapack_problems(path: Path, arrays: dict[str, NDArray]) -> list[str]:
    images, reference = arrays["imgs"], arrays["f0"]
    problems = []
    if images.ndim != 4 or images.shape[-1] != 3:
        return [f"{path}: imgs has shape {images.shape}, not (N, H, W, 3)"]
    if reference.shape != images.shape[1:]:
        problems.append(
            f"{path}: f0 has shape {reference.shape}, the images {images.shape[1:]}: the "
            "background must be of the same size"
        )
    if arrays["touch_center"].shape != (len(images), 2):
        problems.append(
            f"{path}: touch_center has shape {arrays['touch_center'].shape}, not ({len(images)}, 2)"
        )
    if arrays["touch_radius"].size != len(images):
        problems.append(
            f"{path}: touch_radius has {arrays['touch_radius'].size} entries for "
            f"{len(images)} images"
        )
    return problems


def _read_folder(path: Path, mm_per_px: float | None, ball_radius_mm: float | None) -> PressImages:
    problems: list[str] = []
    sensor = read_sensor_file(path / "sensor.yaml", mm_per_px, problems)
    table = _read_list(path / "presses.csv", ball_radius_mm, problems)
    background = _read_image(path / "background.png", "the gel with nothing on it", problems)
    images, rows = [], []
    if table is not None:
        for row, name in zip(table.index, table["file"], strict=True):
            file = path / str(name)
            image = _read_image(file, f"row {row} of presses.csv", problems)
            if image is None:
                continue
            if background is not None and image.shape != background.shape:
                problems.append(
                    f"{file}: (row {row}) is {image.shape[1]}×{image.shape[0]} px, the background "
                    f"{background.shape[1]}×{background.shape[0]}: take all at one resolution"
                )
            images.append(image)
            rows.append(row)
    if background is not None and sensor is not None:
        problems += scale_problems(path / "sensor.yaml", sensor[0], background.shape[1])
    if problems or table is None or background is None or sensor is None:
        raise PressError.from_problems(problems)
    scale, dome, name, pitch = sensor
    kept = table.loc[rows]
    files = [path / str(file) for file in kept["file"]]
    return PressImages(
        images=np.stack(images),
        background=background,
        names=tuple(str(file) for file in kept["file"]),
        center_px=kept[["center_x_px", "center_y_px"]].to_numpy(np.float64),
        radius_px=kept["contact_radius_px"].to_numpy(np.float64),
        ball_radius_mm=kept["radius_mm"].to_numpy(np.float64),
        mm_per_px=scale,
        dome_radius_mm=dome,
        sensor=name,
        stage_mm=kept[list(STAGE)].to_numpy(np.float64),
        dot_pitch_mm=pitch,
        found=np.zeros(len(kept), dtype=bool),
        sha256={
            file.name: sha256_of(file)
            for file in (path / "background.png", path / "presses.csv", *files)
        },
    )


def scale_problems(path: Path, mm_per_px: float, width_px: int) -> list[str]:
    """What is wrong with a scale that makes the picture wider or narrower than a sensor sees."""
    wide = mm_per_px * width_px
    if WIDTHS_MM[0] <= wide <= WIDTHS_MM[1]:
        return []
    return [
        f"{path}: mm_per_px = {mm_per_px:g} makes the picture {wide:.3g} mm wide; a tactile sensor "
        f"sees {WIDTHS_MM[0]:g} to {WIDTHS_MM[1]:g} mm: give the size of one pixel in mm"
    ]


def read_sensor_file(
    path: Path, mm_per_px: float | None, problems: list[str]
) -> tuple[float, float, str, float] | None:
    """Scale, dome radius, name and pitch of the printed dots (0 where there are none)."""
    if not path.is_file():
        if mm_per_px is not None:
            return mm_per_px, 0.0, "", 0.0
        problems.append(f"{path}: missing; write `mm_per_px: <size of a pixel>` into it")
        return None
    data = read_yaml(path).data
    scale: Any = mm_per_px if mm_per_px is not None else data.get("mm_per_px")
    dome: Any = data.get("dome_radius_mm") or 0.0
    for name, value, least in (("mm_per_px", scale, 1e-6), ("dome_radius_mm", dome, 0.0)):
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not np.isfinite(value) or value < least:
            problems.append(f"{path}: {name} = {value!r} must be a positive number of mm")
            return None
    markers = data.get("markers")
    pitch: Any = markers.get("pitch_mm") if isinstance(markers, dict) else None
    known = isinstance(pitch, (int, float)) and np.isfinite(pitch) and pitch > 0
    return float(scale), float(dome), str(data.get("name", "")), float(pitch) if known else 0.0


def _read_list(
    path: Path, ball_radius_mm: float | None, problems: list[str]
) -> pd.DataFrame | None:
    """``presses.csv`` with every column, indexed by the row of the file (the header is row 1)."""
    if not path.is_file():
        problems.append(f"{path}: missing; list the presses in it: {', '.join(COLUMNS)}")
        return None
    try:
        table = pd.read_csv(path, skipinitialspace=True)
    except (ValueError, UnicodeDecodeError) as error:
        problems.append(f"{path}: cannot be read as CSV: {error}")
        return None
    table.index = pd.RangeIndex(2, len(table) + 2)
    table.columns = [str(name).strip() for name in table.columns]
    if ball_radius_mm is not None:
        table["radius_mm"] = ball_radius_mm
    missing = [name for name in ("file", "radius_mm") if name not in table]
    if missing:
        problems.append(
            f"{path}: column {' and '.join(missing)} missing; it needs `file` and `radius_mm` "
            f"(the ball's radius), and may have {', '.join(COORDINATES)}"
        )
        return None
    if len(table) == 0:
        problems.append(f"{path}: lists no presses")
        return None
    for name in (*COORDINATES, *STAGE):
        if name not in table:
            table[name] = np.nan
    for name in ("radius_mm", *COORDINATES, *STAGE):
        numbers = pd.to_numeric(table[name], errors="coerce")
        wrong = table.index[numbers.isna() & table[name].notna()]
        problems += [
            f"{path}: row {row}: {name} = {table.loc[row, name]!r} is no number" for row in wrong
        ]
        table[name] = numbers.replace([np.inf, -np.inf], np.nan)
    balls = table["radius_mm"]
    problems += [
        f"{path}: row {row}: radius_mm is {'empty' if np.isnan(balls[row]) else balls[row]}; give "
        "the ball's radius in mm"
        for row in table.index[~(balls > 0)]
    ]
    problems += [
        f"{path}: row {row}: radius_mm = {balls[row]:g} is no ball that a gel can feel; give the "
        f"radius in mm, {BALLS_MM[0]:g} to {BALLS_MM[1]:g}"
        for row in table.index[(balls > 0) & ~balls.between(*BALLS_MM)]
    ]
    empty = table.index[table["file"].isna()]
    problems += [f"{path}: row {row}: file is empty" for row in empty]
    doubled = table.index[table["file"].duplicated() & table["file"].notna()]
    problems += [
        f"{path}: row {row}: {table.loc[row, 'file']} is listed twice; list each press once"
        for row in doubled
    ]
    return table.drop(index=empty)


def _read_image(path: Path, what: str, problems: list[str]) -> NDArray[np.uint8] | None:
    """An image as RGB (H, W, 3) uint8."""
    if not os.path.isfile(path):
        problems.append(f"{path}: missing ({what})")
        return None
    image = read_bgr(path)
    if image is None:
        problems.append(
            f"{path}: cannot be read as an image of at most {MAX_SIDE_PX} pixels a side ({what})"
        )
        return None
    return np.ascontiguousarray(image[..., ::-1])
