"""Compressed images: what is written here must be what everybody else's decoders read."""

import heapq
import zlib

import h5py
import hdf5plugin
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.dataset import Dataset
from tacgen.dataset.blosc import END_BYTES, ChunkEnds, encode_image, is_image_of
from tacgen.dataset.compression import storage_of
from tacgen.dataset.huffman import (
    HEADER_BYTES,
    MAX_CODE_BITS,
    code_lengths,
    deflate_differences,
)
from tacgen.dataset.schema import ArraySpec
from tacgen.dataset.verify import verify

from .conftest import vouch_for

NOISY = ArraySpec("/x", "uint8", (), "", "", "", image=True, noisy=True)


def read_back(rgb: np.ndarray) -> np.ndarray:
    """An image through an HDF5 file in memory, decoded by hdf5plugin's Blosc2."""
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        array = file.create_dataset("x", rgb.shape, "u1", chunks=rgb.shape, **storage_of(NOISY))
        array.id.write_direct_chunk((0, 0, 0), encode_image(rgb))
        return array[()]


def make_image(kind: str, height: int, width: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = (height, width, 3)
    if kind == "noise":
        values = rng.normal(rng.uniform(0, 255), rng.uniform(0.3, 20), shape)
    elif kind == "skewed":
        # Counts like Fibonacci numbers want codes deeper than the limit.
        values = np.cumsum(rng.geometric(0.382, shape), axis=1)
    else:
        values = rng.integers(0, 256, shape) if kind == "random" else np.full(shape, seed % 256)
    return np.clip(values, 0, 255).astype(np.uint8)


@settings(max_examples=80, deadline=None)
@given(
    kind=st.sampled_from(["noise", "skewed", "random", "flat"]),
    height=st.integers(1, 90),
    width=st.integers(1, 90),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_image_is_read_back_as_it_was(kind, height, width, seed):
    image = make_image(kind, height, width, seed)
    assert np.array_equal(read_back(image), image)


@pytest.mark.parametrize(("height", "width"), [(480, 640), (241, 321), (1, 70_000), (3000, 7)])
def test_images_of_many_blocks_are_read_back(height, width):
    for kind in ("noise", "skewed", "random", "flat"):
        image = make_image(kind, height, width, 5)
        assert np.array_equal(read_back(image), image), kind


def test_a_view_is_encoded_as_its_copy():
    image = make_image("noise", 40, 60, 1)
    assert encode_image(image[::2, ::-1]) == encode_image(image[::2, ::-1].copy())


def test_noise_of_one_grey_level_shrinks_as_far_as_differences_let_it():
    """Two such pixels differ by a normal of variance 2 (1 + 1/12): 2.6 of 8 bits by its entropy."""
    image = np.rint(np.random.default_rng(3).normal(120, 1, (480, 640, 3))).astype(np.uint8)
    entropy_bits = 0.5 * np.log2(2 * np.pi * np.e * 2 * (1 + 1 / 12))
    bits = 8 * len(encode_image(image)) / image.size
    assert entropy_bits < bits < 1.03 * entropy_bits
    assert image.nbytes / len(encode_image(image)) > 2.99


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 3000))
def test_a_stream_is_what_zlib_reads(seed, n):
    rng = np.random.default_rng(seed)
    pixels = rng.normal(128, rng.uniform(0.1, 60), (n, 3)).clip(0, 255).astype(np.uint8)
    words = np.empty(3 * (n * MAX_CODE_BITS // 64 + HEADER_BYTES // 8) + 16, np.uint64)
    differences = np.empty((3, n), np.uint8)
    n_bytes = deflate_differences(pixels, differences, words)
    before = np.vstack([np.zeros((1, 3), np.uint8), pixels[:-1]])
    assert np.array_equal(differences, (pixels - before).T)
    stream = words.view(np.uint8)[:n_bytes].tobytes()
    assert zlib.decompress(stream) == differences.tobytes()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(0, 10**6), min_size=2, max_size=257))
def test_code_lengths_are_those_of_the_best_code(counts):
    counts[:2] = [counts[0] + 1, counts[1] + 1]
    lengths = code_lengths(np.array(counts, np.int64))
    assert ((lengths == 0) == (np.array(counts) == 0)).all()
    assert np.sum(0.5 ** lengths[lengths > 0]) == 1.0
    heap = [count for count in counts if count]
    heapq.heapify(heap)
    best = 0
    while len(heap) > 1:
        joint = heapq.heappop(heap) + heapq.heappop(heap)
        best += joint
        heapq.heappush(heap, joint)
    cost = int(np.dot(lengths, counts))
    if lengths.max() < MAX_CODE_BITS:
        assert cost == best
    # What the limit costs where counts fall off very steeply.
    assert best <= cost <= 1.05 * best + MAX_CODE_BITS * len(counts)


def test_codes_are_never_deeper_than_the_limit():
    fibonacci = [1, 1]
    while len(fibonacci) < 40:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    lengths = code_lengths(np.array(fibonacci, np.int64))
    assert lengths.max() == MAX_CODE_BITS
    assert np.sum(0.5**lengths) == 1.0


def ends(chunk: bytes) -> ChunkEnds:
    return ChunkEnds(chunk[:END_BYTES], chunk[-END_BYTES:], len(chunk))


def test_a_head_that_is_not_the_images_is_seen():
    chunk = encode_image(make_image("noise", 31, 40, 2))
    assert is_image_of(ends(chunk), 31, 40)
    assert not is_image_of(ends(chunk), 40, 30)
    assert not is_image_of(ends(chunk[:-1]), 31, 40)
    assert not is_image_of(ends(b""), 31, 40)
    for place in (*range(97 + 32), *range(-75, 0)):
        wrong = bytearray(chunk)
        wrong[place] ^= 1
        assert not is_image_of(ends(bytes(wrong)), 31, 40), place


def test_images_of_earlier_datasets_are_read(toy):
    path = "/tactile/gelsight/rgb"
    with h5py.File(toy.shard_path(0), "r+") as file:
        images, chunks = file[path][()], file[path].chunks
        notes = dict(file[path].attrs)
        del file[path]
        new = file.create_dataset(path, data=images, chunks=chunks, **hdf5plugin.Htj2k())
        new.attrs.update(notes)
    vouch_for(toy, 0)
    assert not verify(toy.root, decode=True).problems
    assert np.array_equal(Dataset(toy.root).rgb(1), images[1])
