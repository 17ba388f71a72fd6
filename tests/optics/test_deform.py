"""The pyramid of Gaussians."""

import math

import numpy as np
import pytest

from tacgen.optics.deform import NEGLIGIBLE_MM, PYRAMID_SIGMA_MM, Deformer, deform
from tacgen.optics.smooth import Gaussian, half_kernel, smooth

MM_PER_PX = 0.0295


def disc(depth_mm=1.0, radius_px=40, shape=(240, 320), centre=(120, 160)):
    rows, columns = np.indices(shape)
    inside = (rows - centre[0]) ** 2 + (columns - centre[1]) ** 2 <= radius_px**2
    return (depth_mm * inside).astype(np.float32)


def test_smoothing_is_a_convolution_with_a_gaussian():
    image = np.random.default_rng(0).normal(size=(40, 50)).astype(np.float32)
    kernel = half_kernel(1.7)
    smoothed = image.copy()
    smooth(smoothed, (0, 40, 0, 50), kernel)
    full = np.concatenate([kernel[:0:-1], kernel]).astype(float)
    padded = np.pad(image.astype(float), len(kernel) - 1, mode="edge")
    rows = np.apply_along_axis(np.convolve, 1, padded, full, "valid")
    expected = np.apply_along_axis(np.convolve, 0, rows, full, "valid")
    np.testing.assert_allclose(smoothed, expected, atol=1e-6)
    assert full.sum() == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("sigma_px", [1.1, 1.9, 2.0, 3.5, 7.5, 8.0, 15.0, 28.0])
def test_waves_are_damped_as_by_a_gaussian(sigma_px):
    """By exp(−½ (ω σ)²), wherever their crests lie in the blocks.

    To three percent of their height; a wave shorter than two blocks is seen as a longer one.
    """
    gaussian = Gaussian(sigma_px)
    for period_px in (2.25, 2.5, 3, 4, 4.25, 4.5, 5, 6, 8, 12, 20, 30):
        atol = 0.03 if period_px >= 2 * gaussian.factor else 0.16
        phase = 2 * math.pi * np.arange(300) / period_px
        for shift in (0.0, 0.8, 1.6, 2.4):
            wave = np.tile(np.cos(phase + shift).astype(np.float32), (12, 1))
            gaussian.apply(wave, (0, 12, 0, 300))
            damping = math.exp(-0.5 * (2 * math.pi / period_px * sigma_px) ** 2)
            expected = damping * np.cos(phase + shift)
            np.testing.assert_allclose(wave[6, 60:240], expected[60:240], atol=atol)


@pytest.mark.parametrize("sigma_px", [2.0, 3.0, 3.5, 4.0, 8.0, 15.0])
@pytest.mark.parametrize("shape", [(60, 120), (63, 121)])
def test_beyond_an_edge_the_surface_goes_on_as_at_the_edge(sigma_px, shape):
    """A slope of 1 that ends at an edge: there a Gaussian makes it x Φ(x/σ) + σ φ(x/σ)."""
    slope = np.tile(np.arange(shape[1], dtype=np.float32), (shape[0], 1))
    for surface in (slope.copy(), slope.T.copy()):
        whole = (0, surface.shape[0], 0, surface.shape[1])
        Gaussian(sigma_px).apply(surface, whole)
        line = (surface if surface.shape == shape else surface.T)[shape[0] // 2]
        x = np.arange(shape[1])
        below = np.array([0.5 * (1 + math.erf(a / sigma_px / math.sqrt(2))) for a in x])
        density = np.exp(-0.5 * (x / sigma_px) ** 2) / math.sqrt(2 * math.pi)
        expected = x * below + sigma_px * density
        # Between the middles of blocks the curve is a chord: off by a fiftieth of σ at most.
        middle = shape[1] // 2
        np.testing.assert_allclose(line[:middle], expected[:middle], atol=0.02 * sigma_px)
        mirrored = (shape[1] - 1 - line)[::-1]
        np.testing.assert_allclose(mirrored[:middle], expected[:middle], atol=0.02 * sigma_px)


def test_firm_contact_keeps_the_objects_shape_and_the_rim_falls_off_smoothly():
    deformation = deform(disc(), MM_PER_PX)
    assert deformation[120, 160] == pytest.approx(1.0, abs=1e-6)
    outside = deformation[120, 160 + 41 :]
    assert (np.diff(outside) <= 0).all()
    assert 0.1 < outside[4] < 0.9
    assert outside[60] == 0
    assert abs(np.diff(deformation[120])).max() < 0.3


def test_widths_are_taxims_kernels():
    """51, 21, 11 and 5 px at 0.0295 mm/px; OpenCV's σ = 0.3 ((k − 1)/2 − 1) + 0.8."""
    sigmas_px = [0.3 * ((k - 1) * 0.5 - 1) + 0.8 for k in (51, 21, 11, 5)]
    np.testing.assert_allclose(np.array(PYRAMID_SIGMA_MM) / MM_PER_PX, sigmas_px, atol=0.01)


def test_deformation_keeps_its_size_in_mm_at_another_resolution():
    fine = deform(disc(radius_px=40), MM_PER_PX)
    coarse = deform(disc(radius_px=20, shape=(120, 160), centre=(60, 80)), 2 * MM_PER_PX)
    for beyond_mm in (0.1, 0.2, 0.4):
        # The disc's edge is a pixel wide in each, which is the difference that is left.
        at = fine[120, 160 + round(40 + beyond_mm / MM_PER_PX)]
        assert coarse[60, 80 + round(20 + beyond_mm / MM_PER_PX / 2)] == pytest.approx(at, abs=0.09)


@pytest.mark.parametrize("contact", [(100, 141, 120, 201), (0, 30, 290, 320), (0, 240, 0, 320)])
def test_only_what_a_contact_reaches_is_computed(contact):
    top, bottom, left, right = contact
    depth = np.zeros((240, 320), dtype=np.float32)
    depth[top:bottom, left:right] = np.random.default_rng(1).uniform(
        0.1, 1, (bottom - top, right - left)
    )
    deformer = Deformer(MM_PER_PX)
    part, window = deformer.deform(depth[top:bottom, left:right], contact, depth.shape)
    whole = deform(depth, MM_PER_PX)
    outside = whole.copy()
    outside[window[0] : window[1], window[2] : window[3]] = 0
    assert not outside.any()
    within = whole[window[0] : window[1], window[2] : window[3]]
    np.testing.assert_allclose(part, within, rtol=0, atol=NEGLIGIBLE_MM)
