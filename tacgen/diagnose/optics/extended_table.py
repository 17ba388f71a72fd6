"""Between what a diagnosis of images found and a table that the renderer takes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen import __version__
from tacgen.calibrate.lookup.prepared import make_background
from tacgen.calibrate.lookup.press_fit import LabelModel, PressModel
from tacgen.calibrate.lookup.settings import BackgroundRecipe
from tacgen.calibrate.lookup.smooth_model import SmoothModel
from tacgen.calibrate.lookup.table_fit import N_DIRECTION, N_SLOPE, camera_noise_grey, without_rest
from tacgen.core.arrays import FloatArray
from tacgen.core.errors import PressError
from tacgen.diagnose.optics.model import DEGREE, Optics, PlainTable, skin_of, surface_slopes
from tacgen.diagnose.optics.model_comparison import Entry
from tacgen.optics.effects import CHANNELS, LEAKS, PLACES
from tacgen.optics.render import Shader
from tacgen.optics.table import LookupTable
from tacgen.presses.geometry import Membrane, rest_height
from tacgen.presses.press_images import PressImages, place_mm

SMOOTH = 0.03
"""Width, as a share of the image's, that the background is smoothed with: its noise is no effect
to find."""

BEYOND_STEEPEST = 1.02


def reference_of(presses: PressImages, table: LookupTable | None) -> NDArray[np.float32]:
    """The gel at rest (H, W, 3): as photographed, or as a given table renders it without effects.

    Raises
    ------
    PressError
        If the table is of another resolution than the presses.
    """
    if table is None:
        recipe = BackgroundRecipe(smooth=SMOOTH)
        return make_background(presses.background, None, recipe, presses.dots)
    if table.shape_px != presses.shape_px:
        msg = (
            f"the table renders {table.shape_px} pixels (rows, columns), the presses are "
            f"{presses.shape_px}: give the table of the presses' own resolution"
        )
        raise PressError(msg)
    height, width = table.shape_px
    columns, rows = np.meshgrid(np.arange(float(width)), np.arange(float(height)))
    x_mm, y_mm = place_mm(columns, rows, table.shape_px, table.mm_per_px)
    rest = rest_height(x_mm, y_mm, presses.dome_radius_mm).astype(np.float32)
    image = np.empty((height, width, 3), dtype=np.float32)
    Shader(replace(table, effects={})).light(
        np.ascontiguousarray(rest), (0, height, 0, width), image
    )
    return image


def first_state(table: LookupTable | None, labels_mm: FloatArray) -> tuple[Optics, FloatArray]:
    """Where a diagnosis begins, and the labels (N, 3) as a given table understands them."""
    if table is None:
        return Optics(), labels_mm
    state = with_effects(Optics(), table.effects)
    learnt = table.provenance.get("press_model")
    if not learnt:
        return state, labels_mm
    model = PressModel.from_dict(learnt)
    expected = model.labels.geometry(labels_mm)
    decay = model.membrane.decay_mm / float(expected[:, 2].mean())
    form = str(table.provenance.get("form", "skirt"))
    found = replace(state, form=form, decay=np.array([decay]), sharpness=model.membrane.sharpness)
    return found, expected


def with_effects(state: Optics, effects: Mapping[str, Mapping[str, float]]) -> Optics:
    """``state`` with the effects that a table carries switched on."""

    def read(name: str, parameters: tuple[str, ...], identity: float = 0.0) -> FloatArray:
        given = effects.get(name, {})
        return np.array([float(given.get(p, identity)) for p in parameters])

    light = read("illumination", tuple(f"{c}_{p}" for c in CHANNELS for p in PLACES))
    return replace(
        state,
        sigma_mm=read("blur", ("sigma_mm",)),
        light=light.reshape(3, 5),
        mixing=read("cross_talk", LEAKS),
        gain=read("background_gain", tuple(f"gain_{c}" for c in CHANNELS), 1.0) - 1,
        offset=read("background_gain", tuple(f"offset_{c}" for c in CHANNELS)),
        dimming_all=read("vignetting", ("strength",)),
        dimming=read("vignetting", ("change_strength",)),
        level=read("saturation", ("level_grey",), math.inf),
        knee=read("saturation", ("knee_grey",)),
        shadow=read("shadow", ("strength",)),
        shadow_length_mm=float(effects.get("shadow", {}).get("length_mm", 0.0)),
    )


def effects_of(state: Optics) -> dict[str, dict[str, float]]:
    """What the renderer applies, by the names and units of ``tacgen.optics.effects``."""
    gain, offset = state.gain, state.offset
    light = {
        f"{c}_{p}": float(state.light[i, j])
        for i, c in enumerate(CHANNELS)
        for j, p in enumerate(PLACES)
    }
    effects: dict[str, dict[str, float]] = {}
    if state.sigma_mm[0] > 0:
        effects["blur"] = {"sigma_mm": float(state.sigma_mm[0])}
    if state.shadow[0] > 0:
        effects["shadow"] = {
            "strength": float(state.shadow[0]), "length_mm": float(state.shadow_length_mm)
        }  # fmt: skip
    if state.light.any():
        effects["illumination"] = light
    if state.mixing.any():
        effects["cross_talk"] = dict(zip(LEAKS, map(float, state.mixing), strict=True))
    if gain.any() or offset.any():
        effects["background_gain"] = {
            **{f"gain_{c}": 1 + float(gain[i]) for i, c in enumerate(CHANNELS)},
            **{f"offset_{c}": float(offset[i]) for i, c in enumerate(CHANNELS)},
        }
    if state.dimming[0] or state.dimming_all[0]:
        effects["vignetting"] = {
            "strength": float(state.dimming_all[0]), "change_strength": float(state.dimming[0])
        }  # fmt: skip
    if np.isfinite(state.level[0]):
        effects["saturation"] = {
            "level_grey": float(state.level[0]), "knee_grey": float(state.knee[0])
        }  # fmt: skip
    return effects


def extended_table(
    presses: PressImages,
    entry: Entry,
    reference: NDArray[np.float32],
    given: LookupTable | None,
) -> LookupTable:
    """The table with everything that was found, which ``tacgen collect`` renders with.

    A given table keeps its coefficients and gains the effects; without one the fitted table is
    tabulated. What belongs to single presses (centres, radii, the scatter of exposure) stays out.
    """
    effects = MappingProxyType(effects_of(entry.state))
    if given is not None:
        provenance = {**given.provenance, "diagnosed_by": f"tacgen {__version__} diagnose optics"}
        return replace(given, effects=effects, provenance=MappingProxyType(provenance))
    table, state, pixels = entry.problem.table, entry.state, entry.problem.pixels
    if not isinstance(table, PlainTable):
        msg = "a fitted table has weights"
        raise TypeError(msg)
    model = SmoothModel(table.position_weights(state.weights), DEGREE)
    gx, gy = surface_slopes(state, pixels, entry.problem.profiles)
    steepest = min(BEYOND_STEEPEST * float(np.arctan(np.hypot(gx, gy)).max()), math.pi / 2)
    slope = np.linspace(0.0, steepest, N_SLOPE)
    direction = -np.pi + 2 * np.pi * np.arange(N_DIRECTION) / N_DIRECTION
    press_model = press_model_of_state(entry, presses.dome_radius_mm)
    return LookupTable(
        coefficients=model.coefficients(slope, direction),
        background=without_rest(reference, model, press_model, presses.mm_per_px),
        mm_per_px=presses.mm_per_px,
        max_slope_rad=steepest,
        sensor=presses.sensor,
        noise_grey=camera_noise_grey(presses),
        effects=effects,
        provenance=MappingProxyType(_provenance(presses, entry, press_model)),
    )


def press_model_of_state(entry: Entry, dome_radius_mm: float) -> PressModel:
    """What the presses say about their labels and the skin, as a table keeps it."""
    state, pixels = entry.state, entry.problem.pixels
    radius = float(pixels.labels[:, 2].mean())
    factor = float(state.contact_factor[0])
    shift = np.zeros((3, 2))
    if len(state.shift):
        shift[0] = (state.shift * pixels.labels[:, 2:]).mean(axis=0)
    skin = skin_of(state, pixels)
    return PressModel(
        LabelModel(shift, factor * radius, radius, factor),
        Membrane(skin.decay_mm, skin.sharpness),
        dome_radius_mm,
    )


def _provenance(presses: PressImages, entry: Entry, press_model: PressModel) -> dict[str, Any]:
    return {
        "made_by": f"tacgen {__version__} diagnose optics",
        "data_sha256": dict(presses.sha256),
        "n_presses": len(presses),
        "left_out": [str(press) for press in presses.dropped],
        "ball_radius_mm": sorted({float(r) for r in presses.ball_radius_mm}),
        "press_model": press_model.as_dict(),
        "form": entry.state.form,
        "found": list(entry.names),
    }
