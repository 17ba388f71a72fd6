"""How the light differs between a picture and the gel at rest, seen where nothing touches."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label

from tacgen.core.compiled import njit
from tacgen.core.types import BoolArray, FloatArray

ROBUST_PASSES = 8  # of reweighted least squares; later ones move the fit by < 0.05 grey levels
SETTLED_GREY = 0.01  # a pass that moves it by less is the last
COMPARED_PX = 80  # width of the pictures that the drift is fitted on: light changes slowly
BARE_PASSES = 3  # of light and bare gel in turn
FITTED_EVERY = 2  # row and column of these: a quarter of them is enough to find the bare gel
TOUCHED_SIGMAS = 4.0  # of the bare gel's own scatter: a larger change is no drift
LEAST_SCATTER_GREY = 0.3  # of a picture without noise
BESIDE_SHARE = 0.04  # of the width: so far the gel beside a contact bends with it
USUAL_GAIN = 0.05  # lamps change by so much in a session
LEAST_GAIN = 0.05  # of a light that still shows a contact
CLIPPED_GREY = 2.0  # so near to black or white, averaged, a picture may be clipped
INDEPENDENT_PATCHES = 30  # of a picture whose light differs otherwise than by gain and slope
LEAST_BARE = 0.15  # of the picture: less gel cannot tell a slope of the light over it
MEDIAN_TO_SIGMA = 1.4826  # of a normal distribution
IMPRINT_GREY, IMPRINT_SIGMAS, IMPRINT_SHARE = 4.0, 7.5, 0.6
"""A patch of the bare gel that differs on average by so many grey levels, by so many times what
the rest of it does, and makes so much of all that differs (squares). Most presses of seven real
sets reach 7, 8 and 0.97; two gels of one sensor 5, 6 and 0.9, two sensors 90, 7.2
and 1."""


def apart_grey(image: FloatArray, rest: FloatArray, *, is_tilted: bool = False) -> float:
    """Median difference, grey levels, of two pictures (h, w, 3), both in the light of the first.

    A gain, which may be larger at one side, and an offset of each channel are fitted to most of the
    picture: a contact is not.
    """
    image, rest = (np.asarray(part, np.float64) for part in (image, rest))
    given, spread = np.ones(rest.shape, np.bool_), np.full(3, USUAL_GAIN)
    fitted = _fits(rest, image - rest, given, spread, 4 if is_tilted else 2)[3]
    apart = np.abs(image - rest - fitted).reshape(-1, 3)
    return float(np.median(np.median(apart, axis=0)))


@dataclass(frozen=True, slots=True)
class OddPatch:
    """A compact patch in which bare gel differs: ``center_px`` (x, y), radius of its area."""

    center_px: FloatArray
    radius_px: float
    grey: float

    def sentence(self, whose: str, px: float = 1.0) -> str:
        """What a background that has it shows beside ``whose`` gel, averaged over ``px`` px."""
        x, y = (self.center_px + 0.5) * px - 0.5
        return (
            f"the background may show a press, at ({x:.0f}, {y:.0f}), where it differs by "
            f"{self.grey:.0f} grey levels from {whose} gel at rest"
        )


def press_in_background(rest: FloatArray, known: FloatArray) -> OddPatch | None:
    """The press that a gel at rest (h, w, 3) shows beside the one that is ``known`` (h, w, 3)."""
    seen = np.ones(rest.shape[:2])
    return drift_of(rest - known, known, seen, falls_outwards=True).imprint


@dataclass(frozen=True, slots=True)
class Drift:
    """What the light of a picture makes of the gel at rest.

    ``added`` (h, w, 3) is in grey levels; ``gain`` (h, w, 3) is what each channel's changes are
    multiplied by, ``gain_stderr`` (h, w) its relative standard error, ``offset`` (3,) what is added
    besides; ``bare`` (h, w) is where nothing touches, nowhere if that is too little, and
    ``unlike_grey`` what half of it differs by beyond all this. ``imprint`` is what looks like a
    contact.
    """

    added: FloatArray
    offset: FloatArray
    gain: FloatArray
    gain_stderr: FloatArray
    bare: BoolArray
    unlike_grey: float
    imprint: OddPatch | None


def drift_of(
    change: FloatArray, rest: FloatArray, known: FloatArray, *, falls_outwards: bool = False
) -> Drift:
    """The drift between a picture and the gel at rest, fitted to the gel that nothing touches.

    ``change`` (h, w, 3) is the picture less ``rest`` (h, w, 3); ``known`` (h, w) is 1 where the
    picture shows gel. Each channel has an offset and a gain that changes smoothly over the picture,
    since lamps drift one by one; only where it ``falls_outwards`` also as a lens does, because a
    gel that bends around a contact looks alike. Gain and offset are separated by the contrast of
    the gel at rest; with less contrast the gain tends to 1, and its error to the whole change of
    brightness.
    """
    height, width = change.shape[:2]
    scale = min(1.0, COMPARED_PX / width)
    size = max(8, round(width * scale)), max(8, round(height * scale))
    small, gel, seen = (
        np.asarray(cv2.resize(part.astype(np.float32), size, interpolation=cv2.INTER_AREA), float)
        for part in (change, rest, known)
    )
    is_seen, picture = seen > 0.5, gel + small
    clear = (np.minimum(gel, picture) > CLIPPED_GREY) & (
        np.maximum(gel, picture) < 255.0 - CLIPPED_GREY
    )
    clear[..., clear.mean(axis=(0, 1)) < LEAST_BARE] = True
    # So much of a change of brightness may be gain.
    brightness = np.median(picture / np.maximum(gel, 1.0), axis=(0, 1)) - 1.0
    spread = np.maximum(np.abs(brightness), USUAL_GAIN)
    bare, terms = is_seen, 2
    fitted_at = np.zeros(is_seen.shape, np.bool_)
    fitted_at[::FITTED_EVERY, ::FITTED_EVERY] = True
    for step in range(BARE_PASSES):
        if step == BARE_PASSES - 1:
            fitted_at[:] = True
        use = clear & (bare & fitted_at)[..., None]
        fits, normals, patches, fitted = _fits(gel, small, use, spread, terms)
        # The camera clips what drift carries beyond its scale.
        expected = np.clip(gel + fitted, 0.0, 255.0)
        left = np.abs(
            cv2.GaussianBlur(picture - expected, (9, 9), 1.0, borderType=cv2.BORDER_REFLECT)
        ).max(axis=2)
        usual = max(float(np.median(left[bare])), LEAST_SCATTER_GREY)
        differs = is_seen & (left > TOUCHED_SIGMAS * usual)
        beside = max(1, round(BESIDE_SHARE * size[0]))
        untouched = is_seen & ~binary_dilation(differs, iterations=beside)
        if untouched.mean() < LEAST_BARE:
            break
        bare, terms = untouched, 5 if falls_outwards else 4
    coefficients = np.zeros((5, 3))
    coefficients[:terms] = fits.T
    coefficients[0] -= coefficients[1] * gel.mean(axis=(0, 1))
    added, field = _spread(np.asarray(rest, np.float32), coefficients.astype(np.float32))
    u, v = np.linspace(-1, 1, size[0]), np.linspace(-1, 1, size[1])[:, None]
    places = np.stack([u + v - u - v + 1.0, u + 0.0 * v, v + 0.0 * u, u**2 + v**2], axis=-1)
    places = places[..., : terms - 1]
    covariance = np.linalg.inv(normals) * (MEDIAN_TO_SIGMA**2 * patches[:, None, None])
    within = covariance[:, 1:, 1:].mean(axis=0)
    variance = ((places @ within) * places).sum(axis=-1)
    gain = cv2.resize(field, size, interpolation=cv2.INTER_AREA).mean(axis=2)
    stderr = cv2.resize(np.sqrt(variance) / gain, (width, height))
    bare = bare & (terms > 2)
    nearest = cv2.resize(bare.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    imprint = None
    if falls_outwards:
        imprint = _imprint_in(np.where(differs, left, 0.0), usual, width / size[0])
    return Drift(added, coefficients[0], field, stderr, np.asarray(nearest > 0), usual, imprint)


def _imprint_in(left: FloatArray, usual: float, px: float) -> OddPatch | None:
    """The imprint in what differs (h, w), grey levels, on pixels of ``px`` of the picture's."""
    patches, count = label(left)
    if not count:
        return None
    squares = np.bincount(patches.ravel(), weights=(left**2).ravel())[1:]
    patch = patches == 1 + int(squares.argmax())
    grey = float(left[patch].mean())
    if grey < max(IMPRINT_GREY, IMPRINT_SIGMAS * usual):
        return None
    if squares.max() < IMPRINT_SHARE * squares.sum():
        return None
    center = np.argwhere(patch).mean(axis=0)[::-1]
    return OddPatch((center + 0.5) * px - 0.5, float(np.sqrt(patch.sum() / np.pi)) * px, grey)


@njit(cache=True, nogil=True)
def _spread(rest: NDArray[Any], coefficients: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """What drift adds to the gel at rest (h, w, 3), within the camera's scale, and its gain."""
    added, gain = np.empty_like(rest), np.empty_like(rest)
    height, width = rest.shape[:2]
    for r in range(height):
        v = np.float32(2.0 * r / (height - 1) - 1.0)
        for k in range(width):
            u = np.float32(2.0 * k / (width - 1) - 1.0)
            for c in range(3):
                more = coefficients[1, c] + coefficients[2, c] * u + coefficients[3, c] * v
                more += coefficients[4, c] * (u * u + v * v)
                at_rest = rest[r, k, c]
                lit = at_rest + at_rest * more + coefficients[0, c]
                added[r, k, c] = min(max(lit, 0.0), 255.0) - at_rest
                gain[r, k, c] = max(1.0 + more, LEAST_GAIN)
    return added, gain


@njit(cache=True, nogil=True)
def _fits(
    rest: NDArray[Any], change: NDArray[Any], use: NDArray[Any], spread: NDArray[Any], terms: int
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
    """What light makes of the gel at ``rest`` (h, w, 3), fitted to most of a ``change`` (h, w, 3).

    So many ``terms`` of: an offset, a gain, the gain's slopes and its fall outwards. Returns for
    each channel, fitted where it is of ``use`` (h, w, 3), the coefficients (3, n), what
    :func:`_reweighted` says of their error, and the fit (h, w, 3).
    """
    height, width = rest.shape[:2]
    fits, normals = np.zeros((3, terms)), np.zeros((3, terms, terms))
    patches, fitted = np.zeros(3), np.empty(rest.shape)
    columns = np.ones((height * width, 5))
    for c in range(3):
        mean, n = rest[..., c].mean(), 0
        matrix, wanted = np.empty((terms, height * width)), np.empty(height * width)
        for r in range(height):
            v = 2.0 * r / (height - 1) - 1.0
            for k in range(width):
                u, at = 2.0 * k / (width - 1) - 1.0, r * width + k
                grey = rest[r, k, c]
                columns[at, 1], columns[at, 2], columns[at, 3] = grey - mean, grey * u, grey * v
                columns[at, 4] = grey * (u * u + v * v)
                if use[r, k, c]:
                    for i in range(terms):
                        matrix[i, n] = columns[at, i]
                    wanted[n] = change[r, k, c]
                    n += 1
        fits[c], normals[c], patches[c] = _reweighted(matrix, wanted[:n], spread[c])
        for at in range(height * width):
            total = 0.0
            for i in range(terms):
                total += columns[at, i] * fits[c, i]
            fitted[at // width, at % width, c] = total
    return fits, normals, patches, fitted


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _reweighted(
    matrix: NDArray[Any], wanted: NDArray[Any], spread: float
) -> tuple[NDArray[Any], NDArray[Any], float]:
    """Coefficients (n,), normal matrix (n, n) and squared error of a patch.

    The first values of each row of ``matrix`` (n, …) are fitted to those ``wanted`` (N,).
    """
    count, n = len(wanted), len(matrix)
    usual, soft, size = LEAST_SCATTER_GREY, np.ones(count), np.empty(count)
    change = np.empty(count)
    normal, right = np.eye(n), np.empty(n)
    fit, before, patch = np.zeros((n, 1)), np.zeros((n, 1)), 0.0
    for _ in range(ROBUST_PASSES if count else 0):
        # What light does beyond these columns is alike over patches.
        patch = usual**2 * count / INDEPENDENT_PATCHES
        normal[:], right[:] = patch / spread**2 * np.eye(n), 0.0
        normal[0, 0] = 1e-6
        for i in range(n):
            share = soft * matrix[i, :count]
            right[i] = np.dot(share, wanted)
            for j in range(i + 1):
                normal[i, j] += np.dot(share, matrix[j, :count])
                normal[j, i] = normal[i, j]
        before[:, 0], fit[:, 0] = fit[:, 0], np.linalg.solve(normal, right)
        size[:], change[:] = wanted, 0.0
        for i in range(n):
            size -= matrix[i, :count] * fit[i, 0]
            change += matrix[i, :count] * (fit[i, 0] - before[i, 0])
        size = np.abs(size)
        moved = np.abs(change).max()
        if moved < SETTLED_GREY:
            break
        usual = max(np.median(size), LEAST_SCATTER_GREY)
        soft = 1.0 / (1.0 + (size / (usual + 1.0)) ** 2)
    return fit[:, 0], normal, patch
