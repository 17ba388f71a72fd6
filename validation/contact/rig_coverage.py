"""How often the true compliances are inside their 95 % intervals, on sessions of the rig.

python -m validation.contact.rig_coverage --recipe rig --sessions 1000
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from tacgen.calibrate.contact.slope_fit import fit_slope
from tacgen.rig import load_rig_recipe, simulate_session

CHANNELS = {
    "k_n": (["force_normal_n"], ["volume_mm3"]),
    "k_s": (["force_shear_x_n", "force_shear_y_n"], ["shear_x_mm", "shear_y_mm"]),
}


def main() -> int:
    """Print a line a compliance: coverage, mean and spread of (estimate − truth) / stderr."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recipe", default="rig")
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--presses", type=int)
    parser.add_argument("--seed", type=int, default=0, help="the first session's")
    arguments = parser.parse_args()
    recipe = load_rig_recipe(arguments.recipe)
    if arguments.presses:
        schedule = recipe.schedule.model_copy(update={"presses": arguments.presses})
        recipe = recipe.model_copy(update={"schedule": schedule})
    truth = {"k_n": recipe.law.k_n_mm3_per_n, "k_s": recipe.law.k_s_mm_per_n}
    scores: dict[str, list[float]] = {name: [] for name in CHANNELS}
    for seed in range(arguments.seed, arguments.seed + arguments.sessions):
        log = simulate_session(recipe.model_copy(update={"seed": seed})).log
        for name, (load, response) in CHANNELS.items():
            fit = fit_slope(log[load].to_numpy(), log[response].to_numpy(), log["trial"].to_numpy())
            scores[name].append((fit.value - truth[name]) / fit.stderr)
    for name, values in scores.items():
        z = np.array(values)
        inside = 100.0 * (np.abs(z) < 1.96).mean()
        sys.stdout.write(f"{name}: {inside:.1f} % inside, z {z.mean():+.2f} ± {z.std():.2f}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
