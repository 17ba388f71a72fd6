"""From the volume of the indentation to its depth, exactly, and what the gel then looks like."""

import math

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.raster import Float64
from tacgen.core.compiled import njit
from tacgen.core.errors import ContactError


def solve_indentation(
    gap_map_mm: NDArray[np.floating], volume_mm3: float, pixel_area_mm2: float
) -> float:
    """The δ at which the gel below the object has lost a given volume.

    V(δ) = Σ max(0, δ − gap) · pixel area is convex, monotone and piecewise linear in δ, and is
    solved to the last digit.

    Parameters
    ----------
    gap_map_mm : (H, W)
        Gel frame, mm; +inf where there is no object.
    volume_mm3 : float
        At least 0.
    pixel_area_mm2 : float

    Returns
    -------
    float
        δ in mm, in the same zero as the gap map: the indentation of a pixel is max(0, δ − gap).
        At volume 0 it is the smallest gap.

    Raises
    ------
    ContactError
        If there is no object under the gel, or a number is not what it should be.

    Source
    ------
    Si et al. 2022, Eq. 1 and 2.
    """
    gap = np.asarray(gap_map_mm)
    if gap.ndim != 2 or not (np.isfinite(volume_mm3) and volume_mm3 >= 0 and pixel_area_mm2 > 0):
        msg = (
            f"gap_map_mm of shape {gap.shape} with volume_mm3 = {volume_mm3:g} and "
            f"pixel_area_mm2 = {pixel_area_mm2:g}: need a (H, W) map, a volume of at least 0 "
            "and an area above 0"
        )
        raise ContactError(msg)
    if np.isnan(gap).any():
        msg = "gap_map_mm holds NaN; use +inf where there is no object"
        raise ContactError(msg)
    gaps = gap[np.isfinite(gap)].astype(np.float64)
    if gaps.size == 0:
        msg = "no pixel can touch: the gap map is +inf everywhere; move the object over the pad"
        raise ContactError(msg)
    # Relative to first touch, so that no digit is spent on where the object is.
    zero_mm = float(gaps.min())
    gaps -= zero_mm
    while True:
        # Newton from the right: each step only drops pixels, and ends, exactly, when none is.
        delta_mm = (volume_mm3 / pixel_area_mm2 + gaps.sum()) / gaps.size
        below = gaps[gaps < delta_mm]
        if below.size in (0, gaps.size):
            return zero_mm + float(delta_mm)
        gaps = below


def contact_depth(gap_map_mm: NDArray[np.floating], delta_mm: float) -> Float64:
    """Indentation of each pixel (H, W), mm: max(0, δ − gap)."""
    return np.maximum(0.0, delta_mm - np.asarray(gap_map_mm, dtype=np.float64))


@njit(cache=True, nogil=True)
def _sum_below(grains: NDArray[np.int32], limit: int, stride: int) -> tuple[int, int]:
    """Count and sum of the gaps below ``limit``, of every ``stride``-th row."""
    count, total = 0, 0
    for r in range(0, grains.shape[0], stride):
        row = grains[r]
        row_count, row_total = 0, 0
        for k in range(row.shape[0]):
            below = row[k] < limit
            row_count += 1 if below else 0
            row_total += row[k] if below else 0
        count += row_count
        total += row_total
    return count, total


@njit(cache=True, nogil=True)
def _sum_of(gaps: NDArray[np.int32], limit: int) -> tuple[int, int]:
    """Count and sum of the ``gaps`` below ``limit``."""
    count, total = 0, 0
    for gap in gaps:
        if gap < limit:
            count += 1
            total += gap
    return count, total


@njit(cache=True, nogil=True)
def solve_grains(
    grains: NDArray[np.int32],
    volume: float,
    deepest: float,
    beside: NDArray[np.int32],
    weight: float,
) -> float:
    """``solve_indentation`` of a re-zeroed gap map in whole grains: sums are exact and quick.

    ``grains`` (h, w) int32 are gaps beyond first touch, more than ``deepest`` where there is no
    object; ``beside`` (n,) are those of points around the window, of the same zero, each of which
    stands for ``weight`` pixels. ``volume`` is in pixels × grains; ``deepest`` is the largest δ
    there can be, in grains. Returns δ in grains, exact, or ``deepest``.
    """
    if volume <= 0.0:
        return 0.0
    delta = deepest
    # From the right every step comes closer; a look at every eighth row starts it near the end.
    # A start that is too low does no harm: the first step from there lands on the right.
    for stride in (8, 1):
        for _ in range(1000):
            limit = int(min(math.ceil(delta), deepest + 1.0))
            n_pixels, in_window = _sum_below(grains, limit, stride)
            n_beside, around = _sum_of(beside, limit)
            count = n_pixels + n_beside * weight / stride
            if count == 0:
                delta = deepest
                break
            found = (volume / stride + in_window + around * weight / stride) / count
            if stride == 1 and math.ceil(found) == math.ceil(delta):
                return min(found, deepest)
            if stride == 8 and abs(found - delta) < 1e-3 * abs(delta):
                break
            if found >= deepest and delta >= deepest:
                break
            delta = found
    return min(delta, deepest)
