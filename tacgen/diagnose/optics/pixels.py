"""The pixels of all presses in one row, as the images' models take them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.prepared import disc_pixels
from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.rules import RULES, SelectionRules
from tacgen.optics.effects import Patch
from tacgen.presses.press_images import PressImages, label_mm


@dataclass(frozen=True, slots=True)
class PressPixels:
    """Pixels of N presses, one press after the other.

    Attributes
    ----------
    press : (n,) int
        Which press a pixel is of.
    x_mm, y_mm : (n,) float
        Place on the gel, from the image's centre.
    position : (n, 6) float
        The table's features u², v², uv, u, v, 1.
    grey, background : (n, 3) float
        The image, and the reference, RGB.
    inside, odd : (n,) bool
        Within the labelled circle; of the chess board's other colour.
    rows, columns : (n,) int
    labels : (N, 3) float
        Centre and contact radius, mm, as labelled or found.
    ball_mm : (N,) float
    dome_radius_mm, mm_per_px : float
    """

    press: NDArray[np.int64]
    x_mm: FloatArray
    y_mm: FloatArray
    position: FloatArray
    grey: FloatArray
    background: FloatArray
    inside: NDArray[np.bool_]
    odd: NDArray[np.bool_]
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    labels: FloatArray
    ball_mm: FloatArray
    dome_radius_mm: float
    mm_per_px: float

    def __len__(self) -> int:
        return len(self.press)

    @property
    def n_presses(self) -> int:
        """How many presses."""
        return len(self.labels)

    def of_presses(self, which: NDArray[np.bool_]) -> PressPixels:
        """The pixels of the presses that a mask (N,) picks, numbered anew."""
        numbers = np.cumsum(which) - 1
        mine = which[self.press]
        changed: dict[str, Any] = {"press": numbers[self.press[mine]]}
        for entry in fields(self):
            value = getattr(self, entry.name)
            if entry.name in ("labels", "ball_mm"):
                changed[entry.name] = value[which]
            elif entry.name not in changed:
                changed[entry.name] = value[mine] if isinstance(value, np.ndarray) else value
        return PressPixels(**changed)

    @property
    def patch(self) -> Patch:
        """The pixels as an optical effect sees them."""
        return Patch(self.background, self.position[:, 3], self.position[:, 4], self.mm_per_px)

    @property
    def parts(self) -> list[slice]:
        """The pixels of each press."""
        ends = np.searchsorted(self.press, np.arange(self.n_presses + 1))
        return [slice(first, last) for first, last in pairwise(ends)]

    def mean_by_press(self, values: FloatArray) -> NDArray[np.float64]:
        """Mean (N,) over each press's pixels of values (n,)."""
        counts = np.maximum(np.bincount(self.press, minlength=self.n_presses), 1)
        sums = np.bincount(self.press, weights=values, minlength=self.n_presses)
        return np.asarray(sums / counts)


def gather_pixels(
    presses: PressImages,
    background: FloatArray,
    *,
    all_pixels: bool = False,
    rules: SelectionRules = RULES,
) -> PressPixels:
    """A lattice of the pixels of every press, or all of them; ``background`` is (H, W, 3)."""
    labels = label_mm(presses)
    labels[:, 2] = np.minimum(labels[:, 2], rules.max_label_balls * presses.ball_radius_mm)
    limit = None if all_pixels else rules.pixels_per_press
    parts = [
        disc_pixels(presses, k, reach=rules.reach_radii, limit=limit) for k in range(len(presses))
    ]

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(part, name) for part in parts])

    rows, columns = joined("rows"), joined("columns")
    return PressPixels(
        press=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        x_mm=joined("x_mm"),
        y_mm=joined("y_mm"),
        position=joined("position"),
        grey=joined("grey"),
        background=background[rows, columns].astype(np.float64),
        inside=joined("inside"),
        odd=joined("odd_block"),
        rows=rows,
        columns=columns,
        labels=labels,
        ball_mm=np.asarray(presses.ball_radius_mm, dtype=np.float64),
        dome_radius_mm=presses.dome_radius_mm,
        mm_per_px=presses.mm_per_px,
    )
