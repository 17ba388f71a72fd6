"""What training refuses, in words: data, devices and folders that it cannot use."""

import shutil
from pathlib import Path

import pytest
import torch

from tacgen.core.errors import DatasetError, LearningError
from tacgen.learning.train import train
from tests.learning.conftest import collect, make_sample, make_spec, recipe_of
from tests.messages import refused


def shard_of(data: Path, number: int = 0) -> Path:
    return data / "shards" / f"shard-{number:05d}.h5"


def test_a_missing_shard_is_told(toy, tmp_path):
    data = tmp_path / "data"
    shutil.copytree(toy, data)
    shard_of(data, 1).unlink()
    with refused(DatasetError):
        train(recipe_of(), data, tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "change",
    [{"recipe_sha256": "ef" * 32}, {"calibration": {}}],
)
def test_shards_of_different_recipes_are_refused(toy, tmp_path, change):
    data, other = tmp_path / "data", collect(tmp_path / "other", make_spec(**change))
    shutil.copytree(toy, data)
    for suffix in (".h5", ".json"):
        shutil.copy(shard_of(other, 1).with_suffix(suffix), shard_of(data, 1).with_suffix(suffix))
    (data / "manifest.jsonl").unlink()
    with refused(DatasetError):
        train(recipe_of(), data, tmp_path / "run")


def test_one_class_only_is_told(tmp_path):
    def all_fail(index, spec):
        sample = make_sample(index, spec)
        return sample if sample.label != 1 else make_failure(sample)

    def make_failure(sample):
        from dataclasses import replace

        return replace(sample, label=0, failure_mode="translational_slip")

    data = collect(tmp_path / "data", make_spec(), all_fail)
    with refused(LearningError):
        train(recipe_of(), data, tmp_path / "run")


def test_a_sequence_cannot_be_learnt_from_single_images(tmp_path):
    data = collect(tmp_path / "data", make_spec(n_frames=1))
    with refused(LearningError):
        train(recipe_of("sequence"), data, tmp_path / "run")


def test_a_gpu_that_is_not_there_is_told(toy, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with refused(LearningError):
        train(recipe_of(training={"device": "cuda"}), toy, tmp_path / "run")


def test_a_pad_that_is_not_there_is_told(toy, tmp_path):
    with refused(DatasetError):
        train(recipe_of(input={"pad": "right"}), toy, tmp_path / "run")
