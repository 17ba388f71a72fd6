"""Marker dots, drawn where the gel's motion has carried them."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import FloatArray

INK_TRANSMISSION = 0.25  # share of the light that a dot reflects


@njit(cache=True, nogil=True)
def _draw(
    image: NDArray[Any],
    columns: NDArray[Any],
    rows: NDArray[Any],
    radius: float,
    transmission: float,
) -> None:
    n_rows, n_columns = image.shape[0], image.shape[1]
    reach = radius + 1.0
    for i in range(columns.shape[0]):
        x, y = columns[i], rows[i]
        top, bottom = max(0, math.floor(y - reach)), min(n_rows, math.ceil(y + reach) + 1)
        left, right = max(0, math.floor(x - reach)), min(n_columns, math.ceil(x + reach) + 1)
        for r in range(top, bottom):
            for c in range(left, right):
                inside = radius + 0.5 - math.sqrt((c - x) ** 2 + (r - y) ** 2)
                cover = min(max(inside, 0.0), 1.0)
                if cover > 0.0:
                    gain = np.float32(1.0 - cover * (1.0 - transmission))
                    for channel in range(3):
                        image[r, c, channel] *= gain


def draw_markers(
    image: NDArray[np.float32], centers_mm: FloatArray, radius_mm: float, mm_per_px: float
) -> None:
    """Darken ``image`` (H, W, 3) in place under the dots, with edges a pixel soft.

    ``centers_mm`` (n, 2) are x, y of the dots in the gel frame; those outside are skipped.
    """
    n_rows, n_columns = image.shape[:2]
    columns = centers_mm[:, 0] / mm_per_px + (n_columns / 2 - 0.5)
    rows = centers_mm[:, 1] / mm_per_px + (n_rows / 2 - 0.5)
    _draw(image, columns, rows, radius_mm / mm_per_px, INK_TRANSMISSION)
