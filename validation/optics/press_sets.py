"""Held-out errors of lookup tables on measured ball presses, in and around the contact.

    python -m validation.optics.press_sets [SET ...] [--data ../shared/data] [--json errors.json]

Every set is calibrated as ``tacgen calibrate lookup`` does, with the same defaults, and scored on
presses that had no part in the fit, in the choice of settings or in the background.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from tacgen.calibrate.lookup.table_fit import calibrate
from tacgen.presses.press_folder import read_presses
from tacgen.presses.screening import usable_presses

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
SETS = {
    "taxim": "taxim_ball_presses/dataPack_small_37.npz",
    "digit_a": "press_sets/digit_a",
    "fots_gelsight": "press_sets/fots_gelsight",
    "gelsight_mini": "press_sets/gelsight_mini",
}


def held_out_errors(path: Path) -> list[dict[str, float]]:
    """RMSE, grey levels, in each ring around the contacts of the presses at ``path``."""
    heldout = calibrate(usable_presses(read_presses(path))).heldout
    if heldout is None:
        msg = f"{path}: no press was held out"
        raise RuntimeError(msg)
    return heldout.rings()


def main() -> None:
    """Print a table row for each ring of each set."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="*", metavar="SET", default=list(SETS))
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = {}
    for name in options.sets:
        found[name] = held_out_errors(options.data / SETS[name])
        for ring in found[name]:
            sys.stdout.write(
                f"{name:14} {ring['from_radii']:g} to {ring['to_radii']:g} radii: "
                f"labels {ring['rmse_labels']:5.2f}, re-estimated {ring['rmse_refined']:5.2f}, "
                f"background {ring['rmse_bare']:5.2f}\n"
            )
            sys.stdout.flush()
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
