"""What halving, doubling or removing each rule of the contact diagnosis changes.

    python -m validation.contact.sensitivity --logs 20 --out sensitivity.md
    python -m validation.contact.sensitivity --logs 20 --changes removed --out removed.md

Each log of ``validation.blind``'s generator (one effect, two, none, or one outside the lists, in
turn) is diagnosed once by the rules as they are and once for every change of a rule. Every
diagnosis is kept beside the table as a line of JSON, so that a run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.core.files import write_text
from tacgen.diagnose.rules import CONTACT, ContactRules
from validation.blind.evaluate import Wanted, draw_wanted, judge, ratios, run
from validation.blind.generator import draw_case

SEED = 3_100_000
KINDS = ("single", "pair", "clean", "unlisted")
CHANGES = ("half", "double", "removed")
STRENGTHS = [1.5, 2.0, 3.0]
REMOVED: dict[str, Any] = {
    "least_share_of_all": 0.0,
    "parameter_price": 0.0,
    "min_gain": 0.0,
    "negative_loss_in_sd": 1e9,
    "form_share_left": 0.0,
}
"""The value at which a rule does nothing, for those that can be left out."""


def changed_rules(names: list[str], changes: list[str]) -> Iterator[tuple[str, ContactRules]]:
    """(label, rules) of the rules as they are and of every change of one of them."""
    yield "as they are", CONTACT
    for rule in fields(ContactRules):
        value: Any = getattr(CONTACT, rule.name)
        if isinstance(value, tuple) or (rule.name not in names):
            continue
        values: dict[str, Any] = {"half": 0.5 * value, "double": 2.0 * value}
        if isinstance(value, int):
            values = {label: max(1, int(new)) for label, new in values.items()}
        if rule.name in REMOVED:
            values["removed"] = REMOVED[rule.name]
        for label, new in values.items():
            if new != value and label in changes:
                yield f"{rule.name}: {label}", replace(CONTACT, **{rule.name: new})


def logs(count: int, seed: int) -> Iterator[tuple[int, dict[str, Wanted]]]:
    """(seed, effects) of so many logs."""
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        yield seed + index, draw_wanted(KINDS[index % len(KINDS)], STRENGTHS, rng)


def diagnosed(seed: int, wanted: dict[str, Wanted], rules: ContactRules) -> dict[str, Any]:
    """Channels of a log, those that are right, those with a false name, and their errors."""
    case = draw_case(seed, normal=wanted.get("normal", ()), shear=wanted.get("shear", ()))
    record = run(case, seed, rules)
    wrong, measured = judge(case, record), ratios(case, record)
    put_in = {"normal": set(case.normal), "shear": set(case.shear)}
    found = {name: {e["name"] for e in c["effects"]} for name, c in record["channels"].items()}
    return {
        "channels": len(found),
        "right": len(found) - len(set(wrong) & set(found)),
        "false": sum(bool(names - put_in[name]) for name, names in found.items()),
        "errors": [ratio["after_over_true_noise"] for ratio in measured.values()],
    }


def table(store: dict[tuple[str, int], dict[str, Any]]) -> str:
    """A row a change: the logs that it was tried on, and what they come to."""
    rows = ["| rule | logs | right | false name | error over noise | changed |", "|" + "---|" * 6]
    for label in dict.fromkeys(label for label, _ in store):
        seeds = [seed for known, seed in store if known == label]
        found = [store[label, seed] for seed in seeds]
        plain = [store["as they are", seed] for seed in seeds]
        channels = sum(f["channels"] for f in found)
        right, false = (sum(f[key] for f in found) for key in ("right", "false"))
        error = float(np.mean([e for f in found for e in f["errors"]]))
        changed = sum(f != p for f, p in zip(found, plain, strict=True))
        rows.append(
            f"| {label} | {len(seeds)} | {right} of {channels} | {false} of {channels} "
            f"| {error:.4f} | {changed} |"
        )
    return "\n".join(rows) + "\n"


def main() -> None:
    """Diagnose what is not kept yet, and write the table."""
    every = [rule.name for rule in fields(ContactRules)]
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--logs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=SEED, help="of the first log")
    parser.add_argument("--rules", nargs="+", default=every, help="all if not given")
    parser.add_argument("--changes", nargs="+", default=list(CHANGES), choices=CHANGES)
    parser.add_argument("--out", type=Path, required=True, help="the table, in Markdown")
    arguments = parser.parse_args()
    kept = arguments.out.with_suffix(".jsonl")
    store: dict[tuple[str, int], dict[str, Any]] = {}
    if kept.is_file():
        for line in kept.read_text(encoding="utf-8").splitlines():
            item = json.loads(line)
            store[item.pop("label"), item.pop("seed")] = item
    kept.parent.mkdir(parents=True, exist_ok=True)
    with kept.open("a", encoding="utf-8") as file:
        for seed, wanted in logs(arguments.logs, arguments.seed):
            for label, rules in changed_rules(arguments.rules, arguments.changes):
                if (label, seed) not in store:
                    store[label, seed] = diagnosed(seed, wanted, rules)
                    entry = {"label": label, "seed": seed, **store[label, seed]}
                    file.write(json.dumps(entry) + "\n")
                    file.flush()
            write_text(arguments.out, table(store))
            sys.stderr.write(f"log {seed}\n")


if __name__ == "__main__":
    main()
