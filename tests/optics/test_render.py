"""The look-up renderer against an independent form, and its quick path against its plain one."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from scripts.reference_background import with_reference
from tacgen.core.errors import TableError
from tacgen.optics import LookupTable, load_table, render_rgb, save_table
from tacgen.optics.render import Renderer
from tacgen.optics.table import ContactLight
from tests.messages import refused

SHAPE = (90, 120)
MM_PER_PX = 0.1
LEDS = tuple(
    ((0.9 * math.cos(a), 0.9 * math.sin(a), -0.436), tuple(float(i == k) for k in range(3)))
    for i, a in enumerate((0.0, -2.1, 2.1))
)


def table(seed=0, **changes):
    rng = np.random.default_rng(seed)
    made = LookupTable(
        coefficients=rng.normal(0, 12, (11, 16, 3, 6)).astype(np.float32),
        background=rng.uniform(90, 160, (*SHAPE, 3)).astype(np.float32),
        mm_per_px=MM_PER_PX,
        max_slope_rad=1.1,
        noise_grey=2.0,
    )
    return replace(made, **changes)


def grid_mm():
    x = (np.arange(SHAPE[1]) + 0.5 - SHAPE[1] / 2) * MM_PER_PX
    y = (np.arange(SHAPE[0]) + 0.5 - SHAPE[0] / 2) * MM_PER_PX
    return np.meshgrid(x, y)


def dome():
    x, y = grid_mm()
    return np.sqrt(30**2 - x**2 - y**2) - 30


def bumps(seed=1):
    rng = np.random.default_rng(seed)
    x, y = grid_mm()
    return dome() - sum(
        rng.uniform(0.1, 0.9) * np.exp(-((x - a) ** 2 + (y - b) ** 2) / rng.uniform(0.1, 2))
        for a, b in rng.uniform(-4, 4, (8, 2))
    )


def plain_render(height_mm, made):
    """Written out with numpy and scipy, in float64, from the table's docstring alone."""
    gradient_y, gradient_x = np.gradient(np.float32(height_mm).astype(float), made.mm_per_px)
    slope = np.minimum(np.arctan(np.hypot(gradient_x, gradient_y)), made.max_slope_rad)
    direction = np.arctan2(gradient_y, gradient_x)
    n_slope, n_direction = made.coefficients.shape[:2]
    wrapped = np.concatenate([made.coefficients, made.coefficients[:, :1]], axis=1)
    nodes = (
        np.linspace(0, made.max_slope_rad, n_slope),
        np.linspace(-np.pi, np.pi, n_direction + 1),
    )
    method = "linear"
    if made.interpolation == "floor":
        method = "nearest"
        slope = np.floor(slope / made.max_slope_rad * (n_slope - 1)) * nodes[0][1]
        step = 2 * np.pi / n_direction
        direction = np.floor((direction + np.pi) / step) * step - np.pi
    lookup = RegularGridInterpolator(nodes, wrapped.astype(float), method=method)
    here = lookup(np.stack([np.minimum(slope, nodes[0][-1]), direction], axis=-1))
    u = (np.arange(SHAPE[1]) + 0.5) / SHAPE[1] - 0.5
    v = ((np.arange(SHAPE[0]) + 0.5) / SHAPE[0] - 0.5)[:, None]
    features = np.stack(np.broadcast_arrays(u * u, v * v, u * v, u, v, 1.0), axis=-1)
    return made.background + (here * features[..., None, :]).sum(axis=-1)


def with_response(made, seed=5):
    rng = np.random.default_rng(seed)
    response = rng.normal(0, 12, (7, 9, 5, 4, 3)).astype(np.float16).astype(np.float32)
    return replace(made, response=response)


def with_contact(made, dome_radius_mm=30.0):
    change = np.random.default_rng(6).normal(0, 40, (5, 4, 3, 3)).astype(np.float32)
    return replace(made, contact=ContactLight(change, 0.7, dome_radius_mm))


def plain_contact(height_mm, made):
    """What a contact adds, by scipy, from the docstring of ``ContactLight`` alone."""
    gy, gx = np.gradient(np.float32(height_mm).astype(float), made.mm_per_px)
    length = np.sqrt(1 + gx**2 + gy**2)
    x, y = grid_mm()
    depth = np.maximum(np.sqrt(30**2 - x**2 - y**2) - 30 - height_mm, 0)
    rows, columns = made.contact.change.shape[:2]
    nodes = np.linspace(-0.5, 0.5, rows), np.linspace(-0.5, 0.5, columns)
    u = (np.arange(SHAPE[1]) + 0.5) / SHAPE[1] - 0.5
    v = ((np.arange(SHAPE[0]) + 0.5) / SHAPE[0] - 0.5)[:, None]
    at = np.stack(np.broadcast_arrays(v, u), axis=-1)
    terms = RegularGridInterpolator(nodes, made.contact.change.astype(float))(at)
    normal = np.stack([np.ones_like(gx), gx / length, gy / length], axis=-1)
    return (depth / (depth + 0.7))[..., None] * (terms * normal[..., None]).sum(axis=2)


def test_a_contact_adds_by_depth_slope_and_place(tmp_path):
    made = with_contact(with_response(table()))
    rendered = render_rgb(bumps(), made).astype(float)
    added = plain_contact(bumps(), made)
    expected = np.clip(plain_response(bumps(), made) + added, 0, 255)
    assert abs(added).max() > 10
    assert abs(rendered - expected).max() <= 0.5 + 2e-3
    gy, gx = np.gradient(np.float32(bumps()).astype(float), MM_PER_PX)
    light, half_mm = made.image_model.contact_light(SHAPE)
    normal = np.stack([np.ones_like(gx), gx, gy], axis=-1)
    normal[..., 1:] /= np.sqrt(1 + gx**2 + gy**2)[..., None]
    depth = np.maximum(dome() - bumps(), 0)
    looked_up = (depth / (depth + half_mm))[..., None] * (light * normal[..., None]).sum(axis=2)
    np.testing.assert_allclose(looked_up, added, atol=1e-4)
    save_table(made, tmp_path / "table.npz")
    np.testing.assert_array_equal(
        render_rgb(bumps(), load_table(tmp_path / "table.npz")), render_rgb(bumps(), made)
    )
    at_rest = replace(made, contact=None)
    np.testing.assert_array_equal(render_rgb(dome(), made), render_rgb(dome(), at_rest))
    with refused(TableError):
        replace(made, response=None)


def plain_response(height_mm, made):
    """The response between its nodes by scipy, in float64, from the table's docstring alone."""
    gradient_y, gradient_x = np.gradient(np.float32(height_mm).astype(float), made.mm_per_px)
    slope = np.minimum(np.arctan(np.hypot(gradient_x, gradient_y)), made.max_slope_rad)
    direction = np.arctan2(gradient_y, gradient_x)
    n_slope, n_direction, n_rows, n_columns, _ = made.response.shape
    nodes = (
        np.linspace(0, made.max_slope_rad, n_slope),
        np.linspace(-np.pi, np.pi, n_direction + 1),
        np.linspace(-0.5, 0.5, n_rows),
        np.linspace(-0.5, 0.5, n_columns),
    )
    wrapped = np.concatenate([made.response, made.response[:, :1]], axis=1).astype(float)
    u = (np.arange(SHAPE[1]) + 0.5) / SHAPE[1] - 0.5
    v = ((np.arange(SHAPE[0]) + 0.5) / SHAPE[0] - 0.5)[:, None]
    at = np.stack(np.broadcast_arrays(slope, direction, v, u), axis=-1)
    return made.background + RegularGridInterpolator(nodes, wrapped)(at)


def test_a_response_that_is_linear_in_position_renders_as_its_coefficients():
    """Features u, v and 1 alone: both forms of a table are the same function."""
    made = table()
    coefficients = made.coefficients.copy()
    coefficients[..., :3] = 0
    v, u = np.meshgrid(np.linspace(-0.5, 0.5, 4), np.linspace(-0.5, 0.5, 6), indexing="ij")
    linear = np.stack([u, v, np.ones_like(u)], axis=-1)
    response = np.einsum("sdcf,rkf->sdrkc", coefficients[..., 3:], linear).astype(np.float32)
    made = replace(made, coefficients=coefficients)
    by_response = render_rgb(bumps(), replace(made, response=response)).astype(int)
    assert abs(by_response - render_rgb(bumps(), made)).max() <= 1


def test_a_response_survives_its_file_and_a_wrong_one_is_refused(tmp_path):
    made = with_response(table())
    save_table(made, tmp_path / "table.npz")
    read = load_table(tmp_path / "table.npz")
    np.testing.assert_array_equal(read.response, made.response)
    np.testing.assert_array_equal(render_rgb(bumps(), read), render_rgb(bumps(), made))
    save_table(table(), tmp_path / "plain.npz")
    assert load_table(tmp_path / "plain.npz").response is None
    with refused(TableError):
        replace(made, response=made.response[..., :1])


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["linear", "floor"])
def test_rendering_is_the_look_up_that_the_table_describes(interpolation):
    made = table(interpolation=interpolation)
    rendered = render_rgb(bumps(), made).astype(float)
    expected = np.clip(plain_render(bumps(), made), 0, 255)
    beyond_rounding = abs(rendered - expected) > 0.5 + 2e-3
    # A slope in float32 may fall on the other side of a bin's edge than in float64.
    assert beyond_rounding.mean() <= (2e-3 if interpolation == "floor" else 0)


def test_the_gel_at_rest_renders_as_its_reference():
    reference = np.random.default_rng(3).integers(20, 235, (*SHAPE, 3)).astype(float)
    made = with_reference(table(), dome(), reference)
    # The background is kept to a sixteenth of a grey level.
    np.testing.assert_array_equal(render_rgb(dome(), made), reference)


EFFECTS = {
    "none": {},
    "light": {
        "cross_talk": {"rg": 0.1, "bg": -0.05},
        "background_gain": {"gain_r": 1.1, "offset_b": 3.0},
        "vignetting": {"strength": 0.3},
        "saturation": {"level_grey": 180.0},
    },
    "blur": {"blur": {"sigma_mm": 0.25}},
    "shadow": {"shadow": {"strength": 0.6, "length_mm": 2.0}},
}


@pytest.mark.slow
@pytest.mark.parametrize("effects", EFFECTS.values(), ids=EFFECTS)
@pytest.mark.parametrize(
    ("shadows", "window", "form"),
    [
        (False, (20, 61, 30, 81), table),
        (True, (0, 35, 60, 120), table),
        (True, (0, 90, 0, 120), lambda **changes: with_response(table(**changes))),
    ],
    ids=["inside", "at the edge", "whole"],
)
def test_the_quick_path_gives_the_same_picture_to_the_last_bit(effects, shadows, window, form):
    made = form(effects=effects)
    rest = dome().astype(np.float32)
    renderer = Renderer(made, rest, shadows=shadows, leds=LEDS)
    top, bottom, left, right = window
    # A smooth pit within the window, deepest at its middle, at rest on its border and corners.
    rows = np.sin(np.linspace(0, np.pi, bottom - top + 2)[1:-1]) ** 2
    columns = np.sin(np.linspace(0, np.pi, right - left + 2)[1:-1]) ** 2
    pit = np.maximum(0.8 * rows[:, None] * columns - 0.1, 0).astype(np.float32)
    height = rest.copy()
    height[top:bottom, left:right] -= pit
    whole = render_rgb(height, made, shadows=shadows, leds=LEDS)
    at_rest = render_rgb(rest, made, shadows=shadows, leds=LEDS)
    np.testing.assert_array_equal(renderer.expose(), at_rest)
    elsewhere = rest.copy()
    elsewhere[:40, 50:90] -= np.float32(0.2)
    for _ in range(2):  # The second time they find what the first has left.
        renderer.draw(np.full((40, 40), 0.2, dtype=np.float32), (0, 40, 50, 90))
        other = render_rgb(elsewhere, made, shadows=shadows, leds=LEDS)
        np.testing.assert_array_equal(renderer.expose(), other)
        renderer.draw(pit, window)
        np.testing.assert_array_equal(renderer.expose(), whole)
    noisy = renderer.expose(np.random.default_rng(5))
    same = render_rgb(height, made, shadows=shadows, leds=LEDS, rng=np.random.default_rng(5))
    np.testing.assert_array_equal(noisy, same)
    np.testing.assert_array_equal(renderer.expose(), whole)
    renderer.draw(np.zeros((0, 0), dtype=np.float32), (0, 0, 0, 0))
    np.testing.assert_array_equal(renderer.expose(), at_rest)


@settings(max_examples=25, deadline=None)
@given(lift_mm=st.floats(-2, 2))
def test_lifting_the_whole_gel_changes_nothing_visible(lift_mm):
    made = table()
    before, after = (render_rgb(bumps() + lift, made).astype(int) for lift in (0, lift_mm))
    # float32 holds 2 mm to 1e-7, a slope to 2e-6: a grey level at most where rounding is close.
    assert abs(before - after).max() <= 1
    assert (before != after).mean() < 0.01


def test_noise_has_the_tables_width_is_seeded_and_off_without_a_generator():
    made = replace(table(), background=np.full((*SHAPE, 3), 128, np.float32))
    flat = np.zeros(SHAPE)
    clean = render_rgb(flat, made).astype(float)
    noisy = [render_rgb(flat, made, rng=np.random.default_rng(s)).astype(float) for s in (1, 1, 2)]
    np.testing.assert_array_equal(noisy[0], noisy[1])
    assert (noisy[0] != noisy[2]).any()
    error = noisy[0] - clean
    # Rounding adds 1/12; 32400 draws know the width to half a percent.
    assert error.std() == pytest.approx(math.sqrt(2.0**2 + 1 / 12), rel=0.02)
    assert abs(error.mean()) < 0.05
    np.testing.assert_array_equal(render_rgb(flat, made), clean)


def test_a_table_of_another_resolution_and_holes_are_refused():
    with refused(TableError):
        render_rgb(np.zeros((80, 120)), table())
    holed = dome()
    holed[3, 3] = np.nan
    with refused(TableError):
        render_rgb(holed, table())
    unknown = table(effects={"sparkle": {}, "background_gain": {"gain": 1.0}})
    with refused(TableError):
        render_rgb(dome(), unknown)
