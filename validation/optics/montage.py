"""Held-out presses of every real set beside their renderings, all at one scale.

    python -m validation.optics.montage [SET ...] --out FOLDER [--data ../shared/data]

One picture a set: rows are presses, from the one with the smallest error to that with the largest;
columns are the real image, the rendered one at the place re-estimated, and the difference about
grey, four times enlarged. Each is ``SIDE_MM`` wide, about the contact. Sets are those of
``against_mlp``; most licences allow no more than looking.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.report import DIFFERENCE_GAIN
from tacgen.calibrate.lookup.score import PressRenderer
from tacgen.calibrate.lookup.table_fit import Calibration, calibrate
from tacgen.core.images import GAP_PX, difference, encode_png, evenly, side_by_side
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses
from validation.optics.against_mlp import all_sets
from validation.optics.press_sets import DATA

Image = NDArray[np.uint8]

SIDE_MM, SIDE_PX = 9.0, 260
PRESSES = 5


def montage(presses: PressImages, made: Calibration) -> Image:
    """Rows of real, rendered and difference, of held-out presses."""
    renderers = [PressRenderer(table, made.fit.press_model) for table in made.fold_tables]
    scored = sorted(enumerate(made.heldout.presses), key=lambda one: one[1].rmse("refined"))
    rows = []
    for k, score in (scored[place] for place in evenly(len(scored), PRESSES)):
        shown = renderers[made.folds[k]].picture(score.refined_mm, float(presses.ball_radius_mm[k]))
        real = presses.images[k]
        parts = real, shown, difference(real, shown, DIFFERENCE_GAIN)
        rows.append(side_by_side([_window(one, presses, k) for one in parts]))
    gap = np.full((GAP_PX, rows[0].shape[1], 3), 255, np.uint8)
    return np.concatenate([part for row in rows for part in (row, gap)][:-1])


def _window(image: Image, presses: PressImages, k: int) -> Image:
    """The square about a press, white beside the image."""
    scale = SIDE_PX * presses.mm_per_px / SIDE_MM
    x, y = presses.center_px[k]
    move = np.array([[scale, 0, SIDE_PX / 2 - scale * x], [0, scale, SIDE_PX / 2 - scale * y]])
    shown = cv2.warpAffine(
        image, move, (SIDE_PX, SIDE_PX), flags=cv2.INTER_AREA, borderValue=(255, 255, 255)
    )
    return np.asarray(shown, np.uint8)


def main() -> None:
    """Write a picture of each set."""
    parser = argparse.ArgumentParser(description="Real and rendered presses side by side.")
    parser.add_argument("sets", nargs="*", metavar="SET")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name, raw in all_sets(options.data):
        if options.sets and name not in options.sets:
            continue
        presses = usable_presses(raw)
        path = options.out / f"{name}.png"
        path.write_bytes(encode_png(montage(presses, calibrate(presses))))
        sys.stdout.write(f"{path}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
