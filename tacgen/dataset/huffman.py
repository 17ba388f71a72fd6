"""Differences of neighbouring pixels, Huffman-coded: what takes a camera's noise off fastest.

Noise has no repeats, so a coder that looks for them (as all general ones do) spends its time in
vain. What is left is the distribution of the differences, which a Huffman code takes to within
1 % of its entropy. The output is a plain DEFLATE stream without matches.
"""

from __future__ import annotations

import numpy as np
from numba import njit, uint32, uint64
from numpy.typing import NDArray

MAX_CODE_BITS = 12
"""Two codes and a remainder of 31 bits fit into the 64 of the accumulator with room to spare."""
HEADER_BYTES = 400
"""More than the description of a code and a block's ends ever take."""
_N_LITERALS, _END = 257, 256
# The code for code lengths is always the same: 13 lengths of four bits, six symbols of five.
_CL_BITS = np.array([4] * 13 + [5] * 6, dtype=np.int64)
_CL_ORDER = np.array([16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15])


@njit(cache=True, nogil=True)
def deflate_differences(
    image: NDArray[np.uint8], differences: NDArray[np.uint8], words: NDArray[np.uint32]
) -> int:
    """Code an image, each channel after the other, as one zlib stream without its checksum.

    Parameters
    ----------
    image : (n, 3) uint8
        Pixels in raster order, C-contiguous.
    differences : (3, n) uint8
        Takes what the stream unfolds to: each pixel minus the one before, modulo 256.
    words : (m,) uint32
        Takes the stream; at least ``MAX_CODE_BITS`` a value and ``HEADER_BYTES`` a channel.

    Returns
    -------
    int
        Bytes of the stream; the Adler-32 of ``differences`` is to follow.

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
    words[state[2]] = uint32(state[0])
    return int(state[2]) * 4 + (int(state[1]) + 7) // 8


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
    words: NDArray[np.uint32], state: NDArray[np.uint64], bits: np.uint64, n_bits: np.uint64
) -> None:
    """Append up to 32 bits; ``state`` is the bits at hand, how many, and the words so far."""
    state[0] |= uint64(bits) << state[1]
    state[1] += uint64(n_bits)
    if state[1] >= uint64(32):
        words[state[2]] = uint32(state[0])
        state[0] >>= uint64(32)
        state[1] -= uint64(32)
        state[2] += uint64(1)


@njit(cache=True, nogil=True)
def _put_header(
    words: NDArray[np.uint32], state: NDArray[np.uint64], lengths: NDArray[np.int64], last: bool
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
    words: NDArray[np.uint32],
    state: NDArray[np.uint64],
    values: NDArray[np.uint8],
    table: NDArray[np.uint64],
) -> None:
    held, n_bits, place = state[0], state[1], np.int64(state[2])
    even = values.shape[0] - values.shape[0] % 2
    for k in range(0, even, 2):
        first, second = table[values[k]], table[values[k + 1]]
        length = first & uint64(255)
        pair = (first >> uint64(8)) | ((second >> uint64(8)) << length)
        held |= pair << n_bits
        n_bits += length + (second & uint64(255))
        # Written whether or not the word is full: a branch here would be guessed wrong often.
        words[place] = uint32(held)
        full = n_bits & uint64(32)
        held >>= full
        n_bits -= full
        place += np.int64(full >> uint64(5))
    state[0], state[1], state[2] = held, n_bits, uint64(place)
    if values.shape[0] % 2:
        code = table[values[even]]
        _put(words, state, code >> uint64(8), code & uint64(255))
