"""Run the diagnosis on logs with an effect that acts in one part of them, and count what is right.

    python -m validation.blind.localised --cases 60 --strength 1 --seed 7200000 --out local.jsonl

The part is a region of the gel, a stretch of the session, or the presses of one ball, in turn;
``--beside`` adds an effect that acts everywhere. Right is the effect's name, and that it is said to
act in the right part: by the same kind of condition, and on the right side for nine in ten trials.
Stiffening and saturation, which both bend the curve, count as one.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from validation.blind.evaluate import LEAST_REACHED, judge, ratios, run
from validation.blind.generator import Case, draw_case

KINDS = ("region", "stretch", "indenter")
COLUMNS = {"region": ("x_mm", "y_mm"), "stretch": ("trial",), "indenter": ("indenter", "radius_mm")}
EFFECTS = {
    "normal": ("compliance_change", "zero_offset", "stiffening", "creep", "hysteresis"),
    "shear": ("compliance_change", "zero_offset", "slip", "normal_coupling", "creep"),
}
BENDS = {"stiffening", "saturation"}
LEAST_TRIALS = 32


def one_log(index: int, seed: int, strength: float, *, beside: bool) -> dict[str, Any]:
    """What was put into log ``index`` and what was found."""
    rng = np.random.default_rng([seed, index])
    kind = KINDS[index % len(KINDS)]
    channel = ("normal", "normal", "shear")[index // len(KINDS) % 3]
    name = EFFECTS[channel][index // 9 % 5]
    if (kind, channel, name) == ("indenter", "normal", "compliance_change"):
        name = "stiffening"  # one ball that gives more or less is what `geometry` says
    wanted = [(name, strength)]
    if beside:
        others = [one for one in EFFECTS[channel][1:] if one != name]
        wanted.append((str(rng.choice(others)), strength))
    n_trials = int(rng.integers(LEAST_TRIALS, 81))
    case = draw_case(
        seed + index,
        normal=wanted if channel == "normal" else (),
        shear=wanted if channel == "shear" else (),
        local={name: kind},
        n_trials=n_trials,
    )
    start = time.process_time()
    record = run(case, seed + index)
    found = record["channels"][channel]
    named = [(one["name"], one.get("where")) for one in found["effects"]]
    for one in found["effects"]:
        one["name"] = name if {one["name"], name} == BENDS else one["name"]
    return {
        "index": index,
        "kind": kind,
        "channel": channel,
        "wanted": wanted,
        "reached": all(case.reached[channel, n] >= LEAST_REACHED * s for n, s in wanted),
        "inside": len(case.inside[name]),
        "trials": n_trials,
        "found": named,
        "wrong": judge(case, record),
        "place": _place_is_right(case, name, kind, found),
        "ratio": ratios(case, record)[channel]["later_over_true_noise"],
        "before": found["error_before"]["rmse"] / found["noise_floor"]["rmse"],
        "sentence": found["sentence"],
        "cpu_s": round(time.process_time() - start, 2),
    }


def _place_is_right(case: Case, name: str, kind: str, found: dict[str, Any]) -> bool:
    """Whether the effect is said to act on the right trials; the other effects, everywhere."""
    said = {one["name"]: one.get("where") for one in found["effects"]}
    where = said.get(name)
    if where is None or any(said[other] for other in said if other != name):
        return False
    if where["column"] not in COLUMNS[kind]:
        return False
    per_trial = case.frame.groupby("trial").first().reset_index()
    value = per_trial[where["column"]]
    if "equals" in where:
        held = value.astype(str) == where["equals"]
    else:
        held = (value > where.get("above", -np.inf)) & (value <= where.get("up_to", np.inf))
    true = per_trial["trial"].isin(case.inside[name])
    same = float((held == true).mean())
    # A change of compliance in one part is one in the rest.
    return max(same, 1.0 - same if name == "compliance_change" else 0.0) >= 0.9


def summary(results: list[dict[str, Any]]) -> str:
    """A line a kind: logs, right names, right names and parts, and errors on later trials."""
    groups = defaultdict(list)
    for one in results:
        if one["reached"]:
            for key in (one["kind"], one["wanted"][0][0], "all"):
                groups[key].append(one)
    lines = [
        "| | logs | right names | and part | error ≤ 1.10 × noise | median |",
        "|" + "---|" * 6,
    ]
    for key, logs in groups.items():
        names = sum(not one["wrong"] for one in logs)
        both = sum(not one["wrong"] and one["place"] for one in logs)
        errors = np.array([one["ratio"] for one in logs])
        lines.append(
            f"| {key} | {len(logs)} | {names} | {both} | {(errors <= 1.1).sum()} "
            f"| {np.median(errors):.2f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Diagnose the logs that are not kept yet, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=45)
    parser.add_argument("--strength", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=7_200_000)
    parser.add_argument("--beside", action="store_true")
    parser.add_argument("--out", type=Path, required=True, help="a line of JSON a log")
    arguments = parser.parse_args()
    kept = arguments.out.read_text(encoding="utf-8") if arguments.out.is_file() else ""
    results = [json.loads(line) for line in kept.splitlines()]
    with arguments.out.open("a", encoding="utf-8") as file:
        for index in range(len(results), arguments.cases):
            results.append(
                one_log(index, arguments.seed, arguments.strength, beside=arguments.beside)
            )
            file.write(json.dumps(results[-1]) + "\n")
            file.flush()
    sys.stdout.write(summary(results))


if __name__ == "__main__":
    main()
