"""Batches of network input: decoded once into memory where they fit, else read when needed."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from tacgen.learning.grasps import GraspSource
from tacgen.learning.inputs import InputSpec, augmented, read_input, resized, to_network
from tacgen.learning.training_recipe import Augmentation

_STREAM_ORDER, _STREAM_AUGMENT = 10, 11  # keep the random numbers of one seed apart


class DecodedInputs:
    """The frames of some grasps at the network's size: item ``i`` is (T, h, w, 3) uint8.

    All are decoded once and kept in memory if they fit into ``cache_mb``.
    """

    def __init__(
        self, source: GraspSource, rows: NDArray[np.int64], spec: InputSpec, cache_mb: int
    ) -> None:
        self.rows, self.labels = rows, source.table.label[rows]
        self._source, self._spec = source, spec
        n_bytes = len(rows) * spec.n_frames * spec.size_px[0] * spec.size_px[1] * 3
        self._cache: list[NDArray[np.uint8]] | None = None
        if n_bytes <= cache_mb << 20:
            self._cache = [read_input(source, int(row), spec) for row in rows]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, item: int) -> NDArray[np.uint8]:
        if self._cache is not None:
            return self._cache[item]
        return read_input(self._source, int(self.rows[item]), self._spec)


class Batches:
    """Batches of (input (B, T, 3, h, w), labels (B,), items) over decoded grasps.

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
        self._reference = None if reference is None else resized(reference[None], spec.size_px)[0]
        self._batch_size = batch_size

    def as_taken(self) -> "Batches":
        """The same without the removal of each image's gain and each grasp's contrast."""
        spec = replace(self._spec, normalised=False)
        return Batches(self._inputs, spec, self._reference, self._batch_size)

    def in_order(self) -> Iterator[tuple[Tensor, Tensor, NDArray[np.int64]]]:
        """Every grasp once, in the order of the rows."""
        yield from self._batches(self._divide(np.arange(len(self._inputs))))

    def shuffled(
        self, seed: int, epoch: int, augmentation: Augmentation
    ) -> Iterator[tuple[Tensor, Tensor, NDArray[np.int64]]]:
        """Every grasp once, in an order and with changes that depend on seed and epoch alone."""
        rng = _rng(seed, epoch, _STREAM_ORDER)
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
    ) -> Iterator[tuple[Tensor, Tensor, NDArray[np.int64]]]:
        for items in order:
            frames = [self._inputs[int(item)] for item in items]
            if augmentation is not None and augmentation.on:
                rngs = [_rng(*key, _STREAM_AUGMENT, int(item)) for item in items]
                pairs = zip(frames, rngs, strict=True)
                frames = [augmented(f, self._reference, augmentation, rng) for f, rng in pairs]
            images = as_batch(frames, self._reference, self._spec)
            yield images, torch.from_numpy(self._inputs.labels[items]), items


def as_batch(
    frames: list[NDArray[np.uint8]], reference: NDArray[np.uint8] | None, spec: InputSpec
) -> Tensor:
    """(B, T, 3, h, w) float32; shorter sequences repeat their last frame.

    All are padded to the network's length, so that no prediction depends on the other grasps of
    its batch.
    """
    n = spec.n_frames
    filled = [np.concatenate([g, g[-1:].repeat(n - len(g), axis=0)]) for g in frames]
    images = to_network(np.stack(filled), reference, spec)
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(images, -1, 2)))


def _rng(seed: int, *key: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
