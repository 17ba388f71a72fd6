"""How images are compressed in a shard, and what a sound compressed image starts with.

Every image is a chunk of its own, compressed without loss. A camera's noise has no repeats, so
what shrinks a tactile image is the Huffman coding of the differences of neighbouring pixels: the
search for matches, which takes a codec most of its time, is all but switched off. Blosc2 knows
the steps (``shuffle`` sets the colours apart, ``bytedelta`` takes differences, Zstandard codes
them) but not these settings, so the image is coded here and put into a Blosc2 frame, which the
HDF5 filter 32026 of any Blosc2 reads.

The codecs trust the size that a chunk states and would take any amount of memory for it, so that
is checked before a chunk is decoded.
"""

import os
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import h5py
import hdf5plugin
import numpy as np
import zstandard
from numpy.typing import NDArray

ZSTD_LEVEL = 3  # of images without noise

END_BYTES = 160  # more than the heads that are looked at take

_SHUFFLE, _BYTEDELTA, _ZSTD = 1, 35, 5  # Blosc2's numbers for the two filters and the codec
_FRAME_BYTES, _CHUNK_BYTES = 97, 32
_INDEX = struct.pack("<4B3i", 5, 1, 7, 8, 8, 8, 40) + bytes([0, 0, 0, 0, 0, 1]) + bytes(18)
_TRAILER = bytes.fromhex("9401 93cd0006de0000dc0000 ce00000023 d800") + bytes(16)

_NO_MATCHES = zstandard.ZstdCompressionParameters(
    strategy=zstandard.STRATEGY_FAST,
    min_match=7,
    hash_log=6,  # the smallest table of earlier places: few false candidates are followed
    window_log=17,  # whole 128 KiB blocks, each with a Huffman code of its own
)


@dataclass(frozen=True, slots=True)
class ChunkEnds:
    """How a compressed chunk of ``size`` bytes starts and ends: ``END_BYTES`` of each, at most."""

    head: bytes
    tail: bytes
    size: int


def storage_of(*, noisy: bool) -> dict[str, Any]:
    """The arguments of ``create_dataset`` that say how an image array is compressed."""
    if noisy:
        options = (0, 0, 0, 0, 1, _BYTEDELTA, _ZSTD)
        return {"compression": hdf5plugin.Blosc2.filter_id, "compression_opts": options}
    return dict(hdf5plugin.Zstd(clevel=ZSTD_LEVEL))


def write_images(dataset: h5py.Dataset, row: int, frames: NDArray[np.uint8]) -> None:
    """Write the noisy images (T, H, W, 3) of one grasp, compressed here and not by HDF5.

    An image that equals the one before is not coded again: that of a steady hold, stored without
    the noise.
    """
    chunk = b""
    for frame, rgb in enumerate(frames):
        before = frames[frame - 1]
        # The first row differs at once where there is noise.
        is_same = frame > 0 and np.array_equal(rgb[0], before[0]) and np.array_equal(rgb, before)
        if not is_same:
            chunk = encode_image(rgb)
        dataset.id.write_direct_chunk((row, frame, 0, 0, 0), chunk)


def encode_image(rgb: NDArray[np.uint8]) -> bytes:
    """One image (H, W, 3) as the chunk of an HDF5 array that has the Blosc2 filter."""
    height, width, _ = rgb.shape
    planes = np.empty((3, height * width), dtype=np.uint8)
    cv2.split(np.ascontiguousarray(rgb), list(planes.reshape(3, height, width)))
    differences = np.empty_like(planes)
    differences[:, 0] = planes[:, 0]
    np.subtract(planes[:, 1:], planes[:, :-1], out=differences[:, 1:])
    block = zstandard.ZstdCompressor(compression_params=_NO_MATCHES).compress(differences.data)
    if len(block) >= differences.nbytes:
        block = differences.tobytes()  # Blosc2 reads a block of full length as not compressed
    start = _CHUNK_BYTES + 4
    head = frame_head(height, width, start + 4 + len(block))
    return b"".join([head, struct.pack("<2i", start, len(block)), block, _INDEX, _TRAILER])


@lru_cache(maxsize=8)
def frame_head(height: int, width: int, chunk_bytes: int) -> bytes:
    """How the frame of an image starts whose compressed chunk takes ``chunk_bytes``.

    Source: C-Blosc2, README_CFRAME_FORMAT and README_CHUNK_FORMAT.
    """
    n_bytes = 3 * height * width
    frame_bytes = _FRAME_BYTES + chunk_bytes + len(_INDEX) + len(_TRAILER)
    frame = b"\x9e\xa8b2frame\0"
    frame += struct.pack(">BiBQ", 0xD2, _FRAME_BYTES, 0xCF, frame_bytes)
    frame += bytes([0xA4, 0x12, 0, 0x10 | _ZSTD, 3])
    frame += struct.pack(">BqBq", 0xD3, n_bytes, 0xD3, chunk_bytes)
    frame += struct.pack(">BiBiBi", 0xD2, 3, 0xD2, n_bytes, 0xD2, n_bytes)
    frame += bytes.fromhex("d10001 d10001 c2 d806")
    filters = bytes([0, 0, 0, 0, _SHUFFLE, _BYTEDELTA, _ZSTD, 0, 0, 0, 0, 0, 0, 3, 0, 0])
    frame += filters + bytes.fromhex("93 cd0007 de0000 dc0000")
    # Extended header, one block that is not split into streams, Zstandard.
    chunk = struct.pack("<4B3i", 5, 1, 0x95, 3, n_bytes, n_bytes, chunk_bytes)
    return frame + chunk + filters


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
    starts = (found.byte_offset, found.byte_offset + found.size - n_bytes)
    head, tail = (os.pread(handle, n_bytes, start) for start in starts)
    return ChunkEnds(head, tail, found.size)


def is_sound(dataset: h5py.Dataset, ends: ChunkEnds) -> bool:
    """Whether a chunk starts as that of one image of this array does, by the array's filter."""
    filters = dataset.id.get_create_plist()
    if ends.size < 0 or filters.get_nfilters() == 0:
        return ends.size >= 0
    check = _CHECKS.get(filters.get_filter(0)[0])
    return check is not None and check(ends, dataset.chunks, dataset.id.get_type().get_size())


def _is_zstd(ends: ChunkEnds, shape: tuple[int, ...], n_bytes: int) -> bool:
    """A frame that states its size, and the right one.

    Source: RFC 8878, section 3.1.1.1.
    """
    try:
        size = zstandard.get_frame_parameters(ends.head).content_size
    except zstandard.ZstdError:
        return False
    return bool(size == n_bytes * int(np.prod(shape, dtype=np.int64)))


def is_blosc2_image(ends: ChunkEnds, shape: tuple[int, ...], n_bytes: int) -> bool:
    """A frame that starts and ends as ``encode_image`` has it for that size."""
    height, width, channels = shape[-3:]
    chunk_bytes = ends.size - _FRAME_BYTES - len(_INDEX) - len(_TRAILER)
    if n_bytes != 1 or channels != 3 or not _CHUNK_BYTES < chunk_bytes < 1 << 31:
        return False
    head = frame_head(height, width, chunk_bytes)
    return ends.head.startswith(head) and ends.tail.endswith(_INDEX + _TRAILER)


_CHECKS: dict[int, Callable[[ChunkEnds, tuple[int, ...], int], bool]] = {
    hdf5plugin.Blosc2.filter_id: is_blosc2_image,
    hdf5plugin.Zstd.filter_id: _is_zstd,
}
ALLOWED_FILTERS = frozenset(_CHECKS)
