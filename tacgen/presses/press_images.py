"""Images of ball presses: what the readers give and what a fit of the table needs."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.types import BoolArray, FloatArray, IntArray

_OF_EACH_PRESS = (
    *("images", "center_px", "radius_px", "ball_radius_mm"),
    *("found", "seen_px", "stage_mm", "hidden", "trial", "experiment"),
)


@dataclass(frozen=True, slots=True)
class DroppedPress:
    """A press that is not used: which file, which row of the list, why, and the fix."""

    file: str
    row: int
    reason: str
    fix: str

    def __str__(self) -> str:
        where = f"{self.file} (row {self.row})" if self.row else self.file
        return f"{where}: {self.reason}; dropped: {self.fix}"


@dataclass(frozen=True, slots=True)
class PressImages:
    """Ball presses on one sensor: N pictures, RGB; what is not known of a press is NaN."""

    images: NDArray[np.uint8]  # (N, H, W, 3)
    background: NDArray[np.uint8]  # (H, W, 3), the gel with nothing on it
    names: tuple[str, ...]
    center_px: FloatArray  # (N, 2), the contact's column and row, pixel centres at integers
    radius_px: FloatArray  # (N,) of the contact circle
    ball_radius_mm: FloatArray  # (N,)
    mm_per_px: float
    dome_radius_mm: float = 0.0  # of the gel at rest, 0 for a flat one
    sensor: str = ""
    seen_px: FloatArray | None = None  # (N, 3), column, row, radius of the circle seen, labelled or
    # not
    stage_mm: FloatArray | None = None  # (N, 2), where a stage says that each press was
    dot_pitch_mm: float = 0.0  # of printed dots, 0 where it is not known
    trial: FloatArray | None = None  # (N,), as listed
    experiment: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))  # (N,), the
    # press that a picture is of; by default each of its own
    found: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))  # (N,), whether the
    # circle is found in the image instead of labelled; by default where a label is missing
    dots: BoolArray | None = None  # (H, W), what printed dots cover in the background, if any
    hidden: BoolArray | None = None  # (N, H, W), the same in each press
    dropped: tuple[DroppedPress, ...] = ()
    warnings: tuple[str, ...] = ()
    sha256: Mapping[str, str] = field(default_factory=dict)  # of each file read, by its name

    def __post_init__(self) -> None:
        """Fill in ``found`` and ``experiment``."""
        if len(self.found) != len(self.images):
            object.__setattr__(self, "found", ~self.labelled)
        if len(self.experiment) != len(self.images):
            object.__setattr__(self, "experiment", np.arange(len(self.images)))

    def __len__(self) -> int:
        return len(self.images)

    @property
    def n_experiments(self) -> int:
        """How many presses the pictures are of."""
        return len(np.unique(self.experiment))

    @property
    def shape_px(self) -> tuple[int, int]:
        """(height, width) of the images."""
        return self.images.shape[1], self.images.shape[2]

    @property
    def labelled(self) -> BoolArray:
        """Which presses come with a centre and a radius (N,)."""
        return np.isfinite(self.center_px).all(axis=1) & np.isfinite(self.radius_px)

    def hidden_in(self, k: int) -> BoolArray | None:
        """Pixels (H, W) of press ``k`` that show a dot; None where there are no dots."""
        return None if self.hidden is None else self.hidden[k]

    def select(self, which: NDArray[Any]) -> "PressImages":
        """The presses that an index array or mask picks; notes on the set stay."""
        picked: dict[str, Any] = {name: getattr(self, name) for name in _OF_EACH_PRESS}
        picked |= {name: own[which] for name, own in picked.items() if own is not None}
        return replace(self, names=tuple(np.array(self.names, dtype=object)[which]), **picked)


def place_mm(
    column: FloatArray, row: FloatArray, shape_px: tuple[int, int], mm_per_px: float
) -> tuple[FloatArray, FloatArray]:
    """(x, y) on the gel, mm from the image's centre, of pixel coordinates."""
    height, width = shape_px
    return (column - (width - 1) / 2) * mm_per_px, (row - (height - 1) / 2) * mm_per_px


def label_mm(presses: PressImages) -> FloatArray:
    """Labelled centre and radius (N, 3), mm on the gel from the image's centre."""
    x, y = place_mm(
        presses.center_px[:, 0], presses.center_px[:, 1], presses.shape_px, presses.mm_per_px
    )
    return np.column_stack([x, y, presses.radius_px * presses.mm_per_px])
