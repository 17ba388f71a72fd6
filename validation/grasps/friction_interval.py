"""How often the interval of the friction sweep holds the true μ, and how wide it is.

``python -m validation.grasps.friction_interval [--sets N] [--seed N]`` prints a row for each step
of the sweep, number of labels and share of wrong ones. A grasp holds where μ exceeds its threshold,
drawn evenly from 0.1 to 1; the true μ is from 0.3 to 0.7. Seeds from 10 000 on served to choose the
method, those from 0 on to report. Sets whose labels are all equal have a one-sided answer and do
not count.
"""

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from tacgen.collection.friction import fit_friction, mu_range

STEPS = (0.1, 0.05, 0.01)
N_LABELS = (10, 20, 40)
WRONG = (0.0, 0.05, 0.1, 0.2)


def study(
    step: float, n_labels: int, wrong: float, seeds: Sequence[int]
) -> tuple[float, float, float]:
    """Share of intervals that hold the true μ, their mean width, and the estimate's mean error."""
    mus = np.array(mu_range(f"0:1:{step}"))
    found = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        mu = rng.uniform(0.3, 0.7)
        threshold = rng.uniform(0.1, 1.0, n_labels)
        real = (mu >= threshold) ^ (rng.random(n_labels) < wrong)
        simulated = (mus[:, None] >= threshold).astype(np.int64)
        fit = fit_friction(mus, simulated, real.astype(np.int64))
        if fit.bounded == "both":
            low, high = fit.interval
            found.append((low <= mu <= high, high - low, abs(fit.mu - mu)))
    coverage, width, error = np.mean(found, axis=0).tolist()
    return coverage, width, error


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=300)
    parser.add_argument("--seed", type=int, default=0, help="of the first set")
    arguments = parser.parse_args()
    seeds = range(arguments.seed, arguments.seed + arguments.sets)
    sys.stdout.write("| step | labels | wrong | coverage | width | error |\n")
    sys.stdout.write("|---|---|---|---|---|---|\n")
    for step in STEPS:
        for n_labels in N_LABELS:
            for wrong in WRONG:
                coverage, width, error = study(step, n_labels, wrong, seeds)
                row = f"{step:g} | {n_labels} | {100 * wrong:g} % | {100 * coverage:.1f} %"
                sys.stdout.write(f"| {row} | {width:.2f} | {error:.3f} |\n")


if __name__ == "__main__":
    main()
