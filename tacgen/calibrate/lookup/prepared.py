"""Ball presses made ready for the fits: pixels, drift of the bare gel, candidate backgrounds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.settings import RULES, BackgroundRecipe
from tacgen.calibrate.lookup.smooth_model import position_features
from tacgen.core.types import BoolArray, FloatArray, IntArray, Window
from tacgen.optics.dots import coarse, filled_in
from tacgen.optics.table import features
from tacgen.presses.experiments import per_experiment
from tacgen.presses.press_images import PressImages, label_mm, place_mm


@dataclass(frozen=True, slots=True)
class Pixels:
    """Some pixels of one image."""

    rows: IntArray  # (n,)
    columns: IntArray  # (n,)
    x_mm: FloatArray  # (n,), place on the gel from the image's centre, along columns
    y_mm: FloatArray  # (n,), and along rows
    position: FloatArray  # (n, 6), the table's features
    grey: FloatArray  # (n, 3), RGB grey levels of the image
    inside: BoolArray  # (n,), within the labelled (or found) contact circle

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, mask: BoolArray) -> "Pixels":
        """The pixels where ``mask`` (n,) holds."""
        return Pixels(*(getattr(self, name)[mask] for name in self.__slots__))

    @property
    def window(self) -> Window:
        """The rectangle that they span: rows and columns, first and one beyond the last."""
        rows, columns = self.rows, self.columns
        ends = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
        return tuple(map(int, ends))  # type: ignore[return-value]

    @property
    def odd_block(self) -> BoolArray:
        """Which of the two sets of a chess board of 8×8 blocks each pixel belongs to."""
        return np.asarray((self.rows // RULES.block_px + self.columns // RULES.block_px) % 2 == 1)


def disc_pixels(
    presses: PressImages,
    k: int,
    *,
    reach: float = 1.0,
    limit: int | None = None,
    inner: float = 0.0,
) -> Pixels:
    """The pixels of press ``k`` from ``inner`` to ``reach`` contact radii that no dot covers.

    Where there are more than ``limit``, an even lattice of them: every k-th row and column, so
    that no part of the circle is favoured.
    """
    image, hidden = presses.images[k], presses.hidden_in(k)
    (x, y), radius_px = presses.center_px[k], float(presses.radius_px[k])
    height, width = presses.shape_px
    reach_px = reach * radius_px
    top, bottom = (int(np.clip(y + s * (reach_px + 1), 0, height)) for s in (-1, 1))
    left, right = (int(np.clip(x + s * (reach_px + 1), 0, width)) for s in (-1, 1))
    step = 1
    if limit is not None:
        area_px = np.pi * (reach**2 - inner**2) * radius_px**2
        step = max(1, math.ceil(math.sqrt(area_px / limit) - 0.05))
    rows = np.arange(top, bottom, step)[:, None]
    columns = np.minimum(np.arange(left, right + 1, step), width - 1)
    distance = np.sqrt((columns - x) ** 2 + (rows - y) ** 2)
    near = (distance < reach_px) & (distance >= inner * radius_px)
    if hidden is not None:
        near &= ~hidden[rows, columns]
    along = np.nonzero(near)
    rows, columns, distance = rows[along[0], 0], columns[along[1]], distance[near]
    x_mm, y_mm = place_mm(columns, rows, (height, width), presses.mm_per_px)
    return Pixels(
        rows=rows,
        columns=columns,
        x_mm=x_mm,
        y_mm=y_mm,
        position=features((columns + 0.5) / width - 0.5, (rows + 0.5) / height - 0.5),
        grey=image[rows, columns].astype(np.float64),
        inside=distance < radius_px,
    )


@dataclass(frozen=True, slots=True)
class Sample:
    """The pixels of one press and what the fit needs with them."""

    pixels: Pixels
    position: FloatArray  # (n, f), features of position of the highest degree
    change: FloatArray  # (n, 3), grey levels less the background's
    weight: FloatArray  # (n,)
    label: FloatArray  # (3,), labelled centre and radius, mm
    ball_radius_mm: float


@dataclass(frozen=True, slots=True)
class PreparedPresses:
    """Ball presses with all that the fits derive from their pictures, derived once."""

    presses: PressImages
    bare_changes: FloatArray  # (N, h, w, 3), image − reference where no press touches, coarse; NaN
    # near the contacts
    drift: FloatArray  # (N, 3), what each picture's bare gel is brighter by, grey levels
    backgrounds: Mapping[BackgroundRecipe, FloatArray]  # (H, W, 3) of every candidate
    light: FloatArray  # (H, W, 3), the reference's smoothed brightness, relative to its mean
    _pixels: dict[int, list[tuple[Pixels, FloatArray, FloatArray]]] = field(
        default_factory=dict, repr=False
    )

    @classmethod
    def of(cls, presses: PressImages, bare_changes: FloatArray | None = None) -> "PreparedPresses":
        """The set of these presses; their ``bare_changes`` are computed unless they are known."""
        changes = _bare_changes(presses) if bare_changes is None else bare_changes
        change = _bare_gel_change(per_experiment(changes, presses.experiment))
        backgrounds = {
            recipe: make_background(presses.background, change, recipe, presses.dots)
            for recipe in RULES.backgrounds
        }
        return cls(presses, changes, _drift(changes), backgrounds, _light(presses))

    def __len__(self) -> int:
        return len(self.presses)

    def select(self, which: BoolArray) -> "PreparedPresses":
        """The presses that a mask picks; drift and backgrounds are estimated from them alone."""
        chosen = PreparedPresses.of(self.presses.select(which), self.bare_changes[which])
        picked = np.nonzero(which)[0].tolist()
        pixels = {limit: [of_each[k] for k in picked] for limit, of_each in self._pixels.items()}
        return replace(chosen, _pixels=pixels)

    def samples(self, background: FloatArray, limit: int = RULES.pixels_per_press) -> list[Sample]:
        """A sample of every press against ``background`` (H, W, 3), with up to ``limit`` pixels."""
        if limit not in self._pixels:
            self._pixels[limit] = [self._rings(k, limit) for k in range(len(self))]
        labels = label_mm(self.presses)
        return [
            Sample(
                pixels=pixels,
                position=position,
                change=pixels.grey - background[pixels.rows, pixels.columns],
                weight=weight,
                label=labels[k],
                ball_radius_mm=float(self.presses.ball_radius_mm[k]),
            )
            for k, (pixels, position, weight) in enumerate(self._pixels[limit])
        ]

    def _rings(self, k: int, limit: int) -> tuple[Pixels, FloatArray, FloatArray]:
        """Pixels of press ``k`` in every ring, their features of position and their weights."""
        inner, parts = 0.0, []
        for reach, share in zip(RULES.ring_radii, RULES.ring_pixels, strict=True):
            most = max(1, int(share * limit))
            parts.append(disc_pixels(self.presses, k, reach=reach, limit=most, inner=inner))
            inner = reach
        pixels = Pixels(
            *(np.concatenate([getattr(p, name) for p in parts]) for name in Pixels.__slots__)
        )
        weight = np.repeat(RULES.ring_weights, [len(part) for part in parts])
        height, width = self.presses.shape_px
        u, v = (pixels.columns + 0.5) / width - 0.5, (pixels.rows + 0.5) / height - 0.5
        position = position_features(u, v, self.light, max(RULES.position_degrees))
        return pixels, position, weight


def _light(presses: PressImages) -> FloatArray:
    """Brightness of the reference image (H, W, 3), smoothed, relative to its mean, less 1."""
    gel = presses.background.astype(np.float32)
    if presses.dots is not None:
        gel = filled_in(gel, presses.dots)
    smooth = _blur(gel, RULES.light_smooth_share * presses.shape_px[1])
    return np.asarray(smooth / max(float(smooth.mean()), 1.0) - 1.0)


def _blur(image: FloatArray, sigma_px: float) -> FloatArray:
    """Gaussian blur of (H, W) or (H, W, C); edges are mirrored."""
    if sigma_px <= 0:
        return image
    source = np.ascontiguousarray(image, dtype=np.float32)
    step = int(sigma_px / RULES.fine_sigma_px)
    if step < 2:
        return np.asarray(cv2.GaussianBlur(source, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT))
    # A wide Gaussian cannot tell the means of few pixels from the pixels.
    height, width = source.shape[:2]
    size = (max(1, width // step), max(1, height // step))
    small = cv2.resize(source, size, interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(small, (0, 0), sigma_px / step, borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(soft, (width, height), interpolation=cv2.INTER_LINEAR))


def _bare_changes(presses: PressImages) -> FloatArray:
    """Image − reference where no press touches (N, h, w, 3), coarse; NaN near the contacts."""
    height, width = presses.shape_px
    scale = min(1.0, RULES.coarse_px / width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    reference = coarse(presses.background, size, presses.dots)
    rows, columns = np.mgrid[: size[1], : size[0]]
    changes = np.empty((len(presses), size[1], size[0], 3), np.float32)
    for k in range(len(presses)):
        x, y = (presses.center_px[k] + 0.5) * scale - 0.5
        bare = (
            np.hypot(columns - x, rows - y) > RULES.bare_beyond_radii * presses.radius_px[k] * scale
        )
        image = coarse(presses.images[k], size, presses.hidden_in(k))
        changes[k] = np.where(bare[..., None], image - reference, np.nan)
    return changes


def _drift(bare_changes: FloatArray) -> FloatArray:
    """What each picture's bare gel is brighter by than that of the others (N, 3), grey levels."""
    drift = np.zeros((len(bare_changes), 3))
    for k, change in enumerate(bare_changes):
        bare = change[np.isfinite(change[..., 0])]
        if len(bare):
            drift[k] = np.median(bare, axis=0)
    return np.asarray(drift - drift.mean(axis=0))


def _bare_gel_change(changes: FloatArray) -> FloatArray:
    """Median over the presses of image − reference where no press touches: (h, w, 3), coarse.

    Where fewer than three presses leave the gel bare the change is carried over from around.
    """
    views = np.isfinite(changes[..., 0]).sum(axis=0)
    known = views >= RULES.min_views
    median = np.zeros(changes.shape[1:], np.float32)
    if not known.any():
        return median
    ordered = np.sort(changes, axis=0)  # NaN goes last; eight times as fast as nanmedian
    middle = [np.maximum(views - 1 + upper, 0) // 2 for upper in (0, 1)]
    low, high = (np.take_along_axis(ordered, index[None, ..., None], axis=0)[0] for index in middle)
    median[known] = (0.5 * (low + high))[known]
    weight = known.astype(np.float32)
    sigma = RULES.carried_over_share * known.shape[1]
    blurred = _blur(median * weight[..., None], sigma)
    near = blurred / np.maximum(_blur(weight, sigma), 1e-6)[..., None]
    return np.where(known[..., None], median, near)


def make_background(
    reference: FloatArray | NDArray[np.uint8],
    change: FloatArray | None,
    recipe: BackgroundRecipe,
    dots: BoolArray | None = None,
) -> FloatArray:
    """The background (H, W, 3) by ``recipe`` from a reference image and the bare gel's change.

    Printed ``dots`` (H, W) stay as sharp as they are: the gel around them is smoothed, and they
    dim it by what they dim the reference by.
    """
    height, width = reference.shape[:2]
    image = reference.astype(np.float32)
    gel = image if dots is None else filled_in(image, dots)
    ink = None if dots is None else np.where(dots[..., None], image / np.maximum(gel, 1.0), 1.0)
    if recipe.drift and change is not None:
        gel = gel + cv2.resize(change, (width, height), interpolation=cv2.INTER_LINEAR)
    gel = _blur(gel, recipe.smooth * width)
    return np.asarray(gel if ink is None else gel * ink, dtype=np.float32)
