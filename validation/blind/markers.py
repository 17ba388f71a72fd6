"""Marker tracks with nothing, one or two effects of the field, diagnosed blind.

    python -m validation.blind.markers --cases 72 --seed 1

Sessions of the virtual rig, a third of them with each number of effects, whose balls, forces,
places, gel and noise are drawn at random, are written as press_log.csv and markers.csv and read and
diagnosed as ``tacgen diagnose contact --markers`` does. Printed are the share of sessions whose
effects are named without one too many or too few, and the error before and after on held-out
presses. ``--out`` keeps a line of JSON a case.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.calibrate.contact.law_fit import fit_contact
from tacgen.core.sensors import load_sensor
from tacgen.diagnose.markers.diagnose import diagnose_markers
from tacgen.diagnose.markers.problem import PARTIAL_SLIP, PLACE, SHIFTED, TURNED
from tacgen.presses.marker_tracks import read_marker_tracks
from tacgen.presses.press_log import read_press_log
from tacgen.rig import RigRecipe, run_rig

EFFECTS = (PARTIAL_SLIP, PLACE, TURNED, SHIFTED)
WANTED = {0: 0.95, 1: 0.90, 2: 0.80}


def effects_of(case: int) -> tuple[str, ...]:
    """What the session of that number has: nothing, one and two in turn, all of them evenly."""
    pairs = list(combinations(EFFECTS, 2))
    number, kind = divmod(case, 3)
    return ((), (EFFECTS[number % len(EFFECTS)],), pairs[number % len(pairs)])[kind]


def draw_session(case: int, seed: int) -> RigRecipe:
    """A recipe with the effects of the case and everything else drawn."""
    rng, effects = np.random.default_rng([seed, case]), effects_of(case)
    radii = np.sort(rng.uniform(1.5, 7.0, 3))
    top = rng.uniform(0.35, 0.5)
    friction = rng.uniform(1.1, 2.0) * top if PARTIAL_SLIP in effects else None
    markers: dict[str, Any] = {
        "rate_hz": 3.0,
        "noise_mm": rng.uniform(0.003, 0.006),
        "decay_mm": rng.uniform(0.9, 2.4),
        "friction": friction,
    }
    if PLACE in effects:
        markers["place"] = {
            "x_mm": rng.uniform(-3.0, 3.0),
            "y_mm": rng.uniform(-2.0, 2.0),
            "radius_mm": rng.uniform(1.2, 2.4),
            "friction": rng.uniform(0.25, 0.5) * (friction or 0.6),
        }
    if TURNED in effects:
        markers["grid_turn_deg"] = rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 3.0)
    if SHIFTED in effects:
        angle, size = rng.uniform(-np.pi, np.pi), rng.uniform(0.02, 0.5)
        markers["grid_shift_mm"] = (size * np.cos(angle), size * np.sin(angle))
    return RigRecipe.model_validate(
        {
            "name": f"case_{case}",
            "seed": int(rng.integers(2**31)),
            "sensor": "virtual_gelsight",
            "indenters": [{"name": f"ball_{i}", "radius_mm": r} for i, r in enumerate(radii)],
            "law": {"k_n_mm3_per_n": rng.uniform(3.5, 7.0), "k_s_mm_per_n": rng.uniform(0.5, 1.2)},
            "schedule": {
                "presses": int(rng.integers(16, 25)),
                "force_n": (rng.uniform(1.5, 4.0), rng.uniform(6.0, 10.0)),
                "shear_ratio": (0.1, top),
            },
            "markers": markers,
        }
    )


def run_case(case: int, seed: int) -> dict[str, Any]:
    """Make, read and diagnose one session."""
    recipe = draw_session(case, seed)
    sensor = load_sensor(recipe.sensor, needs_table=False)
    with tempfile.TemporaryDirectory() as folder:
        run_rig(recipe, Path(folder))
        log = read_press_log(Path(folder) / "press_log.csv")
        tracks = read_marker_tracks(Path(folder) / "markers.csv", sensor, log)
    start = time.process_time()
    found = diagnose_markers(tracks, sensor, fit_contact(log).normal.pooled.value)
    given = recipe.markers.model_dump() if recipe.markers else {}
    return {
        "case": case,
        "seed": seed,
        "effects": sorted(effects_of(case)),
        "found": sorted(found.effects),
        "right": set(found.effects) == set(effects_of(case)) and not found.unexplained,
        "before_mm": found.before_mm,
        "after_mm": found.after_mm,
        "floor_mm": found.data.noise_mm,
        "unexplained": [one.covariate for one in found.unexplained],
        "given": given,
        "cpu_s": time.process_time() - start,
        "record": found.record(),
    }


def main() -> None:
    """Run the sessions and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=72)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    cases = range(options.cases)
    results = []
    with ProcessPoolExecutor(options.workers) as pool:
        for result in pool.map(run_case, cases, [options.seed] * len(cases)):
            results.append(result)
            mark = "right" if result["right"] else "WRONG"
            names = " + ".join(result["effects"]) or "nothing"
            errors = [1e3 * result[f"{name}_mm"] for name in ("before", "after", "floor")]
            print(  # noqa: T201
                f"{result['case']:3d} {mark} {names}: found "
                f"{' + '.join(result['found']) or 'nothing'}; "
                f"{errors[0]:.3g} -> {errors[1]:.3g} µm (floor {errors[2]:.3g})",
                flush=True,
            )
            if options.out:
                with options.out.open("a") as file:
                    file.write(json.dumps(result) + "\n")
    for count, wanted in WANTED.items():
        own = [one for one in results if len(one["effects"]) == count]
        if own:
            share = np.mean([one["right"] for one in own])
            before, after, floor = (
                1e3 * np.median([one[f"{name}_mm"] for one in own])
                for name in ("before", "after", "floor")
            )
            print(  # noqa: T201
                f"{count} effects: {share:.0%} of {len(own)} right (wanted {wanted:.0%}); median "
                f"error {before:.3g} -> {after:.3g} µm, noise floor {floor:.3g} µm"
            )


if __name__ == "__main__":
    main()
