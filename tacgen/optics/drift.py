"""How the light differs between a picture and the gel at rest, seen where nothing touches."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter, label

from tacgen.core.types import BoolArray, FloatArray

ROBUST_PASSES = 8  # of reweighted least squares; later ones move the fit by < 0.05 grey levels
COMPARED_PX = 80  # width of the pictures that the drift is fitted on: light changes slowly
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


def in_light_of(image: FloatArray, rest: FloatArray, *, is_tilted: bool = False) -> FloatArray:
    """The gel at rest (h, w, 3) in the light of another picture (h, w, 3).

    A gain, which may be larger at one side, and an offset of each channel, fitted to most of the
    picture: a contact is not.
    """
    change, weight, fitted = image - rest, np.ones(rest.shape[:2]), np.empty(rest.shape)
    for c in range(3):
        columns = _columns(rest[..., c])[..., : 4 if is_tilted else 2]
        fitted[..., c] = columns @ _robust_fit(columns, change[..., c], weight, USUAL_GAIN)[0]
    return rest + fitted


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
    columns = [_columns(gel[..., channel]) for channel in range(3)]
    # So much of a change of brightness may be gain.
    brightness = np.median(picture / np.maximum(gel, 1.0), axis=(0, 1)) - 1.0
    spread = np.maximum(np.abs(brightness), USUAL_GAIN)
    bare, terms = is_seen, 2
    for _ in range(3):
        fits, fitted = [], np.empty(gel.shape)
        for c, part in enumerate(columns):
            weight = (bare & clear[..., c]).astype(np.float64)
            fits.append(_robust_fit(part[..., :terms], small[..., c], weight, spread[c]))
            fitted[..., c] = part[..., :terms] @ fits[-1][0]
        # The camera clips what drift carries beyond its scale.
        expected = np.clip(gel + fitted, 0.0, 255.0)
        left = np.abs(gaussian_filter(picture - expected, (1.0, 1.0, 0.0))).max(axis=2)
        usual = max(float(np.median(left[bare])), LEAST_SCATTER_GREY)
        differs = is_seen & (left > TOUCHED_SIGMAS * usual)
        beside = max(1, round(BESIDE_SHARE * size[0]))
        untouched = is_seen & ~binary_dilation(differs, iterations=beside)
        if untouched.mean() < LEAST_BARE:
            break
        bare, terms = untouched, 5 if falls_outwards else 4
    coefficients = np.zeros((columns[0].shape[-1], 3))
    coefficients[:terms] = np.stack([fit for fit, _ in fits], axis=1)
    offset, gain, across, down, outwards = coefficients
    u, v = np.linspace(-1, 1, width)[:, None], np.linspace(-1, 1, height)[:, None, None]
    slow = (across * u + outwards * u**2) + (down * v + outwards * v**2)
    offset = offset - gain * gel.mean(axis=(0, 1))
    added = rest * (slow + gain) + offset
    added = np.clip(rest + added, 0.0, 255.0) - rest
    field = np.maximum(1.0 + gain + slow, LEAST_GAIN)
    places = _columns(np.ones(size[::-1]))[..., 1:terms]
    places[..., 0] = 1.0
    variance = np.mean([((places @ cov[1:, 1:]) * places).sum(axis=-1) for _, cov in fits], axis=0)
    stderr = cv2.resize(np.sqrt(variance), (width, height)) / field.mean(axis=2)
    bare = bare & (terms > 2)
    nearest = cv2.resize(bare.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    imprint = _imprint_in(np.where(differs, left, 0.0), usual, width / size[0])
    return Drift(added, offset, field, stderr, np.asarray(nearest > 0), usual, imprint)


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


def _columns(rest: FloatArray) -> FloatArray:
    """What drift is made of (h, w, 5): offset, gain, and the gain's slopes and fall outwards."""
    height, width = rest.shape
    u, v = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    centred = rest.astype(np.float64) - float(rest.mean())
    return np.stack(
        [np.ones_like(centred), centred, rest * u, rest * v, rest * (u**2 + v**2)], axis=-1
    )


def _robust_fit(
    columns: FloatArray, values: FloatArray, weight: FloatArray, spread: float
) -> tuple[FloatArray, FloatArray]:
    """Coefficients (n,) of ``columns`` (h, w, n) that fit most of ``values`` (h, w), covariance.

    Least squares, reweighted after Cauchy by the median residual. All but the first coefficient are
    gains, expected to be of this spread where a picture has too little contrast to show them.
    """
    matrix, wanted = columns.reshape(-1, columns.shape[-1]), values.ravel().astype(np.float64)
    given, soft = weight.ravel(), np.ones(len(wanted))
    usual = LEAST_SCATTER_GREY
    for _ in range(ROBUST_PASSES):
        weighted = matrix * (given * soft)[:, None]
        # What light does beyond these columns is alike over patches.
        patch = usual**2 * given.sum() / INDEPENDENT_PATCHES
        ridge = np.full(matrix.shape[1], patch / spread**2)
        ridge[0] = 1e-6
        normal = weighted.T @ matrix + np.diag(ridge)
        fit = np.linalg.solve(normal, weighted.T @ wanted)
        size = np.abs(wanted - matrix @ fit)
        usual = max(float(np.median(size[given > 0])), LEAST_SCATTER_GREY)
        soft = 1.0 / (1.0 + (size / (usual + 1.0)) ** 2)
    return np.asarray(fit), np.linalg.inv(normal) * patch * MEDIAN_TO_SIGMA**2
