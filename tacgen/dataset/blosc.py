"""Tactile images as Blosc2 frames, which the HDF5 filter 32026 of any Blosc2 reads.

Blosc2's own way to code (``deflate`` with matches) is slow and weak on noisy images, so the
pixels are coded here and only put into its container: in blocks of rows, colours apart
(``shuffle``), each pixel as the difference to the one before (``bytedelta``), one zlib stream a
block. Whatever reads Blosc2 undoes all of that.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tacgen.dataset.huffman import HEADER_BYTES, MAX_CODE_BITS, deflate_differences

FILTER_OPTIONS = (0, 0, 0, 0, 1, 35, 4)
"""What the array says of itself: level 1, bytedelta, zlib."""

END_BYTES = 160
"""More than the heads that are looked at take."""

BLOCK_PIXELS = 1 << 16
"""About what a block holds: with its scratch it stays in a processor's second cache."""

_SHUFFLE, _BYTEDELTA, _ZLIB = 1, 35, 4
_FRAME_BYTES, _CHUNK_BYTES = 97, 32
_INDEX = struct.pack("<4B3i", 5, 1, 7, 8, 8, 8, 40) + bytes([0, 0, 0, 0, 0, 1]) + bytes(18)
_TRAILER = bytes.fromhex("9401 93cd0006de0000dc0000 ce00000023 d800") + bytes(16)


@dataclass(frozen=True, slots=True)
class ChunkEnds:
    """How a compressed chunk of ``size`` bytes starts and ends: ``END_BYTES`` of each, at most."""

    head: bytes
    tail: bytes
    size: int


def encode_image(rgb: NDArray[np.uint8]) -> bytes:
    """One image (H, W, 3) as the chunk of an HDF5 array that has the Blosc2 filter."""
    height, width, _ = rgb.shape
    pixels = np.ascontiguousarray(rgb).reshape(-1, 3)
    step = _block_pixels(height, width)
    differences = np.empty(3 * step, np.uint8)
    words = np.empty(3 * (step * MAX_CODE_BITS // 64 + HEADER_BYTES // 8) + 16, np.uint64)
    blocks = []
    for start in range(0, len(pixels), step):
        rows = pixels[start : start + step]
        planes = differences[: rows.size].reshape(3, -1)
        n_bytes = deflate_differences(rows, planes, words)
        blocks.append(words.view(np.uint8)[:n_bytes].tobytes())
    offset = _CHUNK_BYTES + 4 * len(blocks)
    starts = []
    for block in blocks:
        starts.append(offset)
        offset += 4 + len(block)
    parts = [struct.pack(f"<{len(starts)}i", *starts)]
    for block in blocks:
        parts += [struct.pack("<i", len(block)), block]
    head = frame_head(height, width, offset)
    return b"".join([head, *parts, _INDEX, _TRAILER])


@lru_cache(maxsize=8)
def frame_head(height: int, width: int, chunk_bytes: int) -> bytes:
    """How the frame of an image starts whose compressed chunk takes ``chunk_bytes``.

    Source
    ------
    C-Blosc2, README_CFRAME_FORMAT and README_CHUNK_FORMAT.
    """
    n_bytes, block_bytes = 3 * height * width, 3 * _block_pixels(height, width)
    frame_bytes = _FRAME_BYTES + chunk_bytes + len(_INDEX) + len(_TRAILER)
    frame = b"\x9e\xa8b2frame\0"
    frame += struct.pack(">BiBQ", 0xD2, _FRAME_BYTES, 0xCF, frame_bytes)
    frame += bytes([0xA4, 0x12, 0, 0x10 | _ZLIB, 3])
    frame += struct.pack(">BqBq", 0xD3, n_bytes, 0xD3, chunk_bytes)
    frame += struct.pack(">BiBiBi", 0xD2, 3, 0xD2, block_bytes, 0xD2, n_bytes)
    frame += bytes.fromhex("d10001 d10001 c2 d806")
    filters = bytes([0, 0, 0, 0, _SHUFFLE, _BYTEDELTA, _ZLIB, 0, 0, 0, 0, 0, 0, 3, 0, 0])
    frame += filters + bytes.fromhex("93 cd0007 de0000 dc0000")
    # Extended header, blocks not split into streams, zlib.
    chunk = struct.pack("<4B3i", 5, 1, 0x75, 3, n_bytes, block_bytes, chunk_bytes)
    return frame + chunk + filters


def is_image_of(ends: ChunkEnds, height: int, width: int) -> bool:
    """Whether a chunk starts and ends as ``encode_image`` has it for that size.

    A frame that says otherwise could have the reader take any amount of memory.
    """
    chunk_bytes = ends.size - _FRAME_BYTES - len(_INDEX) - len(_TRAILER)
    if not _CHUNK_BYTES < chunk_bytes < 1 << 31:
        return False
    head = frame_head(height, width, chunk_bytes)
    return ends.head.startswith(head) and ends.tail.endswith(_INDEX + _TRAILER)


def _block_pixels(height: int, width: int) -> int:
    """Whole rows, sixteen at a time where that fits: bytedelta is quickest on such lengths."""
    rows = max(1, BLOCK_PIXELS // width)
    rows = rows - rows % 16 if rows > 16 else rows
    return width * min(rows, height)
