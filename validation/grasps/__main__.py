"""Run every set of grasps: ``python -m validation.grasps --out DIR``."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from itertools import product
from pathlib import Path

from tacgen.core.files import write_text
from validation.grasps.trust import FLIPS, SETS, Trial, run_set, summary_of


def main() -> None:
    """Write ``trials.json`` and ``trust.md``."""
    parser = argparse.ArgumentParser(description="Diagnoses of simulations perturbed on purpose.")
    parser.add_argument("--out", type=Path, default=Path("out/grasp_trust"))
    parser.add_argument("--sets", type=int, default=len(SETS), help="Only the first so many.")
    arguments = parser.parse_args()
    trials: list[Trial] = []
    for flips, (objects, seed) in product(FLIPS, SETS[: arguments.sets]):
        for trial in run_set(objects, seed, flips, arguments.out):
            trials.append(trial)
            found = " and ".join(trial.named) or "nothing"
            wrong = " and ".join(trial.causes) or "nothing"
            sys.stderr.write(
                f"{trial.objects}, {trial.flips:g} flipped: {wrong}; named {found}: "
                f"{trial.result}{'' if trial.telling else ', too few labels changed'}\n"
            )
            content = json.dumps([asdict(one) for one in trials], indent=1)
            write_text(arguments.out / "trials.json", content + "\n")
            write_text(arguments.out / "trust.md", summary_of(trials))


main()
