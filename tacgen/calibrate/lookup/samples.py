"""The pixels of a press that a fit looks at, thinned evenly where there are plenty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.smooth_model import position_terms
from tacgen.core.arrays import FloatArray

BLOCK_PX = 8
"""Side of the blocks that take turns in estimating and scoring."""


@dataclass(frozen=True, slots=True)
class Pixels:
    """Some pixels of one image.

    Attributes
    ----------
    rows, columns : (n,) int
    x_mm, y_mm : (n,) float
        Place on the gel, from the image's centre, along columns and rows.
    position : (n, 6) float
        The table's features.
    grey : (n, 3) float
        RGB grey levels of the image.
    inside : (n,) bool
        Within the labelled (or found) contact circle.
    """

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    x_mm: FloatArray
    y_mm: FloatArray
    position: FloatArray
    grey: FloatArray
    inside: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, mask: NDArray[np.bool_]) -> Pixels:
        """The pixels where ``mask`` (n,) holds."""
        return Pixels(*(getattr(self, name)[mask] for name in self.__slots__))

    @property
    def odd_block(self) -> NDArray[np.bool_]:
        """Which of the two sets of a chess board of 8×8 blocks each pixel belongs to."""
        odd: NDArray[np.bool_] = ((self.rows // BLOCK_PX + self.columns // BLOCK_PX) % 2).astype(
            bool
        )
        return odd


def place_mm(
    column: FloatArray, row: FloatArray, shape_px: tuple[int, int], mm_per_px: float
) -> tuple[FloatArray, FloatArray]:
    """(x, y) on the gel, mm from the image's centre, of pixel coordinates."""
    height, width = shape_px
    return (column - (width - 1) / 2) * mm_per_px, (row - (height - 1) / 2) * mm_per_px


def disc_pixels(
    image: NDArray[np.uint8],
    center_px: FloatArray,
    radius_px: float,
    mm_per_px: float,
    *,
    reach: float = 1.0,
    limit: int | None = None,
    hidden: NDArray[np.bool_] | None = None,
) -> Pixels:
    """The pixels of ``image`` (H, W, 3) within ``reach`` × the contact circle, not ``hidden``.

    Where there are more than ``limit``, an even lattice of them: every k-th row and column, so
    that no part of the circle is favoured.
    """
    height, width = image.shape[:2]
    reach_px = reach * radius_px
    top, bottom = (int(np.clip(center_px[1] + s * (reach_px + 1), 0, height)) for s in (-1, 1))
    left, right = (int(np.clip(center_px[0] + s * (reach_px + 1), 0, width)) for s in (-1, 1))
    step = 1
    if limit is not None:
        step = max(1, math.ceil(math.sqrt(np.pi * reach_px**2 / limit) - 0.05))
    rows, columns = np.mgrid[top:bottom:step, left : right + 1 : step]
    rows, columns = rows.ravel(), np.minimum(columns.ravel(), width - 1)
    distance = np.hypot(columns - center_px[0], rows - center_px[1])
    near = distance < reach_px
    if hidden is not None:
        near &= ~hidden[rows, columns]
    rows, columns, distance = rows[near], columns[near], distance[near]
    x_mm, y_mm = place_mm(columns, rows, (height, width), mm_per_px)
    u, v = (columns + 0.5) / width - 0.5, (rows + 0.5) / height - 0.5
    return Pixels(
        rows=rows,
        columns=columns,
        x_mm=x_mm,
        y_mm=y_mm,
        position=position_terms(u, v),
        grey=image[rows, columns].astype(np.float64),
        inside=distance < radius_px,
    )
