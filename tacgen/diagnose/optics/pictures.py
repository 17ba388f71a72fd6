"""Pictures of one press: as photographed, by the plain model, and by the extended one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.diagnose import OpticsDiagnosis
from tacgen.diagnose.optics.extended_table import first_state
from tacgen.diagnose.optics.model import render
from tacgen.diagnose.optics.model_comparison import Entry, own_of_others, with_shade_of
from tacgen.diagnose.optics.pixels import gather_pixels
from tacgen.presses.press_images import PressImages

CONTRAST = 3.0


def before_and_after(presses: PressImages, k: int, diagnosis: OpticsDiagnosis) -> NDArray[np.uint8]:
    """A strip (h, 5 w, 3): the press, two models of it, and what each leaves over."""
    one = presses.select(np.arange(len(presses)) == k)
    radius, reach = float(one.radius_px[0]), 1.7
    x, y = one.center_px[0]
    height, width = one.shape_px
    top, bottom = (int(np.clip(y + s * reach * radius, 0, height)) for s in (-1, 1))
    left, right = (int(np.clip(x + s * reach * radius, 0, width)) for s in (-1, 1))
    photo = one.images[0, top:bottom, left:right].astype(np.float64)
    made = [
        _picture(one, entry, diagnosis)[top:bottom, left:right]
        for entry in (diagnosis.selection.plain, diagnosis.selection.chosen)
    ]
    left_over = [128 + CONTRAST * (photo - picture) for picture in made]
    gap = np.full((bottom - top, 4, 3), 255.0)
    parts = [part for picture in (photo, *made, *left_over) for part in (picture, gap)]
    return np.rint(np.clip(np.hstack(parts[:-1]), 0, 255)).astype(np.uint8)


def _picture(press: PressImages, entry: Entry, diagnosis: OpticsDiagnosis) -> FloatArray:
    """The whole picture (H, W, 3) that a model gives, the reference where it says nothing."""
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
