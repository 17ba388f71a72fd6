"""Names for the arrays that functions take and return; units and known constants.

Units within tacgen are N, mm, s, rad, °C and kg.
"""

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.floating[Any]]
IntArray: TypeAlias = NDArray[np.integer[Any]]
BoolArray: TypeAlias = NDArray[np.bool_]


MM_PER_M = 1000.0
M_PER_MM = 1e-3
STANDARD_GRAVITY_M_S2 = 9.80665
"""CODATA standard gravity; also the factor that turns a gauge reading in kgf into newtons."""
PUBLISHED_K_N_MM3_PER_N = 5.135  # taxim-robot's slope of 200 039 px³/N at its 0.0295 mm/px
GELS_K_N_MM3_PER_N = (0.3, 60.0)
"""What gels can have: those that are published are between 1 and 10, an order of magnitude less is
hard rubber, and more flows."""


def k_n_doubt(value: float) -> str:
    """What to do about a k_n, mm³/N, that no gel has; empty for all others."""
    low, high = GELS_K_N_MM3_PER_N
    if low <= value <= high or not (math.isfinite(value) and value > 0):
        return ""
    return (
        f"= {value:g}: gels have {low:g} to {high:g} mm³/N, so another unit is likely; if it is "
        f"right, say so in a contact.yaml: k_n_mm3_per_n: {{value: {value:g}, unit: mm3/N}}"
    )
