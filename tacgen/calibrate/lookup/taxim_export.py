"""A table as the folder of calibration files that simulators with Taxim's optics load.

Taxim's form is poorer than a table: one quadratic in image position for each bin of slope and
direction, whatever the depth of the contact. What the form can hold best is found on
pictures of simulated ball presses; what it loses is measured on other presses, and reported.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.taxim_import import CHANNELS_RGB, pixel_features_from_position
from tacgen.contact.gel import gel_map_mm, pixel_centers_mm
from tacgen.contact.indentation import contact_depth
from tacgen.core.files import atomic_folder
from tacgen.core.records import Sensor
from tacgen.core.types import FloatArray
from tacgen.optics.deform import deform
from tacgen.optics.image_models.base import features
from tacgen.optics.render import Shader
from tacgen.optics.shade import whole_spans
from tacgen.optics.table import N_FEATURES, LookupTable


@dataclass(frozen=True, slots=True, kw_only=True)
class TaximRules:
    """How Taxim's form is fitted to a table, and its loss measured."""

    bins: int = 125  # of slope and of direction, as in the tables that Taxim ships
    places: int = 5  # of simulated presses, each way
    fitted_balls: tuple[tuple[float, float], ...] = (
        *((0.10, 30.0), (0.10, 55.0)),
        *((0.20, 20.0), (0.20, 40.0)),
    )  # radius in heights of the window, and steepest slope in degrees, of those it is fitted to
    scored_balls: tuple[tuple[float, float], ...] = ((0.14, 45.0), (0.16, 30.0))  # that the loss is
    # measured on, which stand between the places of the others
    prior_pixels: float = 25.0  # weight, in pixels, of the table's own quadratic where few
    # simulated pixels have a slope


RULES = TaximRules()
TAXIM_PX_MM = 0.0295
TAXIM_PYRAMID_PX = (30.5, 15.5, 8.0, 3.5, 2.0, 1.1)
"""Taxim's deformation, widths of its Gaussians at ``TAXIM_PX_MM``: ``calib/gelsight`` of the
package taxim 1.4.1."""


@dataclass(frozen=True, slots=True)
class TaximLoss:
    """Grey levels (RMSE, all colours) between a table's pictures and those in Taxim's form.

    Inside the contacts of simulated presses that the form was not fitted to, and of the gel at
    rest; ``of_contact`` is how far these contacts are from the gel at rest.
    """

    contact_grey: float
    rest_grey: float
    of_contact: float

    def line(self) -> str:
        """One line for the terminal."""
        return (
            f"Taxim's form is {self.contact_grey:.2f} grey (RMSE) from the table inside contacts "
            f"of simulated balls, which differ by {self.of_contact:.1f} from the gel at rest; "
            f"at rest {self.rest_grey:.2f}"
        )


def export_taxim(table: LookupTable, out: Path, dome_radius_mm: float | None = None) -> TaximLoss:
    """Write ``polycalib.npz``, ``dataPack.npz``, ``gelmap.npy``, ``shadowTable.npz`` and
    ``params.json``, whole or not at all.

    ``dome_radius_mm`` is that of the gel at rest; by default the table's, flat where it states
    none. The shadows' table is empty: tables hold
    none. Parameters of the deformation are Taxim's, in mm; its mixing of the first frame with a
    blurred one is off, so the gel at rest is the table's.

    Source: Si & Yuan 2022, Taxim; the files that the package ``taxim`` 1.4.1 reads.
    """
    sensor = _sensor(table, dome_radius_mm)
    by_pixel = taxim_coefficients(table, sensor)
    loss = _loss(table, by_pixel, sensor)
    arrays: dict[str, Any] = {
        name: by_pixel[:, :, channel] for channel, name in enumerate(CHANNELS_RGB)
    }
    f0 = np.clip(np.rint(table.background[..., ::-1]), 0, 255).astype(np.uint8)
    rest_mm = gel_map_mm(sensor)
    gelmap_px = ((rest_mm - rest_mm.min()) / table.mm_per_px).astype(np.float32)
    directions = np.arange(0.0, 2 * np.pi, 0.1)
    shadows = np.empty((3, len(directions), 9), dtype=object)
    for place in np.ndindex(shadows.shape):
        shadows[place] = [math.inf]  # no shadow darkens anything
    with atomic_folder(out) as folder:
        np.savez_compressed(folder / "polycalib.npz", bins=len(by_pixel), **arrays)
        np.savez_compressed(folder / "dataPack.npz", f0=f0, img_size=np.array(f0.shape))
        np.save(folder / "gelmap.npy", gelmap_px)
        np.savez_compressed(
            folder / "shadowTable.npz",
            shadowDirections=directions,
            shadowTable=shadows,
        )
        text = json.dumps(_parameters(table, len(by_pixel)), indent=2)
        (folder / "params.json").write_text(text + "\n")
    return loss


def taxim_coefficients(table: LookupTable, sensor: Sensor) -> NDArray[np.float64]:
    """Coefficients (bins, bins, 3, 6) of pixel features, RGB: Taxim's form nearest to a table.

    ``sensor`` has the shape of the gel at rest.

    A table that is one of Taxim's gives its own back.
    """
    n_slope, n_direction = table.coefficients.shape[:2]
    to_pixels = np.linalg.inv(pixel_features_from_position(table.shape_px))
    taxims = table.interpolation == "floor" and n_direction == 2 * (n_slope - 1)
    if taxims and table.model is None and table.response is None:
        turned = np.roll(table.coefficients.astype(np.float64), 1 - n_slope, axis=1)
        sectors = turned[:, 1::2]  # both halves of each are alike
        return np.asarray(np.concatenate([sectors, sectors[:, :1]], axis=1) @ to_pixels)
    return np.asarray(_fitted(table, sensor, RULES.bins) @ to_pixels)


def _sensor(table: LookupTable, dome_radius_mm: float | None) -> Sensor:
    height, width = table.shape_px
    stated = table.geometry.get("dome_radius_mm", 0.0)
    return Sensor(
        name=table.sensor or "sensor",
        width_px=width,
        height_px=height,
        mm_per_px=table.mm_per_px,
        gel_depth_mm=4.0,
        dome_radius_mm=stated if dome_radius_mm is None else dome_radius_mm,
    )


def _prior(table: LookupTable, bins: int) -> NDArray[np.float64]:
    """The quadratic (bins, bins, 3, 6) nearest to the table's model in the middle of each bin."""
    model = table.image_model
    middle = np.arange(bins) + 0.5
    turn = -np.pi + 2 * np.pi * middle / (bins - 1) + np.pi  # Taxim's directions are ours plus π
    slope = np.tan(np.minimum(0.5 * np.pi * middle / (bins - 1), table.max_slope_rad))
    prior = np.empty((bins, bins, 3, N_FEATURES))
    solve = None
    for i in range(bins):
        colors = model.slope_colors(slope[i] * np.cos(turn), slope[i] * np.sin(turn))
        if solve is None:
            nodes = (np.linspace(-0.5, 0.5, n) for n in colors.shape[1:3])
            v, u = np.meshgrid(*nodes, indexing="ij")
            solve = np.linalg.pinv(features(u.ravel(), v.ravel()))
        prior[i] = np.einsum("fp,dpc->dcf", solve, colors.reshape(bins, -1, 3))
    return prior


def _fitted(table: LookupTable, sensor: Sensor, bins: int) -> NDArray[np.float64]:
    """Coefficients (bins, bins, 3, 6) of position, least squares over simulated presses."""
    n_bins = bins * bins
    normal = np.zeros((N_FEATURES, N_FEATURES, n_bins))
    right = np.zeros((N_FEATURES, 3, n_bins))
    place = _places(table.shape_px)
    shader = Shader(table)
    presses = list(_presses(sensor, RULES.fitted_balls, 0.0))
    rest_mm = gel_map_mm(sensor)
    for pressed_mm, weight in [(rest_mm, float(len(presses))), *((one, 1.0) for one in presses)]:
        change = _lit(shader, pressed_mm) - table.background
        slope, direction = taxim_bins(pressed_mm, table.mm_per_px, bins)
        seen = (slope * bins + direction).ravel()
        used = (
            np.ones(seen.shape, bool) if pressed_mm is rest_mm else (pressed_mm != rest_mm).ravel()
        )
        seen, terms = seen[used], place[:, used]
        colors = change.reshape(-1, 3)[used]
        for a in range(N_FEATURES):
            weighted = weight * terms[a]
            for b in range(a + 1):
                total = np.bincount(seen, weighted * terms[b], n_bins)
                normal[a, b] += total
                if a != b:
                    normal[b, a] += total
            for channel in range(3):
                right[a, channel] += np.bincount(seen, weighted * colors[:, channel], n_bins)
    prior = _prior(table, bins).reshape(n_bins, 3, N_FEATURES)
    # The prior weighs like pixels that are spread over the whole window.
    spread = RULES.prior_pixels * (place @ place.T) / place.shape[1]
    matrix = normal.transpose(2, 0, 1) + spread
    vector = right.transpose(2, 0, 1) + np.einsum("ab,ncb->nac", spread, prior)
    solved = np.linalg.solve(matrix, vector)
    return np.asarray(solved.transpose(0, 2, 1).reshape(bins, bins, 3, N_FEATURES))


def taxim_bins(
    height_map_mm: FloatArray, mm_per_px: float, bins: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Bins (H, W) of slope and direction of a surface (H, W), gel frame, mm, as Taxim counts them.

    Level gel has direction 0; the edge of the image has the slope beside it.
    """
    depth = -np.asarray(height_map_mm, np.float64) / mm_per_px
    down = (depth[2:, 1:-1] - depth[:-2, 1:-1]) / 2
    across = (depth[1:-1, 2:] - depth[1:-1, :-2]) / 2
    slope = np.pad(np.arctan(np.hypot(down, across)), 1, "edge")
    direction = np.pad(np.arctan2(down, across), 1, "edge")
    i = np.floor(slope / (0.5 * np.pi / (bins - 1))).astype(np.intp)
    j = np.floor((direction + np.pi) / (2 * np.pi / (bins - 1))).astype(np.intp)
    return i, j


def _places(shape_px: tuple[int, int]) -> NDArray[np.float64]:
    """Features of position (6, H·W)."""
    height, width = shape_px
    v, u = np.meshgrid(
        (np.arange(height) + 0.5) / height - 0.5,
        (np.arange(width) + 0.5) / width - 0.5,
        indexing="ij",
    )
    return features(u, v).reshape(-1, N_FEATURES).T.copy()


def _lit(shader: Shader, height_map_mm: FloatArray) -> NDArray[np.float32]:
    """The table's picture (H, W, 3), not rounded, without what a camera or shadows change."""
    image = np.empty((*height_map_mm.shape, 3), np.float32)
    whole = (0, image.shape[0], 0, image.shape[1])
    surface = np.ascontiguousarray(height_map_mm, np.float32)
    shader.light(surface, whole, image, whole_spans(whole))
    return image


def _presses(
    sensor: Sensor, balls: tuple[tuple[float, float], ...], offset: float
) -> Iterator[FloatArray]:
    """Surfaces (H, W), gel frame, mm, under balls over the window, ``offset`` in steps between."""
    rest_mm = gel_map_mm(sensor)
    x_mm, y_mm = pixel_centers_mm(sensor)
    side_mm = sensor.height_px * sensor.mm_per_px
    for of_height, degrees in balls:
        radius_mm = of_height * side_mm
        depth_mm = min(radius_mm * (1 - math.cos(math.radians(degrees))), sensor.gel_depth_mm)
        steps = (np.arange(RULES.places - (offset > 0)) + offset) / (RULES.places - 1) - 0.5
        for down in steps * 0.8 * sensor.height_px * sensor.mm_per_px:
            for across in steps * 0.8 * sensor.width_px * sensor.mm_per_px:
                square = (x_mm[None, :] - across) ** 2 + (y_mm[:, None] - down) ** 2
                cap = -np.sqrt(np.maximum(radius_mm**2 - square, 0.0))
                gap = np.where(square < radius_mm**2, cap, np.inf) - rest_mm
                depth = contact_depth(gap - gap.min(), depth_mm)
                yield rest_mm - deform(depth, sensor.mm_per_px)


def _loss(table: LookupTable, by_pixel: NDArray[np.float64], sensor: Sensor) -> TaximLoss:
    """See :class:`TaximLoss`."""
    bins = len(by_pixel)
    by_place = by_pixel @ pixel_features_from_position(table.shape_px)
    place = _places(table.shape_px).T.reshape(*table.shape_px, N_FEATURES)
    shader = Shader(table)
    rest_mm = gel_map_mm(sensor)

    def off(surface_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        lit = _lit(shader, surface_mm)
        slope, direction = taxim_bins(surface_mm, table.mm_per_px, bins)
        theirs = np.einsum("hwcf,hwf->hwc", by_place[slope, direction], place) + table.background
        return np.clip(theirs, 0, 255) - np.clip(lit, 0, 255), lit

    at_rest, rest_lit = off(rest_mm)
    total = np.zeros(3)
    for surface_mm in _presses(sensor, RULES.scored_balls, 0.5):
        differences, lit = off(surface_mm)
        sunk = rest_mm - surface_mm
        contact = sunk > 0.25 * sunk.max()
        total += (
            np.square(differences[contact]).sum(),
            np.square(lit - rest_lit)[contact].sum(),
            3 * contact.sum(),
        )
    return TaximLoss(
        contact_grey=float(np.sqrt(total[0] / total[2])),
        rest_grey=float(np.sqrt(np.square(at_rest).mean())),
        of_contact=float(np.sqrt(total[1] / total[2])),
    )


def _parameters(table: LookupTable, bins: int) -> dict[str, Any]:
    """``params.json``: Taxim's own, with lengths on the gel kept in mm."""
    height, width = table.shape_px

    def of_sides(mm: float) -> tuple[float, float]:
        return mm / (table.mm_per_px * width), mm / (table.mm_per_px * height)

    pyramid = [of_sides(px * TAXIM_PX_MM) for px in TAXIM_PYRAMID_PX]
    return {
        "simulator": {
            "initial_frame_sigma_rel": of_sides(50 * TAXIM_PX_MM),
            "diff_threshold": 5,
            "frame_mixing_percentage": 0.0,
            "shadow_step_rel": of_sides(1.25 * TAXIM_PX_MM),
            "discretize_precision": 0.1,
            "height_precision": 0.1,
            "fan_angle": 0.1,
            "fan_precision": 0.05,
            "contact_scale": 0.4,
            "deform_pyramid_sigma_rel": [list(sides) for sides in zip(*pyramid, strict=True)],
            "deform_final_sigma_rel": of_sides(2.0 * TAXIM_PX_MM),
            "shadow_blur_sigma_rel": of_sides(1.1 * TAXIM_PX_MM),
            "shadow_attachment_kernel_size_rel": of_sides(5 * TAXIM_PX_MM),
        },
        "sensor": {"pixmm": table.mm_per_px, "num_bins": bins, "h": height, "w": width},
    }
