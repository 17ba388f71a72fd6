"""A dataset's executed grasps as a ``torch`` dataset."""

from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset as TorchDataset

from tacgen.core.errors import DatasetError, require_known
from tacgen.core.records import LABEL_NOT_EXECUTED
from tacgen.dataset.schema import SPLITS


class Grasps(Protocol):
    """What is read of a ``tacgen.Dataset``."""

    root: Path

    def columns(self) -> dict[str, NDArray[Any]]:
        """Each grasp's values, by column."""

    def rgb(self, index: int, pad: str | None = None, frame: int | None = None) -> NDArray[Any]:
        """The images of a grasp, or one of its frames."""


class TorchGrasps(TorchDataset[tuple[torch.Tensor, torch.Tensor]]):
    """(images, label) of each executed grasp; images float32 in [0, 1], channels first.

    Those of several ``pads`` are stacked in front.

    Raises ``DatasetError`` if ``split`` or ``frames`` is unknown, or no executed grasp is on that
    side of the split.
    """

    def __init__(
        self, dataset: Grasps, split: str | None, frames: str, pads: tuple[str, ...]
    ) -> None:
        require_known("split", split or "train", SPLITS, DatasetError)
        require_known("frames", frames, ("grasp", "sequence"), DatasetError)
        self._dataset, self._frames, self._pads = dataset, frames, pads
        columns = dataset.columns()
        chosen = columns["label"] != LABEL_NOT_EXECUTED
        if split is not None:
            chosen &= columns["split"] == split
        if not chosen.any():
            msg = f"{dataset.root}: no executed grasp on the side {split!r} of its split"
            raise DatasetError(msg)
        self.indices = columns["index"][chosen]
        self.labels = torch.as_tensor(columns["label"][chosen].astype(np.int64))
        self._grasp_frame = columns["grasp_frame"][chosen]

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, place: Any) -> Any:
        """The pair at a place, or a list of them for a slice."""
        if isinstance(place, slice):
            return [self[k] for k in range(*place.indices(len(self)))]
        if not -len(self) <= place < len(self):
            raise IndexError(place)
        frame = int(self._grasp_frame[place]) if self._frames == "grasp" else None
        index = int(self.indices[place])
        each = [self._dataset.rgb(index, pad, frame) for pad in self._pads]
        rgb = each[0] if len(each) == 1 else np.stack(each)
        images = torch.from_numpy(np.ascontiguousarray(np.moveaxis(rgb, -1, -3)))
        return images.float() / 255.0, self.labels[place]
