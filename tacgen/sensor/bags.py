"""ROS 2 bags and MCAP files: the pictures and forces of their topics, without ROS.

A bag is a file (``.db3`` or, by the extra ``mcap``, ``.mcap``) or the folder that ``ros2 bag
record`` writes. It is read twice, for times and forces and for the pictures, so that a long one
takes no more memory than a short one.
"""

import sqlite3
import struct
import time
from collections import defaultdict
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from tacgen.core.errors import SensorError, require_extra
from tacgen.core.images import encode_png
from tacgen.core.safe_io import decode_rgb
from tacgen.sensor.recorded import Recorded, Recording, Wrench

REFUSED = {".bag": "a bag of ROS 1", ".zstd": "a bag packed as a whole"}
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
WRENCH = "geometry_msgs/msg/WrenchStamped"
LAYOUTS = {IMAGE: "iIsIIsBIb", COMPRESSED: "iIssb", WRENCH: "iIsdddddd"}
"""What a message holds, in the letters of :func:`_values`; first its stamp, s and ns, and frame."""
CHANNELS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0]}
"""Where red, green and blue are in a pixel, by the encodings that are read."""
MOST_GAP = 5.0
"""Median intervals of the forces that two of them may be apart for one to be read between them."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

PICTURE, BACKGROUND = "/tacgen/image/compressed", "/tacgen/background/compressed"
"""Topics of what ``tacgen read --record`` writes: a camera's pictures, and the gel at rest."""
_PART = f"{'=' * 80}\nMSG: "
DEFINITION = (
    "std_msgs/Header header\nstring format\nuint8[] data\n"
    f"{_PART}std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_PART}builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
"""What a CompressedImage holds, for those who read the file."""


def open_bag(path: Path, files: Sequence[Path], topics: Sequence[str]) -> Recording:
    """The pictures and forces of a bag: of the ``topics`` that are named, or of the only ones.

    Raises ``SensorError``, which lists the topics, if one is not there, several could be meant, or
    none holds pictures; or if nothing can be read.
    """
    suffixes = {file.suffix.lower() for file in files}
    for suffix in suffixes & {*REFUSED}:
        way = "pip install rosbags; rosbags-convert --src BAG --dst NEW_FOLDER"
        msg = f"{path}: {REFUSED[suffix]}; convert it: `{way}`"
        raise SensorError(msg)
    if ".mcap" in suffixes:
        require_extra("mcap", f"{path}: reading MCAP needs", SensorError)
    types: dict[str, str] = {}
    rows: dict[str, list[list[float]]] = defaultdict(list)
    cut = ""
    try:
        for name, kind, log_ns, data in _messages(files):
            types[name] = kind
            layout = LAYOUTS.get(kind, "")
            # Of a picture the stamp alone.
            found = _values(layout if kind == WRENCH else layout[:2], data, name) or [0, 0]
            rows[name].append([log_ns / 1e9, found[0] + found[1] / 1e9, *found[3:6]])
    except SensorError as error:
        cut = f"; {error}"
    listed = ", ".join(sorted(f"{name} ({types[name]}, {len(rows[name])})" for name in types))
    image_topic, wrench_topic = _chosen(
        types, topics, f"{path}: {{}}; it has {listed or 'no messages'}{cut}"
    )
    names = [name for name in (image_topic, wrench_topic) if name]
    logs, stamps = zip(
        *(np.array([row[:2] for row in rows[name]]).T for name in names), strict=True
    )
    starts, ends = [of.min() for of in stamps], [of.max() for of in stamps]
    is_stamped = min(starts) > 0 and max(starts) <= min(ends)
    times_s, forces_s = [*(stamps if is_stamped else logs), np.zeros(0)][:2]
    background = None
    if image_topic == PICTURE and BACKGROUND in types:
        with closing(_pictures(files, BACKGROUND)) as first:
            background = next(first, None)
    pictures = (
        Recorded(f"{path.stem}_{number:06d}", time_s, rgb)
        for number, (rgb, time_s) in enumerate(
            zip(_pictures(files, image_topic), times_s, strict=False)
        )
    )
    wrench = None
    if len(forces_s) > 1:
        order = np.argsort(forces_s, kind="stable")
        forces_s, force_n = forces_s[order], np.array(rows[wrench_topic])[order, 2:]
        gap_s = MOST_GAP * float(np.median(np.diff(forces_s)))
        wrench = Wrench(wrench_topic, forces_s, force_n, gap_s)
    note = f"{path}: the headers of {' and '.join(names)} hold no common time: times are the log's"
    notes = () if is_stamped else (note,)
    return Recording(f"{path}: {image_topic}", len(times_s), pictures, background, wrench, notes)


def _chosen(types: dict[str, str], topics: Sequence[str], msg: str) -> tuple[str, str]:
    """The topic of pictures and that of forces, empty where there is none, in a bag's ``types``."""
    unknown = [name for name in topics if types.get(name) not in LAYOUTS]
    problem = f"--topic {unknown[0]} holds neither pictures nor forces" if unknown else ""
    found = []
    for what, kinds in {"pictures": (IMAGE, COMPRESSED), "forces": (WRENCH,)}.items():
        known = [name for name, kind in types.items() if kind in kinds and name != BACKGROUND]
        wanted = [name for name in known if name in topics] or known
        if len(wanted) > 1:
            problem = problem or f"{len(wanted)} topics hold {what}: choose one with --topic"
        found.append(wanted[0] if wanted else "")
    if problem or not found[0]:
        raise SensorError(msg.format(problem or f"no {IMAGE} or {COMPRESSED}"))
    return found[0], found[1]


def _pictures(files: Sequence[Path], topic: str) -> Generator[NDArray[np.uint8]]:
    number = 0
    for name, kind, _, data in _messages(files):
        if name == topic:
            yield _picture(kind, data, f"{files[0].parent}: {topic}: picture {number}", topic)
            number += 1


def _messages(files: Sequence[Path]) -> Iterator[tuple[str, str, int, bytes]]:
    """Topic, type, time of the log, ns, and bytes of each message."""
    for file in files:
        try:
            of_kind = _mcap_messages if file.suffix.lower() == ".mcap" else _sqlite_messages
            for name, kind, log_ns, data in of_kind(file):
                is_packed = data[:4] == ZSTD_MAGIC
                raw = zstandard.ZstdDecompressor().decompress(data) if is_packed else data
                yield name, kind, log_ns, raw
        except Exception as error:  # whatever damage leads the readers to
            what = str(error) or type(error).__name__
            msg = f"{file}: broken or cut ({what}); record it anew"
            raise SensorError(msg) from None


def _mcap_messages(path: Path) -> Iterator[tuple[str, str, int, bytes]]:
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    types, channels = {0: "no type"}, {}
    with path.open("rb") as file:
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Schema):
                types[record.id] = record.name
            elif isinstance(record, Channel):
                kind, form = types[record.schema_id], record.message_encoding
                channels[record.id] = record.topic, kind if form == "cdr" else f"{kind} as {form}"
            elif isinstance(record, Message):
                yield *channels[record.channel_id], record.log_time, record.data


def _sqlite_messages(path: Path) -> Iterator[tuple[str, str, int, bytes]]:
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as base:
        base.execute("PRAGMA writable_schema = ON")  # a file that is cut is read as far as it goes
        yield from base.execute(
            "SELECT name, type, timestamp, data FROM messages CROSS JOIN topics "
            "ON topics.id = topic_id ORDER BY messages.id"
        )


def _values(layout: str, data: bytes, where: str) -> list[Any]:
    """What a message holds in ROS 2's form, CDR: ``s`` a text, ``b`` bytes, others a number.

    Source: OMG, DDS Interoperability Wire Protocol 2.5, §10: a number lies at a multiple of its
    size, counted from behind the four bytes that state the order of bytes.
    """
    found: list[Any] = []
    at = 4
    try:
        order = "<" if data[1] & 1 else ">"
        for kind in layout:
            number = "I" if kind in "sb" else kind
            at += (4 - at) % struct.calcsize(number)
            (value,) = struct.unpack_from(order + number, data, at)
            at += struct.calcsize(number)
            if kind in "sb":
                (raw,) = struct.unpack_from(f"{value}s", data, at)
                at += value
                value = raw if kind == "b" else raw[:-1].decode(errors="replace")
            found.append(value)
    except (struct.error, IndexError):
        msg = f"{where}: a message ends early; record it anew"
        raise SensorError(msg) from None
    return found


def _picture(kind: str, data: bytes, where: str, topic: str) -> NDArray[np.uint8]:
    """The picture (H, W, 3), RGB, of a message."""
    if kind == COMPRESSED:
        form, packed = _values(LAYOUTS[kind], data, where)[3:]
        if "compressedDepth" in form:
            msg = f"{where}: {form!r} are distances; choose the camera's colour picture"
            raise SensorError(msg)
        return decode_rgb(packed, where, SensorError, kind_of=topic)
    height, width, encoding, _, step, raw = _values(LAYOUTS[kind], data, where)[3:]
    if encoding not in CHANNELS:
        msg = f"{where}: encoding {encoding!r} is not read; record one of {', '.join(CHANNELS)}"
        raise SensorError(msg)
    n_channels = 4 if "a8" in encoding else 3
    if step < width * n_channels or len(raw) < step * height:
        msg = f"{where}: {len(raw)} bytes, {step} a row, are no {width} × {height} {encoding}"
        raise SensorError(msg)
    rows = np.frombuffer(raw, np.uint8, step * height).reshape(height, step)
    pixels = rows[:, : width * n_channels].reshape(height, width, n_channels)
    return np.ascontiguousarray(pixels[..., CHANNELS[encoding]])


def check_new_mcap(path: Path) -> None:
    """Raises ``SensorError`` if the extra is missing, or ``path`` is no new file of .mcap."""
    require_extra("mcap", "--record needs", SensorError)
    if path.suffix != ".mcap" or path.exists():
        msg = f"--record {path}: give the name of a new file that ends in .mcap"
        raise SensorError(msg)


def kept(recording: Recording, path: Path, background_rgb: NDArray[np.uint8]) -> Recording:
    """The recording of a camera, which is written, lossless, into an MCAP file as it is read.

    Raises ``SensorError`` as :func:`check_new_mcap`.
    """
    check_new_mcap(path)
    at_rest = Recorded("", time.time(), background_rgb)
    return replace(recording, pictures=_written(path, at_rest, recording.pictures))


def _written(path: Path, at_rest: Recorded, pictures: Iterator[Recorded]) -> Generator[Recorded]:
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "tacgen")
        schema = writer.register_schema(COMPRESSED, "ros2msg", DEFINITION.encode())
        channels = [writer.register_channel(of, "cdr", schema) for of in (BACKGROUND, PICTURE)]
        try:
            for number, picture in enumerate(chain([at_rest], pictures)):
                log_ns, png = round(picture.time_s * 1e9), encode_png(picture.rgb)
                head = (*divmod(log_ns, 10**9), 4, b"gel", 4, b"png", len(png))
                data = b"\0\1\0\0" + struct.pack("<iII4sI4sI", *head) + png
                writer.add_message(channels[min(number, 1)], log_ns, data, log_ns)
                if number:
                    yield picture
        finally:
            writer.finish()
