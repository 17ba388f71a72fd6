"""Grasps to learn from: a table of what is known of each, and a source of their images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import LearningError
from tacgen.core.records import LABEL_NOT_EXECUTED
from tacgen.dataset import Dataset

CONFIGURATION_DIGITS = 6
FRAME_UNKNOWN = -1


@dataclass(frozen=True, slots=True)
class GraspTable:
    """One row a grasp; every field has length N.

    Attributes
    ----------
    ids : (N,) str
        Name of the grasp where it comes from.
    objects : (N,) str
    label : (N,) int64
        1 success, 0 failure.
    split : (N,) str
        ``train`` or ``test``.
    force_n, x_mm, y_mm, z_mm, yaw_rad : (N,) float64
        The configuration; see ``GraspConfig``.
    grasp_frame : (N,) int64
        Frame of the moment of grasp; ``FRAME_UNKNOWN`` where nobody noted it.
    """

    ids: NDArray[np.str_]
    objects: NDArray[np.str_]
    label: NDArray[np.int64]
    split: NDArray[np.str_]
    force_n: NDArray[np.float64]
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    z_mm: NDArray[np.float64]
    yaw_rad: NDArray[np.float64]
    grasp_frame: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.ids)

    def configurations(self) -> list[str]:
        """A text for each grasp, equal for grasps that were asked to do the same."""
        numbers = np.stack([self.force_n, self.x_mm, self.y_mm, self.z_mm, self.yaw_rad], axis=1)
        rounded = np.round(numbers, CONFIGURATION_DIGITS) + 0.0  # no "-0"
        return [
            f"{name} " + " ".join(f"{value:g}" for value in row)
            for name, row in zip(self.objects, rounded, strict=True)
        ]

    def object_names(self) -> list[str]:
        """The objects, sorted."""
        return sorted({str(name) for name in self.objects})

    def rows(self, *, objects: Sequence[str], split: str) -> NDArray[np.int64]:
        """The rows of these objects on one side of the split."""
        return np.flatnonzero(np.isin(self.objects, list(objects)) & (self.split == split))

    def take(self, rows: NDArray[np.int64]) -> GraspTable:
        """The table of some rows."""
        return GraspTable(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})


class GraspSource(Protocol):
    """Where the images of a table's grasps are read from; can be pickled to a loader's worker.

    ``made_with`` is the hash of the recipe that simulated them, None where a robot made them.
    """

    table: GraspTable
    made_with: str | None
    shape_px: tuple[int, int]

    def frames(self, row: int, frames: Sequence[int]) -> NDArray[np.uint8]:
        """Some tactile images of one grasp, (len(frames), H, W, 3) RGB."""
        ...

    def frame_count(self, row: int) -> int:
        """How many images the grasp has."""
        ...

    def reference(self) -> NDArray[np.uint8] | None:
        """The image of the undeformed gel, (H, W, 3), where there is one."""
        ...


class SimulatedGrasps:
    """The executed grasps of a dataset; its shards are opened when first needed.

    Raises
    ------
    DatasetError
        If the dataset is incomplete, mixed or damaged.
    LearningError
        If no grasp in it was executed.
    """

    def __init__(self, root: Path, pad: str | None = None) -> None:
        self.root = Path(root)
        self.dataset = Dataset(self.root)
        self.pad = pad
        self.made_with: str | None = self.dataset.lines[0].recipe_sha256
        columns = self.dataset.columns()
        self._indices = columns["index"][columns["label"] != LABEL_NOT_EXECUTED]
        self.table = _table_of(columns)
        if not len(self.table):
            msg = f"{self.root}: no grasp in it was executed; collect one with reachable grasps"
            raise LearningError(msg)
        self.reference_rgb = self.dataset.reference(pad)
        self.shape_px: tuple[int, int] = self.reference_rgb.shape[:2]
        self.n_frames = self.dataset.n_frames

    def frames(self, row: int, frames: Sequence[int]) -> NDArray[np.uint8]:
        """Some images of one grasp, each read by itself."""
        index = int(self._indices[row])
        return np.stack([self.dataset.rgb(index, self.pad, int(frame)) for frame in frames])

    def frame_count(self, row: int) -> int:
        """The same for every grasp of a dataset."""
        return self.n_frames

    def reference(self) -> NDArray[np.uint8]:
        """The undeformed gel, as the dataset stores it."""
        return self.reference_rgb

    def identity(self) -> dict[str, object]:
        """What tells this dataset from any other."""
        return {
            "recipe_sha256": self.made_with,
            "shards_sha256": [line.sha256 for line in self.dataset.lines],
            "sensor": self.dataset.sensor,
            "pad": self.pad or self.dataset.pads[0],
        }


def _table_of(columns: dict[str, NDArray]) -> GraspTable:
    executed = columns["label"] != LABEL_NOT_EXECUTED

    def column(name: str, dtype: type) -> NDArray:
        return columns[name][executed].astype(dtype)

    return GraspTable(
        ids=column("index", np.str_),
        objects=column("object", np.str_),
        label=column("label", np.int64),
        split=column("split", np.str_),
        force_n=column("force_n", np.float64),
        x_mm=column("x_mm", np.float64),
        y_mm=column("y_mm", np.float64),
        z_mm=column("z_mm", np.float64),
        yaw_rad=column("yaw_rad", np.float64),
        grasp_frame=column("grasp_frame", np.int64),
    )
