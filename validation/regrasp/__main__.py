"""The study of regrasping by touch against no touch, chance and an oracle.

``python -m validation.regrasp RUN RECIPE --out DIR [--regrasps N] [--episodes N] [--worlds N]
[--drop-cost C] [--regrasp-cost C] [--seed N] [--workers N]`` plays every policy on the episodes of
``tacgen regrasp``, whose finished worlds it uses where DIR has them, prints a line a policy, and
writes ``study.json`` and ``index.html``.
"""

import argparse
from pathlib import Path

from tacgen.collection.recipe import load_recipe
from tacgen.envs.regrasp import Costs, Play
from validation.regrasp.page import study_lines, write_study_page
from validation.regrasp.study import PAGE, study


def main() -> None:
    """Run the study from the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("recipe")
    parser.add_argument("--out", type=Path, required=True)
    counts = {"regrasps": 3, "episodes": 40, "worlds": 32, "workers": 1, "seed": None}
    for name, default in counts.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--drop-cost", type=float, default=1.0)
    parser.add_argument("--regrasp-cost", type=float, default=0.1)
    given = parser.parse_args()
    costs = Costs(given.drop_cost, given.regrasp_cost)
    play = Play(costs, given.regrasps, given.episodes, given.worlds, given.seed)
    recipe = load_recipe(given.recipe)
    result, played = study(given.run, recipe, given.out, play, workers=given.workers)
    write_study_page(given.out / PAGE, result, played)
    print("\n".join(study_lines(result)))  # noqa: T201


if __name__ == "__main__":
    main()
