"""What a person sees in a picture: a count of pixels, which the camera's noise does not change."""

import numpy as np
import pytest

from tacgen.optics.noise import with_camera_noise
from tacgen.optics.visible import VISIBLE, visible_share

AT_REST = np.full((40, 50, 3), 120, np.uint8)


@pytest.mark.parametrize(("step", "seen"), [(16, 0), (17, 30), (-16, 0), (-17, 30)])
def test_pixels_count_whose_change_in_a_channel_exceeds_the_limit(step, seen):
    rgb = AT_REST.copy()
    rgb[5:10, 10:16, 1] = 120 + step
    assert visible_share(rgb, AT_REST) == seen / 2000


@pytest.mark.parametrize("noise_grey", [0.0, 1.0, 4.0, 8.0])
def test_noise_alone_is_nothing_to_see(noise_grey):
    large = np.full((480, 640, 3), 120, np.uint8)
    noisy = with_camera_noise(large, noise_grey, 3) if noise_grey else large
    assert visible_share(noisy, large, noise_grey) == 0


def test_a_press_is_seen_through_noise():
    rgb = AT_REST.copy()
    rgb[:10, :6] = 200
    noisy = with_camera_noise(rgb, 8.0, 3)
    assert visible_share(noisy, AT_REST, 8.0) == 60 / 2000 > VISIBLE.contact_share
