"""Pictures of test presses: photographs beside the plain model and the extended one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.core.images import difference, side_by_side
from tacgen.diagnose.optics.diagnose import OpticsDiagnosis
from tacgen.diagnose.optics.extended_table import first_state
from tacgen.diagnose.optics.model import prepared, render
from tacgen.diagnose.optics.model_comparison import FittedModel
from tacgen.diagnose.optics.pixels import gather_pixels
from tacgen.presses.press_images import PressImages

SHOWN = 3
"""Test presses that the page shows before and after."""
DIFFERENCE_GAIN = 3  # differences of a few grey levels become visible
REACH = 1.7
"""Half the width of a picture in contact radii: a little more than the fit looks at."""


def press_pictures(
    presses: PressImages, diagnosis: OpticsDiagnosis
) -> list[tuple[str, NDArray[np.uint8]]]:
    """Names and strips of test presses, from the largest error after the diagnosis downwards."""
    tests = diagnosis.tests
    by_error = tests[np.argsort(diagnosis.after_squares)[::-1]]
    shown = by_error[:: max(1, len(tests) // SHOWN)][:SHOWN]
    return [(presses.names[k], before_and_after(presses, int(k), diagnosis)) for k in shown]


def before_and_after(presses: PressImages, k: int, diagnosis: OpticsDiagnosis) -> NDArray[np.uint8]:
    """A strip of the press, of the plain and the extended model, and of the residual of each."""
    one = presses.select(np.arange(len(presses)) == k)
    reach = REACH * float(one.radius_px[0])
    x, y = one.center_px[0]
    height, width = one.shape_px
    rows = slice(*(int(np.clip(y + sign * reach, 0, height)) for sign in (-1, 1)))
    columns = slice(*(int(np.clip(x + sign * reach, 0, width)) for sign in (-1, 1)))
    photo = one.images[0, rows, columns]
    models = [
        np.rint(np.clip(_picture(one, model, diagnosis)[rows, columns], 0, 255)).astype(np.uint8)
        for model in (diagnosis.selection.plain, diagnosis.selection.chosen)
    ]
    residuals = [difference(photo, model, DIFFERENCE_GAIN) for model in models]
    return side_by_side([photo, *models, *residuals])


def _picture(press: PressImages, model: FittedModel, diagnosis: OpticsDiagnosis) -> FloatArray:
    """The whole picture (H, W, 3) of a model, the reference image where there is no contact."""
    rules = model.problem.rules
    seen = gather_pixels(press, diagnosis.reference, rules=rules)
    dense = gather_pixels(press, diagnosis.reference, all_pixels=True, rules=rules)
    labels = first_state(diagnosis.given, seen.labels)[1]
    problem = replace(model.problem, pixels=replace(dense, labels=labels))
    state = model.state_of(replace(seen, labels=labels))
    picture = diagnosis.reference.astype(np.float64)
    picture[dense.rows, dense.columns] = render(problem, prepared(problem, state, model.state))
    return picture
