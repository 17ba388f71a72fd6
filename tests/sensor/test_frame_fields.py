"""A frame's marker and force field: shapes, sums, directions, and what a sequence remembers."""

import pickle
import warnings

import numpy as np
import pytest
import trimesh

import tacgen
from tacgen.core.errors import SensorError
from tacgen.sensor import simulated
from tacgen.sensor.tactile_pad import TactilePad
from tests.messages import refused

BALL = trimesh.creation.icosphere(subdivisions=4, radius=6.0)


@pytest.fixture(scope="module")
def sensor():
    return tacgen.Sensor("gelsight_mini")


@pytest.mark.parametrize("shape", [None, (5, 7), (1, 1)])
def test_the_force_field_sums_to_the_force(shape):
    sensor = tacgen.Sensor("gelsight_mini", force_field=shape)
    pose = np.eye(4)
    pose[:2, 3] = 1.5, -1.0
    frame = sensor.render(BALL, pose, force_n=6.0, shear_n=(0.8, -0.5))
    field_n = frame.force_field_n
    if shape is None:  # a cell for each marker
        assert field_n.shape[0] * field_n.shape[1] == len(sensor.marker_rest_mm)
    else:
        assert field_n.shape == (*shape, 3)
    np.testing.assert_allclose(field_n.sum(axis=(0, 1)), frame.force_n, rtol=0.01)
    np.testing.assert_allclose(frame.force_n, [0.8, -0.5, 6.0])


def test_of_an_object_across_the_edge_the_field_has_the_windows_part(sensor):
    width = sensor.description.shape_px[1]
    pose = np.eye(4)
    pose[0, 3] = width * sensor.description.mm_per_px / 2
    frame = sensor.render(BALL, pose, force_n=4.0)
    assert 0 < frame.force_n[2] < 4.0
    np.testing.assert_allclose(frame.force_field_n.sum(axis=(0, 1)), frame.force_n, rtol=0.01)


def test_the_force_is_where_the_ball_is(sensor):
    pose = np.eye(4)
    pose[:2, 3] = 3.0, 2.0
    frame = sensor.render(BALL, pose, force_n=3.0)
    rows, columns, _ = frame.force_field_n.shape
    height, width = sensor.description.shape_px
    x_mm = ((np.arange(columns) + 0.5) / columns - 0.5) * width * sensor.description.mm_per_px
    y_mm = ((np.arange(rows) + 0.5) / rows - 0.5) * height * sensor.description.mm_per_px
    share = frame.force_field_n[..., 2] / frame.force_n[2]
    # The middle of a cell stands for it: off by a part of a cell, which is some 2 mm wide.
    assert (share.sum(axis=0) @ x_mm, share.sum(axis=1) @ y_mm) == pytest.approx((3, 2), abs=0.5)


def test_fields_are_made_when_asked_for_and_pickled_as_arrays(sensor, monkeypatch):
    asked = []
    real = TactilePad.force_field_n
    monkeypatch.setattr(
        TactilePad, "force_field_n", lambda *of: (asked.append(1), real(*of))[1], raising=True
    )
    frame = sensor.render(BALL, np.eye(4), force_n=5.0, shear_n=(0.5, 0.0))
    assert not asked
    first = frame.force_field_n
    assert frame.force_field_n is first
    assert len(asked) == 1
    there = pickle.loads(pickle.dumps(frame))
    np.testing.assert_array_equal(there.force_field_n, first)
    np.testing.assert_array_equal(there.markers_mm, frame.markers_mm)
    # The pad, with its table of megabytes, does not go along.
    assert len(pickle.dumps(frame._touch)) < 10 * (first.nbytes + frame.markers_mm.nbytes) + 1000


@pytest.mark.parametrize("shape", [(0, 3), (3,), (2, 3, 4), (2.5, 3)])
def test_a_shape_that_is_none_is_refused(shape):
    with refused(SensorError):
        tacgen.Sensor("gelsight_mini", force_field=shape)


def test_a_frame_that_no_sensor_simulated_has_no_fields(sensor):
    frame = sensor.render(BALL, np.eye(4), force_n=1.0)
    alone = simulated.replace(frame, _touch=None)
    with refused(SensorError):
        _ = alone.markers_mm


def test_readings_go_on_from_each_other_and_reset_forgets(monkeypatch):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.002"/><worldbody>
        <body name="gel"><geom type="box" size=".02 .02 .005" pos="0 0 -.005"/></body>
        <body name="ball" pos="0 0 .0059"><freejoint/><geom type="sphere" size=".006" mass=".3"/>
        </body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    given = []
    real = TactilePad.press

    def press(self, mesh, pose, load, before=None):
        made = real(self, mesh, pose, load, before)
        given.append((before, made))
        return made

    monkeypatch.setattr(TactilePad, "press", press)
    sensor = tacgen.Sensor("gelsight_mini").attach_mujoco(model, data, "gel")
    sensor.add_object("ball")
    for _ in range(3):
        mujoco.mj_step(model, data, 20)
        sensor.read()
    assert given[0][0] is None
    for (before, _), (_, made) in zip(given[1:], given[:-1], strict=True):
        assert before is made
    sensor.reset()
    mujoco.mj_step(model, data, 20)
    sensor.read()
    assert given[-1][0] is None
    sensor.render(BALL, np.eye(4), force_n=1.0)
    assert given[-1][0] is None  # a render is of a gel at rest


@pytest.mark.parametrize("x_mm", [0.0, 7.0, 9.0, 11.5])
@pytest.mark.parametrize("force_n", [0.0, 4.0])
def test_the_part_that_is_shown_and_the_whole(x_mm, force_n):
    """A ball in the window, at its border and beside it, on the gel."""
    pose = np.eye(4)
    pose[0, 3] = x_mm
    ball = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of shear where nothing presses
        frame = tacgen.Sensor("gelsight_mini").render(ball, pose, force_n, (1.0, -0.5))
    whole_n = np.array([1.0, -0.5, force_n]) if force_n else np.zeros(3)
    np.testing.assert_array_equal(frame.total_force_n, whole_n)
    np.testing.assert_allclose(frame.force_field_n.sum(axis=(0, 1)), frame.force_n, atol=1e-9)
    share = frame.volume_mm3 / (5.135 * force_n) if force_n else 0.0
    np.testing.assert_allclose(frame.force_n, share * whole_n, atol=1e-3)
