"""How many grasps an accuracy needs where they are drawn at random, and near the border.

``python -m validation.collection.border DIR [--seeds N] [--objects NAME …]`` simulates a grid of
force × place × height of each object once, without images (``DIR/<object>.csv``; it resumes). A
third of a grid, drawn at random, is for tests; the rest is what both samplings take from. Three
classifiers of the commanded parameters learn from what they took: the trees of ``tacgen eval
--baseline parameters``, support vectors and a small network. Written are ``border.json`` and
``border.png``: accuracy against the number of grasps, and what part of the random grasps the others
need for the same accuracy.

The method was chosen on sugar_box; the objects below are four others.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.neural_network import MLPClassifier
from sklearn.svm import SVC

from tacgen.collection.border import choose_near_border
from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe
from tacgen.core.files import atomic_path, write_text
from tacgen.core.processes import map_in_processes
from tacgen.core.progress import print_status
from tacgen.learning.parameter_baseline import forest
from tacgen.report.figures import ACCENT, MUTED, new_figure

OBJECTS = ("tomato_soup_can", "cup", "rubiks_cube", "strawberry")
GRIDS: dict[str, dict[str, Any]] = {
    "tomato_soup_can": {"force_n": [2, 20], "y_mm": [-6, 6, 9], "z_mm": [25, 92, 8]},
    "cup": {"force_n": [1, 12], "y_mm": [-10, 10, 9], "z_mm": [20, 62, 8]},
    "rubiks_cube": {"force_n": [1, 20], "y_mm": [-18, 18, 9], "z_mm": [16, 40, 8]},
    "strawberry": {"force_n": [0.1, 4], "y_mm": [-10, 16, 9], "z_mm": [16, 38, 8]},
    "sugar_box": {"force_n": [2.5, 25], "y_mm": [-15, 15, 9], "z_mm": [60, 150, 8]},
    "spatula": {"force_n": [1, 25], "y_mm": [-140, -27, 12], "z_mm": [14, 22, 6]},
}
"""First and last value of each axis and how many there are; 14 forces, by equal factors."""
N_FORCES = 14
ALL = "mean of the objects"
AXES = ("force_n", "y_mm", "z_mm")
TEST_PART = 3  # one of so many grasps of the grid
COUNTS = (30, 50, 70, 90, 130, 170, 230, 310)
BATCH = 20  # grasps chosen at a time, as `tacgen grid --near-border` does
READ_AT = (170, 310)
"""Numbers of random grasps whose accuracy the others are to reach."""
RESAMPLINGS, INTERVAL = 2000, (2.5, 97.5)


def simulated(name: str, folder: Path) -> pd.DataFrame:
    """The grid of an object with the ``label`` of each grasp, simulated or as it is there."""
    path = folder / f"{name}.csv"
    if not path.is_file():
        grid = {axis: {"linspace": ends} for axis, ends in GRIDS[name].items()}
        grid["force_n"] = {"geomspace": [*GRIDS[name]["force_n"], N_FORCES]}
        recipe = Recipe.model_validate({"name": name, "objects": [name], "grid": grid})
        with GraspPipeline(recipe) as pipeline:
            traces = [pipeline.simulate(planned).trace for planned in plan_recipe(recipe)]
        rows = [
            {axis: getattr(t.config, axis) for axis in AXES} | {"label": t.label} for t in traces
        ]
        with atomic_path(path) as partial_file:
            pd.DataFrame(rows).to_csv(partial_file, index=False)
    return pd.read_csv(path)


def accuracies(name: str, seed: int, folder: Path) -> dict[str, dict[str, list[float]]]:
    """Accuracy on the test grasps by sampling and classifier, for each of ``COUNTS``."""
    table = simulated(name, folder)
    label = table["label"].to_numpy()
    places = np.stack([table[axis].rank(method="dense").to_numpy() - 1 for axis in AXES], axis=1)
    places /= np.maximum(places.max(axis=0), 1)
    drawn = np.random.default_rng(seed).permutation(len(table))
    n_test = len(table) // TEST_PART
    test, pool = drawn[:n_test], drawn[n_test:]
    test = test[label[test] >= 0]
    found: dict[str, dict[str, list[float]]] = {}
    for sampling in ("random", "adaptive"):
        taken = pool[: COUNTS[0]]
        scores = found.setdefault(sampling, {})
        for count in COUNTS:
            while len(taken) < count:
                left = pool[~np.isin(pool, taken)]
                if sampling == "adaptive":
                    left = left[
                        choose_near_border(places[taken], label[taken], places[left], BATCH)
                    ]
                taken = np.concatenate([taken, left[:BATCH]])
            for kind, score in _scores(places, label, taken[label[taken] >= 0], test).items():
                scores.setdefault(kind, []).append(score)
    return found


def _scores(
    places: NDArray[np.float64], label: NDArray[np.int64], taken: Any, test: Any
) -> dict[str, float]:
    models = {
        "trees": forest(),
        "support vectors": SVC(C=1000, gamma=2.0),
        "network": MLPClassifier((32, 32), solver="lbfgs", max_iter=300, random_state=0),
    }
    x, y = places[taken], label[taken]
    if len(np.unique(y)) < 2:
        return dict.fromkeys(models, float(np.mean(label[test] == y[0])))
    return {
        kind: float(model.fit(x, y).score(places[test], label[test]))
        for kind, model in models.items()
    }


def share_needed(random: NDArray[np.float64], adaptive: NDArray[np.float64], count: int) -> float:
    """Grasps that ``adaptive`` needs for the accuracy of so many at random, over their number.

    Both are mean accuracies at ``COUNTS``, between which they run straight; NaN where it is not
    reached.
    """
    wanted = float(np.interp(count, COUNTS, random))
    reached = np.flatnonzero(adaptive >= wanted)
    if not len(reached):
        return float("nan")
    k = int(reached[0])
    if k == 0:
        return COUNTS[0] / count
    rise = (wanted - adaptive[k - 1]) / (adaptive[k] - adaptive[k - 1])
    return float(COUNTS[k - 1] + rise * (COUNTS[k] - COUNTS[k - 1])) / count


def mean_of(of_objects: Sequence[dict[str, dict[str, list[float]]]]) -> dict[str, Any]:
    """The mean accuracies over objects."""
    return {
        sampling: {
            kind: np.mean([one[sampling][kind] for one in of_objects], axis=0).tolist()
            for kind in kinds
        }
        for sampling, kinds in of_objects[0].items()
    }


def summary(of_seeds: list[dict[str, dict[str, list[float]]]]) -> dict[str, Any]:
    """Means, their standard errors and the share of grasps that is needed, with intervals."""
    rng = np.random.default_rng(0)
    found: dict[str, Any] = {}
    for kind in of_seeds[0]["random"]:
        curves = {s: np.array([one[s][kind] for one in of_seeds]) for s in ("random", "adaptive")}
        one: dict[str, Any] = {}
        for sampling, values in curves.items():
            one[sampling] = {
                "mean": values.mean(axis=0).round(4).tolist(),
                "stderr": (values.std(axis=0, ddof=1) / len(values) ** 0.5).round(4).tolist(),
            }
        draws = rng.integers(len(of_seeds), size=(RESAMPLINGS, len(of_seeds)))
        for count in READ_AT:
            again = [
                share_needed(curves["random"][d].mean(0), curves["adaptive"][d].mean(0), count)
                for d in draws
            ]
            again = np.nan_to_num(again, nan=np.inf).tolist()
            ends = np.percentile(again, INTERVAL, method="nearest")
            means = [curves[s].mean(axis=0) for s in ("random", "adaptive")]
            share = share_needed(means[0], means[1], count)
            one[f"share_of_{count}"] = {
                "share": None if np.isnan(share) else round(share, 3),
                "interval": [round(float(end), 3) if np.isfinite(end) else None for end in ends],
            }
        found[kind] = one
    return found


def draw(found: Mapping[str, Any], path: Path) -> None:
    """Write the curves: an object a row, a classifier a column."""
    kinds = list(next(iter(found.values())))
    figure, axes = new_figure(3.4 * len(kinds), 2.4 * len(found), len(found), len(kinds))
    for row, (name, of_kind) in zip(axes, found.items(), strict=True):
        for ax, kind in zip(row, kinds, strict=True):
            for sampling, color in (("random", MUTED), ("adaptive", ACCENT)):
                mean, error = (np.array(of_kind[kind][sampling][k]) for k in ("mean", "stderr"))
                ax.plot(COUNTS, mean, ".-", color=color, label=sampling)
                low, high = mean - 1.96 * error, mean + 1.96 * error
                ax.fill_between(COUNTS, low, high, color=color, alpha=0.2, lw=0)
            ax.set_title(f"{name}, {kind}", fontsize=9)
            ax.set_xlabel("training grasps", fontsize=9)
            ax.set_ylabel("accuracy", fontsize=9)
    axes[0, 0].legend(frameon=False, fontsize=9)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Simulate what is missing, learn, and write the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--objects", nargs="+", default=OBJECTS, choices=GRIDS)
    options = parser.parse_args()
    folder, names = options.folder, options.objects
    folder.mkdir(parents=True, exist_ok=True)
    map_in_processes(partial(simulated, folder=folder), names, method="spawn")
    found: dict[str, Any] = {}
    scores: dict[str, list[Any]] = {}
    for name in [*names, ALL]:
        if name == ALL:
            scores[ALL] = [mean_of(of_objects) for of_objects in zip(*scores.values(), strict=True)]
        else:
            one = partial(accuracies, name, folder=folder)
            scores[name] = map_in_processes(one, range(options.seeds), method="spawn")
        found[name] = summary(scores[name])
        shares = {k: [v[f"share_of_{n}"] for n in READ_AT] for k, v in found[name].items()}
        print_status(f"{name} {json.dumps(shares)}")
    record = {"counts": COUNTS, "seeds": options.seeds, "objects": found}
    write_text(folder / "border.json", json.dumps(record, indent=1) + "\n")
    draw(found, folder / "border.png")


if __name__ == "__main__":
    main()
