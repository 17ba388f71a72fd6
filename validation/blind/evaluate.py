"""Run the diagnosis on many blind logs and print what it got right, by class.

    python -m validation.blind.evaluate --cases 40 --classes single pair clean unlisted --seed 0
    python -m validation.blind.evaluate --only normal:creep shear:slip --strength 1.5 2
    python -m validation.blind.evaluate --source independent --classes single clean --cases 20

Each case is written as CSV, less a fifth of its trials, and read and diagnosed as ``tacgen
diagnose contact`` does; what is found is compared with what was put in, and the law is tried on
the trials that it never saw. Wrong cases are listed with the seed that makes them again; ``--out``
keeps a line of JSON a case.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tacgen.diagnose.contact.command import diagnose
from tacgen.diagnose.contact.result import diagnosis_record, log_notes
from tacgen.diagnose.rules import CONTACT, ContactRules
from tacgen.presses.press_log import read_press_log
from validation.blind.blind_forms import ALL_NORMAL, ALL_SHEAR, ALL_UNLISTED
from validation.blind.generator import Case, draw_case
from validation.blind.independent import draw_case as draw_independent_case

Wanted = list[tuple[str, float]]


def draw_few_trials(
    seed: int,
    *,
    normal: Sequence[tuple[str, float]] = (),
    shear: Sequence[tuple[str, float]] = (),
) -> Case:
    """A log of the first generator with 12 to 19 trials, of which the tool gets 10 to 16."""
    n_trials = int(np.random.default_rng([seed, 7]).integers(12, 20))
    return draw_case(seed, normal=normal, shear=shear, n_trials=n_trials)


INSEPARABLE = {
    frozenset(pair)
    for pair in (("drift", "conditioning"), ("stiffening", "saturation"), ("slip", "saturation"))
}
"""Pairs that are one thing in a log: both follow the order of the presses, or bend the curve."""
SOURCES: dict[str, Callable[..., Case]] = {
    "blind": draw_case,
    "few": draw_few_trials,
    "independent": draw_independent_case,
}
"""Generators of logs; each draws the effects of the same lists in forms of its own."""
CLASSES = ("single", "pair", "cross", "clean", "unlisted", "triple")
N_EFFECTS = {"single": 1, "pair": 2, "triple": 3}
LEAST_REACHED = 0.9


def draw_wanted(kind: str, strengths: list[float], rng: np.random.Generator) -> dict[str, Wanted]:
    """The effects of one case, by channel; a ``cross`` pair has one in each channel."""
    if kind == "clean":
        return {}
    listed = {"normal": sorted(ALL_NORMAL), "shear": sorted(ALL_SHEAR)}
    if kind == "cross":
        return {
            channel: [(str(rng.choice(names)), float(rng.choice(strengths)))]
            for channel, names in listed.items()
        }
    channel = "normal" if rng.random() < len(ALL_NORMAL) / 18 else "shear"
    if kind == "unlisted":
        names = [str(rng.choice(sorted(ALL_UNLISTED)))]
    else:
        names = [str(n) for n in rng.choice(listed[channel], N_EFFECTS[kind], replace=False)]
        if any(pair <= set(names) for pair in INSEPARABLE):
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
    for index in range(arguments.cases):
        for kind in arguments.classes:
            number = CLASSES.index(kind)
            rng = np.random.default_rng([arguments.seed, number, index])
            yield (
                kind,
                arguments.seed + 10_000 * number + index,
                draw_wanted(kind, arguments.strength, rng),
            )


def split(frame: pd.DataFrame, seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The log that the tool gets, and a fifth of the trials, never the first, that it does not."""
    trials = np.sort(frame["trial"].unique())
    later = np.random.default_rng(seed).choice(trials[1:], max(1, trials.size // 5), replace=False)
    away = frame["trial"].isin(later)
    return frame[~away], frame[away]


def run(case: Case, seed: int, rules: ContactRules = CONTACT) -> dict[str, Any]:
    """The diagnosis of a case, as its JSON, with the law's error on trials kept from it."""
    given, later = split(case.frame, seed)
    with tempfile.TemporaryDirectory() as folder:
        given.to_csv(Path(folder) / "log.csv", index=False)
        log = read_press_log(Path(folder) / "log.csv")
    found = diagnose(
        log.columns, notes=log_notes(log), session_clock=log.session_clock, rules=rules
    )
    record = diagnosis_record(found)
    # The forces of all trials are known: a memory may outlast the pause between two.
    volume, shear = (response[later.index] for response in found.law.predict(case.frame))
    measured = later["volume_mm3"].to_numpy()
    record["later"] = {"normal": _rms(measured - volume)}
    record["later_noise"] = {"normal": _rms(measured - case.volume_mm3[later.index])}
    if "shear" in record["channels"]:
        measured = later[["shear_x_mm", "shear_y_mm"]].to_numpy()
        record["later"]["shear"] = _rms(measured - shear)
        record["later_noise"]["shear"] = _rms(measured - case.shear_mm[later.index])
    return record


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def judge(case: Case, diagnosis: dict[str, Any]) -> dict[str, str]:
    """What is wrong, by channel; nothing where it is right."""
    wrong = {}
    for channel, true in (("normal", case.normal), ("shear", case.shear)):
        hidden = case.unexplained[channel]
        found = diagnosis["channels"].get(channel)
        if found is None:
            if true or hidden:
                wrong[channel] = "missing"
            continue
        names = {effect["name"] for effect in found["effects"]}
        said = [entry["covariate"] for entry in found["unexplained"]]
        expected = "unexplained" if hidden else "effect_found" if true else "sufficient"
        named = said == [hidden] if hidden else not said
        if names != set(true) or found["verdict"] != expected or not named:
            wrong[channel] = f"{sorted(true) or hidden} taken for {sorted(names)}, left {said}"
    return wrong


def ratios(case: Case, diagnosis: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Errors over floors, by channel.

    That on later trials over the noise is given for channels that have an effect of the list, and
    what it would be had the law no error: the noise of so few samples is not the noise of all.
    """
    found = {}
    channels = (
        ("normal", case.floor_mm3, case.noise_mm3, case.normal),
        ("shear", case.floor_mm, case.noise_mm, case.shear),
    )
    for channel, noise, of_response, effects in channels:
        if channel in diagnosis["channels"] and noise > 0:
            record = diagnosis["channels"][channel]
            after = record["error_after"]["rmse"]
            found[channel] = {
                "after_over_true_noise": after / noise,
                "after_over_floor": after / record["noise_floor"]["rmse"],
                "floor_over_true_noise": record["noise_floor"]["rmse"] / noise,
                "later_over_after": diagnosis["later"][channel] / after,
            }
            if effects:
                found[channel]["later_over_true_noise"] = diagnosis["later"][channel] / noise
                drawn = diagnosis["later_noise"][channel]
                least = float(np.sqrt(max(drawn**2 + noise**2 - of_response**2, 0.0)))
                found[channel]["later_over_true_noise_of_no_error"] = least / noise
    return found


def evaluate(
    kind: str, seed: int, wanted: dict[str, Wanted], source: str = "blind"
) -> dict[str, Any]:
    """One case: what was put in, what was said, what is wrong, and the error's ratios."""
    case = SOURCES[source](seed, normal=wanted.get("normal", ()), shear=wanted.get("shear", ()))
    start = time.process_time()
    said, wrong, measured = {}, {}, {}
    try:
        diagnosis = run(case, seed)
        wrong, measured = judge(case, diagnosis), ratios(case, diagnosis)
        said = {name: found["sentence"] for name, found in diagnosis["channels"].items()}
    except Exception as error:
        wrong = {"crash": repr(error)}
    return {
        "kind": kind,
        "seed": seed,
        "wanted": wanted,
        "forms": case.form_names,
        "schedules": case.schedules,
        "trials": int(case.frame["trial"].nunique()),
        "rows": len(case.frame),
        "reached": all(
            case.reached[channel, name] >= LEAST_REACHED * strength
            for channel, effects in wanted.items()
            for name, strength in effects
        ),
        "wrong": wrong,
        "said": said,
        "ratios": measured,
        "cpu_s": round(time.process_time() - start, 2),
    }


def summary(results: list[dict[str, Any]]) -> str:
    """A line a class and a line a ratio."""
    right: Counter[str] = Counter()
    total: Counter[str] = Counter()
    clean: Counter[bool] = Counter()
    values: dict[str, list[float]] = defaultdict(list)
    for result in results:
        total[result["kind"]] += 1
        right[result["kind"]] += not result["wrong"]
        for channel, measured in result["ratios"].items():
            if not result["wanted"].get(channel):
                clean[channel not in result["wrong"]] += 1
            for name, value in measured.items():
                values[name].append(value)
    lines = [
        f"{kind:24s} {right[kind]}/{total[kind]} = {100 * right[kind] / total[kind]:.1f} %"
        for kind in total
    ]
    if clean:
        share = 100 * clean[True] / clean.total()
        lines.append(
            f"{'channels without effect':24s} {clean[True]}/{clean.total()} = {share:.1f} %"
        )
    for name, found in values.items():
        low, middle, high = np.nanquantile(found, [0.05, 0.5, 0.95])
        within = 100 * np.mean(np.nan_to_num(found) <= 1.10)
        lines.append(
            f"{name:33s} {low:.3f} {middle:.3f} {high:.3f} (5 50 95 %), ≤ 1.1: {within:.1f} %"
        )
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run, print a line a wrong case, and the summary."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--source", default="blind", choices=SOURCES, help="what makes the logs")
    parser.add_argument("--cases", type=int, default=20, help="cases a class")
    parser.add_argument("--classes", nargs="+", default=list(CLASSES), choices=CLASSES)
    parser.add_argument("--only", nargs="+", help="channel:effect, all of them in every case")
    parser.add_argument("--strength", nargs="+", type=float, default=[1.5, 2.0, 3.0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="a line of JSON a case")
    arguments = parser.parse_args()
    results = []
    for kind, seed, wanted in cases(arguments):
        result = evaluate(kind, seed, wanted, arguments.source)
        if not result["reached"]:
            continue
        results.append(result)
        if arguments.out:
            with arguments.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(result) + "\n")
        if result["wrong"]:
            shown = {
                name: value for name, value in result.items() if name not in ("said", "ratios")
            }
            sys.stdout.write(f"WRONG {shown}\n")
            sys.stdout.flush()
    sys.stdout.write(summary(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
