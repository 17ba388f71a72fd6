"""Pictures of test presses: photographs beside the plain model and the extended one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.diagnose import TEST_EVERY, OpticsDiagnosis
from tacgen.diagnose.optics.extended_table import first_state
from tacgen.diagnose.optics.model import render
from tacgen.diagnose.optics.model_comparison import Entry, own_of_others, with_shade_of
from tacgen.diagnose.optics.pixels import gather_pixels
from tacgen.presses.press_images import PressImages
from tacgen.report.images import difference, side_by_side

SHOWN = 3
"""Test presses that the page shows before and after."""
DIFFERENCE_GAIN = 3
REACH = 1.7
"""Half the width of a picture in contact radii: a little more than the fit looks at."""


def press_pictures(
    presses: PressImages, diagnosis: OpticsDiagnosis
) -> list[tuple[str, NDArray[np.uint8]]]:
    """Names and strips of test presses, from the largest error after the diagnosis downwards."""
    tests = np.nonzero(np.arange(len(presses)) % TEST_EVERY == TEST_EVERY - 1)[0]
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
        np.rint(np.clip(_picture(one, entry, diagnosis)[rows, columns], 0, 255)).astype(np.uint8)
        for entry in (diagnosis.selection.plain, diagnosis.selection.chosen)
    ]
    residuals = [difference(photo, model, DIFFERENCE_GAIN) for model in models]
    return side_by_side([photo, *models, *residuals])


def _picture(press: PressImages, entry: Entry, diagnosis: OpticsDiagnosis) -> FloatArray:
    """The whole picture (H, W, 3) of a model, the reference image where there is no contact."""
    seen = gather_pixels(press, diagnosis.reference)
    dense = gather_pixels(press, diagnosis.reference, limit=None)
    labels = first_state(diagnosis.given, seen.labels)[1]
    seen, dense = replace(seen, labels=labels), replace(dense, labels=labels)
    state = own_of_others(entry, seen)
    problem = replace(entry.problem, pixels=dense)
    grey = render(
        with_shade_of(entry, problem, state), dense, entry.problem.table, entry.problem.profiles
    ).grey
    picture = diagnosis.reference.astype(np.float64)
    picture[dense.rows, dense.columns] = grey
    return picture
