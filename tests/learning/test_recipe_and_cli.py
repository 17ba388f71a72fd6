"""Training recipes and the two commands, as a user meets them."""

import json
import sys

import pytest
import yaml

from tacgen import cli
from tacgen.core import errors
from tacgen.core.errors import TacgenError
from tacgen.core.resources import packaged
from tacgen.learning.training_recipe import load_train_recipe
from tests.learning.conftest import recipe_of, write_real
from tests.messages import refused

SHIPPED = sorted(packaged("recipes").glob("train*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_training_recipe_loads_under_its_own_name(path):
    recipe = load_train_recipe(path.stem)
    assert recipe.name == path.stem
    rate = 5e-4 if path.stem == "train_regrasp" else 1e-4  # from scratch, in ten epochs
    assert (recipe.training.learning_rate, recipe.training.backbone_rate_factor) == (rate, 0.8)


def test_every_mistake_is_told_at_once_with_its_line(tmp_path):
    path = tmp_path / "r.yaml"
    path.write_text(
        "name: r\nmodel: {kind: pair}\ntraining:\n  epoch: 3\n  batch_size: 1\n"
        "input: {size_px: [8, 8]}\n"
    )
    with refused(TacgenError):
        load_train_recipe(path)


@pytest.mark.parametrize(
    "text",
    [
        "grid: {sample: 3}\n",
        "objects: [can, can]\n",
        "input: {image: raw, normalised: true}\n",
        "input: {frames: 4}\n",
    ],
)
def test_a_recipe_that_cannot_be_meant_is_refused(tmp_path, text):
    path = tmp_path / "r.yaml"
    path.write_text(f"name: r\n{text}")
    with refused(TacgenError):
        load_train_recipe(path)


def run_cli(monkeypatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["tacgen", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code or 0)


@pytest.mark.slow
def test_from_a_dataset_to_the_gap_on_the_command_line(toy, tmp_path, monkeypatch, capsys):
    recipe, run = tmp_path / "toy.yaml", tmp_path / "run"
    recipe.write_text(yaml.safe_dump(recipe_of(training={"epochs": 1}).resolved()))
    assert run_cli(monkeypatch, "train", recipe, "--data", toy, "--out", run) == 0
    assert "pre-trained weights: none" in capsys.readouterr().out
    assert run_cli(monkeypatch, "eval", run, "--data", toy, "--json") == 0
    simulated = json.loads(capsys.readouterr().out)
    assert simulated == json.loads((run / "eval.json").read_text())
    real = write_real(tmp_path / "real")
    assert run_cli(monkeypatch, "eval", run, "--real", real) == 0
    said = capsys.readouterr().out
    assert "sim-to-real gap" in said
    assert "pre-trained weights: NONE, trained from scratch" in said


def test_a_missing_extra_is_named_with_its_fix(monkeypatch, capsys, tmp_path):
    present = errors.find_spec
    monkeypatch.setattr(
        errors,
        "find_spec",
        lambda name: None if name in ("torch", "sklearn") else present(name),
    )
    assert run_cli(monkeypatch, "eval", tmp_path, "--data", tmp_path) == 2
    said = capsys.readouterr().err
    assert "torch, sklearn" in said
    assert "pip install 'tacgen[learn]'" in said
