"""How images are compressed in a shard, and what a sound compressed image starts with.

Every image is a chunk of its own, compressed without loss. What a chunk says of its size is
believed by the codecs, which would take any amount of memory for it: so it is looked at first.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from typing import Any

import h5py
import hdf5plugin
import numpy as np
from numpy.typing import NDArray

from tacgen.dataset.blosc import (
    END_BYTES,
    FILTER_OPTIONS,
    ChunkEnds,
    encode_image,
    is_image_of,
)
from tacgen.dataset.schema import ArraySpec

ZSTD_LEVEL = 3
# The coding style of HTJ2K's images: one layer, five levels, blocks of 64 × 64, reversible.
_HTJ2K_CODING = bytes.fromhex("ff52 000c 00 02 0001 00 05 04 04 40 01")
_ZSTD_MAGIC = bytes.fromhex("28b52ffd")


def storage_of(array: ArraySpec) -> dict[str, Any]:
    """The arguments of ``create_dataset`` that say how an image array is compressed."""
    if array.noisy:
        return {"compression": hdf5plugin.BLOSC2_ID, "compression_opts": FILTER_OPTIONS}
    return dict(hdf5plugin.Zstd(clevel=ZSTD_LEVEL))


def write_images(dataset: h5py.Dataset, row: int, frames: NDArray[np.uint8]) -> None:
    """Write the noisy images (T, H, W, 3) of one grasp, compressed here and not by HDF5."""
    for frame, rgb in enumerate(frames):
        dataset.id.write_direct_chunk((row, frame, 0, 0, 0), encode_image(rgb))


def ends_of(dataset: h5py.Dataset, place: tuple[int, ...]) -> ChunkEnds | None:
    """The ends of the chunk at ``place``, its leading indices; None where it was never written.

    Straight from the file: HDF5 would read the whole chunk. Its ``size`` is −1, which no image
    has, where the writer skipped the filter.
    """
    corner = place + (0,) * (dataset.id.rank - len(place))
    found = dataset.id.get_chunk_info_by_coord(corner)
    if found.byte_offset is None:
        return None
    if found.filter_mask:
        return ChunkEnds(b"", b"", -1)
    handle = h5py.h5i.get_file_id(dataset.id).get_vfd_handle()
    n_bytes = min(END_BYTES, found.size)
    head = os.pread(handle, n_bytes, found.byte_offset)
    tail = os.pread(handle, n_bytes, found.byte_offset + found.size - n_bytes)
    return ChunkEnds(head, tail, found.size)


def is_sound(dataset: h5py.Dataset, ends: ChunkEnds) -> bool:
    """Whether a chunk starts as that of one image of this array does, by the array's filter."""
    if ends.size < 0:
        return False
    filters = dataset.id.get_create_plist()
    if filters.get_nfilters() == 0:
        return True
    check = _CHECKS.get(filters.get_filter(0)[0])
    return check is not None and check(ends, dataset.chunks, dataset.id.get_type().get_size())


def _is_htj2k(ends: ChunkEnds, shape: tuple[int, ...], n_bytes: int) -> bool:
    """One tile of the whole image, 8 bits a channel."""
    height, width, channels = shape[-3:]
    extent = struct.pack(">8I", width, height, 0, 0, width, height, 0, 0)
    body = struct.pack(">H", 0x4000) + extent + struct.pack(">H", channels) + b"\x07\x01\x01" * 3
    size = b"\xff\x4f\xff\x51" + struct.pack(">H", len(body) + 2) + body
    return n_bytes == 1 and ends.head.startswith(size) and _HTJ2K_CODING in ends.head


def _is_zstd(ends: ChunkEnds, shape: tuple[int, ...], n_bytes: int) -> bool:
    """A frame that states its size, and the right one.

    Source
    ------
    RFC 8878, section 3.1.1.1.
    """
    chunk = ends.head
    if not chunk.startswith(_ZSTD_MAGIC) or len(chunk) < 9:
        return False
    kind = chunk[4]
    single, size_bytes = bool(kind & 0x20), (0, 2, 4, 8)[kind >> 6]
    if single and not size_bytes:
        size_bytes = 1
    start = 5 + (not single) + (0, 1, 2, 4)[kind & 3]
    size = int.from_bytes(chunk[start : start + size_bytes], "little")
    size += 256 if size_bytes == 2 else 0
    return size_bytes > 0 and size == n_bytes * int(np.prod(shape, dtype=np.int64))


def _is_blosc2(ends: ChunkEnds, shape: tuple[int, ...], n_bytes: int) -> bool:
    return n_bytes == 1 and shape[-1] == 3 and is_image_of(ends, *shape[-3:-1])


_CHECKS: dict[int, Callable[[ChunkEnds, tuple[int, ...], int], bool]] = {
    hdf5plugin.BLOSC2_ID: _is_blosc2,
    hdf5plugin.ZSTD_ID: _is_zstd,
    # What earlier datasets hold.
    hdf5plugin.HTJ2K_ID: _is_htj2k,
}
ALLOWED_FILTERS = frozenset(_CHECKS)
