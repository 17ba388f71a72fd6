"""Grasps for training and tests: a table of their parameters, and sources of their images."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import LearningError, require_known
from tacgen.core.records import AXES, LABEL_NOT_EXECUTED, Camera, Until
from tacgen.core.safe_io import read_rgb
from tacgen.dataset import Dataset
from tacgen.dataset.real_grasps import BACKGROUND, FRAME_UNKNOWN, read_real_grasps

CONFIGURATION_DIGITS = 6
"""Decimals of N, mm and rad that count; further ones are rounding errors of the grid."""
YAW_DIGITS = 4
"""Decimals of a yaw in rad, 0.006°: π and −π, written with six digits, are one."""
_DTYPES: dict[str, type] = dict.fromkeys(("ids", "objects", "split"), np.str_)
_DTYPES |= dict.fromkeys(("label", "grasp_frame"), np.int64) | dict.fromkeys(AXES, np.float64)
EqualRanges = Mapping[str, Mapping[str, Sequence[tuple[float, float]]]]
"""By object and axis the ranges in which the axis changes nothing; see ``twins.py``."""
COMMANDED = "commanded"
"""Name of what was commanded, as an array beside the images; see ``GraspTable.commanded``."""
MAX_NAMED = 5  # grasps without images that a message names; it counts the others


@dataclass(frozen=True, slots=True)
class GraspTable:
    """One row a grasp; every field has length N.

    ``ids`` are its names where it comes from, ``label`` 1 for success and 0 for failure, ``split``
    ``train`` or ``test``, ``grasp_frame`` the frame of the moment of grasp (``FRAME_UNKNOWN`` where
    it was not recorded), the numbers its configuration; see ``GraspConfig``.
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

    @classmethod
    def of(cls, **columns: Any) -> "GraspTable":
        """The table with these columns, each in its type."""
        return cls(**{n: np.asarray(values, _DTYPES[n]) for n, values in columns.items()})

    def __len__(self) -> int:
        return len(self.ids)

    def commanded(self) -> NDArray[np.float64]:
        """The force, place and yaw that were commanded, (N, 5) in the order of ``AXES``."""
        return np.stack([getattr(self, axis) for axis in AXES], axis=1)

    def configurations(self, equal: EqualRanges | None = None) -> list[str]:
        """A text for each grasp, equal for grasps of the same configuration.

        Values in one range of ``equal`` are written as its start.
        """
        rounded = np.round(self.commanded(), CONFIGURATION_DIGITS) + 0.0  # no "-0"
        rows = (" ".join(f"{value:g}" for value in row) for row in rounded)
        names = zip(self.objects, rows, strict=True)
        return [configuration_key(f"{name} {row}", equal or {}) for name, row in names]

    def object_names(self) -> list[str]:
        """The objects, sorted."""
        return sorted({str(name) for name in self.objects})

    def rows(self, *, objects: Sequence[str], split: str) -> NDArray[np.int64]:
        """The rows of these objects in one split."""
        return np.flatnonzero(np.isin(self.objects, list(objects)) & (self.split == split))

    def take(self, rows: NDArray[np.int64]) -> "GraspTable":
        """The table of some rows."""
        return GraspTable(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})


def configuration_key(text: str, equal: EqualRanges) -> str:
    """The text of a configuration, the same for values in one of its object's ``equal`` ranges.

    Its yaw lies in [0, 2π), to ``YAW_DIGITS``; earlier versions wrote it as it was asked for.
    """
    name, *values = text.rsplit(" ", len(AXES))
    turned = np.round(float(values[-1]) % (2 * np.pi), YAW_DIGITS)
    values[-1] = f"{turned % np.round(2 * np.pi, YAW_DIGITS):g}"
    for axis, ranges in equal.get(name, {}).items():
        k = AXES.index(axis)
        for low, high in ranges:
            if low <= float(values[k]) <= high:
                values[k] = f"{low:g}"
    return " ".join([name, *values])


class SimulatedGrasps:
    """The executed grasps of a dataset; its shards are opened when first needed.

    ``reference`` (H, W, 3) is the image of the undeformed gel, ``lift_frame`` (N,) the last frame
    before the lift (``FRAME_UNKNOWN`` where it was not recorded). Raises ``DatasetError`` if the
    dataset is incomplete, mixed or damaged, ``LearningError`` if no grasp in it was executed.
    """

    is_simulated = True

    def __init__(self, root: Path, pad: str | None = None) -> None:
        self.root = Path(root)
        self.dataset = Dataset(self.root)
        self.pad = pad
        columns = self.dataset.columns()
        rows = columns["label"] != LABEL_NOT_EXECUTED
        self._indices = columns["index"][rows]
        names = {"ids": "index", "objects": "object"}
        self.table = GraspTable.of(**{n: columns[names.get(n, n)][rows] for n in _DTYPES})
        if not len(self.table):
            msg = f"{self.root}: no grasp in it was executed; collect one with reachable grasps"
            raise LearningError(msg)
        self.reference = self.dataset.reference(pad)
        self.shape_px: tuple[int, int] = self.reference.shape[:2]
        self.n_frames = self.dataset.n_frames
        self.taken_with: Mapping[str, Any] = self.dataset.taken_with(pad)
        self.lift_frame = self.dataset.lift_frames(columns)[rows]

    def frames(self, row: int, frames: Sequence[int]) -> NDArray[np.uint8]:
        """Some tactile images of one grasp, (len(frames), H, W, 3) RGB."""
        index = int(self._indices[row])
        return np.stack([self.dataset.rgb(index, self.pad, int(frame)) for frame in frames])

    def touch(self, row: int, frames: Sequence[int], name: str) -> NDArray[np.floating]:
        """What is beside the images in some frames of one grasp; see ``Dataset.touch``.

        Of ``COMMANDED`` it is the same in all. Raises ``DatasetError`` if the dataset does not keep
        it.
        """
        if name == COMMANDED:
            return self.table.commanded()[[row] * len(frames)]
        index = int(self._indices[row])
        return np.stack([self.dataset.touch(index, name, self.pad, int(one)) for one in frames])

    def camera(self, name: str | None = None) -> Camera:
        """The camera of that name, or the first.

        Raises ``LearningError`` if there is none.
        """
        cameras = self.dataset.cameras
        if not cameras:
            msg = f"{self.root}: has no cameras for vision; collect it with `scene: {{cameras: …}}`"
            raise LearningError(msg)
        name = name or next(iter(cameras))
        require_known(f"{self.root}: the camera", name, tuple(cameras), LearningError)
        return cameras[name]

    def vision(self, row: int, frames: Sequence[int], camera: str) -> NDArray[np.uint8]:
        """What a camera saw in some frames of one grasp, (len(frames), h, w, 3) RGB.

        Raises ``DatasetError`` if the dataset does not keep them.
        """
        index, name = int(self._indices[row]), f"camera/{camera}/rgb"
        return np.stack([self.dataset.view(index, name, int(one)) for one in frames])

    def frame_count(self, row: int) -> int:
        """How many images the grasp has."""
        return self.n_frames

    def identity(self) -> dict[str, object]:
        """The identity of this dataset."""
        return {
            "recipe_sha256": self.dataset.lines[0].recipe_sha256,
            "inputs": self.dataset.inputs,
            "shards_sha256": [line.sha256 for line in self.dataset.lines],
            "taken_with": self.taken_with,
        }


class RealGraspImages:
    """Grasps of a real robot, or of anything written in the same format.

    An image of the undeformed gel may lie beside ``grasps.csv`` as ``background.png``: the
    ``reference`` (H, W, 3), else None.
    ``is_simulated`` says whether a simulation wrote the folder, ``taken_with`` what it says of how,
    ``lift_frame`` (N,) is as in ``SimulatedGrasps``.

    Raises ``DatasetError``, which lists the rows that cannot be used. Raises ``LearningError``,
    which lists the grasps without images.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        found = read_real_grasps(self.folder, needs=())
        self.warnings = found.warnings
        self.is_simulated, self.taken_with = found.is_simulated, found.taken_with
        missing = [grasp.grasp_id for grasp in found.grasps if not grasp.images]
        if missing:
            more = f" and {len(missing) - MAX_NAMED} more" if len(missing) > MAX_NAMED else ""
            msg = (
                f"{self.folder}: no images of {', '.join(missing[:MAX_NAMED])}{more}; "
                "put them at images/<grasp_id>/0.png, 1.png, …, or remove the rows"
            )
            raise LearningError(msg)
        self._grasps = found.grasps
        self.table = GraspTable.of(
            ids=[grasp.grasp_id for grasp in found.grasps],
            objects=[grasp.config.object for grasp in found.grasps],
            label=[grasp.label for grasp in found.grasps],
            split=["test"] * len(found.grasps),
            grasp_frame=[grasp.grasp_frame for grasp in found.grasps],
            **{name: [getattr(grasp.config, name) for grasp in found.grasps] for name in AXES},
        )
        self.lift_frame = np.array([grasp.lift_frame for grasp in found.grasps])
        first = read_rgb(found.grasps[0].images[0], LearningError)
        self.shape_px: tuple[int, int] = first.shape[:2]
        background = self.folder / BACKGROUND
        self.reference = self._read(background) if background.is_file() else None

    def frames(self, row: int, frames: Sequence[int]) -> NDArray[np.uint8]:
        """Some images of one grasp, (len(frames), H, W, 3) RGB.

        Raises ``LearningError`` if one cannot be read, or is not of the size of the others.
        """
        return np.stack([self._read(self._grasps[row].images[frame]) for frame in frames])

    def touch(self, row: int, frames: Sequence[int], name: str) -> NDArray[np.floating]:
        """What was ``COMMANDED``; raises ``LearningError`` of what a folder of pictures lacks."""
        if name == COMMANDED:
            values = self.table.commanded()[row]
            if lacking := [AXES[k] for k in np.flatnonzero(np.isnan(values))]:
                of, what = str(self.table.ids[row]), ", ".join(lacking)
                msg = (
                    f"{self.folder}: grasp {of!r} has no {what}, which the network also sees; "
                    "add what was commanded to grasps.csv"
                )
                raise LearningError(msg)
            return np.tile(values, (len(frames), 1))
        msg = f"{self.folder}: holds images alone, no {name}, which the network also needs"
        raise LearningError(msg)

    def camera(self, name: str | None = None) -> NoReturn:
        """What a folder of tactile pictures does not have: raises ``LearningError``."""
        msg = (
            f"{self.folder}: holds images of the sensor alone, none of the network's camera {name}"
        )
        raise LearningError(msg)

    def vision(self, row: int, frames: Sequence[int], camera: str) -> NDArray[np.uint8]:
        """As ``camera``."""
        self.camera(camera)

    def frame_count(self, row: int) -> int:
        """How many images the grasp has."""
        return len(self._grasps[row].images)

    def _read(self, path: Path) -> NDArray[np.uint8]:
        image = read_rgb(path, LearningError)
        if image.shape[:2] != self.shape_px:
            (height, width), (h, w) = image.shape[:2], self.shape_px
            msg = (
                f"{path}: {width}×{height} px, where the first image of the folder is {w}×{h} px; "
                "take all images with the same sensor and size"
            )
            raise LearningError(msg)
        return image


GraspSource = SimulatedGrasps | RealGraspImages
"""Where the images of a table's grasps are read from; can be pickled to a loader's worker."""


def frames_until(source: GraspSource, row: int, until: Until) -> int:
    """How many images of a grasp there are until the lift, as far as that is known, or in all."""
    last = int(source.lift_frame[row])
    return source.frame_count(row) if until == "outcome" or last == FRAME_UNKNOWN else last + 1
