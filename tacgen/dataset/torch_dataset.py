"""A dataset's executed grasps as a ``torch`` dataset."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset as TorchDataset

from tacgen.core.errors import DatasetError, require_known
from tacgen.core.records import LABEL_NOT_EXECUTED
from tacgen.dataset.schema import SPLITS, TOUCH


class Grasps(Protocol):
    """What is read of a ``tacgen.Dataset``."""

    root: Path

    def columns(self) -> dict[str, NDArray[Any]]:
        """Each grasp's values, by column."""

    def rgb(self, index: int, pad: str | None = None, frame: int | None = None) -> NDArray[Any]:
        """The images of a grasp, or one of its frames."""

    def reference(self, pad: str | None = None) -> NDArray[Any]:
        """The image of the undeformed gel."""

    def touch(
        self, index: int, name: str, pad: str | None = None, frame: int | None = None
    ) -> NDArray[Any]:
        """What is kept of the touch beside them."""

    @property
    def views(self) -> tuple[str, ...]:
        """What its cameras give."""

    def view(self, index: int, name: str, frame: int | None = None) -> NDArray[Any]:
        """One of them."""


class TorchGrasps(TorchDataset[Any]):
    """(images, label) of each executed grasp; images float32 in [0, 1], channels first.

    Those of several ``pads`` are stacked in front. With ``channels`` a dictionary of them and the
    label instead; see ``tacgen.Dataset.torch``.

    Raises ``DatasetError`` if ``split``, ``frames`` or a channel is unknown or the dataset does not
    keep it, or no executed grasp is on that side of the split.
    """

    def __init__(
        self,
        dataset: Grasps,
        split: str | None,
        frames: str,
        pads: tuple[str, ...],
        channels: Sequence[str] | None = None,
        transform: Callable[[Any], Any] | None = None,
    ) -> None:
        require_known("split", split or "train", SPLITS, DatasetError)
        require_known("frames", frames, ("grasp", "pair", "sequence"), DatasetError)
        self._dataset, self._frames, self._pads = dataset, frames, pads
        self._channels = None if channels is None else tuple(channels)
        self._transform = transform
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
        if frames == "pair" and (self._grasp_frame < 1).any():
            msg = (
                f"{dataset.root}: no frame before that of the grasp makes a pair with it; collect "
                "it with frames: {mode: sequence}"
            )
            raise DatasetError(msg)
        for name in self._channels or ():
            require_known("channel", name, ("rgb", *TOUCH, *dataset.views), DatasetError)
            self._values(0, name)  # which says what the dataset does not keep

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, place: Any) -> Any:
        """The sample at a place, or a list of them for a slice."""
        if isinstance(place, slice):
            return [self[k] for k in range(*place.indices(len(self)))]
        if not -len(self) <= place < len(self):
            raise IndexError(place)
        same = self._transform or (lambda sample: sample)
        if self._channels is None:
            return same(self._values(place, "rgb")), self.labels[place]
        values = {name: self._values(place, name) for name in self._channels}
        return same(values | {"label": self.labels[place]})

    def _values(self, place: int, name: str) -> torch.Tensor:
        """One channel of the sample at a place, float32, of several pads stacked in front."""
        index = int(self.indices[place])
        frame = None if self._frames == "sequence" else int(self._grasp_frame[place])
        if name in self._dataset.views:
            each = [self._dataset.view(index, name, frame)]
        elif name == "rgb" and self._frames == "pair":
            each = [self._pair(index, pad, int(self._grasp_frame[place])) for pad in self._pads]
        elif name == "rgb":
            each = [self._dataset.rgb(index, pad, frame) for pad in self._pads]
        else:
            each = [self._dataset.touch(index, name, pad, frame) for pad in self._pads]
        kind = name.rpartition("/")[2]
        if kind == "rgb":
            each = [np.moveaxis(rgb, -1, -3) for rgb in each]
        held = torch.from_numpy(np.ascontiguousarray(each[0] if len(each) == 1 else np.stack(each)))
        if kind == "segmentation":
            return held.long()
        return held.float() / 255.0 if kind == "rgb" else held.float()

    def _pair(self, index: int, pad: str, frame: int) -> NDArray[np.float32]:
        """The frame and the one before it, (H, W, 6), each less the gel at rest, of grey 127.5."""
        rest = self._dataset.reference(pad).astype(np.float32)
        both = [self._dataset.rgb(index, pad, one) for one in (frame, frame - 1)]
        return np.concatenate([np.clip(one - rest + 127.5, 0, 255) for one in both], axis=-1)
