"""A small study, and collecting and training replaced: the studies' tests are about the rest."""

from __future__ import annotations

from pathlib import Path

import pytest

from tacgen.dataset.input_hashes import Inputs
from tests.learning.conftest import (
    collect,
    make_sample,
    make_spec,
    small_backbone,  # noqa: F401
)


def small_study(tmp_path: Path, extra: str = "", quick: str = "{}") -> Path:
    path = tmp_path / "s.yaml"
    path.write_text(
        "name: s\nobjects: [can, cup]\nseeds: 1\n"
        "train: {model: {weights: none}, input: {size_px: [32, 40]}, training: {epochs: 1}}\n"
        f"rows:\n  - {{name: single image, published: {{sim: 0.9}}{extra}}}\n"
        "  - {name: one model for all, train: {per_object: false}}\n"
        f"quick: {quick}\n"
    )
    return path


@pytest.fixture
def toy_collect(monkeypatch):
    """The simulation replaced by synthetic grasps: this is about the study."""
    made: list[Path] = []

    class Nothing:
        @staticmethod
        def summary() -> dict[str, int]:
            return {"not_executed": 4}

    def fake(recipe, out, **_):
        if not (out / "manifest.jsonl").is_file():
            collect(out, make_spec(), make_sample)
            made.append(out)
        return Nothing()

    monkeypatch.setattr("tacgen.study.run.collect", fake)
    monkeypatch.setattr("tacgen.study.run.recipe_inputs", lambda recipe: Inputs())
    return made


@pytest.fixture
def no_networks(monkeypatch, toy_collect):
    """Training and testing replaced too; gives the names of the runs that were trained."""
    trained: list[str] = []

    def train(recipe, data, run, **_):
        trained.append(run.parent.name)
        model = {"weights": "none", "grasps_fit": 20, "grasps_validation": 4}
        return {"models": {"can": model}}

    def evaluate(run, data=None, real=None):
        scores = {"accuracy": 0.9, "accuracy_interval": [0.8, 0.95], "n": 12}
        simulated = real is not None and "world" in real.name
        where = {"data": str(data or real), "real_is_simulated": simulated}
        return {**scores, **where, "by_object": {"can": scores}}

    monkeypatch.setattr("tacgen.study.run.train", train)
    monkeypatch.setattr("tacgen.study.run.evaluate", evaluate)
    return trained
