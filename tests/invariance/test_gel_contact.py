"""What must not matter to the imprint of an object in the gel, or acts in a known way."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tacgen.contact.effects import all_effects
from tacgen.contact.gel_response import GelCourse, GelLoad, gel_loads
from tacgen.contact.law import ContactLaw
from tacgen.core.records import ContactFrame, Estimate, Markers, Mesh, Sensor
from tacgen.sensor.tactile_pad import TactilePad
from tests.contact.effects.test_reading import forms_of, law_of
from tests.contact.effects.test_registry import press_columns
from tests.small_world import slope_table

FIRST_FORMS = [
    pytest.param(law_of(one, next(forms_of(one))[1]), id=f"{one.channel}-{one.name}")
    for one in all_effects()
    if one.in_simulation and not one.is_local
]
FLAT = Sensor("flat", 120, 160, 0.1, 3.0, 0.0, Markers(6, 8, 2.0, 0.2))
DOMED = replace(FLAT, name="domed", dome_radius_mm=30.0)
LOAD = GelLoad(9.0, shear_sum_mm=(0.9, -0.6), turn_sum_mm2=2.0)


def pad_of(sensor, **options):
    """A pad whose picture does not depend on the place in it."""
    return TactilePad(sensor, slope_table(sensor.shape_px, sensor.mm_per_px), **options)


def body():
    """A solid without a symmetry: an ellipsoid with a ball beside it."""
    solid = trimesh.creation.icosphere(subdivisions=4).apply_scale((3.0, 2.0, 2.5))
    other = trimesh.creation.icosphere(subdivisions=3, radius=1.2).apply_translation((3, 1, -1.4))
    return trimesh.util.concatenate([solid, other])


def mesh_of(solid):
    """A mesh of ours."""
    return Mesh.fixed(solid.vertices, solid.faces)


def turned(angle_rad, axis=(0.0, 0.0, 1.0), at_mm=(0.0, 0.0, 0.0)):
    """A pose (4, 4)."""
    pose = trimesh.transformations.rotation_matrix(angle_rad, axis)
    pose[:3, 3] = at_mm
    return pose


POSE = turned(0.4, (0.3, -0.2, 1.0), (1.03, -0.71, 4.0))


def changed_bodies():
    """Name, mesh, and the pose that undoes the change."""
    solid = body()
    move = turned(1.1, (1.0, 2.0, -0.5), (20.0, -3.0, 7.0))
    yield "moved and turned", mesh_of(solid.copy().apply_transform(move)), np.linalg.inv(move)
    yield "subdivided", mesh_of(solid.copy().subdivide()), np.eye(4)
    corners = np.arange(3 * len(solid.faces)).reshape(-1, 3)
    yield "unmerged", Mesh.fixed(solid.triangles.reshape(-1, 3), corners), np.eye(4)
    yield "inverted", Mesh.fixed(solid.vertices, solid.faces[:, ::-1]), np.eye(4)
    order = np.random.default_rng(0).permutation(len(solid.faces))
    yield (
        "its triangles in another order",
        Mesh.fixed(solid.vertices, solid.faces[order]),
        np.eye(4),
    )


@pytest.mark.parametrize("sensor", [FLAT, DOMED], ids=lambda one: one.name)
@pytest.mark.parametrize(("name", "mesh", "undone"), list(changed_bodies()))
def test_how_a_mesh_is_written_does_not_matter(sensor, name, mesh, undone):
    pad = pad_of(sensor, markers=True)
    plain, other = pad.press(mesh_of(body()), POSE, LOAD), pad.press(mesh, POSE @ undone, LOAD)
    a, b = (one.depth_map_mm(sensor) for one in (plain, other))
    # Rounding at a triangle's edge gives a pixel to the one or the other: a step of its facet.
    np.testing.assert_allclose(b, a, atol=1e-5)
    assert np.abs(pad.image(plain).astype(int) - pad.image(other)).max() <= 1


@pytest.mark.parametrize("sensor", [FLAT, DOMED], ids=lambda one: one.name)
def test_a_mirrored_press_is_mirrored(sensor):
    """With x its shear changes its sign, and so does a turn."""
    pad, mirror = pad_of(sensor, markers=True), np.diag([-1.0, 1.0, 1.0, 1.0])
    solid = body()
    mirrored = Mesh.fixed(solid.vertices * [-1, 1, 1], solid.faces[:, ::-1])
    load = replace(LOAD, shear_sum_mm=(-0.9, -0.6), turn_sum_mm2=-2.0)
    plain = pad.press(mesh_of(solid), POSE, LOAD)
    other = pad.press(mirrored, mirror @ POSE @ mirror, load)
    np.testing.assert_allclose(
        other.depth_map_mm(sensor)[:, ::-1], plain.depth_map_mm(sensor), atol=1e-5
    )
    rows, columns = sensor.markers.rows, sensor.markers.columns
    places = pad.markers_mm(other).reshape(rows, columns, 2)[:, ::-1] * [-1, 1]
    np.testing.assert_allclose(places.reshape(-1, 2), pad.markers_mm(plain), atol=1e-5)


@pytest.mark.parametrize("sensor", [FLAT, DOMED], ids=lambda one: one.name)
def test_half_the_pixel_size_is_the_same_gel(sensor):
    fine = replace(sensor, height_px=240, width_px=320, mm_per_px=0.05)
    mesh = mesh_of(body())
    pads = pad_of(sensor), pad_of(fine)
    coarse, finer = (pad.press(mesh, POSE, LOAD) for pad in pads)
    assert finer.volume_mm3 == pytest.approx(coarse.volume_mm3, rel=1e-5)
    # First touch is at a pixel's centre: up to half a pixel from the tip of a ball of 1.2 mm.
    touch_mm = 2 * (0.1 / 2) ** 2 / (2 * 1.2)
    depths = finer.indentation_mm, coarse.indentation_mm
    assert depths[0] == pytest.approx(depths[1], abs=touch_mm)
    averaged = pads[1].image(finer).reshape(120, 2, 160, 2, 3).mean(axis=(1, 3))
    assert np.abs(averaged - pads[0].image(coarse)).mean() < 0.5


def shifts(sensor, law, force_n, pose, torsion_n_mm=0.0):
    """How far shear moves a ball, and how far it is turned."""
    ball = mesh_of(trimesh.creation.icosphere(subdivisions=5, radius=4.0))
    frame = ContactFrame(0.0, 4.0, np.array(force_n), torsion_n_mm, pose)
    motion = pad_of(sensor).press(ball, pose, gel_loads(law, [frame])[0]).motion
    return motion.shift_mm, motion.turn_rad


@pytest.mark.parametrize(("pitch_mm", "at_mm"), [(1.0, (0.0, 0.0, 4.0)), (0.5, (3.1, -1.7, 4.0))])
def test_another_grid_of_markers_is_the_same_gel(pitch_mm, at_mm):
    """Within what a sum over a grid differs from the integral: 1.7 % of a grid of 2 mm."""
    law = ContactLaw.linear(5.135, 1.0, marker_pitch_mm=2.0)
    grid = Markers(round(12 / pitch_mm), round(16 / pitch_mm), pitch_mm, 0.2)
    pose = turned(0.0, at_mm=at_mm)
    one = shifts(FLAT, law, (1.0, -0.5), pose, 3.0)
    other = shifts(replace(FLAT, markers=grid), law, (1.0, -0.5), pose, 3.0)
    np.testing.assert_allclose(other[0], one[0], rtol=0.02)
    assert other[1] == pytest.approx(one[1], rel=0.02)
    # A law without a grid is of the sensor's own, whose sum it then gives.
    own = replace(law, marker_pitch_mm=pitch_mm)
    unknown = replace(law, marker_pitch_mm=float("nan"))
    sensor = replace(FLAT, markers=grid)
    np.testing.assert_array_equal(
        shifts(sensor, own, (1.0, -0.5), pose)[0], shifts(sensor, unknown, (1.0, -0.5), pose)[0]
    )


@pytest.mark.parametrize("sensor", [FLAT, DOMED], ids=lambda one: one.name)
def test_a_force_twice_as_large_on_a_gel_half_as_soft_is_the_same_picture(sensor):
    pad, mesh = pad_of(sensor, markers=True), mesh_of(body())
    pictures = []
    for by in (1.0, 2.0):
        law = ContactLaw.linear(5.135 / by, 1.0 / by, marker_pitch_mm=2.0)
        frame = ContactFrame(0.0, by * 2.0, by * np.array([0.6, -0.4]), by * 3.0, POSE)
        pictures.append(pad.render(mesh, POSE, gel_loads(law, [frame])[0]))
    np.testing.assert_array_equal(*pictures)


def course(law, press, clock_s=0.0, readings=1):
    """The last load of a press, each of its samples read so many times."""
    gel = GelCourse(law)
    for k in range(len(press["trial"])):
        pull_n = np.array([press["force_shear_x_n"][k], press["force_shear_y_n"][k]])
        time_s, force_n = press["time_s"][k] + clock_s, press["force_normal_n"][k]
        frame = ContactFrame(time_s, force_n, pull_n, 1.5, POSE)
        loads = [gel.load(frame, 0.0) for _ in range(readings)]
    return loads[-1]


PRESS = {name: values[:40] for name, values in press_columns(1, 60).items()}  # held, and pulled


@pytest.mark.parametrize("law", FIRST_FORMS)
def test_the_picture_of_a_press_depends_neither_on_the_clock_nor_on_reading_twice(law):
    pad, mesh = pad_of(DOMED, markers=True), mesh_of(body())
    plain = pad.press(mesh, POSE, course(law, PRESS))
    drawn = pad.image(plain).astype(int)
    assert plain.volume_mm3 > 0.0
    for options in ({"clock_s": 1000.0}, {"readings": 2}):
        other = pad.press(mesh, POSE, course(law, PRESS, **options))
        assert other.volume_mm3 == pytest.approx(plain.volume_mm3, rel=1e-9)
        assert np.abs(pad.image(other) - drawn).max() <= 1


def test_shear_scaled_scales_the_motion_of_what_sticks():
    """To the millionth to which the field is solved; where the rim slips it moves farther."""
    pose = turned(0.0, at_mm=(1.0, 2.0, 4.0))
    sticky = replace(ContactLaw.default(), friction=Estimate(1e6))
    once, twice = (shifts(FLAT, sticky, (k * 0.4, k * -0.2), pose, k * 1.5) for k in (1, 2))
    np.testing.assert_allclose(twice[0], 2 * once[0], rtol=1e-4)
    assert twice[1] == pytest.approx(2 * once[1], rel=1e-4)
    law = ContactLaw.default()
    once, twice = (shifts(FLAT, law, (k * 0.4, k * -0.2), pose, k * 1.5) for k in (1, 2))
    assert twice[0][0] > 2.05 * once[0][0]


@pytest.mark.parametrize("center_mm", [None, (0.0, 0.0), (4.0, 2.0)])
def test_a_pull_off_the_gels_middle_does_not_turn_the_object(center_mm):
    """About whatever point the moment of a pure shear is given, it has none about the patch."""
    wide = replace(FLAT, height_px=360, width_px=480, markers=Markers(18, 24, 2.0, 0.2))
    law, pose = ContactLaw.default(), turned(0.0, at_mm=(5.0, -1.5, 4.0))
    ball = mesh_of(trimesh.creation.icosphere(subdivisions=5, radius=4.0))
    pull_n = np.array([0.3, 2.0])
    center = None if center_mm is None else np.array(center_mm)
    arm = np.zeros(2) if center is None else np.array([5.0, -1.5]) - center
    torsion = arm[0] * pull_n[1] - arm[1] * pull_n[0]
    frame = ContactFrame(0.0, 4.0, pull_n, torsion, pose, center)
    motion = pad_of(wide).press(ball, pose, gel_loads(law, [frame])[0]).motion
    # The patch's middle is that of its pixels: within a hundredth of a millimetre of the ball's.
    assert abs(np.degrees(motion.turn_rad)) < 0.003
    assert np.hypot(*motion.shift_mm) > 0.02
