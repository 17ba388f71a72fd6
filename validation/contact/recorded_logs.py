"""What ``tacgen diagnose contact`` names in logs whose rows are not independent readings.

    python -m validation.contact.recorded_logs --logs 100 --kind clean --out recorded.jsonl
    python -m validation.contact.recorded_logs --logs 40 --kind single --out recorded.jsonl

Logs of ``validation.blind``'s generator, without an effect or with one, are recorded in each of
the ways of ``recordings`` in turn. *Right* is a log in whose channels exactly the effect that was
put in is named, and nothing is unexplained. Every diagnosis is a line of JSON.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.diagnose.contact.command import diagnose
from tacgen.diagnose.contact.result import diagnosis_record
from tacgen.presses.press_log import read_press_log
from validation.blind.evaluate import LEAST_REACHED, Wanted, draw_wanted, judge
from validation.blind.generator import draw_case
from validation.contact.recordings import RECORDINGS

SEED = 23_000_000
STRENGTHS = [1.5, 2.0, 3.0]
DIGITS = 6  # of numbers in the file: what a logger writes


def one_log(recording: str, kind: str, seed: int) -> dict[str, Any] | None:
    """What was put in and what is wrong; None where the effect cannot be as strong as asked."""
    rng = np.random.default_rng([seed, 3])
    wanted: dict[str, Wanted] = draw_wanted(kind, STRENGTHS, rng)
    case = draw_case(seed, normal=wanted.get("normal", ()), shear=wanted.get("shear", ()))
    for channel, effects in wanted.items():
        for name, strength in effects:
            if case.reached[channel, name] < LEAST_REACHED * strength:
                return None
    frame = RECORDINGS[recording](case.frame).round(DIGITS)
    with tempfile.TemporaryDirectory() as folder:
        frame.to_csv(Path(folder) / "log.csv", index=False)
        log = read_press_log(Path(folder) / "log.csv")
    found = diagnosis_record(diagnose(log.columns, session_clock=log.session_clock))
    return {
        "recording": recording,
        "kind": kind,
        "seed": seed,
        "rows": len(frame),
        "used": len(log),
        "wanted": wanted,
        "wrong": judge(case, found),
    }


def table(results: list[dict[str, Any]]) -> str:
    """Right logs of all, a line a recording and kind."""
    total: Counter[tuple[str, str]] = Counter()
    right: Counter[tuple[str, str]] = Counter()
    for one in results:
        for recording in (one["recording"], "all"):
            total[one["kind"], recording] += 1
            right[one["kind"], recording] += not one["wrong"]
    lines = ["| kind | recording | right |", "|---|---|---|"]
    lines += [f"| {kind} | {how} | {right[kind, how]} of {n} |" for (kind, how), n in total.items()]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Diagnose the logs that are not kept yet, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--logs", type=int, default=100, help="of each recording")
    parser.add_argument("--kind", choices=("clean", "single"), default="clean")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--out", type=Path, required=True, help="a line of JSON a log")
    arguments = parser.parse_args()
    kept = arguments.out.read_text(encoding="utf-8") if arguments.out.exists() else ""
    results = [json.loads(line) for line in kept.splitlines()]
    known = {(one["kind"], one["recording"], one["seed"]) for one in results}
    for index in range(arguments.logs):
        for number, recording in enumerate(RECORDINGS):
            seed = arguments.seed + len(RECORDINGS) * index + number
            if (arguments.kind, recording, seed) in known:
                continue
            if result := one_log(recording, arguments.kind, seed):
                results.append(result)
                with arguments.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(result) + "\n")
    sys.stdout.write(table(results))


if __name__ == "__main__":
    main()
