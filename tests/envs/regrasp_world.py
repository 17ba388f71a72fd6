"""A recipe and a tiny network for ``tacgen regrasp``, for tests of it and of its study."""

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import collect
from tacgen.envs.regrasp import Play
from tacgen.learning.train import train
from tacgen.learning.training_recipe import TrainRecipe
from tests.small_world import write_world

SECTIONS = {
    "sensor": "recipes/sensors/coarse.yaml",
    "grid": "{force_n: 22, y_mm: [-24, -8, 8, 24], z_mm: 90}",
    "frames": "{mode: sequence, count: 3, span_s: 0.9}",
    "dataset": "{shard_size: 4, markers: true, scene_pictures: false}",
    "randomize": "{center_of_mass_mm: 15, friction_relative: 0.3}",
}
NETWORK = {
    "name": "tiny",
    "model": {"kind": "sequence", "weights": "none"},
    "input": {
        "size_px": [32, 32],
        "channels": ["image", "markers"],
        "frames": 2,
        "until": "outcome",
    },
    "training": {"epochs": 1, "batch_size": 2},
}
FEW = Play(regrasps=2, episodes=3, worlds=3)


@cache
def regrasp_world() -> Path:
    """A folder with a recipe and a network that was trained on 16 grasps of it, for the process."""
    folder = Path(tempfile.mkdtemp(prefix="tacgen-regrasp-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    recipe = write_world(folder, **SECTIONS)
    more = {"grid": "{force_n: [10, 40], y_mm: {linspace: [-28, 28, 8]}, z_mm: 90}", "seed": "6"}
    training = write_world(folder / "training", **(SECTIONS | more))
    collect(load_recipe(training), folder / "data", workers=2)
    train(TrainRecipe.model_validate(NETWORK), folder / "data", folder / "run")
    assert recipe.name == "small.yaml"
    return folder
