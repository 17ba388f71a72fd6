"""Whether two pictures show the gel in the same colours, turned and cropped alike."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tacgen.core.types import FloatArray
from tacgen.optics.drift import apart_grey

MUCH_BETTER = 0.5  # of the difference as it is: what is proven, where lamps and contacts differ too
CLEARLY_BETTER = 0.8  # than with a lamp brighter at one side, which leaves a picture's noise
CLEARLY_GREY = 0.15  # differences below it show nothing
DRIFT_GREY = 3.0
"""Nor do those of the light below this where a picture may be turned: a lamp that drifts by 4 grey
levels at one side makes 2 of it, in either picture."""
SAME_VIEW = "save all pictures of a sensor as RGB, turned and cropped alike"
GREY = "is grey, its three channels are equal"
VIEW_PX = 40  # width of the pictures whose light is compared: colours show at any size
LEAST_SHIFT = 0.03  # of the width: a camera with play moves by 0.02 between real presses
ZOOMS = (0.8, 0.85, 0.9, 0.95, 1.05, 1.1, 1.15, 1.2)
REORDERED: dict[str, tuple[int, ...]] = {
    "red and blue are swapped": (2,),
    "it is turned by 180°": (0, 1),
    "it is mirrored left to right": (1,),
    "it is mirrored top to bottom": (0,),
}
"""Axes of a picture (H, W, 3) that are reversed."""

TEXTURE_PX = 320  # width of the pictures whose fine texture is compared
TEXTURE_SIGMAS_PX = 0.5, 2.0, 8.0
"""Of noise, of the texture that is kept, and of the surroundings that its contrast is relative to.
Dust, the coating's grain and dirt on the lens are that fine; contacts and light are wider."""
LARGEST_TEXTURE = 3.0  # times the local contrast: one bright speck is no picture
PLAY_PX = 3  # of ``TEXTURE_PX``: as near, two pictures lie on each other
SURE_SIGMAS = 9.0
"""Height of the correlation's peak over its scatter. Pictures of one view reach 10 to 80 on seven
real sets of five sensors (but for some of 160 px in which the camera had moved); other views and
other sensors stay below 8 at any place, turned, mirrored or enlarged."""
MUCH_HIGHER = 2.0  # than the correlation as the pictures lie
BEYOND_DOUBT_SIGMAS = 20.0  # no other view leaves so much: enlarged by 4 %, 13 of 72 are left
LARGEST_CLOSE_ZOOM = 0.07  # enlarged by more, two textures do not lie on each other
TEXTURE_ZOOMS = tuple(
    float(zoom) for zoom in np.exp(np.arange(-0.22, 0.225, 0.01)) if abs(zoom - 1) > 0.025
)
ZOOM_HIGHER = 1.2  # than without: enlarged by 2 % a shifted picture fits nearly as well
LIGHT_WORSE = 1.1
"""A gel can slide under the camera, its texture with it; the light, which then differs by more than
so many times what it did, does not."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """How the fine texture of two pictures lies on each other.

    ``sigmas`` is the height of the correlation's peak as they lie, over its scatter; ``other``
    names the view in which it is clearly higher, empty if there is none.
    """

    sigmas: float
    other: str = ""

    @property
    def is_same(self) -> bool:
        """Whether they are proven to be of one view of one gel."""
        return self.sigmas >= SURE_SIGMAS and not self.other


def other_view(image: FloatArray | NDArray[np.uint8], rest: FloatArray | NDArray[np.uint8]) -> str:
    """How a picture (H, W, 3) is turned, coloured or shifted otherwise than ``rest`` (H, W, 3).

    Empty unless that is proven: by the fine texture of the gel, or by the light on the bare gel,
    which up to a gain and an offset of each channel agrees far better that way, and clearly better
    than as it is with a gain that is larger at one side. A gel that looks alike from all sides
    shows nothing. For many pictures make a :class:`View` once.
    """
    return View(rest).other_view(image)


def is_grey(image: FloatArray | NDArray[np.uint8], rest: FloatArray | NDArray[np.uint8]) -> bool:
    """Whether a picture (…, H, W, 3) has lost the colour that the gel at rest has."""
    return bool(np.ptp(rest, axis=-1).any() and not np.ptp(image, axis=-1).any())


def alignment(
    image: FloatArray | NDArray[np.uint8], rest: FloatArray | NDArray[np.uint8]
) -> Alignment:
    """How the fine texture of a picture (H, W, 3) lies on that of ``rest`` (H, W, 3)."""
    return View(rest).alignment(image)


class View:
    """A gel at rest (H, W, 3) that pictures are compared with; what they share is kept.

    Shifts are stated in pixels of which ``step`` were averaged to one, each way.
    """

    def __init__(self, rest: FloatArray | NDArray[np.uint8], step: int = 1) -> None:
        self._rest, self._small, self._texture = rest, _small(rest), _texture(rest)
        self._step = step
        self._spectra: dict[float | tuple[int, ...], NDArray[np.complexfloating]] = {}

    @cached_property
    def _apart_flipped(self) -> dict[tuple[int, ...], float]:
        """How much the gel's light differs from itself that way round, grey levels."""
        gel = self._small
        return {axes: apart_grey(np.flip(gel, axes), gel) for axes in REORDERED.values()}

    def other_view(self, image: FloatArray | NDArray[np.uint8]) -> str:
        """As of the function."""
        small, gel = _small(image), self._small
        if small.std() > CLEARLY_GREY and is_grey(small, gel):
            return f"it {GREY}"
        plain = apart_grey(small, gel)
        if plain < CLEARLY_GREY:
            return ""
        aligned = self.alignment(image)
        if aligned.other:
            return aligned.other
        found = {
            what: apart_grey(small, np.flip(gel, axes)) / plain
            for what, axes in REORDERED.items()
            # Of light that is nearly the same that way, another difference shows nothing.
            if (axes == (2,) or (not aligned.is_same and plain > DRIFT_GREY))
            and self._apart_flipped[axes] > MUCH_BETTER * plain
        }
        if not aligned.is_same:
            for zoom in ZOOMS:
                # Compared on the part that both pictures show.
                share = min(zoom, 1.0 / zoom)
                middle, rest_middle = _middle(small, share), _middle(gel, share)
                pair = (small, rest_middle) if zoom > 1 else (middle, gel)
                as_is = apart_grey(middle, rest_middle)
                found[f"it is {zoom:g} times as large"] = apart_grey(*pair) / as_is
            shift = _shift_px(image, self._rest)
            shifted = f"it is shifted by {shift[0] * self._step, shift[1] * self._step} px"
            found[shifted] = _light_at_shift(image, self._rest, shift)
        what = min(found, key=lambda name: found[name], default="")
        if not what or found[what] >= MUCH_BETTER:
            return ""
        # A lamp that is brighter at one side explains what another view would.
        tilted = CLEARLY_BETTER * apart_grey(small, gel, is_tilted=True) / plain
        return what if found[what] < tilted else ""

    def alignment(self, image: FloatArray | NDArray[np.uint8]) -> Alignment:
        """How the fine texture of a picture (H, W, 3) lies on that of the gel at rest.

        By phase of the correlation at every shift; where it has no clear peak as the pictures lie,
        also turned, mirrored, and enlarged in steps of 1 %.
        """
        seen = _texture(image)
        spectrum, size = _spectrum(seen), (seen.shape[0], seen.shape[1])
        as_is, top, place = _peak(spectrum, self._spectrum(()), size)
        if as_is >= BEYOND_DOUBT_SIGMAS:
            return Alignment(as_is)
        scale = image.shape[1] / seen.shape[1]
        shift = round(place[0] * scale), round(place[1] * scale)
        shifted = f"it is shifted by {shift[0] * self._step, shift[1] * self._step} px"
        found = {shifted: top}
        for what, axes in REORDERED.items():
            if axes != (2,):
                found[what] = _peak(spectrum, self._spectrum(axes), size)[1]
        enlarged = {}
        for zoom in TEXTURE_ZOOMS:
            if as_is >= SURE_SIGMAS and abs(zoom - 1) > LARGEST_CLOSE_ZOOM:
                continue
            larger = _peak(spectrum, self._spectrum(zoom), size)[1]
            enlarged[f"it is {zoom:.2f} times as large"] = larger
        what = max(found, key=lambda name: found[name])
        most = max(enlarged, key=lambda name: enlarged[name])
        if enlarged[most] > ZOOM_HIGHER * found[what]:
            found, what = enlarged, most
        is_clear = found[what] >= max(SURE_SIGMAS, MUCH_HIGHER * as_is)
        if what == shifted:
            is_clear &= _light_at_shift(image, self._rest, shift) <= LIGHT_WORSE
        return Alignment(as_is, what if is_clear else "")

    def _spectrum(self, how: float | tuple[int, ...]) -> NDArray[np.complexfloating]:
        """Of the gel's texture flipped along axes, or enlarged."""
        if how not in self._spectra:
            gel = self._texture
            other = np.flip(gel, how) if isinstance(how, tuple) else _zoomed(gel, how)
            self._spectra[how] = _spectrum(other)
        return self._spectra[how]


def _texture(image: FloatArray | NDArray[np.uint8]) -> FloatArray:
    """What is fine in a picture (h, w, 3), in each channel relative to the contrast around it."""
    height, width = image.shape[:2]
    picture = np.ascontiguousarray(image, dtype=np.float32)
    if width > TEXTURE_PX:
        size = TEXTURE_PX, round(height * TEXTURE_PX / width)
        picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    noise, fine, around = TEXTURE_SIGMAS_PX
    picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), noise))
    picture = picture - cv2.GaussianBlur(picture, (0, 0), fine)
    # So wide a blur needs no more than every fourth pixel.
    size = picture.shape[1::-1]
    quarter = max(1, size[0] // 4), max(1, size[1] // 4)
    power = cv2.resize(picture * picture, quarter, interpolation=cv2.INTER_AREA)
    contrast = np.sqrt(cv2.GaussianBlur(power, (0, 0), around / 4)) + 0.5
    picture /= np.asarray(cv2.resize(contrast, size, interpolation=cv2.INTER_LINEAR))
    return np.asarray(np.clip(picture, -LARGEST_TEXTURE, LARGEST_TEXTURE, out=picture))


def _spectrum(texture: FloatArray) -> NDArray[np.complexfloating]:
    """Of each channel (3, h, w'); edges are faded out."""
    window = np.asarray(cv2.createHanningWindow(texture.shape[1::-1], cv2.CV_32F))
    faded = np.stack([texture[..., channel] * window for channel in range(3)])
    return np.asarray(fft.rfft2(faded, axes=(1, 2)))


def _peak(
    one: NDArray[np.complexfloating], other: NDArray[np.complexfloating], shape: tuple[int, int]
) -> tuple[float, float, tuple[int, int]]:
    """Height of the correlation as the pictures lie, its highest and where (x, y) that is."""
    height, width = shape
    together = fft.irfft2((one * np.conj(other)).sum(axis=0), s=shape)
    scatter = float(together.std())
    if not scatter > 0:
        return 0.0, 0.0, (0, 0)
    together /= scatter
    row, column = np.unravel_index(int(np.argmax(together)), shape)
    near = np.arange(-PLAY_PX, PLAY_PX + 1)
    as_is = float(together[np.ix_(near % height, near % width)].max())
    x, y = int(column), int(row)
    place = x - width * (x > width // 2), y - height * (y > height // 2)
    return as_is, float(together[row, column]), place


def _zoomed(image: FloatArray, zoom: float) -> FloatArray:
    """A picture enlarged about its middle, of the same size."""
    height, width = image.shape[:2]
    scale = np.array(
        [[zoom, 0, (1 - zoom) * (width - 1) / 2], [0, zoom, (1 - zoom) * (height - 1) / 2]]
    )
    return np.asarray(cv2.warpAffine(image, scale, (width, height)))


def _light_at_shift(
    image: FloatArray | NDArray[np.uint8],
    rest: FloatArray | NDArray[np.uint8],
    shift_px: tuple[int, int],
) -> float:
    """Difference of the light where ``image`` is shifted by (x, y), over that as the pictures lie.

    Infinite for a shift that is too small, or larger than half of the picture.
    """
    (dx, dy), (height, width) = shift_px, image.shape[:2]
    too_far = np.any(np.abs(shift_px) >= np.array([width / 2, height / 2]))
    if too_far or np.hypot(dx, dy) < LEAST_SHIFT * width:
        return float("inf")
    rows = slice(max(dy, 0), height + min(dy, 0))
    columns = slice(max(dx, 0), width + min(dx, 0))
    moved = slice(max(-dy, 0), height - max(dy, 0)), slice(max(-dx, 0), width - max(dx, 0))
    here, same_place, there = (
        _small(part) for part in (image[rows, columns], rest[rows, columns], rest[moved])
    )
    return apart_grey(here, there) / max(apart_grey(here, same_place), 1e-9)


def _middle(image: FloatArray, share: float) -> FloatArray:
    """The middle of a picture (h, w, 3), ``share`` of its width and height, enlarged."""
    height, width = image.shape[:2]
    scale = np.array(
        [[share, 0, (1 - share) * (width - 1) / 2], [0, share, (1 - share) * (height - 1) / 2]]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, scale, (width, height), flags=flags))


def _small(image: FloatArray | NDArray[np.uint8]) -> FloatArray:
    height, width = image.shape[:2]
    size = VIEW_PX, max(8, round(VIEW_PX * height / width))
    picture = np.ascontiguousarray(image, dtype=np.float32)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.float64)


def _shift_px(
    image: FloatArray | NDArray[np.uint8], rest: FloatArray | NDArray[np.uint8]
) -> tuple[int, int]:
    """(x, y) by which the image's light is shifted, by the correlation of phases."""
    before, now = (np.asarray(part, np.float64).mean(axis=2) for part in (rest, image))
    window = cv2.createHanningWindow(before.shape[::-1], cv2.CV_64F)
    (dx, dy), _ = cv2.phaseCorrelate(before - before.mean(), now - now.mean(), window)
    return round(dx), round(dy)
