"""A run on single images: the probabilities of ``tacgen eval``, and what is refused."""

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import tacgen
from tacgen.cli import app
from tacgen.core.errors import LearningError
from tacgen.dataset import Dataset
from tacgen.learning.evaluate import evaluate
from tacgen.learning.train import train
from tests.messages import refused

from .conftest import recipe_of

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("small_backbone")]


@pytest.fixture(scope="module")
def run(toy, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "run"
    train(recipe_of(), toy, out)
    return out


@pytest.fixture(scope="module")
def sequence(toy, tmp_path_factory):
    out = tmp_path_factory.mktemp("sequence") / "run"
    train(recipe_of("sequence"), toy, out)
    return out


@pytest.fixture(scope="module")
def grasps_to_test(toy):
    """Images at the moment of grasp, and labels, of the test split."""
    dataset = Dataset(toy)
    columns = dataset.columns()
    rows = np.flatnonzero((columns["split"] == "test") & (columns["label"] >= 0))
    images = [
        dataset.rgb(int(columns["index"][r]), None, int(columns["grasp_frame"][r])) for r in rows
    ]
    return np.stack(images), columns["label"][rows]


def test_predictions_are_those_that_eval_scores(run, toy, grasps_to_test):
    images, labels = grasps_to_test
    found = tacgen.Predictor(run).predict(images)
    assert found.shape == labels.shape
    result = evaluate(run, data=toy)
    assert np.mean((found >= 0.5) == (labels == 1)) == result["accuracy"]
    wrong = sorted(found[(found >= 0.5) != (labels == 1)])
    # One by one or in batches: single precision differs in its last bits.
    assert wrong == pytest.approx(
        sorted(one["probability"] for one in result["misclassified"]), abs=1e-5
    )


def test_the_prior_moves_the_odds(run, grasps_to_test):
    images, _ = grasps_to_test
    odds = [
        found / (1 - found)
        for prior in (0.5, 0.9)
        for found in [tacgen.Predictor(run, prior=prior).predict(images)]
    ]
    np.testing.assert_allclose(odds[1] / odds[0], 9.0)
    with refused(LearningError):
        tacgen.Predictor(run, prior=1.0)


def test_a_sequence_of_frames(sequence, toy, capsys):
    dataset = Dataset(toy)
    found = tacgen.Predictor(sequence).predict([dataset.rgb(0), dataset.rgb(1)])
    assert "trained on" not in capsys.readouterr().err
    tacgen.Predictor(sequence).predict([dataset.rgb(0)[:2]])
    assert "was trained on 3 frames over 1 s of each grasp, not 2" in capsys.readouterr().err
    assert found.shape == (2,)
    assert ((found > 0) & (found < 1)).all()
    with refused(LearningError):
        tacgen.Predictor(sequence).predict(dataset.rgb(0))


def test_the_command_reads_a_folder(run, grasps_to_test, tmp_path):
    images = grasps_to_test[0][:11]
    for k, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"{k}.png"), image[..., ::-1])
    result = CliRunner().invoke(app, ["predict", str(run), str(tmp_path), "--json"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.stdout)
    assert [row["images"] for row in rows] == [str(tmp_path / f"{k}.png") for k in range(11)]
    assert [row["probability"] for row in rows] == pytest.approx(
        list(tacgen.Predictor(run).predict(images))
    )


TIMES = ["1764234000.9731", "1764234001.0064", "1764234001.04", "1764234001.0732"]
"""Seconds since 1970 as Python writes them, without zeros at the end."""


@pytest.mark.parametrize(
    ("names", "loose"),
    [(TIMES, False), (["f8", "f9", "f10", "f11"], False), (["f8", "f9", "f10", "f11"], True)],
)
def test_frames_named_by_time_or_number_are_those_of_the_grasp(
    sequence, toy, tmp_path, names, loose
):
    frames = Dataset(toy).rgb(0)
    named = [*names, *(f"f{12 + k}" for k in range(len(frames)))][: len(frames)]
    for name, frame in zip(named, frames, strict=True):
        cv2.imwrite(str(tmp_path / f"{name}.png"), frame[..., ::-1])
    given = sorted(map(str, tmp_path.iterdir())) if loose else [str(tmp_path)]
    result = CliRunner().invoke(app, ["predict", str(sequence), *given, "--json"])
    assert result.exit_code == 0, result.output
    (row,) = json.loads(result.stdout)
    wanted = tacgen.Predictor(sequence).predict([frames])[0]
    assert row["probability"] == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    "images",
    [
        np.zeros((1, 24, 32, 3), np.uint8),
        np.zeros((1, 2, 48, 64, 3), np.uint8),
        np.zeros((1, 48, 64, 3), np.float32),
    ],
)
def test_images_that_do_not_fit_are_refused(run, images):
    with refused(LearningError):
        tacgen.Predictor(run).predict(images)


def test_an_object_without_a_model_is_named(run, tmp_path):
    with refused(LearningError):
        tacgen.Predictor(run, "spoon")
    with refused(LearningError):
        tacgen.Predictor(tmp_path)


def test_a_run_of_a_newer_tacgen_says_so(tmp_path):
    (tmp_path / "run.json").write_text('{"schema": 2}')
    with refused(LearningError):
        tacgen.Predictor(tmp_path)
