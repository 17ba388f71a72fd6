"""Calibrated probabilities, and images that are unlike those of the training."""

import numpy as np
import pytest
import torch
from scipy.special import expit

from tacgen.learning.predictions import (
    calibrated_temperature,
    input_statistics,
    outside_training,
)


@pytest.mark.parametrize("temperature", [0.5, 1.0, 3.0])
def test_the_temperature_of_too_sure_predictions_is_found(temperature):
    """Labels are drawn from the true probabilities; the network states its logits times T.

    With 20 000 grasps the standard error of log T is some 2 %.
    """
    rng = np.random.default_rng(7)
    logits = rng.normal(0, 2, 20_000)
    labels = (rng.random(20_000) < expit(logits)).astype(np.int64)
    stated = expit(logits * temperature)
    found = calibrated_temperature(stated, labels, np.ones(2))
    assert found == pytest.approx(temperature, rel=0.06)


def test_a_certain_mistake_gives_a_finite_temperature():
    found = calibrated_temperature(np.array([1.0, 1.0, 0.0]), np.array([1, 0, 0]), np.ones(2))
    assert 1 < found <= 16


def test_images_of_another_brightness_contrast_or_colour_lie_outside():
    rng = np.random.default_rng(3)
    images = torch.from_numpy(rng.normal(0, 1, (40, 2, 3, 8, 10)))
    statistics = input_statistics(images)
    np.testing.assert_allclose(statistics[:, :3], images.numpy().mean(axis=(1, 3, 4)))
    input_range = list(zip(statistics.min(0), statistics.max(0), strict=True))
    index = np.arange(40)

    def outside(changed):
        return outside_training([(changed, torch.zeros(40), index)], input_range)

    assert not outside(images).any()
    assert outside(images + 2).all()
    assert outside(images * 2).all()
    one_colour = images.clone()
    one_colour[:, :, 1] -= 2
    assert outside(one_colour).all()
