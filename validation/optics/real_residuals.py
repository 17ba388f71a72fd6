"""What a table calibrated on real presses leaves of them, before and after what is diagnosed.

    python -m validation.optics.real_residuals PRESSES...

For each folder (or dataPack; ``NAME=PRESSES`` of a sensor that ships, with its scale) a row: the
verdict of ``tacgen diagnose optics`` without a table, its effects with what each gains on held-out
presses, the error of presses that took no part before and after, and the share of the residual's
power around contacts that a pattern of distance and direction predicts: of held-out presses the
same everywhere and changing over the gel, and of each press one of its own, of the pixels that it
was not fitted to.

The rules of the search were chosen on simulated presses, ``mini_presses`` and Taxim's small set;
other sets only judge.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from scripts.make_default_tables import real_presses
from tacgen.diagnose.optics.diagnose import diagnose_optics
from tacgen.diagnose.optics.fit import Model, PressFit
from tacgen.diagnose.optics.residuals import AROUND, AROUND_BY_PLACE, PRESS, around_contact
from tacgen.presses.press_folder import read_presses
from tacgen.presses.screening import usable_presses


def structure(fit: PressFit, model: Model) -> str:
    """RMS around contacts, grey levels, and the shares that patterns predict."""
    residuals = fit.residuals(model)
    kinds = (AROUND, AROUND_BY_PLACE, PRESS)
    pairs = [around_contact(fit, model, residuals, kind) for kind in kinds]
    shares = [f"{100 * (1 - after.mean() / before.mean()):.0f}" for before, after in pairs]
    return f"{np.sqrt(pairs[0][0].mean()):.2f} ({', '.join(shares)} %)"


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("presses", nargs="+", metavar="[NAME=]PRESSES")
    sys.stdout.write("| presses | verdict, follows | effects | error | around contacts |\n")
    sys.stdout.write("|---|---|---|---|---|\n")
    for given in parser.parse_args().presses:
        name, _, path = given.rpartition("=")
        presses = real_presses(name, Path(path)) if name else read_presses(Path(path))
        found = diagnose_optics(usable_presses(presses))
        follows = ", ".join(one.covariate for one in found.unexplained)
        effects = "; ".join(
            f"{one.name} ({one.how}) {one.heldout_gain:.2f} ± {one.heldout_gain_stderr:.2f}"
            for one in found.effects
        )
        fit, chosen = found.fit, found.selection.chosen
        sys.stdout.write(
            f"| {name or Path(path).name} | {found.verdict} {follows} | {effects} | "
            f"{found.rmse_before:.2f} → {found.rmse_after:.2f} | "
            f"{structure(fit, found.selection.start)} → {structure(fit, chosen)} |\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
