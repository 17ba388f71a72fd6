"""Opening a shard that somebody else may have made: nothing in it is believed before it is checked.

HDF5 holds no code, but a file can name other files, ask for plugins, or claim sizes that exhaust
the memory. Such a file is refused before any array is read; the limits are stated here.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from tacgen.dataset.schema import FORMAT_VERSION, PADS, ArraySpec, Layout
from tacgen.errors import DatasetError

MAX_GRASPS, MAX_FRAMES, MAX_SIDE_PX = 1_000_000, 10_000, 8192
ALLOWED_FILTERS = {hdf5plugin.HTJ2K_ID, hdf5plugin.ZSTD_ID}
_HEADER_BYTES = 120
# The coding style that the writer uses: one layer, five levels, blocks of 64 × 64, reversible.
_CODING = bytes.fromhex("ff52 000c 00 02 0001 00 05 04 04 40 01")
# What h5py raises on a file that is damaged, truncated or not one at all.
_BROKEN = (OSError, RuntimeError, KeyError, ValueError, TypeError, UnicodeError, MemoryError)


@contextlib.contextmanager
def broken_as_error(path: Path) -> Iterator[None]:
    """Turn what h5py raises on a damaged file into one ``DatasetError``."""
    try:
        yield
    except _BROKEN as error:
        reason = str(error).strip("'\"") or type(error).__name__
        msg = f"{path}: cannot be read as a shard ({reason}); `tacgen collect --repair` remakes it"
        raise DatasetError(msg) from error


def open_shard(path: Path) -> tuple[h5py.File, Layout]:
    """Open a shard for reading once its structure is what the schema says.

    Raises
    ------
    DatasetError
        Naming every array that is missing or otherwise than the schema says, or what is
        forbidden in it.
    """
    if not path.is_file():
        msg = f"{path}: the shard is missing; `tacgen collect` remakes it"
        raise DatasetError(msg)
    with broken_as_error(path):
        file = h5py.File(path, "r")
        try:
            layout, problems = _structure(file)
        except BaseException:
            file.close()
            raise
    if problems:
        file.close()
        raise DatasetError.from_problems([f"{path}: {text}" for text in problems])
    return file, layout


def read_image(dataset: h5py.Dataset, place: tuple[int, ...]) -> NDArray:
    """One image of an image array: the one at ``place``, its leading indices.

    What is compressed has a header of its own, with a size of its own: one that lies would have
    the codec take any amount of memory, so it is read first.

    Raises
    ------
    ValueError
        If the header is not that of an image of this size.
    """
    if has_image(dataset, place):
        require_sound(dataset, place)
    return dataset[place]


def has_image(dataset: h5py.Dataset, place: tuple[int, ...]) -> bool:
    """Whether the image at ``place`` was written; otherwise it reads as zeros."""
    corner = place + (0,) * (dataset.ndim - len(place))
    return dataset.id.get_chunk_info_by_coord(corner).byte_offset is not None


def require_sound(dataset: h5py.Dataset, place: tuple[int, ...]) -> None:
    """Look at the header of the image at ``place`` without decompressing it.

    Raises
    ------
    ValueError
        If it is not that of an image of this size.
    """
    corner = place + (0,) * (dataset.ndim - len(place))
    skipped_filters, raw = dataset.id.read_direct_chunk(corner)
    start = raw[:_HEADER_BYTES]
    if skipped_filters or (
        dataset.dtype == np.uint8
        and not (start.startswith(_jpeg2000_size(*dataset.shape[-3:])) and _CODING in start)
    ):
        msg = f"the image {place} of {dataset.name} is damaged"
        raise ValueError(msg)


def _jpeg2000_size(height: int, width: int, channels: int) -> bytes:
    """Start of a codestream: one tile of the whole image, 8 bits a channel."""
    extent = struct.pack(">8I", width, height, 0, 0, width, height, 0, 0)
    body = struct.pack(">H", 0x4000) + extent + struct.pack(">H", channels) + b"\x07\x01\x01" * 3
    return b"\xff\x4f\xff\x51" + struct.pack(">H", len(body) + 2) + body


def _structure(file: h5py.File) -> tuple[Layout, list[str]]:
    layout, problems = _layout_of(file)
    if problems:
        return layout, problems
    sizes, problems = _sizes_of(file, layout)
    if problems:
        return layout, problems
    return layout, [
        text for array in layout.arrays() for text in _array_problems(file, array, sizes)
    ]


def _layout_of(file: h5py.File) -> tuple[Layout, list[str]]:
    version = file.attrs.get("format_version")
    sensor, pads = file.attrs.get("sensor"), file.attrs.get("pads")
    if file.attrs.get("format") != "tacgen" or version is None:
        return Layout("", (), False, False), ["not a shard of tacgen"]
    if int(version) != FORMAT_VERSION:
        text = f"format {version} is not {FORMAT_VERSION}, which this version of tacgen reads"
        return Layout("", (), False, False), [text]
    names = tuple(str(pads).split(","))
    if not isinstance(sensor, str) or not sensor or "/" in sensor or not set(names) <= set(PADS):
        return Layout("", (), False, False), [f"sensor {sensor!r} with pads {pads!r} is not known"]
    plain = Layout(sensor, names, depth=False, picture=False)
    depth = _is_plain(file, plain.tactile(names[0], "depth_mm"))
    return Layout(sensor, names, depth, _is_plain(file, "/scene/picture")), []


def _sizes_of(file: h5py.File, layout: Layout) -> tuple[dict[str, int], list[str]]:
    """What the letters of the layout stand for here, within the limits."""
    path = layout.tactile(layout.pads[0], "rgb")
    if not _is_plain(file, path) or getattr(file[path], "ndim", 0) != 5:
        return {}, [f"{path} is missing or not of five axes"]
    sizes = dict(zip("NTHW", file[path].shape, strict=False)) | {"h": 0, "w": 0}
    if layout.picture and getattr(file["/scene/picture"], "ndim", 0) == 4:
        sizes["h"], sizes["w"] = file["/scene/picture"].shape[1:3]
    limits = {"N": MAX_GRASPS, "T": MAX_FRAMES} | dict.fromkeys("HWhw", MAX_SIDE_PX)
    too_large = [
        f"{name} = {sizes[name]} exceeds {limit}"
        for name, limit in limits.items()
        if sizes[name] > limit
    ]
    start, stop = (int(n) for n in file.attrs["index_range"])
    if stop - start != sizes["N"]:
        too_large.append(f"index range {start} to {stop} does not go with {sizes['N']} grasps")
    return sizes, too_large


def _array_problems(file: h5py.File, array: ArraySpec, sizes: dict[str, int]) -> Iterator[str]:
    if not _is_plain(file, array.path):
        yield f"{array.path} is missing, or a link"
        return
    dataset = file[array.path]
    shape = array.resolve(sizes)
    if not isinstance(dataset, h5py.Dataset):
        yield f"{array.path} is not an array"
    elif dataset.shape != shape:
        yield f"{array.path} has shape {dataset.shape}, not {shape}"
    elif dataset.dtype != np.dtype(array.dtype):
        yield f"{array.path} is {dataset.dtype}, not {array.dtype}"
    elif dataset.external or dataset.is_virtual:
        yield f"{array.path} lies in another file"
    else:
        yield from _storage_problems(dataset, array)


def _storage_problems(dataset: h5py.Dataset, array: ArraySpec) -> Iterator[str]:
    creation = dataset.id.get_create_plist()
    filters = {creation.get_filter(i)[0] for i in range(creation.get_nfilters())}
    if not filters <= ALLOWED_FILTERS:
        yield f"{array.path} is stored by filters {sorted(filters)}, which are not all known here"
    if dataset.chunks != (array.chunks(dataset.shape) if array.image else None):
        yield f"{array.path} is stored in chunks of {dataset.chunks}"


def _is_plain(file: h5py.File, path: str) -> bool:
    """Whether ``path`` is in the file by hard links alone: no soft or external link on the way."""
    group: h5py.Group = file
    for name in path.strip("/").split("/"):
        if not isinstance(group, h5py.Group):
            return False
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            return False
        group = group[name]
    return True
