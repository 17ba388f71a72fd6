"""Run the diagnosis on many blind logs and print what it got right, by class.

    python tests/blind/evaluate.py --cases 40 --classes single pair clean unlisted --seed 0
    python tests/blind/evaluate.py --only normal:creep shear:slip --strength 1.5 2

Each case is written as CSV, read by ``tacgen diagnose contact`` as a user would run it, and its
``diagnosis.json`` is compared with what was put in. Wrong cases are listed with the seed that
makes them again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import blind_effects as forms
import numpy as np
from generator import Case, draw_case
from typer.testing import CliRunner

Wanted = list[tuple[str, float]]
INSEPARABLE = {frozenset(pair) for pair in (("drift", "conditioning"), ("drift", "time_s"))}
"""Pairs that one session cannot tell apart: both follow the order of the presses."""


def draw_wanted(kind: str, strengths: list[float], rng: np.random.Generator) -> dict[str, Wanted]:
    """The effects of one case, by channel."""
    if kind == "clean":
        return {}
    channel = "normal" if rng.random() < len(forms.NORMAL) / 18 else "shear"
    listed = sorted(forms.NORMAL if channel == "normal" else forms.SHEAR)
    if kind == "unlisted":
        names = [str(rng.choice(sorted(forms.UNLISTED)))]
    else:
        names = [str(name) for name in rng.choice(listed, 1 + (kind == "pair"), replace=False)]
        if frozenset(names) in INSEPARABLE:
            return draw_wanted(kind, strengths, rng)
    return {channel: [(name, float(rng.choice(strengths))) for name in names]}


def cases(arguments: argparse.Namespace) -> Iterator[tuple[str, int, dict[str, Wanted]]]:
    """(class, seed, effects) of every case asked for."""
    if arguments.only:
        for index in range(arguments.cases):
            wanted: dict[str, Wanted] = {}
            rng = np.random.default_rng([arguments.seed, index])
            for text in arguments.only:
                channel, name = text.split(":")
                strength = float(rng.choice(arguments.strength))
                wanted.setdefault(channel, []).append((name, strength))
            yield "+".join(arguments.only), arguments.seed + index, wanted
        return
    for kind_index, kind in enumerate(arguments.classes):
        for index in range(arguments.cases):
            rng = np.random.default_rng([arguments.seed, kind_index, index])
            yield (
                kind,
                arguments.seed + 10_000 * kind_index + index,
                draw_wanted(kind, arguments.strength, rng),
            )


def diagnose(case: Case, folder: Path) -> dict:
    """The diagnosis of a case by the command line, in this process."""
    from tacgen.cli import app

    log, out = folder / "log.csv", folder / "out"
    case.frame.to_csv(log, index=False)
    result = CliRunner().invoke(app, ["diagnose", "contact", str(log), "--out", str(out)])
    if result.exit_code != 0:
        raise RuntimeError(f"exit {result.exit_code}: {result.output} {result.exception}")
    return json.loads((out / "diagnosis.json").read_text())


def judge(case: Case, diagnosis: dict) -> list[str]:
    """What is wrong with the diagnosis; nothing where it is right."""
    wrong = []
    for channel, true in (("normal", case.normal), ("shear", case.shear)):
        found = diagnosis["channels"].get(channel)
        if found is None:
            if true or case.unexplained[channel]:
                wrong.append(f"{channel}: missing")
            continue
        names = {effect["name"] for effect in found["effects"]}
        if names != set(true):
            wrong.append(f"{channel}: {sorted(true)} taken for {sorted(names)}")
        hidden = case.unexplained[channel]
        expected = "unexplained" if hidden else "effect_found" if true else "sufficient"
        if found["verdict"] != expected:
            said = [entry["covariate"] for entry in found["unexplained"]]
            wrong.append(f"{channel}: {found['verdict']} {said}, not {expected}")
        elif hidden and hidden not in [entry["covariate"] for entry in found["unexplained"]]:
            wrong.append(f"{channel}: {hidden} not named")
    return wrong


def error_ratio(case: Case, diagnosis: dict) -> list[float]:
    """error_after / the noise that was really put in, by channel that there is."""
    ratios = []
    for channel, noise in (("normal", case.noise_mm3), ("shear", case.noise_mm)):
        if channel in diagnosis["channels"] and noise > 0:
            ratios.append(diagnosis["channels"][channel]["error_after"]["rmse"] / noise)
    return ratios


def main() -> int:
    """Run, print a line a class and a line a wrong case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=20, help="cases a class")
    parser.add_argument("--classes", nargs="+", default=["single", "pair", "clean", "unlisted"])
    parser.add_argument("--only", nargs="+", help="channel:effect, all of them in every case")
    parser.add_argument("--strength", nargs="+", type=float, default=[1.5, 2.0, 3.0])
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    right: Counter[str] = Counter()
    total: Counter[str] = Counter()
    ratios: list[float] = []
    for kind, seed, wanted in cases(arguments):
        case = draw_case(seed, **wanted)
        start = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            try:
                diagnosis = diagnose(case, Path(folder))
                wrong = judge(case, diagnosis)
                ratios += error_ratio(case, diagnosis)
            except (RuntimeError, KeyError) as error:
                wrong = [f"failed: {error}"]
        total[kind] += 1
        right[kind] += not wrong
        if wrong:
            seconds = time.process_time() - start
            trials = case.frame["trial"].nunique()
            sys.stdout.write(
                f"WRONG {kind} seed={seed} {wanted} forms={case.form_names} trials={trials} "
                f"schedules={case.schedules} {seconds:.1f} s: {'; '.join(wrong)}\n"
            )
            sys.stdout.flush()
    for kind in total:
        share = 100.0 * right[kind] / total[kind]
        sys.stdout.write(f"{kind:12s} right {right[kind]}/{total[kind]} = {share:.1f} %\n")
    if ratios:
        low, middle, high = np.quantile(ratios, [0.05, 0.5, 0.95])
        sys.stdout.write(
            f"error_after / response noise put in: {low:.2f} {middle:.2f} {high:.2f} (5 50 95 %)\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
