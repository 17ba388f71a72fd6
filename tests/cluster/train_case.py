"""A small dataset, and the command that trains a network on it."""

from pathlib import Path

import yaml

from tests.learning.conftest import collect, make_spec, recipe_of

EPOCHS = 6


def write_train_case(folder: Path) -> list[str]:
    """The dataset and the recipe in ``folder``, and what to type after ``tacgen``."""
    collect(folder / "data", make_spec(n_grasps=24))
    recipe = recipe_of(training={"epochs": EPOCHS})
    text = yaml.safe_dump(recipe.model_dump(mode="json", exclude_unset=True), sort_keys=False)
    (folder / "train.yaml").write_text(text)
    return ["train", "train.yaml", "--data", "data", "--out", "run"]
