"""Circles found in pictures, against a generator that shares no code with the package."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacgen.optics.dots import dots_in, printed_dots
from tacgen.presses.circles import find_circle
from tacgen.presses.geometry import Membrane, PressedGel
from validation.optics.press_images import digit, draw_presses, gelsight_mini

PLAIN = gelsight_mini(4, dots=False)

CASES = {
    "three lamps": (gelsight_mini(3, dots=False), {}),
    "four lamps": (PLAIN, {}),
    "uneven light": (digit(), {}),
    "at the border": (PLAIN, {"margin": 0.1}),
    "deep": (PLAIN, {"depth_share": (0.75, 0.93)}),
    "light": (PLAIN, {"depth_share": (0.15, 0.35)}),
    "coarse": (gelsight_mini(4, dots=False, shape=(60, 80)), {}),
    "noisy": (replace(PLAIN, noise_grey=4.0), {}),
}


@pytest.mark.parametrize("case", CASES)
def test_centre_and_rim_are_found(case):
    """To a tenth of the radius at worst; the rim that is seen lies a little outside the contact."""
    sensor, settings = CASES[case]
    session = draw_presses(sensor, 31, count=10, **settings)
    for press in session.presses:
        circle = find_circle(press.image, session.background)
        assert circle.problem == ""
        off = np.hypot(*(circle.center_px - np.array(press.center_px)))
        assert off < 0.1 * press.contact_px + 0.3
        assert 0.95 < circle.radius_px / press.contact_px < 1.2
        assert circle.edge_px > circle.radius_px


def test_lamps_that_make_one_side_wider_do_not_move_the_centre():
    """A side lit so that its shading reaches beyond the rim: its edge alone is 0.1 radii off."""
    center, radius = np.array([83.4, 58.7]), 20.0
    gel = PressedGel(radius, 1.5 * radius, Membrane(0.5 * radius, 4.0))
    rows, columns = np.indices((120, 160), dtype=float)
    gx, gy = gel.slope(columns - center[0], rows - center[1])
    nx, ny = np.stack([gx, gy]) / np.sqrt(1.0 + gx**2 + gy**2)
    lit = np.stack([90 * nx + 80 * nx**2, 40 * ny - 30 * nx**2, 60 * nx - 30 * ny], axis=-1)
    rest = np.full((120, 160, 3), 120.0)
    circle = find_circle(np.rint(rest + lit).clip(0, 255).astype(np.uint8), rest.astype(np.uint8))
    assert np.hypot(*(circle.center_px - center)) < 0.02 * radius


def test_printed_dots_do_not_move_the_circle():
    session = draw_presses(gelsight_mini(4), 32, count=6)
    at_rest = printed_dots(session.background)
    assert at_rest is not None
    for press in session.presses:
        circle = find_circle(press.image, session.background, dots_in(press.image, at_rest))
        off = np.hypot(*(circle.center_px - np.array(press.center_px)))
        assert off < 0.1 * press.contact_px


@pytest.mark.parametrize("noise_grey", [0.3, 1.0, 5.0])
def test_noise_is_no_contact(noise_grey):
    sensor = replace(digit(), noise_grey=noise_grey)
    first, second = (draw_presses(sensor, seed, count=0).background for seed in (1, 2))
    assert find_circle(second, first).problem == "shows no contact"


def test_two_balls_are_no_circle():
    session = draw_presses(PLAIN, 35, count=8, margin=0.2)
    first = min(session.presses, key=lambda press: press.center_px[0])
    second = max(session.presses, key=lambda press: press.center_px[0])
    change = second.image.astype(int) - session.background
    both = np.clip(first.image + change, 0, 255).astype(np.uint8)
    assert find_circle(both, session.background).problem == "shows more than one contact"
