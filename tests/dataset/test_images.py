"""Compressed images: what is written here must be what everybody else's decoders read."""

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.dataset.compression import (
    END_BYTES,
    ChunkEnds,
    encode_image,
    is_blosc2_image,
    storage_of,
    write_images,
)


def read_back(rgb: np.ndarray) -> np.ndarray:
    """An image through an HDF5 file in memory, decoded by hdf5plugin's Blosc2."""
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        array = file.create_dataset(
            "x", rgb.shape, "u1", chunks=rgb.shape, **storage_of(noisy=True)
        )
        array.id.write_direct_chunk((0, 0, 0), encode_image(rgb))
        return array[()]


def test_images_that_equal_the_one_before_or_nearly_do_are_read_as_they_were():
    still = make_image("skewed", 31, 40, 1)
    last_pixel, first_row = still.copy(), still.copy()
    last_pixel[-1, -1] ^= 1
    first_row[0] ^= 1
    frames = np.stack([still, still, last_pixel, first_row, still, still])
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        shape = (2, *frames.shape)
        array = file.create_dataset(
            "x", shape, "u1", chunks=(1, 1, *still.shape), **storage_of(noisy=True)
        )
        write_images(array, 0, frames)
        write_images(array, 1, frames[::-1])
        np.testing.assert_array_equal(array[()], np.stack([frames, frames[::-1]]))


def make_image(kind: str, height: int, width: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = (height, width, 3)
    if kind == "noise":
        values = rng.normal(rng.uniform(0, 255), rng.uniform(0.3, 20), shape)
    elif kind == "skewed":
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


def test_noise_of_one_grey_level_shrinks_as_far_as_differences_let_it():
    """Two such pixels differ by a normal of variance 2 (1 + 1/12): 2.6 of 8 bits by its entropy."""
    image = np.rint(np.random.default_rng(3).normal(120, 1, (480, 640, 3))).astype(np.uint8)
    entropy_bits = 0.5 * np.log2(2 * np.pi * np.e * 2 * (1 + 1 / 12))
    bits = 8 * len(encode_image(image)) / image.size
    assert entropy_bits < bits < 1.05 * entropy_bits
    assert image.nbytes / len(encode_image(image)) > 2.95


def ends(chunk: bytes) -> ChunkEnds:
    return ChunkEnds(chunk[:END_BYTES], chunk[-END_BYTES:], len(chunk))


def test_a_head_that_is_not_the_images_is_seen():
    chunk = encode_image(make_image("noise", 31, 40, 2))
    assert is_blosc2_image(ends(chunk), (31, 40, 3), 1)
    assert not is_blosc2_image(ends(chunk), (40, 30, 3), 1)
    assert not is_blosc2_image(ends(chunk[:-1]), (31, 40, 3), 1)
    assert not is_blosc2_image(ends(b""), (31, 40, 3), 1)
    for place in (*range(97 + 32), *range(-75, 0)):
        wrong = bytearray(chunk)
        wrong[place] ^= 1
        assert not is_blosc2_image(ends(bytes(wrong)), (31, 40, 3), 1), place
