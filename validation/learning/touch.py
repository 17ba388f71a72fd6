"""What marker motion and force field, or a camera, add to the image, in both engines.

``python -m validation.learning.touch DIR [--vision] [--engines NAME…] [--grasps N] [--seeds N]
[--epochs N] [--kind KIND]``
collects the same grasps of two objects in PyBullet and in MuJoCo, trains one network on those of
PyBullet with each set of channels, from scratch, and tests it on the test grasps of both engines.
It prints a Markdown table: the mean accuracy over the seeds with the standard error of one test
set, and of the difference to the image alone, paired by grasp, with its 95 % interval from
resampling the grasps. What is there already is used again. With ``--vision`` the sets are touch,
vision (a camera of 96 × 128 px some 500 mm away) and both.

With 143 training and 116 test grasps and two seeds no channel adds anything that this many grasps
can tell: +1.3 [−1.3, +3.9] % at most, in either engine.

With ``--vision --engines pybullet --grasps 100 --seeds 2 --epochs 10`` (110 training and 90 test
grasps): touch 70.0 ± 4.4 %, vision alone 47.8 ± 4.1, no better than guessing, for it does not show
the force; both 78.9 ± 4.1, which is 8.9 [3.3, 15.0] more than touch: the camera shows where the
object is held. The interval is over grasps; two seeds say little of the spread over seeds.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

import tacgen
from tacgen.learning.evaluate import evaluate
from tacgen.learning.grasps import SimulatedGrasps
from tacgen.learning.run_folder import RunFolder
from tacgen.learning.splits import unseen_tests
from tacgen.learning.train import train
from tacgen.learning.training_recipe import load_train_recipe

ENGINES = ("pybullet", "mujoco")
CHANNELS: tuple[tuple[str, ...], ...] = (
    ("image",),
    ("image", "markers"),
    ("image", "force_field"),
    ("image", "markers", "force_field"),
)
WITH_VISION: tuple[tuple[str, ...], ...] = (("image",), ("vision",), ("image", "vision"))
CAMERA = {"name": "front", "look_at": {"from_mm": [330, -330, 220], "to_mm": [0, 0, 60]}}
RESAMPLES = 4000
UNKNOWN = {"friction_relative": 0.2, "mass_relative": 0.3}
"""What each grasp draws anew: neither force and place nor the imprint of a gel at rest tell it."""
INPUTS: dict[str, dict[str, Any]] = {
    "single": {"size_px": [32, 42]},
    "sequence": {"size_px": [32, 42], "frames": 3, "until": "outcome"},
}
"""The moment of grasp, before the gel carries the object; or three frames until some 0.2 s after
the start of the lift, when it does, but has risen a few mm. Small, for minutes on one core: at the
recipes' 60 × 80 px the images tell more."""
GRASPS = {
    "tomato_soup_can": {
        "force_n": {"geomspace": [2, 20, 12]},
        "y_mm": {"linspace": [-6, 6, 5]},
        "z_mm": {"linspace": [25, 92, 12]},
    },
    "rubiks_cube": {
        "force_n": {"geomspace": [1, 20, 12]},
        "y_mm": {"linspace": [-18, 18, 5]},
        "z_mm": {"linspace": [16, 40, 12]},
    },
}


def collect(engine: str, root: Path, n_grasps: int, *, vision: bool) -> Path:
    """The dataset of an engine, ``n_grasps`` of each object, with all channels."""
    beside = {"dataset": {"markers": True, "force_field": [9, 12]}}
    if vision:
        beside = {"dataset": {}, "scene": {"cameras": [CAMERA], "frames": "all"}}
    recipe: dict[str, Any] = {
        "name": f"touch_{engine}",
        "seed": 23,
        "objects": [
            {"name": name, "grid": {**grid, "sample": n_grasps}} for name, grid in GRASPS.items()
        ],
        "split": {"test_fraction": 0.45},
        "physics": {"engine": engine},
        "frames": {"mode": "sequence", "count": 5, "span_s": 0.8},
        "randomize": UNKNOWN,
        **beside,
        "dataset": {"shard_size": 40, "scene_pictures": False, **beside["dataset"]},
    }
    path = root / f"{engine}.yaml"
    path.write_text(yaml.safe_dump(recipe))
    tacgen.collect(tacgen.load_recipe(path), root / engine)
    return root / engine


def trained(
    data: Path, root: Path, channels: tuple[str, ...], seed: int, epochs: int, kind: str
) -> Path:
    """A run on ``data`` with these channels, all objects together."""
    out = root / "runs" / f"{kind}-{'-'.join(channels)}-{seed}"
    recipe = {
        "name": out.name,
        "seed": seed,
        "per_object": False,
        "model": {"kind": kind, "weights": "none"},
        "input": {**INPUTS[kind], "channels": list(channels)},
        "augmentation": {"on": True},
        "training": {"epochs": epochs},
    }
    path = root / f"{out.name}.yaml"
    path.write_text(yaml.safe_dump(recipe))
    train(load_train_recipe(path), data, out)
    return out


def right(run: Path, data: Path) -> NDArray[np.bool_]:
    """Which test grasps of ``data`` the run classifies right, in the order of their indices."""
    source = SimulatedGrasps(data)
    unseen, _ = unseen_tests(RunFolder(run).plan(), source, str(data))
    wrong = [one["grasp_id"] for one in evaluate(run, data)["misclassified"]]
    return ~np.isin(source.table.ids[unseen], wrong)


def row(
    found: dict[str, list[NDArray[np.bool_]]], plain: dict[str, list[NDArray[np.bool_]]]
) -> str:
    """Accuracy in each engine, and how much more than that of the image alone."""
    cells = []
    for engine in found:
        own, image = np.mean(found[engine], axis=0), np.mean(plain[engine], axis=0)
        rng = np.random.default_rng(0)
        picks = rng.integers(0, len(own), (RESAMPLES, len(own)))
        low, high = np.quantile((own - image)[picks].mean(axis=1), [0.025, 0.975])
        error = own.std() / np.sqrt(len(own))
        cells.append(f"{100 * own.mean():.1f} ± {100 * error:.1f}")
        cells.append(
            "–"
            if found is plain
            else f"{100 * (own - image).mean():+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]"
        )
    return " | ".join(cells)


def main() -> None:
    """Collect, train, test and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path)
    parser.add_argument("--grasps", type=int, default=130)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--epochs", type=int, default=12)
    parser.add_argument("--kind", choices=("single", "sequence"), default="single")
    parser.add_argument("--collect-only", choices=ENGINES)
    parser.add_argument("--engines", nargs="+", choices=ENGINES, default=ENGINES)
    parser.add_argument("--vision", action="store_true")
    asked = parser.parse_args()
    asked.root.mkdir(parents=True, exist_ok=True)
    engines = (asked.collect_only,) if asked.collect_only else asked.engines
    data = {
        engine: collect(engine, asked.root, asked.grasps, vision=asked.vision) for engine in engines
    }
    if asked.collect_only:
        return
    results: dict[str, dict[str, list[NDArray[np.bool_]]]] = {}
    for channels in WITH_VISION if asked.vision else CHANNELS:
        runs = [
            trained(data[engines[0]], asked.root, channels, seed, asked.epochs, asked.kind)
            for seed in range(asked.seeds)
        ]
        results[", ".join(channels)] = {e: [right(run, data[e]) for run in runs] for e in engines}
    listed = {n: {e: np.stack(v).tolist() for e, v in of.items()} for n, of in results.items()}
    (asked.root / f"right_{asked.kind}.json").write_text(json.dumps(listed))
    head = "".join(f" {engine}, % | more |" for engine in engines)
    print(f"| channels |{head}\n|---|{2 * len(engines) * '---|'}")  # noqa: T201
    for name, found in results.items():
        print(f"| {name} | {row(found, results['image'])} |")  # noqa: T201


if __name__ == "__main__":
    main()
