"""What a diagnosis compares with pictures is what the sensor of its table shows."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.calibrate.lookup.prepared import Pixels
from tacgen.calibrate.lookup.press_fit import PressModel, plain_press_model
from tacgen.calibrate.lookup.score import PressRenderer
from tacgen.core.sensors import load_sensor
from tacgen.optics.effects.shadow import cast_shadow
from tacgen.optics.render import Renderer, render_rgb
from tacgen.optics.table import leds_of_table, load_table
from tacgen.presses.geometry import rest_height
from tacgen.presses.press_images import place_mm

EFFECTS = {
    "shadow": {
        "strength_r": 0.26,
        "strength_g": 0.19,
        "strength_b": 0.18,
        "length_mm": 2.9,
        "lamp_distance_mm": 11.5,
        "penumbra": 0.9,
    },
    "vignetting": {"change_strength": 0.1},
}
"""As real presses of a GelSight Mini show them."""
BALL_MM = 2.5


@pytest.mark.parametrize("name", ["gelsight_mini", "gelsight"])
def test_a_sensor_shows_a_press_as_its_diagnosis_predicts_it(name):
    """The gel lowered by the very press, drawn frame after frame, within a grey level."""
    sensor = load_sensor(name)
    table = replace(load_table(sensor.table), effects=EFFECTS)
    model = PressModel.from_dict(table.provenance["press_model"])
    shape = table.shape_px
    rows, columns = np.indices(shape)
    x_mm, y_mm = place_mm(columns, rows, shape, table.mm_per_px)
    rest_mm = rest_height(x_mm, y_mm, model.dome_radius_mm)
    predicted, drawn = PressRenderer(table, model), Renderer(table, rest_mm)
    whole = (0, shape[0], 0, shape[1])
    for place in ((1.0, -2.0, 1.2), (-2.0, 1.5, 1.6)):
        height_mm = model.height(np.array(place), BALL_MM, x_mm, y_mm)
        drawn.draw((rest_mm - height_mm).astype(np.float32), whole)
        rgb = drawn.expose().astype(float)
        radii = np.hypot(x_mm - place[0], y_mm - place[1]) / place[2]
        near = radii < 2.2
        everywhere = np.ones(near.sum(), bool)
        unused = np.zeros((near.sum(), 3))
        pixels = Pixels(rows[near], columns[near], unused, unused, unused, unused, everywhere)
        grey = predicted.grey(np.array(place), BALL_MM, pixels)
        assert np.abs(rgb[near] - grey).max() <= 1.0
        flat = render_rgb(height_mm, replace(table, effects={}))
        assert (flat[near] - rgb[near]).max() > 5  # the effects show


def test_shadows_of_near_lamps_do_not_depend_on_the_frame_before():
    """A window of the picture is drawn as the whole of it is, to the last bit."""
    sensor = load_sensor("gelsight_mini")
    table = replace(load_table(sensor.table), effects=EFFECTS)
    rows, columns = np.indices(table.shape_px)
    x_mm, y_mm = place_mm(columns, rows, table.shape_px, table.mm_per_px)
    model = plain_press_model(1.0)
    renderer = Renderer(table, np.zeros(table.shape_px, np.float32))
    for place in ((4.0, -3.0, 1.0), (-6.0, 4.0, 0.8), (9.5, 0.0, 1.0)):
        deformation = -model.height(np.array(place), BALL_MM, x_mm, y_mm).astype(np.float32)
        deformation[deformation < 1e-3] = 0.0
        by_row, by_column = (np.flatnonzero(deformation.any(axis=k)) for k in (1, 0))
        window = by_row[0], by_row[-1] + 1, by_column[0], by_column[-1] + 1
        top, bottom, left, right = (int(edge) for edge in window)
        part = np.ascontiguousarray(deformation[top:bottom, left:right])
        renderer.draw(part, (top, bottom, left, right))
        np.testing.assert_array_equal(renderer.expose(), render_rgb(-deformation, table))


def test_a_near_lamp_behind_a_bump_is_hidden_as_far_as_the_rays_say():
    """A bump of height d, at a distance of D from a lamp h high, hides it up to d D / (h − d)."""
    mm_per_px, depth_mm, lamp_mm = 0.05, 0.5, 3.0
    height_mm = np.zeros((100, 400), np.float32)
    height_mm[:, 100:104] = -depth_mm
    flat = np.hypot(12.0, lamp_mm)
    shade = cast_shadow(
        *(height_mm, mm_per_px, (-12.0 / flat, 0.0, -lamp_mm / flat)),
        lamp_distance_mm=12.0,
        penumbra=0.01,
        middle_px=(49.5, 199.5),
    )
    distance_mm = 12.0 - (199.5 - 103.5) * mm_per_px
    reach_px = distance_mm * depth_mm / (lamp_mm - depth_mm) / mm_per_px
    shaded = np.flatnonzero(shade[50] > 0)
    assert abs(shaded[-1] - (103 + reach_px)) < 2


def test_there_is_one_near_lamp_of_each_channel():
    """What ``near_shadows`` relies on."""
    leds = leds_of_table(load_table(load_sensor("gelsight").table))
    assert [rgb for _, rgb in leds] == [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
