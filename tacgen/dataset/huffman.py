"""Differences of neighbouring pixels, Huffman-coded: what takes a camera's noise off fastest.

Noise has no repeats, so a coder that looks for them (as all general ones do) spends its time in
vain. What is left is the distribution of the differences, which a Huffman code takes to within
2 % of its entropy. The output is a plain DEFLATE stream without matches.

It is here because no library that could be had takes as little time for as few bytes. On 52
frames of ``stability`` (480 × 640, noise of one grey level), smaller by and ms a frame to write:
this 2.95 × and 1.25; zlib itself with ``Z_HUFFMAN_ONLY`` 2.96 × and 6.4, zlib-ng 2.96 × and 3.2;
python-zstandard with its search for matches all but off 2.92 × and 1.45; Intel's ISA-L
2.55 × and 2.4; HTJ2K by OpenJPH 2.95 × and 6.6; JPEG XL at its quickest 2.64 × and 1.8; JPEG-LS
3.18 × and 15.9. Of these, HDF5 files can hold DEFLATE, Zstandard and HTJ2K so that other readers
undo them. What an HDF5 filter of hdf5plugin runs itself is in docs/dataset.md.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, uint32, uint64
from numpy.typing import NDArray

MAX_CODE_BITS = 12
"""Four codes are put into words of 64 bits at once."""
HEADER_BYTES = 400
"""More than the description of a code and a block's ends ever take."""
_N_LITERALS, _END = 257, 256
# The code for code lengths is always the same: 13 lengths of four bits, six symbols of five.
_CL_BITS = np.array([4] * 13 + [5] * 6, dtype=np.int64)
# Sums of a run of 4096 values, each below 256 and weighted by its place, stay below 2 ** 32.
_ADLER_RUN, _ADLER_PRIME = 4096, uint64(65521)
_CL_ORDER = np.array([16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15])


@njit(cache=True, nogil=True)
def deflate_differences(
    image: NDArray[np.uint8], differences: NDArray[np.uint8], words: NDArray[np.uint64]
) -> int:
    """Code an image, each channel after the other, as one zlib stream.

    Parameters
    ----------
    image : (n, 3) uint8
        Pixels in raster order, C-contiguous.
    differences : (3, n) uint8
        Takes what the stream unfolds to: each pixel minus the one before, modulo 256.
    words : (m,) uint64
        Takes the stream; at least ``MAX_CODE_BITS`` a value and ``HEADER_BYTES`` a channel.

    Returns
    -------
    int
        Bytes of the stream.

    Source
    ------
    RFC 1950 and 1951.
    """
    _difference(image, differences)
    state = np.zeros(3, np.uint64)
    _put(words, state, uint64(0x0178), uint64(16))
    counts = np.zeros(_N_LITERALS, np.int64)
    table = np.zeros(_N_LITERALS, np.uint64)
    for channel in range(3):
        values = differences[channel]
        _count(values, counts)
        lengths = code_lengths(counts)
        _fill_table(lengths, table)
        _put_header(words, state, lengths, channel == 2)
        _put_values(words, state, values, table)
        _put(words, state, table[_END] >> uint64(8), table[_END] & uint64(255))
    _put(words, state, uint64(0), (uint64(64) - state[1]) & uint64(7))
    for byte in _checksum(differences.reshape(-1)):
        _put(words, state, byte, uint64(8))
    words[state[2]] = state[0]
    return int(state[2]) * 8 + int(state[1]) // 8


@njit(cache=True, nogil=True)
def code_lengths(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Lengths in bits, at most ``MAX_CODE_BITS``, of a Huffman code; 0 where a count is 0.

    At least two counts must not be 0. Where the best code is deeper, its deepest leaves are hung
    beside others further up, as zlib does; for noise that costs far below a percent.
    """
    used = np.flatnonzero(counts)
    order = used[np.argsort(counts[used], kind="mergesort")]
    n_leaves = order.shape[0]
    n_nodes = 2 * n_leaves - 1
    weight, parent = np.zeros(n_nodes, np.int64), np.zeros(n_nodes, np.int64)
    weight[:n_leaves] = counts[order]
    leaf, inner = 0, n_leaves
    for node in range(n_leaves, n_nodes):
        for _ in range(2):
            if leaf < n_leaves and (inner >= node or weight[leaf] <= weight[inner]):
                child, leaf = leaf, leaf + 1
            else:
                child, inner = inner, inner + 1
            weight[node] += weight[child]
            parent[child] = node
    depth = np.zeros(n_nodes, np.int64)
    for node in range(n_nodes - 2, -1, -1):
        depth[node] = depth[parent[node]] + 1
    n_of = np.zeros(MAX_CODE_BITS + 1, np.int64)
    taken = 0
    for leaf in range(n_leaves):
        bits = min(depth[leaf], MAX_CODE_BITS)
        n_of[bits] += 1
        taken += 1 << (MAX_CODE_BITS - bits)
    for _ in range(taken - (1 << MAX_CODE_BITS)):
        bits = MAX_CODE_BITS - 1
        while n_of[bits] == 0:
            bits -= 1
        n_of[bits] -= 1
        n_of[bits + 1] += 2
        n_of[MAX_CODE_BITS] -= 1
    lengths = np.zeros(counts.shape[0], np.int64)
    leaf = 0
    for bits in range(MAX_CODE_BITS, 0, -1):
        lengths[order[leaf : leaf + n_of[bits]]] = bits
        leaf += n_of[bits]
    return lengths


@njit(cache=True, nogil=True)
def _difference(image: NDArray[np.uint8], differences: NDArray[np.uint8]) -> None:
    # Three channels at once, by flat places, is what the compiler turns into wide instructions.
    flat = image.reshape(-1)
    red, green, blue = differences[0], differences[1], differences[2]
    red[0], green[0], blue[0] = flat[0], flat[1], flat[2]
    for k in range(1, image.shape[0]):
        red[k] = flat[3 * k] - flat[3 * k - 3]
        green[k] = flat[3 * k + 1] - flat[3 * k - 2]
        blue[k] = flat[3 * k + 2] - flat[3 * k - 1]


@njit(cache=True, nogil=True)
def _count(values: NDArray[np.uint8], counts: NDArray[np.int64]) -> None:
    n = values.shape[0]
    # Four histograms: equal neighbours would otherwise wait for each other's count.
    tally = np.zeros((4, 256), np.int32)
    whole = n - n % 4
    for k in range(0, whole, 4):
        tally[0, values[k]] += 1
        tally[1, values[k + 1]] += 1
        tally[2, values[k + 2]] += 1
        tally[3, values[k + 3]] += 1
    for k in range(whole, n):
        tally[0, values[k]] += 1
    for value in range(256):
        counts[value] = tally[:, value].sum()
    counts[_END] = 1


@njit(cache=True, nogil=True)
def _checksum(values: NDArray[np.uint8]) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Adler-32, first byte first, by sums that the compiler turns into wide instructions."""
    low: Any = uint64(1)
    high: Any = uint64(0)
    for start in range(0, values.shape[0], _ADLER_RUN):
        part = values[start : start + _ADLER_RUN]
        total: Any = uint32(0)
        weighted: Any = uint32(0)
        for k in range(part.shape[0]):
            total += uint32(part[k])
            weighted += uint32(k) * uint32(part[k])
        high += (low + uint64(total)) * uint64(part.shape[0]) - uint64(weighted)
        high %= _ADLER_PRIME
        low = (low + uint64(total)) % _ADLER_PRIME
    return high >> uint64(8), high & uint64(255), low >> uint64(8), low & uint64(255)


@njit(cache=True, nogil=True)
def _fill_table(lengths: NDArray[np.int64], table: NDArray[np.uint64]) -> None:
    """Canonical codes: each entry holds the code, first bit lowest, above its length."""
    n_codes, following = (
        np.zeros(MAX_CODE_BITS + 1, np.int64),
        np.zeros(MAX_CODE_BITS + 1, np.int64),
    )
    for length in lengths:
        n_codes[length] += 1
    n_codes[0] = 0
    for length in range(1, MAX_CODE_BITS + 1):
        following[length] = (following[length - 1] + n_codes[length - 1]) << 1
    for symbol in range(lengths.shape[0]):
        length = lengths[symbol]
        table[symbol] = 0
        if length:
            code, turned = following[length], 0
            following[length] += 1
            for _ in range(length):
                turned = (turned << 1) | (code & 1)
                code >>= 1
            table[symbol] = (uint64(turned) << uint64(8)) | uint64(length)


@njit(cache=True, nogil=True)
def _put(
    words: NDArray[np.uint64], state: NDArray[np.uint64], bits: np.uint64, n_bits: np.uint64
) -> None:
    """Append up to 32 bits; ``state`` is the bits at hand, how many, and the words so far."""
    held, n_held = state[0] | (uint64(bits) << state[1]), state[1] + uint64(n_bits)
    if n_held >= uint64(64):
        words[state[2]] = held
        held = uint64(bits) >> (uint64(64) - state[1])
        n_held -= uint64(64)
        state[2] += uint64(1)
    state[0], state[1] = held, n_held


@njit(cache=True, nogil=True)
def _put_header(
    words: NDArray[np.uint64], state: NDArray[np.uint64], lengths: NDArray[np.int64], last: bool
) -> None:
    """A block's head: dynamic code, 257 literals, one distance that is never used."""
    _put(words, state, uint64(1 if last else 0) | uint64(2 << 1), uint64(3))
    _put(words, state, uint64(15 << 10), uint64(14))
    for symbol in _CL_ORDER:
        _put(words, state, uint64(_CL_BITS[symbol]), uint64(3))
    table = np.zeros(19, np.uint64)
    _fill_table(_CL_BITS, table)
    k = 0
    while k < lengths.shape[0]:
        run = 0
        while k + run < lengths.shape[0] and lengths[k + run] == 0 and run < 138:
            run += 1
        symbol = lengths[k] if run < 3 else 17 if run < 11 else 18
        _put(words, state, table[symbol] >> uint64(8), table[symbol] & uint64(255))
        if run >= 11:
            _put(words, state, uint64(run - 11), uint64(7))
        elif run >= 3:
            _put(words, state, uint64(run - 3), uint64(3))
        k += run if run >= 3 else 1
    _put(words, state, table[0] >> uint64(8), table[0] & uint64(255))


@njit(cache=True, nogil=True)
def _put_values(
    words: NDArray[np.uint64],
    state: NDArray[np.uint64],
    values: NDArray[np.uint8],
    table: NDArray[np.uint64],
) -> None:
    held, n_held, place = state[0], state[1], np.int64(state[2])
    byte = uint64(255)
    whole = values.shape[0] - values.shape[0] % 4
    for k in range(0, whole, 4):
        a, b = table[values[k]], table[values[k + 1]]
        c, d = table[values[k + 2]], table[values[k + 3]]
        n_ab = (a & byte) + (b & byte)
        bits = (a >> uint64(8)) | (b >> uint64(8)) << (a & byte)
        bits |= ((c >> uint64(8)) | (d >> uint64(8)) << (c & byte)) << n_ab
        joined = held | bits << n_held
        # Written whether or not the word is full: a branch here would be guessed wrong often.
        words[place] = joined
        n_all = n_held + n_ab + (c & byte) + (d & byte)
        full = n_all >> uint64(6)
        left = bits >> ((uint64(64) - n_held) & uint64(63))
        held = left if full else joined
        place += np.int64(full)
        n_held = n_all & uint64(63)
    state[0], state[1], state[2] = held, n_held, uint64(place)
    for k in range(whole, values.shape[0]):
        code = table[values[k]]
        _put(words, state, code >> uint64(8), code & byte)
