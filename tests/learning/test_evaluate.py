"""Evaluation: the contract's figures, the sim-to-real gap, and what it refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from safetensors import safe_open
from safetensors.torch import save_file

from tacgen.core.errors import LearningError
from tacgen.core.records import Sensor
from tacgen.dataset import Dataset
from tacgen.dataset.export import export_dataset
from tacgen.dataset.input_hashes import Inputs
from tacgen.learning.evaluate import evaluate, new_to_the_network, scores_by_value
from tacgen.learning.grasps import SimulatedGrasps
from tacgen.learning.train import train
from tests.learning.conftest import collect, make_sample, make_spec, recipe_of, write_real
from tests.learning.test_train import FASTER
from tests.messages import refused

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_backbone")]


@pytest.fixture(scope="module")
def single(toy, tmp_path_factory) -> Path:
    run = tmp_path_factory.mktemp("runs") / "single"
    train(recipe_of("single", per_object=True, training=FASTER | {"epochs": 12}), toy, run)
    return run


@pytest.fixture(scope="module")
def sequence(toy, tmp_path_factory) -> Path:
    run = tmp_path_factory.mktemp("runs") / "sequence"
    train(recipe_of("sequence", training=FASTER | {"epochs": 8}), toy, run)
    return run


@pytest.fixture
def run(single, tmp_path) -> Path:
    """A copy that a test may change."""
    return Path(shutil.copytree(single, tmp_path / "run"))


@pytest.fixture
def real(tmp_path) -> Path:
    return write_real(tmp_path / "real")


def test_the_test_grasps_are_judged_and_the_file_keeps_the_contract(run, toy):
    result = evaluate(run, data=toy)
    written = json.loads((run / "eval.json").read_text())
    assert written == json.loads(json.dumps(result))
    assert {"accuracy", "balanced_accuracy", "auroc", "n", "by_object", "source"} <= set(written)
    assert written["source"] == "sim"
    executed_tests = [
        i for i in range(40) if make_sample(i, make_spec()).label >= 0 and is_test_grasp(i)
    ]
    assert written["n"] == len(executed_tests)
    assert set(written["by_object"]) == {"can", "cup"}
    assert sum(part["n"] for part in written["by_object"].values()) == written["n"]
    assert sum(part["n"] for part in written["by_force_n"].values()) == written["n"]
    assert sum(part["n"] for part in written["by_z_mm"].values()) == written["n"]
    # What tells the classes apart here is plain to see; a network that learnt it makes no more
    # than one mistake or two.
    assert written["accuracy"] >= 0.8
    assert written["accuracy_interval"][0] < written["accuracy"] <= written["accuracy_interval"][1]


def is_test_grasp(index: int) -> bool:
    return make_sample(index, make_spec()).split == "test"


def test_the_report_shows_the_scores_and_the_misjudged_grasps(run, toy, tmp_path):
    def swapped(index, spec):
        """Grasps that look one way and end the other: every one is misjudged."""
        sample = make_sample(index, spec)
        if sample.label < 0:
            return sample
        mode = "translational_slip" if sample.label else ""
        return replace(sample, label=1 - sample.label, failure_mode=mode)

    spec = make_spec(recipe_sha256="ef" * 32)
    result = evaluate(run, data=collect(tmp_path / "swapped", spec, swapped))
    assert result["accuracy"] <= 0.2
    assert len(result["misclassified"]) == round((1 - result["accuracy"]) * result["n"])
    page = (run / "index.html").read_text()
    assert f"{len(result['misclassified'])} in all" in page
    assert "likely to succeed" in page
    assert evaluate(run, data=toy)["notes"] == []


def test_real_grasps_are_judged_and_the_gap_is_told(run, toy, real):
    simulated = evaluate(run, data=toy)
    result = evaluate(run, real=real)
    assert result["source"] == "real"
    assert result["n"] == 8
    assert result["accuracy"] >= 0.8
    assert result["sim_to_real_gap"] == pytest.approx(simulated["accuracy"] - result["accuracy"])
    assert json.loads((run / "eval.json").read_text())["source"] == "real"


def test_the_gap_counts_the_objects_that_both_sides_have(run, toy, real):
    simulated = evaluate(run, data=toy)
    table = pd.read_csv(real / "grasps.csv")
    table[table.object == "can"].to_csv(real / "grasps.csv", index=False)
    result = evaluate(run, real=real)
    assert result["gap_objects"] == ["can"]
    expected = simulated["by_object"]["can"]["accuracy"] - result["accuracy"]
    assert result["sim_to_real_gap"] == pytest.approx(expected)


def test_a_moment_of_grasp_that_is_found_in_the_images_is_noted(run, real, tmp_path):
    words = "several images and no moment of grasp"
    assert words in " ".join(evaluate(run, real=real)["notes"])
    single_images = write_real(tmp_path / "single_images", n_frames=1)
    assert words not in " ".join(evaluate(run, real=single_images)["notes"])


def test_without_a_background_the_gel_of_the_training_data_is_taken_and_it_is_said(
    run, tmp_path, capsys
):
    result = evaluate(run, real=write_real(tmp_path / "real", background=False))
    assert result["accuracy"] >= 0.8
    assert "no background.png" in " ".join(result["notes"])
    assert "no background.png" in capsys.readouterr().err


def test_test_grasps_that_were_trained_on_are_refused(run, tmp_path):
    """The same recipe, but another split: what was for training is now for testing."""

    def other_side(index, spec):
        sample = make_sample(index, spec)
        return replace(sample, split="train" if sample.split == "test" else "test")

    data = collect(tmp_path / "data", make_spec(), other_side)
    with refused(LearningError):
        evaluate(run, data=data)


def test_grasps_of_another_dataset_that_were_trained_on_are_left_out(run, toy, tmp_path):
    """Another recipe by its hash, which may differ in the split alone."""
    whole = evaluate(run, data=toy)["n"]

    def all_for_testing(index, spec):
        return replace(make_sample(index, spec), split="test")

    data = collect(tmp_path / "data", make_spec(recipe_sha256="ef" * 32), all_for_testing)
    result = evaluate(run, data=data)
    assert result["n"] == whole
    assert "are not used: a simulated grasp of the same object" in " ".join(result["notes"])


@pytest.mark.exhaustive
def test_training_grasps_are_known_as_real_ones_and_under_another_recipe(run, toy, tmp_path):
    """A line of description changes the recipe's hash, and no grasp."""
    again = collect(tmp_path / "data", make_spec(recipe_sha256="ef" * 32))
    for name, data in (("own", toy), ("again", again)):
        for split in ("train", "test", None):
            export_dataset(data, tmp_path / name / str(split), "real-grasps", split=split)
        with refused(LearningError):
            evaluate(run, real=tmp_path / name / "train")
        tests = evaluate(run, real=tmp_path / name / "test")
        assert tests["real_is_simulated"]
        whole = evaluate(run, real=tmp_path / name / "None")
        assert whole["n"] == tests["n"] == evaluate(run, data=toy)["n"]
        assert "are not used: a simulated grasp of the same object" in " ".join(whole["notes"])


def test_a_run_that_is_not_finished_is_judged_and_it_is_said(run, toy):
    path = run / "models/can/metrics.jsonl"
    path.write_text("".join(line + "\n" for line in path.read_text().splitlines()[:2]))
    notes = evaluate(run, data=toy)["notes"]
    assert notes == ["the model can is NOT trained to its end: 2 of 12 epochs"]


@pytest.mark.parametrize(
    "spoil",
    [
        lambda plan: plan.pop("recipe"),
        lambda plan: plan["recipe"].update(unknown=1),
        lambda plan: plan.update(dataset=[]),
        lambda plan: plan["models"]["can"].pop("configurations"),
    ],
)
def test_a_plan_that_is_not_of_this_version_is_refused(run, toy, spoil):
    plan = json.loads((run / "run.json").read_text())
    spoil(plan)
    (run / "run.json").write_text(json.dumps(plan))
    with refused(LearningError):
        evaluate(run, data=toy)


def test_a_run_of_an_earlier_version_is_tested(run, toy):
    """It says neither what its images were taken with nor how often its grasps held."""
    n = evaluate(run, data=toy)["n"]
    plan = json.loads((run / "run.json").read_text())
    for place, key in (
        (plan, "equal_ranges"),
        (plan, "test_groups"),
        (plan["dataset"], "taken_with"),
    ):
        del place[key]
    (run / "run.json").write_text(json.dumps(plan))
    for path in run.glob("models/*/model.safetensors"):
        with safe_open(path, framework="pt") as file:
            card = json.loads(file.metadata()["tacgen_model"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        del card["prior_logit"]
        save_file(tensors, path, {"tacgen_model": json.dumps(card)})
    assert evaluate(run, data=toy)["n"] == n


def test_images_of_another_size_are_refused(run, real, tmp_path):
    sensor = Sensor("gelsight", height_px=40, width_px=64, mm_per_px=0.3, gel_depth_mm=2.0)

    def cropped(index, spec):
        sample = make_sample(index, spec)
        pads = {k: replace(pad, rgb=pad.rgb[:, :40].copy()) for k, pad in sample.pads.items()}
        return replace(sample, pads=pads)

    spec = make_spec(sensor=sensor, reference_rgb=np.zeros((40, 64, 3), np.uint8))
    with refused(LearningError):
        evaluate(run, data=collect(tmp_path / "data", spec, cropped))
    (real / "background.png").unlink()
    for path in real.glob("images/*/*.png"):
        cv2.imwrite(str(path), np.zeros((24, 32, 3), np.uint8))
    with refused(LearningError):
        evaluate(run, real=real)


def test_grasps_without_images_are_named(run, real):
    shutil.rmtree(real / "images" / "g03")
    with refused(LearningError):
        evaluate(run, real=real)


def test_single_images_are_too_few_for_the_sequence_network(sequence, tmp_path):
    real = write_real(tmp_path / "real", n_frames=1)
    with refused(LearningError):
        evaluate(sequence, real=real)


def test_objects_without_a_model_are_told(run, real):
    table = pd.read_csv(real / "grasps.csv")
    table.loc[table.object == "cup", "object"] = "mug"
    table.to_csv(real / "grasps.csv", index=False)
    result = evaluate(run, real=real)
    assert "no model is for them: mug" in " ".join(result["notes"])
    assert set(result["by_object"]) == {"can"}
    table["object"] = "mug"
    table.to_csv(real / "grasps.csv", index=False)
    with refused(LearningError):
        evaluate(run, real=real)


def test_a_model_that_was_swapped_or_damaged_is_refused(run, sequence, toy):
    mine = run / "models" / "can" / "model.safetensors"
    shutil.copy(run / "models" / "cup" / "model.safetensors", mine)
    with refused(LearningError):
        evaluate(run, data=toy)
    shutil.copy(sequence / "models" / "pooled" / "model.safetensors", mine)
    with refused(LearningError):
        evaluate(run, data=toy)
    with safe_open(mine, framework="pt") as file:
        card = json.loads(file.metadata()["tacgen_model"])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    del card["contrast"]
    save_file(tensors, mine, {"tacgen_model": json.dumps(card)})
    with refused(LearningError):
        evaluate(run, data=toy)
    mine.write_bytes(mine.read_bytes()[:1000])
    with refused(LearningError):
        evaluate(run, data=toy)
    mine.unlink()
    with refused(LearningError):
        evaluate(run, data=toy)


def test_a_folder_that_is_no_run_is_refused(toy, tmp_path, run):
    with refused(LearningError):
        evaluate(tmp_path, data=toy)
    (run / "run.json").write_text("[]")
    with refused(LearningError):
        evaluate(run, data=toy)


def test_either_simulated_or_real_grasps(run, toy, real):
    for given in ({}, {"data": toy, "real": real}):
        with refused(LearningError):
            evaluate(run, **given)


def test_scores_by_value_lose_no_grasp_where_values_differ_by_less_than_their_text():
    """A robot's own reading of the height is never twice the same."""
    heights_mm = 20 + 1e-6 * np.arange(40)
    labels = np.arange(40) % 2
    parts = scores_by_value(heights_mm, labels, labels * 0.8 + 0.1)
    assert sum(part["n"] for part in parts.values()) == 40
    assert len(parts) == 4


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("sensor", {"inputs": Inputs({"sensor": "another", "table": "one"})}),
        pytest.param(
            "table",
            {"inputs": Inputs({"sensor": "one", "table": "another"})},
            marks=pytest.mark.exhaustive,
        ),
        pytest.param(
            "markers",
            {"recipe": {"optics": {"markers": True}, "objects": ["can", "cup"]}},
            marks=pytest.mark.exhaustive,
        ),
        ("pad", {"pads": ("right",)}),
    ],
)
def test_images_taken_in_another_way_are_refused_or_named(tmp_path, name, changes, single):
    """Of equal size, and all else the same."""
    recipe = {"optics": {"markers": False}, "objects": ["can", "cup"]}
    usual = {"inputs": Inputs({"sensor": "one", "table": "one"}), "recipe": recipe}
    run, data, other = tmp_path / "run", tmp_path / "data", tmp_path / "other"
    collect(data, make_spec(**usual))
    collect(other, make_spec(**(usual | changes)))
    shutil.copytree(single, run)
    plan = json.loads((run / "run.json").read_text())
    plan["dataset"]["taken_with"] = Dataset(data).taken_with()
    (run / "run.json").write_text(json.dumps(plan))
    assert not evaluate(run, data=data)["notes"]
    with refused(LearningError):
        evaluate(run, data=other)
    with refused(LearningError):
        evaluate(run, data=other, across=["sensors"])
    accepted = evaluate(run, data=other, across=[name])
    assert f"ACROSS {name}" in " ".join(accepted["notes"])
    export_dataset(other, tmp_path / "real", "real-grasps", split="test")
    assert f"ACROSS {name}" in " ".join(evaluate(run, real=tmp_path / "real")["notes"])


def test_sequences_over_another_time_are_refused(sequence, single, tmp_path):
    data = collect(tmp_path / "data", make_spec(time_s=(0.0, 0.2, 0.4)))
    with refused(LearningError):
        evaluate(sequence, data=data)
    assert evaluate(single, data=data)["notes"] == []


def test_what_the_training_never_had_is_named(single, toy, tmp_path):
    """Another engine, other friction of one object and forces far above the training's."""
    plan = json.loads((single / "run.json").read_text())
    assert new_to_the_network(plan, SimulatedGrasps(toy), "toy") == []
    trained = {"physics": {"engine": "pybullet"}, "objects": {"can": {"friction": 0.3}}}
    plan["dataset"]["taken_with"]["world"] = trained

    def firmer(index, spec):
        sample = make_sample(index, spec)
        force_n = 40.0 if sample.config.object == "can" else sample.config.force_n
        return replace(sample, config=replace(sample.config, force_n=force_n))

    source = SimulatedGrasps(collect(tmp_path / "data", make_spec(), firmer))
    objects = {"can": {"friction": 0.5}, "cup": {"friction": 0.2}}
    source.taken_with = {"world": {"physics": {"engine": "mujoco"}, "objects": objects}}
    n_cans = (source.table.objects == "can").sum()
    (note,) = new_to_the_network(plan, source, "data")
    assert note == (
        'data: NEW to the network: physics.engine: "pybullet" there, "mujoco" now; '
        "objects.can.friction: 0.3 there, 0.5 now; "
        f"{n_cans} of {n_cans} forces of can, outside of 4 to 10 N"
    )


def test_one_network_for_all_objects_is_tested_on_new_ones_alone(sequence, single, tmp_path):
    recipe = {"name": "toy", "seed": 3, "objects": ["mug", "jar"]}
    data = collect(tmp_path / "data", make_spec(recipe=recipe))
    result = evaluate(sequence, data=data)
    assert set(result["by_object"]) == {"jar", "mug"}
    assert "NEW to the network: the object jar; the object mug" in " ".join(result["notes"])
    assert result["without_touch"]["n"] == result["n"]
    with refused(LearningError):
        evaluate(single, data=data)


def test_networks_are_compared_with_what_was_commanded_on_the_same_grasps(run, toy):
    result = evaluate(run, data=toy)
    baseline = result["without_touch"]
    assert baseline["n"] == result["n"]
    assert baseline["gain"] == pytest.approx(result["accuracy"] - baseline["accuracy"])
    assert baseline["gain_interval"][0] < baseline["gain"] < baseline["gain_interval"][1]
    plan = json.loads((run / "run.json").read_text())
    for model in plan["models"].values():
        del model["labels"]  # of an earlier version
    (run / "run.json").write_text(json.dumps(plan))
    assert "without_touch" not in evaluate(run, data=toy)
