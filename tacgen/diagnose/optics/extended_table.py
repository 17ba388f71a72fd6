"""A diagnosis of images as a table that the renderer reads, and such a table as its start."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.prepared import make_background
from tacgen.calibrate.lookup.press_fit import LabelModel, PressModel
from tacgen.calibrate.lookup.settings import BackgroundRecipe
from tacgen.calibrate.lookup.smooth_model import position_terms
from tacgen.calibrate.lookup.table_fit import N_DIRECTION, N_SLOPE, camera_noise_grey
from tacgen.core.arrays import FloatArray
from tacgen.core.errors import PressError
from tacgen.core.version import __version__
from tacgen.diagnose.optics.model import (
    SKIRT,
    ModelState,
    PlainTable,
    geometry_of,
    membrane_of,
    plain_terms,
    surface_slopes,
)
from tacgen.diagnose.optics.model_comparison import FittedModel
from tacgen.diagnose.optics.rules import SelectionRules
from tacgen.optics.effects import Stage, optical_effects
from tacgen.optics.render import Shader
from tacgen.optics.table import LookupTable
from tacgen.presses.geometry import rest_height, rest_slope
from tacgen.presses.press_images import PressImages, place_mm


def reference_of(
    presses: PressImages, table: LookupTable | None, rules: SelectionRules
) -> NDArray[np.float32]:
    """The gel at rest (H, W, 3): as photographed, or as a given table renders it without effects.

    Raises
    ------
    PressError
        If the table is of another resolution than the presses.
    """
    if table is None:
        recipe = BackgroundRecipe(smooth=rules.background_smoothing)
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


def first_state(table: LookupTable | None, labels_mm: FloatArray) -> tuple[ModelState, FloatArray]:
    """Where a diagnosis begins, and the labels (N, 3) as a given table understands them."""
    if table is None:
        return ModelState(), labels_mm
    state = with_effects(ModelState(), table.effects)
    learnt = table.provenance.get("press_model")
    if not learnt:
        return state, labels_mm
    model = PressModel.from_dict(learnt)
    expected = model.labels.geometry(labels_mm)
    decay = model.membrane.decay_mm / float(expected[:, 2].mean())
    found = replace(
        state,
        form=str(table.provenance.get("form", state.form)),
        sharpness=model.membrane.sharpness,
        shared={**state.shared, SKIRT.key: decay},
    )
    return found, expected


def with_effects(state: ModelState, effects: Mapping[str, Mapping[str, float]]) -> ModelState:
    """``state`` with the effects that a table carries switched on."""
    shared = {
        (effect.name, name): float(effects[effect.name].get(name, parameter.identity))
        for effect in optical_effects(Stage.SURFACE)
        if effect.name in effects
        for name, parameter in effect.parameters.items()
    }
    return replace(state, shared={**state.shared, **shared})


def effects_of(state: ModelState) -> dict[str, dict[str, float]]:
    """What the renderer applies: every effect that does anything, with all of its parameters."""
    effects = {}
    for effect in state.active(Stage.SURFACE, Stage.CAMERA):
        identity = {name: parameter.identity for name, parameter in effect.parameters.items()}
        values = {
            name: state.shared.get((effect.name, name), same) for name, same in identity.items()
        }
        if values != identity:
            effects[effect.name] = values
    return effects


def extended_table(
    presses: PressImages,
    found: FittedModel,
    reference: NDArray[np.float32],
    given: LookupTable | None,
) -> LookupTable:
    """The table with everything that was found, which ``tacgen collect`` renders with.

    A given table keeps its coefficients and gains the effects; without one the fitted table is
    tabulated. What belongs to single presses (centres, radii, the scatter of exposure) stays out.
    """
    effects = MappingProxyType(effects_of(found.state))
    if given is not None:
        provenance = {**given.provenance, "diagnosed_by": f"tacgen {__version__} diagnose optics"}
        return replace(given, effects=effects, provenance=MappingProxyType(provenance))
    table, state, rules = found.problem.table, found.state, found.problem.rules
    if not isinstance(table, PlainTable):
        msg = "a fitted table has weights"
        raise TypeError(msg)
    weights = table.position_weights(state.weights)
    gx, gy, _ = surface_slopes(found.problem, state)
    steepest = float(np.arctan(np.hypot(gx, gy)).max())
    steepest = min(rules.table_margin * steepest, math.pi / 2)
    slope = np.linspace(0.0, steepest, N_SLOPE)
    direction = -np.pi + 2 * np.pi * np.arange(N_DIRECTION) / N_DIRECTION
    press_model = press_model_of_state(found, presses.dome_radius_mm)
    rise = np.tan(slope)[:, None]
    gx, gy = rise * np.cos(direction), rise * np.sin(direction)
    terms = plain_terms(gx.ravel(), gy.ravel(), table.degree).reshape(*gx.shape, -1)
    return LookupTable(
        coefficients=np.einsum("sdt,tfc->sdcf", terms, weights).astype(np.float32),
        background=_without_rest(reference, table, weights, presses),
        mm_per_px=presses.mm_per_px,
        max_slope_rad=steepest,
        sensor=presses.sensor,
        noise_grey=camera_noise_grey(presses),
        effects=effects,
        provenance=MappingProxyType(_provenance(presses, found, press_model)),
    )


def _without_rest(
    reference: NDArray[np.float32], table: PlainTable, weights: FloatArray, presses: PressImages
) -> NDArray[np.float32]:
    """The reference less what the table adds for the gel at rest (0 for a flat gel)."""
    if presses.dome_radius_mm <= 0:
        return reference
    height, width = presses.shape_px
    rows, columns = (part.ravel() for part in np.mgrid[:height, :width])
    x_mm, y_mm = place_mm(columns, rows, presses.shape_px, presses.mm_per_px)
    terms = plain_terms(*rest_slope(x_mm, y_mm, presses.dome_radius_mm), table.degree)
    position = position_terms((columns + 0.5) / width - 0.5, (rows + 0.5) / height - 0.5)
    at_rest = np.einsum("nt,tfc,nf->nc", terms, weights, position, optimize=True)
    return np.asarray(reference - at_rest.reshape(reference.shape), dtype=np.float32)


def press_model_of_state(found: FittedModel, dome_radius_mm: float) -> PressModel:
    """What the presses say about their labels and the skin, as a table keeps it."""
    problem, state = found.problem, found.state
    labels = problem.pixels.labels
    places, _ = geometry_of(problem, state)
    expected, _ = geometry_of(problem, state.for_presses(len(labels)))
    radius = float(labels[:, 2].mean())
    factor = float(expected[:, 2].mean()) / radius
    shift = np.zeros((3, 2))
    shift[0] = (places - labels)[:, :2].mean(axis=0)
    return PressModel(
        LabelModel(shift, factor * radius, radius, factor),
        membrane_of(state, problem.pixels),
        dome_radius_mm,
    )


def _provenance(
    presses: PressImages, found: FittedModel, press_model: PressModel
) -> dict[str, Any]:
    return {
        "made_by": f"tacgen {__version__} diagnose optics",
        "data_sha256": dict(presses.sha256),
        "n_presses": len(presses),
        "left_out": [str(press) for press in presses.dropped],
        "ball_radius_mm": sorted({float(r) for r in presses.ball_radius_mm}),
        "press_model": press_model.as_dict(),
        "form": found.state.form,
        "found": list(found.effects),
    }
