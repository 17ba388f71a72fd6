"""Going on with a training: only with what it began with, and never two at a time."""

import shutil
from pathlib import Path

import pytest
import torch

from tacgen.core.errors import LearningError
from tacgen.learning import fit as fit_module
from tacgen.learning.run_folder import ModelFolder
from tacgen.learning.train import train
from tests.learning.conftest import recipe_of
from tests.learning.test_train import metrics_of
from tests.messages import refused

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_backbone")]


@pytest.fixture(scope="module")
def begun(toy, tmp_path_factory) -> Path:
    """Two of three epochs are done."""
    run = tmp_path_factory.mktemp("runs") / "begun"
    save_state = fit_module.save_state

    def stopped(path, state):
        save_state(path, state)
        if state["epoch"] == 2:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fit_module, "save_state", stopped)
        with pytest.raises(KeyboardInterrupt):
            go_on(toy, run)
    return run


@pytest.fixture
def run(begun, tmp_path) -> Path:
    return Path(shutil.copytree(begun, tmp_path / "run"))


def go_on(toy, run) -> None:
    train(recipe_of("single", training={"epochs": 3}), toy, run)


def change(run: Path, change_state) -> None:
    path = run / "models/pooled/checkpoint.pt"
    state = torch.load(path, weights_only=True)
    change_state(state)
    torch.save(state, path)


def test_the_name_of_the_pretrained_weights_is_kept_and_not_looked_up_again(toy, run):
    """The weights may lie on the disk now that did not when the training began, or no longer."""
    change(run, lambda state: state.update(pretrained="imagenet (there before)"))
    go_on(toy, run)
    origins = [line["weights"] for line in metrics_of(run)]
    assert origins == ["none", "none", "imagenet (there before)"]


def test_two_processes_do_not_train_one_model(toy, run):
    folder = ModelFolder(run / "models/pooled")
    with (
        folder.locked(),
        refused(LearningError, hide=r"(?<=process )\d+ on \S+"),
    ):
        go_on(toy, run)
    go_on(toy, run)
    assert len(metrics_of(run)) == 3


def test_a_worker_whose_parent_was_killed_ends_after_its_epoch(toy, run, monkeypatch):
    class Gone:
        def is_alive(self):
            return False

    monkeypatch.setattr(fit_module.multiprocessing, "parent_process", Gone)
    with refused(LearningError):
        go_on(toy, run)
    monkeypatch.undo()
    assert len(metrics_of(run)) == 2
    go_on(toy, run)
    assert len(metrics_of(run)) == 3
