"""Networks as shipped, tested on another simulation whose camera, lamps and gel they never saw.

``python -m validation.learning.transfer DIR [--recipe train_single] [--seed N] [--workers N]``
collects 192 training grasps of an object and 99 of it on another sensor: other lamps and paint
(``SENSORS``), noise of 2 grey levels, a gain off by 3 %, another k_n and friction, and grasps off
by 1 mm. It is simulation against simulation: both have the same physics engine.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from PIL import Image

import tacgen
from scripts.reference_background import with_reference
from tacgen.contact.gel import gel_map_mm
from tacgen.core.resources import packaged
from tacgen.core.sensors import load_sensor
from tacgen.dataset.export import export_dataset
from tacgen.learning.evaluate import evaluate
from tacgen.learning.train import train
from tacgen.learning.training_recipe import load_train_recipe
from tacgen.optics.table import save_table
from tacgen.optics.virtual_sensor import Paint, VirtualSensor
from validation.optics.sampled_table import sampled_table

NOISE_GREY = 2.0
SENSORS = {
    "near_lamps": (22.0, 1.1, Paint(0.8, 0.2, 15.0), (0.7, 0.8, 0.9), 0.5),
    "far_lamps": (45.0, 1.25, Paint(0.9, 0.0, 6.0), (1.1, 1.0, 0.9), 0.1),
    "warm_lamps": (28.0, 0.95, Paint(0.95, 0.1, 10.0), (1.2, 0.9, 0.7), 0.2),
}
"""Distance of the lamps in mm, gamma, paint, ambient light and glare. The first was looked at while
the input and its augmentation were chosen, the others were not; far lamps make faint imprints."""
WORLDS: dict[str, dict[str, Any]] = {
    "near_lamps": {"object": "tomato_soup_can", "k_n": 5.8, "friction": 0.335, "gain": 1.03},
    "far_lamps": {"object": "sugar_box", "k_n": 4.7, "friction": 0.42, "gain": 0.97},
    "warm_lamps": {"object": "mustard_bottle", "k_n": 5.5, "friction": 0.39, "gain": 1.03},
}
"""The shipped objects have a friction of 0.35, 0.4 and 0.4; the shipped k_n is 5.12 mm³/N."""


def write_sensor(name: str, folder: Path) -> Path:
    """The shipped GelSight with other optics: its YAML file and table."""
    distance_mm, gamma, paint, ambient_rgb, glare = SENSORS[name]
    sensor = load_sensor("gelsight", needs_table=False)
    virtual = replace(
        VirtualSensor.like(sensor, distance_mm=distance_mm, noise_grey=NOISE_GREY),
        gamma=gamma,
        paint=paint,
        ambient_rgb=ambient_rgb,
        glare=glare,
    )
    rest_mm = gel_map_mm(sensor)
    table = replace(sampled_table(virtual, rest_mm, sensor=name), noise_grey=NOISE_GREY)
    table_path = folder / f"{name}.table.npz"
    save_table(with_reference(table, rest_mm, virtual.grey_levels(rest_mm)), table_path)
    described = yaml.safe_load((packaged("recipes") / "sensors" / "gelsight.yaml").read_text())
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({**described, "name": name, "table": table_path.name}))
    return path


def write_recipes(name: str, folder: Path) -> tuple[Path, Path]:
    """The recipe to train on and that to test on, between the same limits on other grids."""
    world = WORLDS[name]
    grid = {
        "force_n": {"geomspace": [2, 20, 16]},
        "y_mm": {"linspace": [-6, 6, 7]},
        "z_mm": {"linspace": [25, 92, 10]},
        "sample": 240,
    }
    common = {
        "frames": {"mode": "sequence", "count": 8},
        "dataset": {"shard_size": 24, "scene_pictures": False},
    }
    own = {
        "name": f"{name}_train",
        "seed": 5,
        "objects": [{"name": world["object"], "grid": grid}],
        "split": {"test_fraction": 0.2},
        **common,
    }
    grid = {**grid, "force_n": {"geomspace": [2, 20, 14]}, "sample": 100}
    other = {
        "name": f"{name}_test",
        "seed": 15,
        "objects": [{"name": world["object"], "friction": world["friction"], "grid": grid}],
        "split": {"test_fraction": 0.99},
        "sensor": write_sensor(name, folder).name,
        "contact": {"k_n_mm3_per_n": world["k_n"]},
        "randomize": {"position_mm": 1.0, "yaw_rad": 0.02},
        **common,
    }
    paths = (folder / f"{name}_train.yaml", folder / f"{name}_test.yaml")
    for path, recipe in zip(paths, (own, other), strict=True):
        path.write_text(yaml.safe_dump(recipe, sort_keys=False))
    return paths


def run(name: str, folder: Path, recipe: str, seed: int, workers: int) -> None:
    """Collect, train and test on one of the sensors; prints a Markdown row."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = write_recipes(name, folder)
    data, other = (folder / path.stem for path in paths)
    for path, out in zip(paths, (data, other), strict=True):
        tacgen.collect(tacgen.load_recipe(path), out, workers=workers)
    real = folder / f"{name}_real"
    if not real.is_dir():
        with TemporaryDirectory(dir=folder) as temporary:
            exported = Path(temporary) / "grasps"
            export_dataset(other, exported, "real-grasps", split="test")
            for picture in exported.rglob("*.png"):
                grey = np.asarray(Image.open(picture)) * WORLDS[name]["gain"]
                Image.fromarray(np.rint(np.clip(grey, 0, 255)).astype(np.uint8)).save(picture)
            exported.rename(real)
    trained = folder / f"{name}_{recipe}_{seed}"
    chosen = load_train_recipe(recipe).model_copy(update={"seed": seed})
    train(chosen, data, trained, workers=1)
    for where, tested in (("data", (data, None)), ("real", (None, real))):
        scores = evaluate(trained, *tested)
        row = (scores[key] for key in ("accuracy", "balanced_accuracy", "auroc"))
        cells = " | ".join(f"{value:.3f}" for value in row)
        print(f"| {recipe} | {seed} | {name} | {where} | {scores['n']} | {cells} |")  # noqa: T201


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--recipe", default="train_single")
    parser.add_argument("--sensors", nargs="*", default=list(SENSORS), choices=list(SENSORS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    for name in options.sensors:
        run(name, options.out, options.recipe, options.seed, options.workers)


if __name__ == "__main__":
    main()
