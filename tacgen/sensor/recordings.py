"""Recordings of a sensor, folders of images, videos, bags and cameras, read picture by picture."""

import csv
import math
import signal
import time
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from itertools import islice
from pathlib import Path
from types import FrameType
from typing import Any, TypeAlias

import cv2
import h5py
import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import SensorError, TableError, require_extra
from tacgen.core.files import atomic_path
from tacgen.core.progress import print_status
from tacgen.core.safe_io import IMAGE_SUFFIXES, read_rgb
from tacgen.report.figures import new_figure, thinned
from tacgen.sensor.bags import open_bag
from tacgen.sensor.read_image import ImageReader
from tacgen.sensor.recorded import Recorded, Recording

VIDEO_SUFFIXES = (".mp4", ".avi", ".mov", ".mkv")
BAG_SUFFIXES = (".mcap", ".db3", ".bag", ".zstd")
MOST_MISSING = 0.02
"""Share of the pictures that a video's header counts and that it need not have: encoders drop some
at the end; a video that was cut lacks more."""
REST_PICTURES = 10
"""Whose median is the gel at rest: less than half a second, and a third of one's noise."""
WRENCH_COLUMNS = ("wrench_x_n", "wrench_y_n", "wrench_z_n")
"""The gauge's force at a picture's time, in the gauge's axes."""


Watch: TypeAlias = Callable[[Recorded, NDArray[np.float32], dict[str, Any]], None]
"""What is shown each picture, with its depth (H, W), mm, and its row."""


def is_recording(path: Path) -> bool:
    """Whether a path is a folder of images, a video or a bag."""
    return path.is_dir() or path.suffix.lower() in (*VIDEO_SUFFIXES, *BAG_SUFFIXES)


def bag_files(path: Path) -> list[Path]:
    """The files of a bag, which may be a folder, in the order of their numbers; none of another."""
    files = [*path.iterdir()] if path.is_dir() else [path]
    bags = (file for file in files if file.suffix.lower() in BAG_SUFFIXES)
    return sorted(bags, key=lambda file: (len(file.name), file.name))


def open_recording(path: Path, topics: Sequence[str] = ()) -> Recording:
    """A recording; ``topics`` are those of a bag with its pictures and forces, or the only ones.

    Raises ``SensorError`` if there are no pictures, or several topics to choose from.
    """
    if not path.exists():
        msg = f"{path}: no such file; give a folder of images, a video or a bag"
        raise SensorError(msg)
    if files := bag_files(path):
        return open_bag(path, files, topics)
    if topics:
        msg = f"{path}: --topic {topics[0]}: only a bag has topics"
        raise SensorError(msg)
    if path.is_dir():
        files = sorted(f for f in path.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            msg = f"{path}: no images in it; give a folder of PNG or JPEG files, a video or a bag"
            raise SensorError(msg)
        pictures = (Recorded(f.name, math.nan, read_rgb(f, SensorError)) for f in files)
        return Recording(str(path), len(files), pictures)
    video = cv2.VideoCapture(str(path))
    if not video.isOpened():
        what = "broken, cut, or in a format not known here"
        msg = f"{path}: {what}; give a video that `ffmpeg -i {path.name} whole.mp4` can convert"
        raise SensorError(msg)
    stated = max(int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
    return Recording(str(path), stated, _of_video(path, video, stated))


def _of_video(path: Path, video: cv2.VideoCapture, stated: int) -> Generator[Recorded]:
    count = 0
    for time_s, rgb in _frames_of(video):
        yield Recorded(f"{path.stem}_{count:06d}", time_s, rgb)
        count += 1
    if _is_cut(count, stated):
        msg = f"{path}: it ends after {count} of {stated} pictures: broken or cut; record it anew"
        raise SensorError(msg)


def _is_cut(count: int, stated: int) -> bool:
    return count < (1.0 - MOST_MISSING) * stated - 1 or not count


def _frames_of(video: cv2.VideoCapture) -> Generator[tuple[float, NDArray[np.uint8]]]:
    """Times, s, and pictures (H, W, 3), RGB, up to the last that can be read."""
    try:
        while True:
            time_s = video.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            is_read, bgr = video.read()
            if not is_read:
                return
            time_s = max(time_s, video.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)
            yield time_s, np.ascontiguousarray(bgr[..., ::-1])
    finally:
        video.release()


def open_camera(name: str, background_rgb: NDArray[np.uint8] | None) -> Recording:
    """The pictures of a camera: its number, or what else OpenCV opens (a video, an address).

    Without a background the first pictures are of the gel at rest. The recording ends with a video,
    or at Ctrl-C; where the camera stops, with ``SensorError``. Raises it too if it gives none.
    """
    cv2.utils.logging.setLogLevel(0)  # what it says of a missing camera is said below
    pictures = _as_they_come(name, cv2.VideoCapture(int(name) if name.isdecimal() else name))
    if background_rgb is None:
        at_rest = [next(pictures).rgb]  # a missing camera is reported first
        print_status(f"camera {name}: touch nothing: {REST_PICTURES} pictures of the gel at rest")
        at_rest += [picture.rgb for picture in islice(pictures, REST_PICTURES - 1)]
        if len(at_rest) < REST_PICTURES:
            msg = f"camera {name}: {len(at_rest)} pictures make no background; start again"
            raise SensorError(msg)
        background_rgb = np.rint(np.median(at_rest, axis=0)).astype(np.uint8)
    print_status(f"camera {name}: reading; Ctrl-C ends it")
    return Recording(name, 0, pictures, background_rgb)


def _as_they_come(name: str, video: cv2.VideoCapture) -> Generator[Recorded]:
    count, stated = 0, int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    asked: list[int] = []

    def ask(number: int, _frame: FrameType | None) -> None:
        asked.append(number)
        signal.signal(signal.SIGINT, before)  # a second time at once

    before = signal.signal(signal.SIGINT, ask)
    try:
        for _, rgb in _frames_of(video):
            if asked:
                return
            yield Recorded(f"{count:06d}", time.time(), rgb)
            count += 1
    finally:
        signal.signal(signal.SIGINT, before)
    if not asked and (stated <= 0 or _is_cut(count, stated)):
        what = f"it stopped after {count} pictures" if count else "it gives no picture"
        msg = f"camera {name}: {what}; connect it, see that no other program has it, start again"
        raise SensorError(msg)


def readings_of(
    reader: ImageReader, recording: Recording
) -> Generator[tuple[Recorded, NDArray[np.float32], dict[str, Any]]]:
    """Each picture, its depth (H, W), mm, and its row: its numbers, and the gauge's at its time.

    A picture that does not fit the sensor has a ``message`` that says so and no numbers. Raises
    ``SensorError`` if that is the first one, or the recording is broken.
    """
    is_first = True
    with closing(recording.pictures) as pictures:
        for picture in pictures:
            depth, numbers = _reading_of(reader, picture, is_first=is_first)
            row = {"file": picture.name, "time_s": picture.time_s, **numbers}
            if recording.wrench is not None:
                force_n = recording.wrench.at(np.array(picture.time_s)).tolist()
                row |= dict(zip(WRENCH_COLUMNS, force_n, strict=True))
            yield picture, depth, row
            is_first = False


def read_recording(
    reader: ImageReader,
    source: Recording | Path,
    out: Path,
    show: Callable[[int, int, str], None],
    watch: Watch | None = None,
) -> dict[str, Any]:
    """Read every picture of a recording into the folder ``out``; returns a summary.

    ``readings.csv`` has one row a picture, with ``file`` and ``time_s`` and, of a bag with a
    gauge, the force beside it; ``depth.h5`` holds ``depth_mm`` (N, H, W) float32 and ``time_s``
    (N,) in the same order; ``overview.png`` shows force and depth over time. All is written as it
    is read, in memory that does not grow with the recording but by its numbers. A picture that does
    not fit the sensor gets a row that says so; ``show`` is given how many were read, of how many (0
    where unknown), and what the last one shows.

    Raises ``SensorError`` if the recording is broken, or its first picture does not fit; what was
    read before is kept.
    """
    recording = source if isinstance(source, Recording) else open_recording(source)
    height, width = reader.background_rgb.shape[:2]
    out.mkdir(parents=True, exist_ok=True)
    course: list[tuple[float, float, float]] = []
    columns, stopped = [], ""
    with (
        (out / "readings.csv").open("w", newline="", encoding="utf-8") as table,
        h5py.File(out / "depth.h5", "w") as depths,
        closing(readings_of(reader, recording)) as readings,
    ):
        maps = depths.create_dataset(
            "depth_mm", (0, height, width), "f4", maxshape=(None, height, width),
            chunks=(1, height, width), compression="lzf", shuffle=True,
        )  # fmt: skip
        times = depths.create_dataset("time_s", (0,), "f8", maxshape=(None,), chunks=(1024,))
        writer = csv.writer(table)
        try:
            for picture, depth, row in readings:
                if not course:
                    columns = [*row]
                    writer.writerow(columns)
                writer.writerow([_text(row.get(name)) for name in columns])
                table.flush()
                count = len(course) + 1
                maps.resize(count, axis=0)
                times.resize(count, axis=0)
                maps[count - 1], times[count - 1] = depth, picture.time_s
                force, deep = (row.get(of) for of in ("force_normal_n", "indentation_mm"))
                force, deep = (math.nan if x is None else float(x) for x in (force, deep))
                course.append((picture.time_s, force, deep))
                total = max(recording.stated, count) if recording.stated else 0
                show(count, total, f"{force:.2f} N, {deep:.2f} mm")
                if watch is not None:
                    watch(picture, depth, row)
        except SensorError as error:
            stopped = str(error)
    found = np.array(course)
    if course:
        _write_overview(found, out / "overview.png")
    if stopped:
        kept = f"; the readings of {len(course)} pictures are kept in {out}" if course else ""
        msg = f"{stopped}{kept}"
        raise SensorError(msg)
    forces = [force for _, force, _ in course if not math.isnan(force)]
    touched = sum(depth > 0 for *_, depth in course)
    summary = {
        "pictures": len(course),
        "with_contact": touched,
        "largest_force_n": max(forces, default=None),
        "file": str(out / "readings.csv"),
    }
    if recording.wrench is not None and course:
        lag_s = recording.wrench.lag_s(found[:, 0], found[:, 1])
        summary["wrench"] = recording.wrench.topic
        summary["wrench_lag_s"] = None if math.isnan(lag_s) else lag_s
    return summary


def summary_line(found: dict[str, Any]) -> str:
    """What ``read_recording`` returns as a line of text."""
    line = f"{found['file']}: {found['pictures']} pictures, {found['with_contact']} of a contact"
    if found["largest_force_n"] is not None:
        line += f", up to {found['largest_force_n']:.2f} N"
    if "wrench" in found:
        lag_s = found["wrench_lag_s"]
        line += f"; the lag of {found['wrench']} behind the pictures "
        line += "does not show" if lag_s is None else f"is {lag_s:.3f} s"
    return line


def rerun_viewer() -> Watch:
    """Open the Rerun viewer; returns what shows a picture, its depth and its numbers there.

    Raises ``SensorError`` if the extra ``view`` is missing.
    """
    require_extra("view", "--rerun needs", SensorError)
    import rerun as rr

    stream = rr.RecordingStream("tacgen")
    stream.spawn()

    def show(picture: Recorded, depth_mm: NDArray[np.float32], row: dict[str, Any]) -> None:
        if not math.isnan(picture.time_s):
            stream.set_time("time", timestamp=picture.time_s)
        stream.log("picture", rr.Image(picture.rgb))
        stream.log("depth", rr.DepthImage(depth_mm, meter=1.0))  # in mm
        for name in ("force_normal_n", "indentation_mm"):
            if row.get(name) is not None:
                stream.log(name, rr.Scalars(row[name]))

    return show


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
