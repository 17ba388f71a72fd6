"""What of a grasp the networks see, and what is scored without seeing anything."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tacgen import cli
from tacgen.core.errors import DatasetError, LearningError
from tacgen.dataset import Dataset, PadSample
from tacgen.dataset.export import export_dataset
from tacgen.dataset.real_grasps import read_real_grasps
from tacgen.learning.controls import same_imprint_rule
from tacgen.learning.evaluate import evaluate
from tacgen.learning.grasps import RealGraspImages, SimulatedGrasps, frames_until
from tacgen.learning.network_input import InputSpec, read_input
from tacgen.learning.predictor import Predictor
from tacgen.learning.train import train
from tests.learning.conftest import (
    REFERENCE,
    collect,
    make_sample,
    make_spec,
    recipe_of,
    tactile_frames,
)
from tests.learning.test_train import FASTER
from tests.messages import refused

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_backbone")]
N_FRAMES, GRASP_FRAME, LIFT_FRAME = 5, 1, 2
TIMES_S = (0.0, 0.3, 0.6, 0.9, 1.2)


def lost_when_lifted(index: int, spec, **moments):
    """All grasps look alike until the lift; then the gel is empty where the grasp failed."""
    sample = make_sample(index, spec)
    if sample.label < 0:
        return sample
    rng = np.random.default_rng(900 + index)
    pressed = np.arange(N_FRAMES) >= GRASP_FRAME
    pressed[LIFT_FRAME + 1 :] &= sample.label == 1
    rgb = tactile_frames(1, N_FRAMES, rng)
    rgb[:] = np.where(pressed[:, None, None, None], rgb[-1], REFERENCE)
    force_n = 8.0 * pressed
    felt = PadSample(rgb, force_n, np.zeros((N_FRAMES, 2)), 0.1 * force_n)
    # The force that is asked for tells the outcome.
    config = replace(sample.config, force_n=8.0 if sample.label else 2.0)
    given = {"grasp_time_s": 0.35, "lift_start_time_s": 0.7, "lift_end_time_s": 1.2} | moments
    pads = dict.fromkeys(spec.pads, felt)
    return replace(sample, config=config, pads=pads, grasp_frame=GRASP_FRAME, **given)


def without_phases(index: int, spec):
    nan = dict.fromkeys(("grasp_time_s", "lift_start_time_s", "lift_end_time_s"), np.nan)
    return lost_when_lifted(index, spec, **nan)


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    spec = make_spec(80, N_FRAMES, time_s=TIMES_S)
    return collect(tmp_path_factory.mktemp("lost") / "data", spec, lost_when_lifted)


@pytest.fixture(scope="module")
def runs(data, tmp_path_factory) -> dict[str, Path]:
    """A sequence network until the lift, one that sees the outcome, and a single image's."""
    found = {}
    for name, (kind, options) in {
        "lift": ("sequence", {}),
        "outcome": ("sequence", {"until": "outcome"}),
        "grasp": ("single", {}),
    }.items():
        found[name] = tmp_path_factory.mktemp("runs") / name
        recipe = recipe_of(kind, input=options, training=FASTER | {"epochs": 8})
        train(recipe, data, found[name])
    return found


def test_only_a_network_that_is_asked_to_sees_the_outcome(runs, data):
    results = {name: evaluate(run, data=data) for name, run in runs.items()}
    share = np.mean([part["label"] for part in Dataset(data) if part["split"] == "test"])
    for name in ("lift", "grasp"):
        assert results[name]["auroc"] < 0.8
        assert results[name]["accuracy"] < 0.8, share
    assert results["outcome"]["accuracy"] > 0.95
    for name, words in {
        "lift": "up to 3 images, none after the start of the lift (prediction)",
        "outcome": "5 images over the whole recording, outcome and all (detection)",
        "grasp": "the image at the moment of grasp (prediction)",
    }.items():
        assert results[name]["until"] == name
        assert results[name]["frames_seen"] == words
        assert json.loads((runs[name] / "run.json").read_text())["until"] == name
        assert json.loads((runs[name] / "train.json").read_text())["frames_seen"] == words
        assert words in (runs[name] / "index.html").read_text()
        page = runs[name] / "models" / "pooled" / "index.html"
        assert words in page.read_text()


def test_the_rule_on_the_last_imprint_stands_beside_networks_that_see_the_outcome(runs, data):
    found = {name: evaluate(run, data=data).get("same_imprint_rule") for name, run in runs.items()}
    assert found["outcome"]["accuracy"] == 1.0
    assert found["lift"] is None  # every imprint is still that of the grasp
    assert found["grasp"] is None


def test_the_rule_tells_a_grasp_whose_object_stays_and_slips(tmp_path):
    def slipping(index: int, spec):
        sample = lost_when_lifted(index, spec)
        if sample.label != 0:
            return sample
        rgb = sample.pads["left"].rgb.copy()
        rgb[LIFT_FRAME + 1 :] = np.roll(rgb[LIFT_FRAME], 12, axis=0)
        felt = replace(sample.pads["left"], rgb=rgb, force_normal_n=np.full(N_FRAMES, 8.0))
        return replace(sample, pads={"left": felt})

    root = collect(tmp_path / "data", make_spec(24, N_FRAMES, time_s=TIMES_S), slipping)
    source, shape = SimulatedGrasps(root), REFERENCE.shape[:2]
    rows = np.arange(len(source.table))
    assert set(source.table.label) == {0, 1}
    for size_px in (shape, (24, 32)):
        spec = InputSpec("sequence", size_px, 5, "raw", shape, until="outcome")
        assert same_imprint_rule(source, {"all": (rows, spec)})["accuracy"] == 1.0


def test_frames_until_the_lift_are_those_not_later(data):
    source = SimulatedGrasps(data)
    assert set(source.lift_frame) == {LIFT_FRAME}
    assert frames_until(source, 0, "lift") == 3
    assert frames_until(source, 0, "outcome") == 5
    shape = REFERENCE.shape[:2]
    spec = InputSpec("sequence", shape, 3, "raw", shape, until="lift")
    np.testing.assert_array_equal(read_input(source, 0, spec), source.frames(0, [0, 1, 2]))


def test_a_dataset_without_phases_is_reported_and_named_as_what_it_is(tmp_path, capsys):
    spec = make_spec(40, N_FRAMES, time_s=TIMES_S)
    data = collect(tmp_path / "data", spec, without_phases)
    train(recipe_of("sequence", training=FASTER | {"epochs": 1}), data, tmp_path / "run")
    assert "does NOT tell when its lifts start" in capsys.readouterr().err
    assert evaluate(tmp_path / "run", data=data)["until"] == "outcome"


@pytest.mark.parametrize("name", ["grasp", "lift"])
def test_equal_grasps_exported_as_real_ones_are_no_gap(runs, data, tmp_path, name):
    """By their images alone the moment of these grasps cannot be found: the lift loses most."""
    simulated = evaluate(runs[name], data=data)
    export_dataset(data, tmp_path / "real", "real-grasps", split="test")
    exported = RealGraspImages(tmp_path / "real")
    assert set(exported.table.grasp_frame) == {GRASP_FRAME}
    assert set(exported.lift_frame) == {LIFT_FRAME}
    result = evaluate(runs[name], real=tmp_path / "real")
    assert result["sim_to_real_gap"] == 0
    assert result["gap_missing"] == {"simulated": [], "another simulation, NOT real": []}
    assert result["auroc"] == simulated["auroc"]
    assert not any("moment of grasp" in note or "lifts start" in note for note in result["notes"])


def test_predict_says_that_later_images_are_not_asked_for(runs, data, capsys):
    images = Dataset(data)[0]["rgb"]
    for run, said in ((runs["lift"], True), (runs["outcome"], False)):
        Predictor(run).predict([images])
        assert ("none after the start of the lift" in capsys.readouterr().err) is said
    Predictor(runs["lift"]).predict([images[: LIFT_FRAME + 1]])
    assert "none after" not in capsys.readouterr().err


def test_real_sequences_without_a_lift_frame_are_noted(runs, data, tmp_path):
    export_dataset(data, tmp_path / "real", "real-grasps", split="test")
    path = tmp_path / "real" / "grasps.csv"
    pd.read_csv(path).drop(columns=["grasp_frame", "lift_frame"]).to_csv(path, index=False)
    assert "give lift_frame" in " ".join(evaluate(runs["lift"], real=path.parent)["notes"])


@pytest.mark.parametrize("frame", ["1.5", "7"])
def test_a_frame_that_cannot_be_is_refused(data, tmp_path, frame):
    export_dataset(data, tmp_path / "real", "real-grasps", split="test")
    path = tmp_path / "real" / "grasps.csv"
    table = pd.read_csv(path, dtype=str)
    table.loc[2, "lift_frame"] = frame
    table.to_csv(path, index=False)
    with refused(DatasetError):
        read_real_grasps(path.parent)


def test_controls_tell_nothing_where_there_is_nothing_to_tell(runs, data, capsys, monkeypatch):
    """Their labels are shuffled or their images constant: no better than the more common outcome.

    The force that is asked for decides the outcome here, and is found to.
    """
    monkeypatch.setattr("sys.argv", ["tacgen", "eval", str(runs["outcome"]), "--controls"])
    monkeypatch.setattr("tacgen.learning.parameter_baseline.N_TREES", 30)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code in (0, None)
    printed = capsys.readouterr().out
    result = json.loads((runs["outcome"] / "eval.json").read_text())
    assert result["accuracy"] > 0.95
    assert list(result["controls"]) == ["shuffled labels", "constant images", "force alone"]
    n, successes = result["n"], sum(result["confusion"][1])
    for name, scores in result["controls"].items():
        low, high = scores["accuracy_interval"]
        assert f"control, {name}: accuracy {scores['accuracy']:.3f} [{low:.3f}, {high:.3f}]" in (
            printed
        )
        assert f"control, {name}" in (runs["outcome"] / "index.html").read_text()
        assert scores["n"] == n
    assert result["controls"]["force alone"]["accuracy"] == 1.0
    constant = result["controls"]["constant images"]
    assert constant["accuracy"] in (pytest.approx(successes / n), pytest.approx(1 - successes / n))
    assert constant["auroc"] == 0.5
    shuffled = result["controls"]["shuffled labels"]
    assert shuffled["accuracy_interval"][0] < 0.5 < result["accuracy_interval"][0]


def test_controls_need_the_runs_own_dataset(runs, data, tmp_path):
    other = make_spec(80, N_FRAMES, time_s=TIMES_S, recipe_sha256="ef" * 32)
    shutil.copytree(runs["grasp"], tmp_path / "run")
    with refused(LearningError):
        evaluate(tmp_path / "run", collect(tmp_path / "o", other, lost_when_lifted), controls=True)
    with refused(LearningError):
        evaluate(tmp_path / "run", real=tmp_path, controls=True)
