"""Recordings of a sensor, videos and folders of images, read picture by picture."""

import csv
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import SensorError, TableError
from tacgen.core.files import atomic_path
from tacgen.core.safe_io import IMAGE_SUFFIXES, read_rgb
from tacgen.report.figures import new_figure, thinned
from tacgen.sensor.read_image import ImageReader

VIDEO_SUFFIXES = (".mp4", ".avi", ".mov", ".mkv")
MOST_MISSING = 0.02
"""Share of the pictures that a video's header counts and that it need not have: encoders drop some
at the end; a video that was cut lacks more."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """A picture of a recording: its name, its time, s (NaN where unknown), and RGB (H, W, 3)."""

    name: str
    time_s: float
    rgb: NDArray[np.uint8]


def is_recording(path: Path) -> bool:
    """Whether a path is a folder of images, or a video."""
    return path.is_dir() or path.suffix.lower() in VIDEO_SUFFIXES


def pictures_of(path: Path) -> tuple[int, Iterator[Recorded]]:
    """How many pictures a recording states that it has, and these one by one.

    Raises ``SensorError`` if there are none, and, after the last one, if a video is cut.
    """
    if path.is_dir():
        files = sorted(f for f in path.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            msg = f"{path}: no images in it; give a folder of PNG or JPEG files, or a video"
            raise SensorError(msg)
        return len(files), (Recorded(f.name, math.nan, read_rgb(f, SensorError)) for f in files)
    video = cv2.VideoCapture(str(path)) if path.is_file() else None
    if video is None or not video.isOpened():
        what = "no such file" if video is None else "broken, cut, or in a format not known here"
        msg = f"{path}: {what}; give a video that `ffmpeg -i {path.name} whole.mp4` can convert"
        raise SensorError(msg)
    return max(int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0), _of_video(path, video)


def _of_video(path: Path, video: cv2.VideoCapture) -> Iterator[Recorded]:
    stated, count = int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0
    try:
        while True:
            time_s = video.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            is_read, bgr = video.read()
            if not is_read:
                break
            time_s = max(time_s, video.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)
            yield Recorded(f"{path.stem}_{count:06d}", time_s, np.ascontiguousarray(bgr[..., ::-1]))
            count += 1
    finally:
        video.release()
    if count < (1.0 - MOST_MISSING) * stated - 1 or not count:
        msg = f"{path}: it ends after {count} of {stated} pictures: broken or cut; record it anew"
        raise SensorError(msg)


def read_recording(
    reader: ImageReader, path: Path, out: Path, show: Callable[[int, int], None]
) -> dict[str, Any]:
    """Read every picture of a recording into the folder ``out``; returns a summary.

    ``readings.csv`` has one row a picture, with ``file`` and ``time_s``; ``depth.h5`` holds
    ``depth_mm`` (N, H, W) float32 and ``time_s`` (N,) in the same order; ``overview.png`` shows
    force and depth over time. All is written as it is read, in memory that does not grow with the
    recording but by its numbers. A picture that does not fit the sensor gets a row that says so;
    ``show`` is given how many were read, of how many.

    Raises ``SensorError`` if the recording is broken, or its first picture does not fit; what was
    read before is kept.
    """
    stated, pictures = pictures_of(path)
    height, width = reader.background_rgb.shape[:2]
    out.mkdir(parents=True, exist_ok=True)
    course: list[tuple[float, float, float]] = []
    columns, stopped = [], ""
    with (
        (out / "readings.csv").open("w", newline="", encoding="utf-8") as table,
        h5py.File(out / "depth.h5", "w") as depths,
    ):
        maps = depths.create_dataset(
            "depth_mm", (0, height, width), "f4", maxshape=(None, height, width),
            chunks=(1, height, width), compression="lzf", shuffle=True,
        )  # fmt: skip
        times = depths.create_dataset("time_s", (0,), "f8", maxshape=(None,), chunks=(1024,))
        writer = csv.writer(table)
        try:
            for picture in pictures:
                depth, row = _reading_of(reader, picture, is_first=not course)
                if not course:
                    columns = ["file", "time_s", *row]
                    writer.writerow(columns)
                row |= {"file": picture.name, "time_s": picture.time_s}
                writer.writerow([_text(row.get(name)) for name in columns])
                table.flush()
                count = len(course) + 1
                maps.resize(count, axis=0)
                times.resize(count, axis=0)
                maps[count - 1], times[count - 1] = depth, picture.time_s
                force, deep = (row.get(of) for of in ("force_normal_n", "indentation_mm"))
                force, deep = (math.nan if x is None else float(x) for x in (force, deep))
                course.append((picture.time_s, force, deep))
                show(count, max(stated, count))
        except SensorError as error:
            stopped = str(error)
    if course:
        _write_overview(np.array(course), out / "overview.png")
    if stopped:
        kept = f"; the readings of {len(course)} pictures are kept in {out}" if course else ""
        msg = f"{stopped}{kept}"
        raise SensorError(msg)
    forces = [force for _, force, _ in course if not math.isnan(force)]
    touched = sum(depth > 0 for *_, depth in course)
    return {
        "pictures": len(course),
        "with_contact": touched,
        "largest_force_n": max(forces, default=None),
        "file": str(out / "readings.csv"),
    }


def _reading_of(
    reader: ImageReader, picture: Recorded, *, is_first: bool
) -> tuple[NDArray[np.float32], dict[str, Any]]:
    """Depth (H, W) and numbers of a picture; of one that does not fit the reason alone."""
    try:
        reading = reader.read(picture.rgb)
    except (SensorError, TableError) as error:
        if is_first:
            msg = f"{picture.name}: {error}"
            raise SensorError(msg) from None
        nothing = np.full(reader.background_rgb.shape[:2], math.nan, np.float32)
        return nothing, {"message": str(error)}
    return reading.depth_mm.astype(np.float32), reading.summary()


def _text(value: Any) -> Any:
    """A cell of the table; empty for what is not known."""
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value


def _write_overview(course: NDArray[np.float64], path: Path) -> None:
    """Force and depth over the time, or the number, of each picture (n, 3)."""
    figure, grid = new_figure(8.0, 5.0, 2, sharex=True)
    upper, lower = grid[:, 0]
    course = course[thinned(len(course))]
    timed = not np.isnan(course[:, 0]).all()
    along = course[:, 0] if timed else np.arange(len(course))
    upper.plot(along, course[:, 1], lw=1)
    lower.plot(along, course[:, 2], lw=1)
    upper.set_ylabel("normal force, N")
    lower.set_ylabel("depth, mm")
    lower.set_xlabel("time, s" if timed else "picture")
    with atomic_path(path) as partial:
        figure.savefig(partial, format="png", dpi=120)
