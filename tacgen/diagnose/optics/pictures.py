"""Pictures of test presses: press images beside the table and the table with its effects."""

import numpy as np
from numpy.typing import NDArray

from tacgen.core.images import difference, side_by_side
from tacgen.core.types import FloatArray
from tacgen.diagnose.optics.diagnose import OpticsDiagnosis, on_presses
from tacgen.diagnose.optics.fit import Model, PressFit
from tacgen.diagnose.optics.rendering import PressView
from tacgen.presses.experiments import ranked
from tacgen.presses.press_images import PressImages

SHOWN = 3
"""Test presses that the page shows before and after."""
DIFFERENCE_GAIN = 3  # differences of a few grey levels become visible
REACH = 2.2
"""Half the width of a picture in contact radii: a diagnosis looks as far."""
MEAN_GAIN = 8  # of a mean over presses, in which each one's own has gone
CELLS, CELL_PX = 30, 8
"""Of a mean residual, along each side, and how large one is drawn."""


def press_pictures(
    presses: PressImages, diagnosis: OpticsDiagnosis
) -> list[tuple[str, NDArray[np.uint8]]]:
    """Names and strips of test presses, from the largest error after the diagnosis downwards."""
    fit, tests = diagnosis.test_fit, diagnosis.tests
    start = diagnosis.test_start
    models = [start, on_presses(fit, start, diagnosis.selection.chosen)]
    by_error = np.argsort(diagnosis.after.squares)[::-1]
    first = np.unique(ranked(fit.experiment), return_index=True)[1]  # picture of each press
    shown = first[by_error[:: max(1, len(first) // SHOWN)][:SHOWN]].tolist()
    return [
        (
            presses.names[tests[k]],
            _before_and_after(presses, int(tests[k]), fit.views[k], models, k),
        )
        for k in shown
    ]


def mean_residuals(diagnosis: OpticsDiagnosis) -> NDArray[np.uint8]:
    """Mean residual of the held-out presses around their contacts, by the table and extended.

    About grey, up to ``REACH`` contact radii; the axes are those of the picture.
    """
    fit, selection = diagnosis.fit, diagnosis.selection
    return side_by_side([_mean_residual(fit, one) for one in (selection.start, selection.chosen)])


def _mean_residual(fit: PressFit, model: Model) -> NDArray[np.uint8]:
    sums, counts = np.zeros((CELLS * CELLS, 3)), np.zeros(CELLS * CELLS)
    places = zip(fit.views, model.places, fit.residuals(model), strict=True)
    for view, (x, y, radius), residual in places:
        offsets = np.stack([view.pixels.y_mm - y, view.pixels.x_mm - x]) / radius
        row, column = np.floor((offsets / REACH + 1.0) * 0.5 * CELLS).astype(int)
        near = (row >= 0) & (row < CELLS) & (column >= 0) & (column < CELLS)
        cell = (row * CELLS + column)[near]
        np.add.at(sums, cell, residual[near])
        np.add.at(counts, cell, 1.0)
    mean = (sums / np.maximum(counts, 1.0)[:, None]).reshape(CELLS, CELLS, 3)
    grey = np.rint(np.clip(128.0 + MEAN_GAIN * mean, 0, 255)).astype(np.uint8)
    return grey.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)


def _before_and_after(
    presses: PressImages, press: int, view: PressView, models: list[Model], k: int
) -> NDArray[np.uint8]:
    """A strip of the press, of the table and its extension, and of the residual of each."""
    whole = view.on_square(presses, press, REACH)
    shape = (-1, len(np.unique(whole.pixels.columns)), 3)
    photo = whole.pixels.grey.reshape(shape).astype(np.uint8)
    pictures = [_picture(whole, model, k).reshape(shape) for model in models]
    residuals = [difference(photo, picture, DIFFERENCE_GAIN) for picture in pictures]
    return side_by_side([photo, *pictures, *residuals])


def _picture(view: PressView, model: Model, k: int) -> NDArray[np.uint8]:
    effects = model.effects()
    grey: FloatArray = view.finished(view.lit(effects, model.places[k]), effects)
    return np.rint(grey).astype(np.uint8)
