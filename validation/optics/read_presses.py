"""Error of ``tacgen read`` on real ball presses: depth inside the contact against the ball's shape.

    python -m validation.optics.read_presses PRESSES… [--folds 4]

Each press is read with a table that was fitted to the other folds. The depth that was read is
compared with a sphere of the ball's radius over the contact (0.9 of the radius that the fit gives
it); the sphere's centre and depth are fitted, because the stage's position is not known.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from tacgen.calibrate.lookup.model_choice import fold_of
from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.optics.dots import dots_in
from tacgen.optics.reconstruct import Reconstructor
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses
from tacgen.sensor.read_image import LEAST_DEPTH_MM

CONTACT_SHARE = 0.9
"""Share of the seen radius: the gel leaves a ball at the rim, and circles follow its dark edge."""


def sphere_rmse_mm(
    depth_mm: np.ndarray, mm_per_px: float, circle: np.ndarray, ball: float
) -> float:
    """RMSE of a depth map against the nearest sphere of a ball's radius inside a circle (px)."""
    rows, columns = np.indices(depth_mm.shape)
    x, y = (columns - circle[0]) * mm_per_px, (rows - circle[1]) * mm_per_px
    inside = np.hypot(x, y) <= min(CONTACT_SHARE * circle[2] * mm_per_px, 0.95 * ball)
    x, y, depth = x[inside], y[inside], depth_mm[inside]

    def residual(place: np.ndarray) -> np.ndarray:
        away = (x - place[0]) ** 2 + (y - place[1]) ** 2
        return depth - (place[2] + np.sqrt(np.maximum(ball**2 - away, 0.0)) - ball)

    found = least_squares(residual, [0.0, 0.0, float(depth.max())])
    return float(np.sqrt(np.mean(found.fun**2)))


def press_errors(presses: PressImages, n_folds: int) -> np.ndarray:
    """RMSE in mm of every press that shows a contact, NaN where none was read."""
    folds, errors = fold_of(presses.experiment, n_folds), np.full(len(presses), np.nan)
    for fold in np.unique(folds):
        reader = Reconstructor(
            fit_lookup(presses.select(folds != fold)), presses.background, presses.dome_radius_mm
        )
        for k in np.nonzero(folds == fold)[0].tolist():
            hidden = None if presses.dots is None else dots_in(presses.images[k], presses.dots)
            shape = reader.shape_of(presses.images[k], hidden)
            depth = shape.imprint(LEAST_DEPTH_MM).depth_mm
            if depth.any():
                step = shape.mm_per_px / presses.mm_per_px
                circle = np.array([*presses.center_px[k], presses.radius_px[k]]) / step
                ball = float(presses.ball_radius_mm[k])
                errors[k] = sphere_rmse_mm(depth, shape.mm_per_px, circle, ball)
    return errors


def main() -> None:
    """Print a line for each set."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("presses", nargs="+", type=Path)
    parser.add_argument("--folds", type=int, default=4)
    options = parser.parse_args()
    for path in options.presses:
        presses = usable_presses(read_presses(path))
        errors = press_errors(presses, options.folds)
        read = errors[np.isfinite(errors)]
        sys.stdout.write(
            f"{path.name}: {len(read)} of {len(errors)} presses read; depth RMSE against the ball: "
            f"median {np.median(read):.4f}, worst {read.max():.4f} mm, "
            f"{np.mean(read <= 0.05):.0%} within 0.05 mm\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
