"""Models trained in processes of their own, with the whole ResNet-18."""

import pytest

from tacgen.learning.train import train
from tests.learning.conftest import recipe_of
from tests.learning.test_train import assert_same_weights, metrics_of

pytestmark = pytest.mark.slow


def test_models_trained_side_by_side_are_the_same(toy, tmp_path):
    """Two processes, one model each, against one process for both."""
    recipe = recipe_of(training={"epochs": 1}, per_object=True)
    alone = train(recipe, toy, tmp_path / "alone")
    beside = train(recipe, toy, tmp_path / "beside", workers=2)
    assert list(beside["models"]) == list(alone["models"]) == ["can", "cup"]
    for name in ("can", "cup"):
        assert_same_weights(tmp_path / "alone", tmp_path / "beside", name)
        assert metrics_of(tmp_path / "alone", name) == metrics_of(tmp_path / "beside", name)
