"""Run every set of grasps: ``python -m validation.grasps --out DIR``."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from tacgen.core.files import write_text
from validation.grasps.trust import SETS, Trial, run_set, summary_of


def main() -> None:
    """Write ``trials.json`` and ``trust.md``."""
    parser = argparse.ArgumentParser(description="Diagnoses of simulations perturbed on purpose.")
    parser.add_argument("--out", type=Path, default=Path("out/grasp_trust"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="Stop at the first name.")
    parser.add_argument("--sets", type=int, default=len(SETS), help="Only the first so many.")
    arguments = parser.parse_args()
    trials: list[Trial] = []
    for objects, count, seed in SETS[: arguments.sets]:
        for trial in run_set(
            objects, count, seed, arguments.out, arguments.workers, quick=arguments.quick
        ):
            trials.append(trial)
            found = ", ".join(trial.named) or "sufficient"
            sys.stderr.write(f"{trial.objects} {trial.change} {trial.flips:g}: {found}\n")
        content = json.dumps([asdict(one) for one in trials], indent=1)
        write_text(arguments.out / "trials.json", content + "\n")
        write_text(arguments.out / "trust.md", summary_of(trials))


main()
