"""How far a table's pictures are from real presses, in grey levels."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup import press_fit
from tacgen.calibrate.lookup.prepared import Pixels, disc_pixels
from tacgen.calibrate.lookup.settings import RULES
from tacgen.core.errors import PressError
from tacgen.core.types import FloatArray, IntArray, Window
from tacgen.optics.effects import Stage, optical_effects
from tacgen.optics.reconstruct import Reconstructor
from tacgen.optics.render import Effects, Shader
from tacgen.optics.smooth import grown
from tacgen.optics.table import LookupTable
from tacgen.presses.geometry import rest_height
from tacgen.presses.press_images import PressImages, label_mm, place_mm

_FINE_DESCENT = press_fit.Descent(nudge=0.01, steps=10, tolerance=2e-3)

PICTURES = ("labels", "refined", "bare")
"""What a press is compared with: the table at the label's word, at the place re-estimated, and the
background without a contact."""


@dataclass(frozen=True, slots=True)
class PressScore:
    """One press: squared errors summed over its pixels, and the place that was found.

    ``likeness`` holds ``ssim_…`` and ``psnr_db_…`` of the picture within the outermost ring's
    square, as labelled and refined; ``contrast``, the measured change of the background inside the
    circle over that as labelled (least squares); if it was asked for, ``gradient_error_deg``: the
    mean angle there between the normals read from the press image and those of the refined press.
    """

    name: str
    squares: FloatArray  # (n_rings, 3, 3), by ring (the contact first), by ``PICTURES``, RGB
    counts: IntArray  # (n_rings,), pixels
    refined_mm: FloatArray  # (3,), centre and contact radius
    likeness: Mapping[str, float]

    def rmse(self, picture: str) -> float:
        """Inside the circle, over the channels, grey levels."""
        return TableScore((self,), 1).rmse(picture)[0]

    def as_dict(self) -> dict[str, Any]:
        """Its entry in the score's ``images``."""
        return {
            "name": self.name,
            "rmse_labels": self.rmse("labels"),
            "rmse_refined": self.rmse("refined"),
            "n_pixels": int(self.counts[0]),
            **self.likeness,
        }


@dataclass(frozen=True, slots=True)
class TableScore:
    """Errors of a table over pictures, which are of ``n_presses`` presses."""

    presses: tuple[PressScore, ...]
    n_presses: int

    def rmse(self, picture: str, ring: int = 0) -> tuple[float, list[float]]:
        """Over all and per channel (RGB) in a ring; ``picture`` is one of ``PICTURES``."""
        which = PICTURES.index(picture)
        squares = np.sum([press.squares[ring, which] for press in self.presses], axis=0)
        mean = squares / max(sum(int(press.counts[ring]) for press in self.presses), 1)
        return float(np.sqrt(mean.mean())), [float(value) for value in np.sqrt(mean)]

    def rings(self) -> list[dict[str, float]]:
        """RMSE in each ring around the circles, with the bare background's beside it."""
        radii = RULES.ring_radii
        return [
            {
                "from_radii": inner,
                "to_radii": outer,
                "n_pixels": sum(int(press.counts[k]) for press in self.presses),
                **{f"rmse_{picture}": self.rmse(picture, k)[0] for picture in PICTURES},
            }
            for k, (inner, outer) in enumerate(zip((0.0, *radii), radii, strict=False))
        ]

    def as_dict(self) -> dict[str, Any]:
        """What ``tacgen calibrate score --json`` prints."""
        labels, labels_rgb = self.rmse("labels")
        refined, refined_rgb = self.rmse("refined")
        names = self.presses[0].likeness if self.presses else {}
        return {
            "rmse_labels": labels,
            "rmse_labels_rgb": labels_rgb,
            "rmse_refined": refined,
            "rmse_refined_rgb": refined_rgb,
            "n_presses": self.n_presses,
            "n_images": len(self.presses),
            "n_pixels": sum(int(press.counts[0]) for press in self.presses),
            "unit": "grey",
            **{name: float(np.mean([p.likeness[name] for p in self.presses])) for name in names},
            "rings": self.rings(),
            "images": [press.as_dict() for press in self.presses],
        }


class PressRenderer:
    """Renders ball presses with a table, the way the simulation does: height map → picture."""

    def __init__(self, table: LookupTable, press_model: press_fit.PressModel) -> None:
        self.table, self.model = table, press_model
        self._shaders = {repr(table.effects): Shader(table)}
        self._lit = dict[tuple[Any, ...], tuple[NDArray[np.float32], NDArray[np.float32]]]()
        self._height_mm = np.zeros(table.shape_px, dtype=np.float32)
        self._image = np.zeros((*table.shape_px, 3), dtype=np.float32)

    def grey(self, geometry: FloatArray, ball_radius_mm: float, pixels: Pixels) -> FloatArray:
        """Grey levels (n, 3) at ``pixels`` of a ball at ``geometry`` (centre and radius, mm)."""
        return np.clip(self.lit(geometry, ball_radius_mm, pixels, self.table.effects), 0.0, 255.0)

    def lit(
        self,
        geometry: FloatArray,
        ball_radius_mm: float,
        pixels: Pixels,
        effects: Effects,
        slope_factors: tuple[tuple[float, float], ...] = (),
    ) -> FloatArray:
        """The same with other effects, and slopes beside the contact, unclipped."""
        self._render(geometry, ball_radius_mm, pixels.window, effects, slope_factors)
        return self._image[pixels.rows, pixels.columns].astype(np.float64)

    def picture(
        self, geometry: FloatArray, ball_radius_mm: float, window: Window | None = None
    ) -> NDArray[np.uint8]:
        """The picture (h, w, 3), RGB, of the whole image or within a window of it."""
        height, width = self.table.shape_px
        window = window or (0, height, 0, width)
        self._render(geometry, ball_radius_mm, window, self.table.effects)
        top, bottom, left, right = window
        part = self._image[top:bottom, left:right]
        return np.rint(np.clip(part, 0, 255)).astype(np.uint8)

    def _render(
        self,
        geometry: FloatArray,
        ball_radius_mm: float,
        window: Window,
        effects: Effects,
        slope_factors: tuple[tuple[float, float], ...] = (),
    ) -> None:
        model = self.model
        if slope_factors:
            membrane = replace(model.membrane, slope_factors=slope_factors)
            model = replace(model, membrane=membrane)
        shader = self._shader(effects)
        depth_mm = ball_radius_mm - math.sqrt(max(ball_radius_mm**2 - geometry[2] ** 2, 0.0))
        shape = self.table.shape_px
        window = grown(window, shader.image_reach_px(depth_mm) + RULES.margin_px, shape)
        rows, columns = slice(*window[:2]), slice(*window[2:])
        surface = {
            effect.name: effects[effect.name]
            for effect in optical_effects(Stage.SURFACE, Stage.SURFACE)
            if effect.name in effects
        }
        key = (window, geometry.tobytes(), ball_radius_mm, model.membrane, repr(surface))
        if key not in self._lit:
            top, bottom, left, right = grown(window, shader.slope_reach_px, shape)
            y, x = np.arange(top, bottom, dtype=float), np.arange(left, right, dtype=float)
            height_mm = model.height(
                geometry, ball_radius_mm, *place_mm(x, y[:, None], shape, self.table.mm_per_px)
            )
            self._height_mm[top:bottom, left:right] = height_mm
            shader.light(self._height_mm, window, self._image)
            lit = self._height_mm[rows, columns].copy(), self._image[rows, columns].copy()
            # A fit goes through values of an effect at the place of a press and of its label.
            self._lit = {**dict(list(self._lit.items())[-1:]), key: lit}
        else:
            self._height_mm[rows, columns], self._image[rows, columns] = self._lit[key]
        shader.finish(self._height_mm, window, self._image)

    def _shader(self, effects: Effects) -> Shader:
        """The table made ready with some effects; the last few are kept."""
        key = repr(effects)
        if key not in self._shaders:
            kept = list(self._shaders.items())[-RULES.kept_shaders :]
            self._shaders = {**dict(kept), key: kept[0][1].with_effects(effects)}
        return self._shaders[key]


def check_resolution(table: LookupTable, presses: PressImages) -> None:
    """Raise ``PressError`` if the presses are not of the table's resolution."""
    if table.shape_px != presses.shape_px:
        msg = (
            f"the table renders {table.shape_px} pixels (rows, columns), the presses are "
            f"{presses.shape_px}: give a table of the presses' own resolution"
        )
        raise PressError(msg)


def score_table(table: LookupTable, presses: PressImages, *, gradients: bool = False) -> TableScore:
    """Score a table on presses; every press must have a circle, labelled or found.

    ``gradients`` also reads the surface normals back from the press images, half a second a press.

    Raises ``PressError`` if the presses are not of the table's resolution.
    """
    check_resolution(table, presses)
    press_model = press_model_of(table, presses)
    renderer = PressRenderer(table, press_model)
    expected = press_fit.expected_by_label(presses, press_model.labels)
    reader = None
    if gradients:
        reader = Reconstructor(table, presses.background, presses.dome_radius_mm)
    scored = []
    for k in range(len(presses)):
        press = _score_press(presses, k, expected[k], renderer)
        if reader is not None:
            error = _gradient_error_deg(reader, press_model, presses, k, press.refined_mm)
            press = replace(press, likeness={**press.likeness, "gradient_error_deg": error})
        scored.append(press)
    return TableScore(tuple(scored), presses.n_experiments)


def _gradient_error_deg(
    reader: Reconstructor,
    press_model: press_fit.PressModel,
    presses: PressImages,
    k: int,
    geometry: FloatArray,
) -> float:
    """Mean angle between the normals that a press image shows and those of a press at a place."""
    depth = reader.shape_of(presses.images[k], presses.hidden_in(k)).depth_mm
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
    x_mm, y_mm = place_mm(columns, rows, (len(depth), depth.shape[1]), reader.mm_per_px)
    true = press_model.height(geometry, float(presses.ball_radius_mm[k]), x_mm, y_mm)
    rest = rest_height(x_mm, y_mm, presses.dome_radius_mm)
    normals = []
    for height in (true, rest - depth):
        gy, gx = np.gradient(height, reader.mm_per_px)
        normals.append(np.stack([-gx, -gy, np.ones_like(gx)]) / np.sqrt(1 + gx**2 + gy**2))
    x, y = label_mm(presses)[k, :2]
    radius_mm = presses.radius_px[k] * presses.mm_per_px
    inside = np.hypot(x_mm - x, y_mm - y) < radius_mm
    cosine = np.clip((normals[0] * normals[1]).sum(axis=0)[inside], -1.0, 1.0)
    return float(np.degrees(np.arccos(cosine)).mean())


def psnr_db(real: NDArray[np.uint8], rendered: NDArray[np.uint8]) -> float:
    """Peak signal-to-noise ratio, dB, of 8-bit pictures; 99 where they are equal."""
    return min(cv2.PSNR(real, rendered), 99.0)


def structural_similarity(real: NDArray[np.uint8], rendered: NDArray[np.uint8]) -> float:
    """Mean structural similarity of 8-bit pictures (H, W, 3), over pixels and channels.

    Source: Wang et al. 2004, Image quality assessment, Eq. 13: Gaussian window of 1.5 px, K = 0.01,
    0.03.
    """
    x, y = real.astype(np.float64), rendered.astype(np.float64)

    def mean(image: FloatArray) -> FloatArray:
        return np.asarray(cv2.GaussianBlur(image, (11, 11), 1.5))

    mean_x, mean_y = mean(x), mean(y)
    product, squares = mean_x * mean_y, mean_x**2 + mean_y**2
    spread, together = mean(x * x + y * y) - squares, mean(x * y) - product
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    similarity = (2 * product + c1) * (2 * together + c2) / ((squares + c1) * (spread + c2))
    return float(similarity.mean())


def press_model_of(table: LookupTable, presses: PressImages) -> press_fit.PressModel:
    """How a label becomes a press for ``table``: as learnt with it, or the label itself."""
    learnt = table.provenance.get("press_model")
    if learnt:
        return press_fit.PressModel.from_dict(learnt)
    radius_mm = float(np.median(presses.radius_px) * presses.mm_per_px)
    return press_fit.plain_press_model(radius_mm, presses.dome_radius_mm)


def _score_press(
    presses: PressImages, k: int, expected: FloatArray, renderer: PressRenderer
) -> PressScore:
    ball = float(presses.ball_radius_mm[k])
    label_mm = float(presses.radius_px[k] * presses.mm_per_px)
    prior = press_fit.PlacePrior(expected, press_fit.LABEL_SCATTER_RADII, label_mm, ball)
    pixels = disc_pixels(presses, k, reach=RULES.ring_radii[-1])
    x, y = presses.center_px[k]
    distance = np.sqrt((pixels.columns - x) ** 2 + (pixels.rows - y) ** 2)
    ring = np.digitize(distance, np.array(RULES.ring_radii[:-1]) * presses.radius_px[k])
    inside, odd_block = ring == 0, pixels.odd_block
    # A lattice of the pixels tells the place.
    step = max(1, math.isqrt(int(inside.sum()) // (2 * RULES.pixels_per_press)))
    on_lattice = (pixels.rows % step == 0) & (pixels.columns % step == 0)
    errors = np.empty((len(pixels), len(PICTURES), 3))
    errors[:, 0] = pixels.grey - renderer.grey(expected, ball, pixels)
    errors[:, 2] = pixels.grey - presses.background[pixels.rows, pixels.columns]
    places = []
    for odd in (False, True):
        estimating, scoring = inside & on_lattice & (odd_block == odd), odd_block != odd
        place = expected
        if estimating.any() and scoring.any():
            seen = pixels.select(estimating)
            grey = partial(renderer.grey, ball_radius_mm=ball, pixels=seen)
            weight = np.full(len(seen), step**2)
            place = press_fit.place_press(grey, seen.grey, weight, prior, expected, _FINE_DESCENT)
        if scoring.any():
            scored = pixels.select(scoring)
            errors[scoring, 1] = scored.grey - renderer.grey(place, ball, scored)
        places.append(place)
    refined = np.mean(places, axis=0)
    predicted = pixels.grey - errors[:, 0] - renderer.table.background[pixels.rows, pixels.columns]
    measured, predicted = errors[inside, 2], predicted[inside]
    # At least 1 squared grey level: a table that predicts no change at all has a contrast of 0.
    likeness = {"contrast": float(np.sum(measured * predicted) / max(np.sum(predicted**2), 1.0))}
    for name, place in (("labels", expected), ("refined", refined)):
        top, bottom, left, right = pixels.window
        rendered = renderer.picture(place, ball, pixels.window)
        real = np.ascontiguousarray(presses.images[k, top:bottom, left:right])
        likeness[f"ssim_{name}"] = structural_similarity(real, rendered)
        likeness[f"psnr_db_{name}"] = psnr_db(real, rendered)
    in_ring = (ring == np.arange(len(RULES.ring_radii))[:, None]).astype(np.float64)
    return PressScore(
        name=presses.names[k],
        squares=np.tensordot(in_ring, errors**2, axes=1),
        counts=in_ring.sum(axis=1).astype(int),
        refined_mm=refined,
        likeness=likeness,
    )
