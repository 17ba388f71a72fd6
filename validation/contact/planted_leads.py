"""Leads planted in a measured log's residuals: are they named, and is nothing named without them?

    python -m validation.contact.planted_leads LOG.csv --grasps 15 --logs 10 --lead-s 0.08

One lead and one compliance are fitted to all trials of a press log. New logs have its courses of
force, scaled by 0.7 to 1.3, what a law with the planted lead makes of them, and the residuals of
other trials, turned in time and in sign. Every log is diagnosed as by ``tacgen diagnose contact``.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from tacgen.calibrate.contact.align import align
from tacgen.diagnose.contact.command import diagnose
from tacgen.presses.press_log import read_press_log

LEADS_S = np.arange(-0.1, 0.2, 0.005)  # tried on the measured log
PAUSE_S = 2.0


def led(trial: pd.DataFrame, lead_s: float) -> np.ndarray:
    """The force (n,) that stands ``lead_s`` later in a trial."""
    time_s = trial["time_s"].to_numpy()
    return np.interp(time_s + lead_s, time_s, trial["force_normal_n"].to_numpy())


def residuals(trials: list[pd.DataFrame]) -> tuple[float, list[np.ndarray]]:
    """The compliance, and what it leaves of each trial with the lead that fits best."""
    volume = np.concatenate([one["volume_mm3"].to_numpy() for one in trials])
    best: tuple[float, float, float] = (np.inf, 0.0, 0.0)
    for lead_s in LEADS_S:
        force = np.concatenate([led(one, lead_s) for one in trials])
        k_n = float(force @ volume / (force @ force))
        best = min(best, (float(((volume - k_n * force) ** 2).sum()), float(lead_s), k_n))
    _, lead_s, k_n = best
    return k_n, [one["volume_mm3"].to_numpy() - k_n * led(one, lead_s) for one in trials]


def planted(
    trials: list[pd.DataFrame], grasps: int, lead_s: float, rng: np.random.Generator
) -> pd.DataFrame:
    """A log of so many grasps."""
    k_n, left = residuals(trials)
    parts, start_s = list[pd.DataFrame](), 0.0
    for number in range(grasps):
        one = trials[rng.integers(len(trials))]
        time_s = one["time_s"].to_numpy() - one["time_s"].iloc[0]
        force = one["force_normal_n"].to_numpy() * rng.uniform(0.7, 1.3)
        noise = left[rng.integers(len(left))]
        noise = np.roll(noise, rng.integers(noise.size)) * rng.choice([-1.0, 1.0])
        course = pd.DataFrame({"time_s": time_s, "force_normal_n": force})
        volume = k_n * led(course, lead_s) + np.resize(noise, time_s.size)
        parts.append(course.assign(trial=number, time_s=time_s + start_s, volume_mm3=volume))
        start_s += float(time_s[-1]) + PAUSE_S
    return pd.concat(parts)


def main() -> None:
    """Print what was found in each log, with and without the lead."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--grasps", type=int, default=15)
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--lead-s", type=float, default=0.08)
    parser.add_argument("--seed", type=int, default=7)
    given = parser.parse_args()
    frame = pd.read_csv(given.log)
    trials = [one for _, one in frame.groupby("trial")]
    for lead_s in (given.lead_s, 0.0):
        rng, named, others = np.random.default_rng(given.seed), 0, 0
        for _ in range(given.logs):
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "press_log.csv"
                planted(trials, given.grasps, lead_s, rng).to_csv(path, index=False)
                log, _ = align(read_press_log(path))
                found = diagnose(log.columns, session_clock=log.session_clock)
            effects = set(found.channels["normal"].effect_names)
            named += "latency" in effects
            others += bool(effects - {"latency"})
        sys.stdout.write(
            f"lead {lead_s:g} s: latency named in {named} of {given.logs}, others in {others}\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
