"""Images and labels of real grasps, as the networks take them in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import LearningError
from tacgen.core.safe_io import read_bgr
from tacgen.dataset.real_grasps import BACKGROUND, RealGrasp, read_real_grasps
from tacgen.learning.grasps import FRAME_UNKNOWN, GraspTable

MAX_IMAGE_BYTES, MAX_SIDE_PX = 64 << 20, 8192
_SHOWN = 5


class RealGraspImages:
    """Grasps of a real robot, or of anything written in the same format.

    An image of the undeformed gel may lie beside ``grasps.csv`` as ``background.png``.
    ``made_with`` is the hash of the recipe where a simulation wrote the folder, else None.

    Raises
    ------
    DatasetError
        Lists the rows that cannot be used.
    LearningError
        Lists the grasps without images.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        found = read_real_grasps(self.folder, needs=())
        self.warnings = found.warnings
        self.made_with = found.recipe_sha256
        missing = [grasp.grasp_id for grasp in found.grasps if not grasp.images]
        if missing:
            more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
            msg = (
                f"{self.folder}: no images of {', '.join(missing[:_SHOWN])}{more}; "
                "put them at images/<grasp_id>/0.png, 1.png, …, or take the rows out"
            )
            raise LearningError(msg)
        self._grasps = found.grasps
        self.table = _table_of(found.grasps)
        background = self.folder / BACKGROUND
        self._background = _read_image(background) if background.is_file() else None
        self.shape_px: tuple[int, int] = _read_image(found.grasps[0].images[0]).shape[:2]
        if self._background is not None:
            self._check_size(self._background, background)

    def frames(self, row: int, frames: Sequence[int]) -> NDArray[np.uint8]:
        """Some images of one grasp, (len(frames), H, W, 3) RGB.

        Raises
        ------
        LearningError
            If one cannot be read, or is not of the size of the others.
        """
        paths = [self._grasps[row].images[frame] for frame in frames]
        images = [_read_image(path) for path in paths]
        for path, image in zip(paths, images, strict=True):
            self._check_size(image, path)
        return np.stack(images)

    def frame_count(self, row: int) -> int:
        """How many images the grasp has."""
        return len(self._grasps[row].images)

    def reference(self) -> NDArray[np.uint8] | None:
        """``background.png``, where there is one."""
        return self._background

    def _check_size(self, image: NDArray[np.uint8], path: Path) -> None:
        if image.shape[:2] != self.shape_px:
            (height, width), (h, w) = image.shape[:2], self.shape_px
            msg = (
                f"{path}: {width}×{height} px, where the first image of the folder is {w}×{h} px; "
                "take all with the same sensor and size"
            )
            raise LearningError(msg)


def _table_of(grasps: Sequence[RealGrasp]) -> GraspTable:
    def numbers(name: str) -> NDArray[np.float64]:
        return np.array([getattr(grasp.config, name) for grasp in grasps], np.float64)

    return GraspTable(
        ids=np.array([grasp.grasp_id for grasp in grasps]),
        objects=np.array([grasp.config.object for grasp in grasps]),
        label=np.array([grasp.label for grasp in grasps], np.int64),
        split=np.full(len(grasps), "test"),
        force_n=numbers("force_n"),
        x_mm=numbers("x_mm"),
        y_mm=numbers("y_mm"),
        z_mm=numbers("z_mm"),
        yaw_rad=numbers("yaw_rad"),
        grasp_frame=np.full(len(grasps), FRAME_UNKNOWN, np.int64),
    )


def _read_image(path: Path) -> NDArray[np.uint8]:
    """An 8-bit image file as RGB (H, W, 3)."""
    if path.stat().st_size > MAX_IMAGE_BYTES:
        msg = f"{path}: larger than {MAX_IMAGE_BYTES >> 20} MB; save a smaller image"
        raise LearningError(msg)
    image = read_bgr(path)
    if image is None or max(image.shape) > MAX_SIDE_PX:
        msg = f"{path}: cannot be read as an image; save it again as 8-bit PNG"
        raise LearningError(msg)
    return np.ascontiguousarray(image[..., ::-1])
