"""The joint of contact and optics: one posed mesh to one picture."""

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.contact import contact_depth, gap_map, gel_map_mm, solve_indentation
from tacgen.contact.gel_response import GelLoad
from tacgen.core.errors import ContactError
from tacgen.core.records import Markers, Mesh, Sensor
from tacgen.core.sensors import load_sensor
from tacgen.optics import deform, load_table, render_rgb
from tacgen.optics.virtual_sensor import VirtualSensor
from tacgen.sensor.tactile_pad import TactilePad
from tests.messages import refused
from validation.optics.sampled_table import sampled_table

LEDS = tuple(
    ((0.866 * math.cos(a), 0.866 * math.sin(a), -0.5), tuple(1.5 * (i == k) for k in range(3)))
    for i, a in enumerate((0.0, -2.1, 2.1))
)
SENSOR = Sensor("small", 120, 160, 0.1, 3.0, 30.0, Markers(7, 10, 1.5, 0.2), LEDS)


def height_map_mm(pad, imprint):
    """The deformed gel surface (H, W), gel frame."""
    height = gel_map_mm(pad.sensor).astype(np.float32)
    deformation, (top, bottom, left, right) = pad.deformation(imprint)
    height[top:bottom, left:right] -= deformation
    return height


@pytest.fixture(scope="module")
def table():
    virtual = VirtualSensor.like(SENSOR, noise_grey=1.5)
    return sampled_table(virtual, gel_map_mm(SENSOR), sensor="small", n_slope=20, n_direction=36)


def mesh_of(shape):
    return Mesh(np.asarray(shape.vertices, dtype=float), np.asarray(shape.faces, dtype=np.int32))


def ball(radius_mm, subdivisions=5):
    return mesh_of(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm))


def pose_at(x_mm=0.0, y_mm=0.0, z_mm=0.0):
    pose = np.eye(4)
    pose[:3, 3] = x_mm, y_mm, z_mm
    return pose


BOX = mesh_of(trimesh.creation.box((40, 40, 20)))


@settings(max_examples=20, deadline=None)
@given(x=st.floats(-6, 6), y=st.floats(-5, 5), shift_mm=st.floats(-10, 10), shadows=st.booleans())
def test_moving_the_object_along_the_normal_changes_no_pixel(table, x, y, shift_mm, shadows):
    pad = TactilePad(SENSOR, table, shadows=shadows)
    load = GelLoad(4.0, shear_sum_mm=(1.0, 0.5))
    here, there = (pad.render(ball(3.0, 3), pose_at(x, y, z), load) for z in (5.0, 5.0 + shift_mm))
    np.testing.assert_array_equal(here, there)


@settings(max_examples=12, deadline=None)
@given(x=st.floats(-8, 8), y=st.floats(-6, 6), volume_mm3=st.floats(0.01, 30))
def test_the_quick_way_is_the_contract_functions_one_after_another(table, x, y, volume_mm3):
    # Of a gel that ends where the window does.
    pad = TactilePad(replace(SENSOR, gel_size_mm=(16.0, 12.0)), table)
    mesh = ball(4.0, 4)
    imprint = pad.press(mesh, pose_at(x, y, 4.2), GelLoad(volume_mm3))
    drawn = pad.image(imprint)
    gap = gap_map(mesh.vertices_mm, mesh.faces, pose_at(x, y, 4.2), SENSOR)
    delta = solve_indentation(gap, volume_mm3, SENSOR.pixel_area_mm2)
    assert imprint.indentation_mm == pytest.approx(
        min(delta - gap.min(), SENSOR.gel_depth_mm), abs=1e-6
    )
    depth = contact_depth(gap, float(gap.min()) + imprint.indentation_mm)
    rgb = render_rgb(gel_map_mm(SENSOR) - deform(depth, SENSOR.mm_per_px), table)
    # δ differs by the grain of the gap, 2 nm: a pixel here and there rounds the other way.
    difference = abs(rgb.astype(int) - drawn)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 1e-3
    np.testing.assert_array_equal(render_rgb(height_map_mm(pad, imprint), table), drawn)


@settings(max_examples=12, deadline=None)
@given(radius_mm=st.floats(0.5, 8), volume_mm3=st.floats(0.01, 60), x=st.floats(-7, 7))
def test_the_gel_loses_the_volume_that_was_asked_for(table, radius_mm, volume_mm3, x):
    """However deep the press, and in the window or beside it: nothing that touches was left out."""
    pad = TactilePad(SENSOR, table)
    imprint = pad.press(ball(radius_mm, 4), pose_at(x), GelLoad(volume_mm3))
    lost_mm3 = imprint.volume_mm3 / imprint.share
    if imprint.saturated:
        assert imprint.indentation_mm == SENSOR.gel_depth_mm
        assert lost_mm3 <= volume_mm3 * (1 + 1e-6)
    else:
        assert lost_mm3 == pytest.approx(volume_mm3, rel=1e-4)


def test_too_much_force_presses_the_gel_through_and_says_so(table):
    imprint = TactilePad(SENSOR, table).press(ball(2.0), pose_at(), GelLoad(1e4))
    assert imprint.saturated
    assert imprint.indentation_mm == SENSOR.gel_depth_mm
    assert imprint.volume_mm3 < 1e4


def test_shear_carries_the_imprint_along_and_the_markers_sum_to_it(table):
    pad = TactilePad(SENSOR, table, markers=True)
    still = pad.press(ball(3.0), pose_at(), GelLoad(5.0))
    sheared = pad.press(ball(3.0), pose_at(), GelLoad(5.0, shear_sum_mm=(6.0, -3.0)))
    shift_px = sheared.motion.shift_mm / SENSOR.mm_per_px
    assert shift_px[0] > 1

    def middle(imprint):
        depth = imprint.depth_map_mm(SENSOR)
        rows, columns = np.indices(depth.shape)
        return np.array([(columns * depth).sum(), (rows * depth).sum()]) / depth.sum()

    # On a dome the patch slides back a little towards the top: 3 mm of ball on 30 mm of dome.
    np.testing.assert_allclose(middle(sheared) - middle(still), shift_px, rtol=0.15, atol=0.1)
    # Pressing alone moves the markers about the middle: to a sum near 0.
    moved = pad.marker_motion_mm(sheared).sum(axis=0) - pad.marker_motion_mm(still).sum(axis=0)
    np.testing.assert_allclose(moved, [6.0, -3.0], rtol=0.05)


def test_frames_do_not_depend_on_the_frames_before(table):
    pad = TactilePad(SENSOR, table, shadows=True, markers=True)

    def frame():
        load, rng = GelLoad(4.0, shear_sum_mm=(2, 1)), np.random.default_rng(7)
        return pad.render(ball(3.0), pose_at(1, 2), load, rng=rng)

    first = frame()
    pad.render(BOX, pose_at(-3, 1), GelLoad(20.0), rng=np.random.default_rng(8))
    np.testing.assert_array_equal(frame(), first)


def test_the_force_field_sums_to_the_force_and_slips_from_the_rim(table):
    pad = TactilePad(SENSOR, table)
    force_n = np.array([1.5, -0.6, 4.0])
    load = GelLoad(
        20.0, shear_sum_mm=(1.5, -0.6), force_n=(1.5, -0.6, 4.0), k_s_mm_per_n=1.0, friction=0.6
    )
    imprint = pad.press(ball(4.0), pose_at(1.5, -1.5), load)
    for shape in ((12, 16), (5, 7), (1, 1), (40, 60)):
        field_n = pad.force_field_n(imprint, force_n, shape)
        np.testing.assert_allclose(field_n.sum(axis=(0, 1)), force_n, rtol=1e-9)
    coarse_n = pad.force_field_n(imprint, force_n, (12, 16))
    at = np.unravel_index(coarse_n[..., 2].argmax(), (12, 16))
    assert at == (4, 9)  # row and column of (1.5, -1.5) mm in cells of 1 mm
    ratio = np.hypot(*np.moveaxis(coarse_n[..., :2], -1, 0)) / np.maximum(coarse_n[..., 2], 1e-9)
    assert ratio.max() <= 0.6 * 1.001
    assert ratio[at] < 0.35  # the middle sticks: what it bears is less than friction could hold
    assert not pad.force_field_n(pad.press(ball(4.0), pose_at(), GelLoad()), force_n, (3, 3)).any()


def test_a_mesh_is_checked_at_every_press(table):
    pad, mesh, load = TactilePad(SENSOR, table), ball(4.0, 3), GelLoad(5.0)
    assert pad.press(mesh, pose_at(), load).indentation_mm > 0
    with refused(ContactError):
        pad.press(mesh, np.full((4, 4), np.nan), load)
    with refused(ContactError):
        pad.press(replace(mesh, faces=mesh.faces + 1), pose_at(), load)
    loose = ball(4.0, 3)
    pad.press(loose, pose_at(), load)
    loose.vertices_mm[0] = np.nan
    with refused(ContactError):
        pad.press(loose, pose_at(), load)


def test_both_cameras_press_the_same(table, monkeypatch):
    """The other camera's part of the joint, with the exact depth in place of GL."""
    mesh, pose = ball(4.0), pose_at(1, -1, 4)
    exact = TactilePad(SENSOR, table).press(mesh, pose, GelLoad(6.0))

    def by_gap(vertices_mm, faces, pose_gel_object, sensor):
        gap = gap_map(vertices_mm, faces, pose_gel_object, sensor).astype(float)
        return gap + gel_map_mm(sensor) - pose_gel_object[2, 3]

    monkeypatch.setattr("tacgen.contact.pyrender_camera.depth_map_mm", by_gap)
    other = TactilePad(SENSOR, table, camera="pyrender").press(mesh, pose, GelLoad(6.0))
    assert other.indentation_mm == pytest.approx(exact.indentation_mm, abs=1e-5)


@pytest.mark.slow
def test_the_shipped_virtual_table_renders_unseen_presses_as_the_virtual_sensor():
    """Balls of sizes and places that the fit had not; noise-free, in grey levels."""
    sensor = load_sensor("virtual_gelsight")
    made = load_table(sensor.table)
    virtual = VirtualSensor.like(sensor)
    pad = TactilePad(sensor, made)
    reference = render_rgb(gel_map_mm(sensor), made).astype(float)
    assert abs(reference - virtual.grey_levels(gel_map_mm(sensor))).max() < 0.6
    for radius_mm, depth_mm, x, y in ((3.0, 0.8, 2.0, 1.0), (1.5, 0.6, 3.0, -3.5), (6, 0.5, -4, 2)):
        imprint = pad.press(ball(radius_mm, 6), pose_at(x, y), GelLoad(indentation_mm=depth_mm))
        truth = virtual.grey_levels(height_map_mm(pad, imprint))
        touched = imprint.depth_map_mm(sensor) > 0
        error = pad.image(imprint).astype(float) - truth
        signal = (truth - reference)[touched]
        rmse = np.sqrt((error[touched] ** 2).mean())
        # Rounding and a quadratic in position are worth about one grey level of it.
        assert rmse < 2.0
        assert rmse < 0.1 * np.sqrt((signal**2).mean())
