"""How far the table of one sensor is from another unit of the same kind.

    python -m validation.optics.other_units SENSOR PRESSES...

Each set of presses is scored with the shipped table, with the shipped table over the unit's own
picture at rest, and with tables of its own by folds. RMSE, grey levels, inside the circle and from
1 to 1.5 radii, labels as given.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

import tacgen
from tacgen.calibrate.lookup.score import TableScore, score_table
from tacgen.calibrate.lookup.table_fit import calibrate
from tacgen.optics.table import LookupTable
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses


def with_background(table: LookupTable, presses: PressImages, *, own: bool) -> LookupTable:
    """The table at the presses' resolution and scale, over its background or over their own.

    Their own is less what the table adds at rest on a dome, as the table's own background is.
    """
    size = presses.shape_px[::-1]
    background = cv2.resize(table.background, size, interpolation=cv2.INTER_AREA)
    if own:
        at_rest = tacgen.Sensor(table.sensor).at_rest_rgb().astype(np.float32)
        shipped = cv2.resize(at_rest, size, interpolation=cv2.INTER_AREA)
        background = background + presses.background - shipped
    at_rest_rgb = np.asarray(background, np.float32)
    return replace(table, background=at_rest_rgb, mm_per_px=presses.mm_per_px)


def _figures(score: TableScore) -> str:
    return " / ".join(f"{score.rmse('labels', ring)[0]:.2f}" for ring in (0, 1))


def main(name: str, folders: list[str]) -> None:
    """Print a row for each set of presses."""
    table = tacgen.load_table(tacgen.Sensor(name).description.table)
    dome_mm = table.geometry.get("dome_radius_mm", 0.0)
    for folder in folders:
        presses = usable_presses(replace(read_presses(Path(folder)), dome_radius_mm=dome_mm))
        found = [
            score_table(with_background(table, presses, own=own), presses) for own in (False, True)
        ]
        found.append(calibrate(presses).heldout)
        bare = " / ".join(f"{found[0].rmse('bare', ring)[0]:.2f}" for ring in (0, 1))
        shipped, over_own, own = map(_figures, found)
        sys.stdout.write(
            f"{folder}: {len(presses)} presses; shipped table {shipped}, over the unit's own "
            f"picture at rest {over_own}, the unit's own tables {own}, no contact {bare}\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
