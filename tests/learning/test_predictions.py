"""Calibrated probabilities, and images that are unlike those of the training."""

import re
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
import trimesh
from scipy.special import expit

import tacgen
from tacgen.learning.predictions import (
    calibrated_temperature,
    input_statistics,
    notes_on_images,
    notes_on_views,
    predict,
    typical_contrast,
)
from tacgen.learning.scores import expected_calibration_error
from tacgen.learning.splits import class_weights


@pytest.mark.parametrize("temperature", [1.2, 3.0])
def test_the_temperature_of_too_sure_predictions_is_found(temperature):
    """Labels are drawn from the true probabilities; the network states its logits times T.

    With 20 000 grasps the standard error of log T is some 2 %.
    """
    rng = np.random.default_rng(7)
    logits = rng.normal(0, 2, 20_000)
    labels = (rng.random(20_000) < expit(logits)).astype(np.int64)
    stated = expit(logits * temperature)
    found = calibrated_temperature(stated, labels)
    assert found == pytest.approx(temperature, rel=0.06)


class _Stated(torch.nn.Module):
    """A network that states the logit that it is shown, as failure and success."""

    temperature = 1.0

    def __init__(self, prior_logit):
        super().__init__()
        self.prior_logit = prior_logit

    def forward(self, images):
        return torch.stack([-images / 2, images / 2], dim=1)


@pytest.mark.parametrize("informative", [True, False])
@pytest.mark.parametrize("successes", [0.5, 0.8, 0.85, 0.95])
def test_an_ideal_network_states_how_often_grasps_hold(successes, informative):
    """One sees x ~ N(±1, 1), whose log likelihood ratio is 2x, or nothing at all.

    The weights of the classes hide the prior in training. Of 20 000 grasps in ten bins the
    calibration error of chance alone is below 0.01.
    """
    rng = np.random.default_rng(5)
    labels = (rng.random(20_000) < successes).astype(np.int64)
    seen = 2 * (rng.normal(0, 1, 20_000) + np.where(labels == 1, 1, -1)) * informative
    failure, success = class_weights(labels)
    network = _Stated(np.log(failure / success))
    network.temperature = calibrated_temperature(expit(seen), labels, network.prior_logit)
    batch = (torch.from_numpy(seen), torch.from_numpy(labels), np.arange(20_000))
    probabilities, _ = predict(network, [batch], "cpu")
    assert expected_calibration_error(labels, probabilities) < 0.01
    if informative:
        assert network.temperature == pytest.approx(1, rel=0.06)


def test_images_of_another_brightness_contrast_or_colour_lie_outside():
    """Half the contrast lies within the range of single grasps, but not of forty grasps' median."""
    rng = np.random.default_rng(3)
    images = torch.from_numpy(rng.normal(0, 1, (40, 2, 3, 8, 10)))
    index = np.arange(40)

    def statistics_of(changed):
        return input_statistics([(changed, torch.zeros(40), index)])

    statistics = statistics_of(images)
    np.testing.assert_allclose(statistics[:, :3], images.numpy().mean(axis=(1, 3, 4)))
    input_range = list(zip(statistics.min(0), statistics.max(0), strict=True))
    card = SimpleNamespace(
        name="can", input_range=input_range, contrast=typical_contrast(statistics)
    )

    def notes(changed):
        return " ".join(notes_on_images(statistics_of(changed), card))

    everything = "40 of 40 grasps lies OUTSIDE of the training images of the model can"
    assert not notes(images)
    assert everything in notes(images + 2)
    assert everything in notes(images * 2)
    one_colour = images.clone()
    one_colour[:, :, 1] -= 2
    assert everything in notes(one_colour)
    faint = images.clone()
    faint[1:] *= 0.5
    card.input_range = [(low - 1, high + 1) for low, high in input_range]
    assert not notes(faint[:10])
    assert "contrast is 0.50 of that in training" in notes(faint)
    assert "OUTSIDE" not in notes(faint)
    card.contrast = 0.0  # training images of one colour
    assert "of that in training" in notes(images)


def gel_at_rest():
    """Light that falls off to one side, otherwise in each colour."""
    v, u = np.meshgrid(np.linspace(-1, 1, 48), np.linspace(-1, 1, 64), indexing="ij")
    light = np.stack(
        [120 + 40 * u + 30 * v * v, 110 + 30 * v + 25 * u * u, 100 - 35 * np.sin(3 * u) + 20 * v],
        axis=-1,
    )
    return np.rint(light).astype(np.uint8)


OTHER_VIEWS = {
    "mirrored left to right": lambda rgb: rgb[..., :, ::-1, :],
    "turned by 180": lambda rgb: rgb[..., ::-1, ::-1, :],
    "red and blue are swapped": lambda rgb: rgb[..., ::-1],
}


@pytest.mark.parametrize("view", OTHER_VIEWS)
def test_a_background_or_images_of_another_view_are_noted(view):
    rest = gel_at_rest()
    images = [rest[None]] * 5
    other = OTHER_VIEWS[view]
    assert notes_on_views(images, rest, rest) == []
    (note,) = notes_on_views(images, rest, other(rest))
    assert note.startswith("the background does NOT match the training's: ")
    assert view in note
    (note,) = notes_on_views([other(one) for one in images], rest, rest)
    assert note.startswith("the images do NOT match their background: ")
    assert view in note
    # One odd picture among many is none of the set.
    assert notes_on_views([other(images[0]), *images], rest, rest) == []
    assert notes_on_views(images, None, rest) == []


def test_a_press_as_background_is_noted():
    sensor = tacgen.Sensor("gelsight_mini")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
    pictures = sensor.at_rest_rgb(), sensor.render(ball, np.eye(4), 4.0).rgb
    rest, pressed = (cv2.resize(one, (128, 96), interpolation=cv2.INTER_AREA) for one in pictures)
    (note,) = notes_on_views([pressed[None]], pressed, rest)
    x, y = re.findall(r"the background may show a press, at \((\d+), (\d+)\)", note)[0]
    assert (int(x), int(y)) == pytest.approx((63.5, 47.5), abs=1.5)
    dimmed = np.rint(0.9 * rest).astype(np.uint8)
    assert notes_on_views([dimmed[None]], dimmed, rest) == []
