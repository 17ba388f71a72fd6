"""A camera out of focus is seen by the noise that it takes away."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tacgen.diagnose.optics.sharpness import lost_noise, noise_share
from tacgen.diagnose.rules import OPTICS
from tacgen.optics.table import LookupTable
from tacgen.presses.press_images import PressImages

NOISE_GREY, COUNT, SHAPE = 3.0, 8, (120, 160)


def noisy_presses(sigma_px=0.0, gain=1.0, seed=0):
    """Pictures of a shaded gel with white noise, through a lens out of focus."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    shade = np.dstack([90 + 0.2 * columns, 120 - 0.1 * rows, 100 + 0.1 * rows])
    images = shade + rng.normal(0, NOISE_GREY, (COUNT, *SHAPE, 3))
    if sigma_px:
        images = gaussian_filter(images, (0, sigma_px, sigma_px, 0))
    return PressImages(
        images=np.rint(np.clip(gain * images, 0, 255)).astype(np.uint8),
        background=shade.astype(np.uint8),
        names=tuple(f"{k}.png" for k in range(COUNT)),
        center_px=np.full((COUNT, 2), 60.0),
        radius_px=np.full(COUNT, 20.0),
        ball_radius_mm=np.full(COUNT, 2.0),
        mm_per_px=0.05,
    )


def table(noise_grey=NOISE_GREY):
    return LookupTable(
        coefficients=np.zeros((2, 4, 3, 6), dtype=np.float32),
        background=noisy_presses().background.astype(np.float32),
        mm_per_px=0.05,
        max_slope_rad=1.0,
        noise_grey=noise_grey,
    )


@pytest.mark.parametrize("sigma_px", [0.7, 1.0, 1.5])
def test_the_share_of_noise_is_that_of_filtered_white_noise(sigma_px):
    noise = np.random.default_rng(1).normal(0, 1, (800, 800))
    second = np.diff(gaussian_filter(noise, sigma_px, truncate=6), 2, axis=1)
    # The filter is cut into pixels, the formula is not: 6 % at 0.7 of a pixel.
    assert second.std() / np.sqrt(6) == pytest.approx(noise_share(sigma_px), rel=0.08)


def test_a_lens_out_of_focus_is_found_with_its_width():
    found = lost_noise(noisy_presses(0.8), noisy_presses(0.8, seed=2), table(), OPTICS)
    # Rounding to whole grey levels is allowed for; the cut kernel costs some per cent.
    assert found.sigma_mm == pytest.approx(0.8 * 0.05, rel=0.1)
    assert found.p_value < OPTICS.false_alarm
    assert found.gain > 10 * found.gain_stderr


def test_sharp_pictures_are_not_called_blurred():
    for given in (noisy_presses(), noisy_presses(gain=0.85)):
        assert lost_noise(given, noisy_presses(seed=2), table(), OPTICS) is None


def test_test_presses_may_object():
    assert lost_noise(noisy_presses(1.0), noisy_presses(seed=2), table(), OPTICS) is None
