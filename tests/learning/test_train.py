"""Training: it learns, repeats bit for bit, goes on after a kill, and stops with words."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from tacgen.core.errors import Interrupted, LearningError
from tacgen.learning import fit as fit_module
from tacgen.learning import train as train_module
from tacgen.learning.evaluate import evaluate
from tacgen.learning.loader import Batches
from tacgen.learning.scores import score
from tacgen.learning.train import train
from tests.learning.conftest import (
    REFERENCE,
    SENSOR,
    collect,
    make_sample,
    make_spec,
    recipe_of,
)
from tests.messages import refused

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_backbone")]

FASTER = {"learning_rate": 5e-3, "average_epochs": 3}
"""With these the small backbone learns in a dozen epochs what is to be seen."""
TIMES = {"epoch_s"}


def metrics_of(run: Path, model: str = "pooled") -> list[dict]:
    """The metrics of a run without how long it took."""
    text = (run / "models" / model / "metrics.jsonl").read_text()
    lines = [json.loads(line) for line in text.splitlines()]
    return [{k: v for k, v in line.items() if k not in TIMES} for line in lines]


def assert_same_weights(run: Path, other: Path, model: str = "pooled") -> None:
    one = load_file(run / "models" / model / "model.safetensors")
    two = load_file(other / "models" / model / "model.safetensors")
    assert one.keys() == two.keys()
    for name, value in one.items():
        assert torch.equal(value, two[name]), name
    states = [
        torch.load(folder / "models" / model / "checkpoint.pt", weights_only=True)
        for folder in (run, other)
    ]
    moments = [state["optimizer"]["state"] for state in states]
    assert all(
        torch.equal(moments[0][key][name], moments[1][key][name])
        for key in moments[0]
        for name in ("exp_avg", "exp_avg_sq")
    )


@pytest.fixture(scope="module")
def recipe():
    return recipe_of("sequence", training=FASTER | {"epochs": 3}, augmentation={"on": True})


@pytest.fixture(scope="module")
def trained(toy, recipe, tmp_path_factory) -> Path:
    run = tmp_path_factory.mktemp("runs") / "whole"
    train(recipe, toy, run)
    return run


def test_the_network_learns_what_can_be_seen(trained):
    lines = metrics_of(trained)
    assert [line["epoch"] for line in lines] == [1, 2, 3]
    # Better than guessing, which costs log 2.
    assert lines[-1]["train_loss"] < min(np.log(2), lines[0]["train_loss"])
    assert lines[0]["backbone_rate"] == pytest.approx(0.8 * lines[0]["learning_rate"])


@pytest.mark.parametrize(
    ("balanced_accuracies", "best"),
    [
        # One lucky epoch among bad ones does not win over five good ones, nor does a late fall.
        ((0.5, 1.0, 0.5, 0.9, 0.9, 0.9, 0.9, 0.9, 0.5, 0.5), 8),
        # Of equals the later, which has learnt longer.
        ((0.9,) * 7, 7),
    ],
)
def test_the_best_epoch_is_the_end_of_the_best_five(
    toy, tmp_path, monkeypatch, balanced_accuracies, best
):
    told = iter(balanced_accuracies)

    def scripted(labels, probabilities):
        figures = score(labels, probabilities)
        return figures | {"balanced_accuracy": next(told)}

    monkeypatch.setattr(fit_module, "score", scripted)
    recipe = recipe_of(training={"epochs": len(balanced_accuracies)})
    assert train(recipe, toy, tmp_path / "run")["models"]["pooled"]["best_epoch"] == best


@pytest.mark.parametrize(
    ("average_epochs", "shares"),
    [
        # 2 / (3 + 1) of each epoch after the first.
        (3, (1 / 16, 1 / 16, 1 / 8, 1 / 4, 1 / 2)),
        # Until 1 / epoch falls below 2 / (n + 1) it is the plain mean.
        (100, (0.2,) * 5),
    ],
)
def test_the_kept_model_is_the_mean_of_the_latest_epochs(
    toy, tmp_path, monkeypatch, average_epochs, shares
):
    learnt = []

    class Watched(fit_module.TrainingState):
        def _learn(self, epoch):
            result = super()._learn(epoch)
            learnt.append({k: v.double().clone() for k, v in self.network.state_dict().items()})
            return result

    def always_as_good(labels, probabilities):
        return score(labels, probabilities) | {"balanced_accuracy": 0.9}

    monkeypatch.setattr(train_module, "TrainingState", Watched)
    monkeypatch.setattr(fit_module, "score", always_as_good)
    recipe = recipe_of("single", training={"epochs": 5, "average_epochs": average_epochs})
    assert train(recipe, toy, tmp_path / "run")["models"]["pooled"]["best_epoch"] == 5
    kept = load_file(tmp_path / "run/models/pooled/model.safetensors")
    for name in learnt[0]:
        if kept[name].is_floating_point():
            each = zip(shares, (epoch[name] for epoch in learnt), strict=True)
            wanted = sum(share * weights for share, weights in each)
            # float32 holds 24 bits; four steps round four times.
            torch.testing.assert_close(kept[name].double(), wanted, rtol=1e-6, atol=1e-6)


def test_that_no_imagenet_weights_were_used_is_said_everywhere(toy, tmp_path, capsys):
    recipe = recipe_of(training={"epochs": 1})
    summary = train(recipe, toy, tmp_path / "run")
    assert "NO ImageNet weights" in capsys.readouterr().err
    assert summary["models"]["pooled"]["weights"] == "none"
    assert all(line["weights"] == "none" for line in metrics_of(tmp_path / "run"))
    report = (tmp_path / "run" / "models" / "pooled" / "index.html").read_text()
    assert "NONE, trained from scratch" in report


def test_a_run_leaves_its_log_its_report_and_its_plan(trained):
    assert list((trained / "models" / "pooled" / "tensorboard").glob("events*"))
    assert "data:image/png" in (trained / "models" / "pooled" / "index.html").read_text()
    plan = json.loads((trained / "run.json").read_text())
    assert plan["recipe"]["training"]["threads"] == 1
    assert not set(plan["models"]["pooled"]["fit"]) & set(plan["models"]["pooled"]["validation"])


def test_a_killed_run_goes_on_to_the_same_weights(toy, recipe, trained, tmp_path, monkeypatch):
    """Stopped in the middle of its third epoch."""
    shuffled = Batches.shuffled

    def stopped(self, seed, epoch, augmentation):
        for count, item in enumerate(shuffled(self, seed, epoch, augmentation)):
            if epoch == 3 and count == 2:
                raise Interrupted
            yield item

    run = tmp_path / "killed"
    monkeypatch.setattr(Batches, "shuffled", stopped)
    with pytest.raises(Interrupted):
        train(recipe, toy, run)
    monkeypatch.undo()
    assert len(metrics_of(run)) == 2
    train(recipe, toy, run)
    assert_same_weights(trained, run)
    assert metrics_of(trained) == metrics_of(run)


@pytest.mark.exhaustive
def test_a_kill_between_model_and_checkpoint_does_no_harm(
    toy, recipe, trained, tmp_path, monkeypatch
):
    """The epoch counts as not done and is repeated."""
    save_state = fit_module.save_state

    def stopped(path, state):
        if state["epoch"] == 2:
            raise Interrupted
        save_state(path, state)

    run = tmp_path / "killed"
    monkeypatch.setattr(fit_module, "save_state", stopped)
    with pytest.raises(Interrupted):
        train(recipe, toy, run)
    monkeypatch.undo()
    train(recipe, toy, run)
    assert_same_weights(trained, run)
    assert metrics_of(trained) == metrics_of(run)


def test_torch_is_left_as_it_was_found(toy, tmp_path):
    torch.manual_seed(11)
    expected = torch.rand(1)
    torch.manual_seed(11)
    threads = torch.get_num_threads()
    train(recipe_of(training={"epochs": 1}), toy, tmp_path / "run")
    assert torch.equal(torch.rand(1), expected)
    assert torch.get_num_threads() == threads
    assert not torch.are_deterministic_algorithms_enabled()


def test_the_threads_belong_to_the_run(toy, recipe, trained):
    changed = recipe.model_copy(
        update={"training": recipe.training.model_copy(update={"threads": 2})}
    )
    with refused(LearningError):
        train(changed, toy, trained)


def test_a_folder_with_a_run_of_another_network_is_refused(toy, trained):
    with refused(LearningError):
        train(recipe_of("single", training={"epochs": 3}), toy, trained)


def test_a_checkpoint_of_another_model_is_refused(toy, recipe, trained, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    single = tmp_path / "single"
    train(recipe_of("single", training={"epochs": 1}), toy, single)
    shutil.copy(single / "models/pooled/checkpoint.pt", run / "models/pooled/checkpoint.pt")
    with refused(LearningError):
        train(recipe, toy, run)
    (run / "models/pooled/checkpoint.pt").write_bytes(b"broken")
    with refused(LearningError):
        train(recipe, toy, run)


def test_a_diverging_loss_stops_with_words_and_keeps_the_last_checkpoint(
    toy, tmp_path, monkeypatch
):
    """The rate is normal in the first epoch and absurd from the second on."""
    run_epoch = fit_module.TrainingState._run_epoch

    def wild(self, epoch):
        if epoch == 2:
            for group in self.optimizer.param_groups:
                group["lr"] = 1e6
        return run_epoch(self, epoch)

    monkeypatch.setattr(fit_module.TrainingState, "_run_epoch", wild)
    run = tmp_path / "run"
    with refused(LearningError):
        train(recipe_of(training={"epochs": 4}), toy, run)
    state = torch.load(run / "models/pooled/checkpoint.pt", weights_only=True)
    assert state["epoch"] == 1
    assert all(torch.isfinite(v).all() for v in state["network"].values())
    assert len(metrics_of(run)) == 1


@pytest.mark.exhaustive
def test_images_that_tell_nothing_leave_the_share_of_successes(tmp_path):
    """Four of five grasps hold; every image is noise. All are predicted near 0.8."""

    def blind(index, spec):
        rng = np.random.default_rng(index)
        sample = make_sample(index, spec)
        if sample.label < 0:
            return sample
        label = int(index % 5 > 0)
        mode = "" if label else "translational_slip"
        noise = rng.normal(0, 2, (len(spec.time_s), *SENSOR.shape_px, 3))
        rgb = np.clip(REFERENCE + noise, 0, 255).astype(np.uint8)
        pads = {pad: replace(felt, rgb=rgb) for pad, felt in sample.pads.items()}
        return replace(sample, label=label, failure_mode=mode, pads=pads)

    data = collect(tmp_path / "data", make_spec(160), blind)
    train(recipe_of(training={"epochs": 3}), data, tmp_path / "run")
    result = evaluate(tmp_path / "run", data=data)
    # Weighed classes and no prior gave 0.3; of some 50 grasps chance alone makes 0.06.
    assert result["ece"] < 0.15


def test_one_model_an_object(toy, tmp_path):
    recipe = recipe_of(per_object=True, training={"epochs": 1})
    summary = train(recipe, toy, tmp_path / "run")
    assert {name: model["objects"] for name, model in summary["models"].items()} == {
        "can": ["can"],
        "cup": ["cup"],
    }
