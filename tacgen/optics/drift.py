"""The lamps' drift between a picture and the gel at rest, seen where nothing touches."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter

from tacgen.core.arrays import BoolArray, FloatArray

ROBUST_PASSES = 8  # of reweighted least squares; later ones move the fit by < 0.05 grey levels
COMPARED_PX = 80  # width of the pictures that the drift is fitted on: light changes slowly
TOUCHED_SIGMAS = 4.0  # of the bare gel's own scatter: a larger change is no drift
LEAST_SCATTER_GREY = 0.3  # of a picture without noise
BESIDE_SHARE = 0.04  # of the width: so far the gel beside a contact bends with it
USUAL_GAIN = 0.05  # lamps change by so much in a session
INDEPENDENT_PATCHES = 30  # of a picture whose light differs otherwise than by gain and slope
LEAST_BARE = 0.15  # of the picture: less gel cannot tell a slope of the light over it


def gain_and_offset(image: FloatArray, rest: FloatArray) -> FloatArray:
    """The gel at rest (h, w, 3) in the light of another picture (h, w, 3).

    A gain and an offset of each channel, fitted to most of the picture: a contact is not.
    """
    columns = [_columns(rest[..., channel], slow=False) for channel in range(3)]
    change, weight = image - rest, np.ones(rest.shape[:2])
    fits = [_robust_fit(part, change[..., c], weight) for c, part in enumerate(columns)]
    return np.asarray(rest + np.stack([a @ b for a, b in zip(columns, fits, strict=True)], axis=-1))


@dataclass(frozen=True, slots=True)
class Drift:
    """What the light of a picture adds to the gel at rest.

    ``added`` (h, w, 3) is in grey levels; ``gain`` (3,) is what each channel's changes are
    multiplied by; ``bare`` (h, w) is where nothing touches.
    """

    added: FloatArray
    gain: FloatArray
    bare: BoolArray


def drift_of(change: FloatArray, rest: FloatArray, known: FloatArray) -> Drift:
    """The drift between a picture and the gel at rest, fitted to the gel that nothing touches.

    ``change`` (h, w, 3) is the picture less ``rest`` (h, w, 3); ``known`` (h, w) is 1 where the
    picture shows gel. Each channel has a gain, an offset and a slope over the picture, since lamps
    drift one by one.
    """
    height, width = change.shape[:2]
    scale = min(1.0, COMPARED_PX / width)
    size = max(8, round(width * scale)), max(8, round(height * scale))
    small, gel, seen = (
        np.asarray(cv2.resize(part.astype(np.float32), size, interpolation=cv2.INTER_AREA), float)
        for part in (change, rest, known)
    )
    is_seen = seen > 0.5
    bare, slow = is_seen, False
    for _ in range(3):
        columns = [_columns(gel[..., channel], slow=slow) for channel in range(3)]
        weight = bare.astype(np.float64)
        fits = [_robust_fit(part, small[..., c], weight) for c, part in enumerate(columns)]
        fitted = np.stack([a @ b for a, b in zip(columns, fits, strict=True)], axis=-1)
        left = np.abs(gaussian_filter(small - fitted, (1.0, 1.0, 0.0))).max(axis=2)
        usual = max(float(np.median(left[bare])), LEAST_SCATTER_GREY)
        touched = binary_dilation(
            left > TOUCHED_SIGMAS * usual, iterations=max(1, round(BESIDE_SHARE * size[0]))
        )
        if (is_seen & ~touched).mean() < LEAST_BARE:
            break
        bare, slow = is_seen & ~touched, True
    columns = [_columns(rest[..., channel], slow=len(fits[0]) > 2) for channel in range(3)]
    added = np.stack([a @ b for a, b in zip(columns, fits, strict=True)], axis=-1)
    # The camera clips what drift carries beyond its scale.
    added = np.clip(rest + added, 0.0, 255.0) - rest
    nearest = cv2.resize(bare.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    gain = 1.0 + np.array([fit[1] for fit in fits])
    return Drift(np.asarray(added), gain, np.asarray(nearest > 0))


def _columns(rest: FloatArray, *, slow: bool) -> FloatArray:
    """What drift is made of (h, w, 2 or 4): gain, offset and, if ``slow``, slopes."""
    height, width = rest.shape
    centred = rest.astype(np.float64) - float(rest.mean())
    parts = [np.ones_like(centred), centred]
    if slow:
        parts += np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    return np.stack(parts, axis=-1)


def _robust_fit(columns: FloatArray, values: FloatArray, weight: FloatArray) -> FloatArray:
    """Coefficients (n,) of ``columns`` (h, w, n) that fit most of ``values`` (h, w).

    Least squares, reweighted after Cauchy by the median residual. The second coefficient, a gain,
    is held near 0 where a picture has too little contrast to show it.
    """
    matrix, wanted = columns.reshape(-1, columns.shape[-1]), values.ravel().astype(np.float64)
    given, soft = weight.ravel(), np.ones(len(wanted))
    usual = LEAST_SCATTER_GREY
    for _ in range(ROBUST_PASSES):
        weighted = matrix * (given * soft)[:, None]
        # What light does beyond these columns is alike over patches.
        ridge = np.full(matrix.shape[1], 1e-6)
        ridge[1] = usual**2 * given.sum() / INDEPENDENT_PATCHES / USUAL_GAIN**2
        normal = weighted.T @ matrix + np.diag(ridge)
        fit = np.linalg.solve(normal, weighted.T @ wanted)
        size = np.abs(wanted - matrix @ fit)
        usual = max(float(np.median(size[given > 0])), LEAST_SCATTER_GREY)
        soft = 1.0 / (1.0 + (size / (usual + 1.0)) ** 2)
    return np.asarray(fit)
