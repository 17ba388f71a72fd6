"""How often ``tacgen diagnose contact`` names an effect in a log that has none.

    python -m validation.contact.clean_logs --logs 1000 --out clean_logs.jsonl

Every log of ``validation.blind``'s generator is drawn without an effect and then spoiled as its
kind says, in turn. A false name is an effect in the extended law; a covariate called unexplained
is counted apart. Every diagnosis is a line of JSON beside the table, so that a run goes on where
it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.signal import lfilter
from scipy.stats import binomtest

from tacgen.diagnose.contact.command import diagnose
from tacgen.presses.press_log import read_press_log
from validation.blind.generator import Case, draw_case

SEED = 8_000_000
RESPONSES = (("volume_mm3",), ("shear_x_mm", "shear_y_mm"))
Spoil = Callable[[pd.DataFrame, Case, np.random.Generator], pd.DataFrame]


def _with_errors(
    frame: pd.DataFrame, case: Case, errors: Callable[[float], np.ndarray]
) -> pd.DataFrame:
    """``frame`` with the generator's noise replaced: ``errors(noise)`` (n,) of each column."""
    frame = frame.copy()
    truth = {"volume_mm3": case.volume_mm3, "shear_x_mm": case.shear_mm[:, 0]}
    truth["shear_y_mm"] = case.shear_mm[:, 1]
    for names, noise in zip(RESPONSES, (case.noise_mm3, case.noise_mm), strict=True):
        for name in names:
            if name in frame:
                frame[name] = truth[name] + errors(noise)
    return frame


def _plain(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    return frame


def _correlated(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """Noise that lasts 5 to 50 samples, beside as much white noise."""
    memory = np.exp(-1.0 / np.exp(rng.uniform(np.log(5.0), np.log(50.0))))

    def errors(noise: float) -> np.ndarray:
        white = rng.standard_normal(len(frame))
        slow = [_slow(memory, int(count), rng) for count in frame.groupby("trial").size()]
        return np.asarray(noise * (white + np.concatenate(slow)) * np.sqrt(0.5))

    return _with_errors(frame, case, errors)


def _slow(memory: float, count: int, rng: np.random.Generator) -> np.ndarray:
    """Samples (count,) of unit variance, each correlated by ``memory`` with the one before it."""
    driven = np.sqrt(1 - memory**2) * rng.standard_normal(count)
    driven[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -memory], driven))


def _heavy_tails(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """Student's t with 3 degrees of freedom."""
    return _with_errors(
        frame, case, lambda noise: noise * rng.standard_t(3, len(frame)) / np.sqrt(3)
    )


def _outliers(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """One sample in 200 to 20 sticks out by 5 to 50 times the noise, to one side or both."""
    share, one_sided = np.exp(rng.uniform(np.log(0.005), np.log(0.05))), rng.random() < 0.5

    def errors(noise: float) -> np.ndarray:
        size = rng.uniform(5, 50, len(frame)) * (rng.random(len(frame)) < share)
        sign = 1.0 if one_sided else rng.choice([-1.0, 1.0], len(frame))
        return np.asarray(noise * (rng.standard_normal(len(frame)) + sign * size))

    return _with_errors(frame, case, errors)


def _growing(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """Noise in proportion to the load, over a floor."""
    load = frame["force_normal_n"].to_numpy()
    share = load / np.sqrt((load**2).mean())
    return _with_errors(
        frame, case, lambda noise: noise * (0.2 + share) * rng.standard_normal(len(load))
    )


def _trials_differ(
    frame: pd.DataFrame, case: Case, rng: np.random.Generator, share: float = 0.02
) -> pd.DataFrame:
    """Every trial has its own gain, by ``share``, that follows nothing."""
    gain = 1 + share * rng.standard_normal(int(frame["trial"].max()) + 1)[frame["trial"]]
    frame = frame.copy()
    for names in RESPONSES:
        for name in set(names) & set(frame):
            frame[name] *= gain
    return frame


def _trials_bend(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """Every trial has its own curvature, which follows nothing: 3 % at the log's full response."""
    bend = 0.03 * rng.standard_normal(int(frame["trial"].max()) + 1)[frame["trial"]]
    frame = frame.copy()
    for names in RESPONSES:
        if present := [name for name in names if name in frame]:
            size = np.linalg.norm(frame[present], axis=1)
            frame[present] = frame[present].mul(1 + bend * size / size.max(), axis=0)
    return frame


def _coarse(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """Readings in steps of two to four times the noise."""
    step = rng.uniform(2.0, 4.0)
    frame = frame.copy()
    for names, noise in zip(RESPONSES, (case.noise_mm3, case.noise_mm), strict=True):
        for name in set(names) & set(frame):
            frame[name] = step * noise * np.round(frame[name] / (step * noise))
    return frame


def _required_only(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """The columns that every log has, and shear in half of the logs."""
    kept = ["trial", "time_s", "force_normal_n", "volume_mm3"]
    if rng.random() < 0.5:
        kept += [name for name in frame if "shear" in str(name)]
    return frame[kept]


def _gaps(frame: pd.DataFrame, case: Case, rng: np.random.Generator) -> pd.DataFrame:
    """A third of the rows was lost, and a tenth of the responses was not measured."""
    frame = frame[rng.random(len(frame)) > 1 / 3].copy()
    for names in RESPONSES:
        frame.loc[rng.random(len(frame)) < 0.1, [name for name in names if name in frame]] = np.nan
    return frame


KINDS: dict[str, tuple[Spoil, tuple[int, int]]] = {
    "white and briefly correlated noise": (_plain, (12, 80)),
    "noise that lasts 5 to 50 samples": (_correlated, (12, 80)),
    "heavy tails": (_heavy_tails, (12, 80)),
    "outliers": (_outliers, (12, 80)),
    "noise that grows with the load": (_growing, (12, 80)),
    "trials that differ by 2 %": (_trials_differ, (12, 80)),
    "trials that bend by 3 %": (_trials_bend, (12, 80)),
    "coarse readings": (_coarse, (12, 80)),
    "required columns only": (_required_only, (12, 80)),
    "gaps": (_gaps, (12, 80)),
    "4 to 11 trials": (_plain, (4, 11)),
    "4 to 11 trials, lasting noise": (_correlated, (4, 11)),
    "4 to 15 trials that differ by 4 %": (partial(_trials_differ, share=0.04), (4, 15)),
    "2 or 3 trials": (_plain, (2, 3)),
}
"""What spoils the logs of each kind, and how many trials they have."""


def one_log(index: int, seed: int) -> dict[str, Any]:
    """The kind of log ``index`` and what each channel was said to follow."""
    kind = list(KINDS)[index % len(KINDS)]
    spoil, (least, most) = KINDS[kind]
    rng = np.random.default_rng([seed, index])
    case = draw_case(seed + index, n_trials=int(rng.integers(least, most + 1)))
    frame = spoil(case.frame, case, rng)
    with tempfile.TemporaryDirectory() as folder:
        frame.to_csv(Path(folder) / "log.csv", index=False)
        log = read_press_log(Path(folder) / "log.csv")
    start = time.process_time()
    found = diagnose(log.columns, session_clock=log.session_clock)
    said = {
        name: {
            "effects": [term.name for term in channel.final.model.terms],
            "unexplained": [one.covariate for one in channel.unexplained],
        }
        for name, channel in found.channels.items()
    }
    seconds = round(time.process_time() - start, 2)
    rows, trials = len(frame), int(frame["trial"].nunique())
    return {"index": index, "kind": kind, "trials": trials, "rows": rows, "cpu_s": seconds} | {
        "said": said
    }


def table(results: list[dict[str, Any]]) -> str:
    """A line a kind: logs, logs with a false name, its 95 % interval, and those said unexplained.

    The interval is Clopper and Pearson's.
    """
    lines = [
        "| kind of clean log | logs | false name | 95 % interval | called unexplained |",
        "|---|---|---|---|---|",
    ]
    for kind in (*KINDS, "all"):
        said = [one["said"].values() for one in results if kind in (one["kind"], "all")]
        false = sum(any(channel["effects"] for channel in log) for log in said)
        left = sum(any(channel["unexplained"] for channel in log) for log in said)
        if said:
            interval = binomtest(false, len(said)).proportion_ci()
            shown = f"{100 * interval.low:.1f} to {100 * interval.high:.1f} %"
            lines.append(f"| {kind} | {len(said)} | {false} | {shown} | {left} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Diagnose the logs that are not kept yet, and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--out", type=Path, required=True, help="a line of JSON a log")
    arguments = parser.parse_args()
    kept = arguments.out.read_text(encoding="utf-8") if arguments.out.is_file() else ""
    results = [json.loads(line) for line in kept.splitlines()]
    with arguments.out.open("a", encoding="utf-8") as file:
        for index in range(len(results), arguments.logs):
            results.append(one_log(index, arguments.seed))
            file.write(json.dumps(results[-1]) + "\n")
            file.flush()
    sys.stdout.write(table(results))


if __name__ == "__main__":
    main()
