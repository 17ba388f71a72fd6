"""Batches of network input: decoded once into memory where they fit, else read when needed."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from tacgen.core.records import rng_of
from tacgen.learning.grasps import GraspSource
from tacgen.learning.network_input import (
    InputSpec,
    at_rest,
    augmented,
    read_input,
    read_touch,
    resized,
    to_network,
    touch_to_network,
)
from tacgen.learning.networks import NetworkInput, TouchedImages
from tacgen.learning.training_recipe import Augmentation

_STREAM_ORDER, _STREAM_AUGMENT = 10, 11  # keep the random numbers of one seed apart


class DecodedInputs:
    """The frames of some grasps at the network's size: item ``i`` is (T, h, w, 3 or 6) uint8.

    All are decoded once and kept in memory if they fit into ``cache_mb``, with what the network
    sees beside the image, ``touch(i)``.
    """

    def __init__(
        self, source: GraspSource, rows: NDArray[np.int64], spec: InputSpec, cache_mb: int
    ) -> None:
        self.rows, self.labels = rows, source.table.label[rows]
        self._source, self._spec = source, spec
        numbers = sum(one.size for one in spec.touch)
        n_bytes = spec.size_px[0] * spec.size_px[1] * 3 * spec.n_images + 4 * numbers
        self._cache: list[NDArray[np.uint8]] | None = None
        self._touch: list[list[NDArray[np.float32]]] | None = None
        if len(rows) * spec.n_frames * n_bytes <= cache_mb << 20:
            self._cache = [read_input(source, int(row), spec) for row in rows]
            self._touch = [read_touch(source, int(row), spec) for row in rows]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, item: int) -> NDArray[np.uint8]:
        if self._cache is not None:
            return self._cache[item]
        return read_input(self._source, int(self.rows[item]), self._spec)

    def touch(self, item: int) -> list[NDArray[np.float32]]:
        """What the network sees of an item beside its images; see ``read_touch``."""
        if self._touch is not None:
            return self._touch[item]
        return read_touch(self._source, int(self.rows[item]), self._spec)


class Batches:
    """Batches of (input (B, T, 3 or 6, h, w), labels (B,), items) over decoded grasps.

    ``reference`` (H, W, 3) uint8 is the undeformed gel, at any size.
    """

    def __init__(
        self,
        inputs: DecodedInputs,
        spec: InputSpec,
        reference: NDArray[np.uint8] | None,
        batch_size: int,
    ) -> None:
        self._inputs, self._spec = inputs, spec
        self.reference = None if reference is None else resized(reference[None], spec.size_px)[0]
        self._batch_size = batch_size

    def as_taken(self) -> "Batches":
        """The same without the removal of each image's gain and each grasp's contrast."""
        spec = replace(self._spec, normalised=False)
        return Batches(self._inputs, spec, self.reference, self._batch_size)

    def in_order(self) -> Iterator[tuple[NetworkInput, Tensor, NDArray[np.int64]]]:
        """Every grasp once, in the order of the rows."""
        yield from self._batches(self._divide(np.arange(len(self._inputs))))

    def shuffled(
        self, seed: int, epoch: int, augmentation: Augmentation
    ) -> Iterator[tuple[NetworkInput, Tensor, NDArray[np.int64]]]:
        """Every grasp once, in an order and with changes that depend on seed and epoch alone."""
        rng = rng_of(seed, epoch, _STREAM_ORDER)
        order = self._divide(rng.permutation(len(self._inputs)))
        # Batch normalisation cannot learn from one image: it goes with the batch before.
        if len(order) > 1 and len(order[-1]) == 1:
            order[-2:] = [np.concatenate(order[-2:])]
        yield from self._batches(order, augmentation, (seed, epoch))

    def _divide(self, order: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        return np.split(order, range(self._batch_size, len(order), self._batch_size))

    def _batches(
        self,
        order: list[NDArray[np.int64]],
        augmentation: Augmentation | None = None,
        key: tuple[int, int] = (0, 0),
    ) -> Iterator[tuple[NetworkInput, Tensor, NDArray[np.int64]]]:
        for items in order:
            frames = [self._inputs[int(item)] for item in items]
            if augmentation is not None and augmentation.on:
                rngs = [rng_of(*key, _STREAM_AUGMENT, int(item)) for item in items]
                pairs = zip(frames, rngs, strict=True)
                rest = at_rest(self.reference, self._spec)
                frames = [augmented(f, rest, augmentation, rng) for f, rng in pairs]
            touch = [self._inputs.touch(int(item)) for item in items] if self._spec.touch else []
            inputs = as_batch(frames, self.reference, self._spec, touch)
            yield inputs, torch.from_numpy(self._inputs.labels[items]), items


def as_batch(
    frames: list[NDArray[np.uint8]],
    reference: NDArray[np.uint8] | None,
    spec: InputSpec,
    touch: list[list[NDArray[np.float32]]],
) -> NetworkInput:
    """(B, T, 3 or 6, h, w) float32, with the ``touch`` of each grasp where the network sees it.

    Shorter sequences repeat their last frame: all are padded to the network's length, so that no
    prediction depends on the other grasps of its batch.
    """
    n = spec.n_frames
    images = to_network(np.stack([_filled(one, n) for one in frames]), reference, spec)
    batch = torch.from_numpy(np.ascontiguousarray(np.moveaxis(images, -1, 2)))
    if not spec.touch:
        return batch
    vectors = [_filled(touch_to_network(one, spec), n) for one in touch]
    return TouchedImages(batch, torch.from_numpy(np.stack(vectors)))


def _filled(frames: NDArray[Any], count: int) -> NDArray[Any]:
    return np.concatenate([frames, frames[-1:].repeat(count - len(frames), axis=0)])
