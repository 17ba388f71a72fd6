"""A network of the light: one hidden layer whose inner weights are drawn once and stay.

Only what each of its tanh units adds to R, G and B is fitted, by ridge regression. It is told the
bent surface normal, the place and the light that falls there, and is 0 where the slope is 0. It
errs elsewhere than a polynomial does, so that the average of both errs less.

Source: Rahimi & Recht 2008, Weighted sums of random kitchen sinks.
"""

from dataclasses import dataclass

import numpy as np

from tacgen.calibrate.lookup.smooth_model import N_LIGHT, bent_normal
from tacgen.core.arrays import FloatArray

N_UNITS = 400  # on presses not seen 800 are no better

_INPUT_SCALES = np.array([2.0, 2.0, 0.5, 0.5, *[1.0] * N_LIGHT])
"""Standard deviation of a unit's weights on the bent normal, on the place, −1 to 1, and on the
light: of six that were tried the one that measured sets of presses choose most often."""

_SHOWN_RAD = 0.05  # slope at which half of what the units say shows


@dataclass(frozen=True, slots=True)
class RandomLight:
    """What the units add to the light of a smooth model."""

    weights: FloatArray  # (N_UNITS, 3), RGB grey levels of each
    bend: float  # of the normal, as in a smooth model

    def grey(self, gx: FloatArray, gy: FloatArray, position: FloatArray) -> FloatArray:
        """Grey levels (n, 3) for slopes (n,) at places (n, n_features)."""
        return np.asarray(units(gx, gy, position, self.bend) @ self.weights.astype(np.float32))


def units(gx: FloatArray, gy: FloatArray, position: FloatArray, bend: float) -> FloatArray:
    """What the units say (n, N_UNITS), single precision, of slopes (n,) at places (n, n_features).

    The features of place are those of a smooth model of any degree in position from 1 on.
    """
    rng = np.random.default_rng(0)
    inner = _INPUT_SCALES[:, None] * rng.normal(size=(len(_INPUT_SCALES), N_UNITS))
    offset = rng.uniform(-2.0, 2.0, N_UNITS)
    told = np.column_stack([*bent_normal(gx, gy, bend), position[:, 1:3], position[:, -N_LIGHT:]])
    said = told.astype(np.float32) @ inner.astype(np.float32)
    said += offset.astype(np.float32)
    np.tanh(said, out=said)
    square = (gx * gx + gy * gy).astype(np.float32)
    said *= (square / (square + np.float32(_SHOWN_RAD**2)))[:, None]
    return said
