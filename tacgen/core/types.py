"""Names for the arrays that functions take and return; units and known constants; rigid transforms.

Units within tacgen are N, mm, s, rad, °C and kg.
"""

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.floating[Any]]
IntArray: TypeAlias = NDArray[np.integer[Any]]
BoolArray: TypeAlias = NDArray[np.bool_]
Pose: TypeAlias = FloatArray
"""A (4, 4) rigid transform, or (..., 4, 4) of them."""
Window: TypeAlias = tuple[int, int, int, int]
"""Half-open rectangle of pixels: top, bottom, left, right."""


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


def rotation_of(quaternion_xyzw: Sequence[float] | FloatArray) -> FloatArray:
    """The (..., 3, 3) rotation of each unit quaternion of (..., 4)."""
    given = np.asarray(quaternion_xyzw, dtype=np.float64)
    batch = range(given.ndim - 1)
    x, y, z, w = given.transpose(-1, *batch)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(*(axis + 2 for axis in batch), 0, 1)


def quaternion_from_rotation(rotation: FloatArray) -> FloatArray:
    """The unit quaternion x, y, z, w with w ≥ 0 of a (3, 3) rotation.

    Source: Shepperd 1978: the largest of the four components is found first, so nothing cancels.
    """
    trace = np.trace(rotation)
    squares = np.array([*(2 * np.diag(rotation) - trace), trace]) + 1.0
    k = int(np.argmax(squares))
    r = rotation
    products = np.array(
        [
            [squares[0], r[1, 0] + r[0, 1], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[1, 0] + r[0, 1], squares[1], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[2, 1] + r[1, 2], squares[2], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]],
        ]
    )[k]
    quaternion = products / np.linalg.norm(products)
    return np.asarray(quaternion if quaternion[3] >= 0 else -quaternion)


def pose(rotation: FloatArray, position: Sequence[float] | FloatArray) -> Pose:
    """The (..., 4, 4) transforms of rotations (..., 3, 3) followed by translations (..., 3)."""
    matrix = np.zeros((*rotation.shape[:-2], 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = position
    matrix[..., 3, 3] = 1.0
    return matrix


def inverse(matrix: Pose) -> Pose:
    """The inverse of a rigid transform."""
    rotation = matrix[:3, :3].T
    return pose(rotation, -rotation @ matrix[:3, 3])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """The cross products (..., 3) of two arrays (..., 3).

    As numpy's to the last bit, without its search for axes, which takes a tenth of a millisecond.
    """
    yzx, zxy = [1, 2, 0], [2, 0, 1]
    return a.take(yzx, -1) * b.take(zxy, -1) - a.take(zxy, -1) * b.take(yzx, -1)


def rotation_about_z(angle_rad: float) -> FloatArray:
    """The (3, 3) rotation about z."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def twice_sine(rotation: FloatArray) -> FloatArray:
    """Axis times twice the sine of the angle, (..., 3), of rotations (..., 3, 3)."""
    pairs = ((2, 1), (0, 2), (1, 0))
    return np.stack([rotation[..., i, j] - rotation[..., j, i] for i, j in pairs], axis=-1)


def turn_rad(rotation: FloatArray) -> FloatArray:
    """The angle of each rotation of a (..., 3, 3) array, exact for small angles too."""
    sine = twice_sine(rotation)
    cosine = np.trace(rotation, axis1=-2, axis2=-1) - 1.0
    return np.asarray(np.arctan2(np.linalg.norm(sine, axis=-1), cosine))
