"""The gap map against closed forms, and what must not depend on how it is taken."""

import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tacgen.contact import gap_map, gel_map_mm
from tacgen.contact.gap import CUT_AFTER, GapMapper
from tacgen.contact.gel import pixel_centers_mm
from tacgen.core.errors import ContactError
from tacgen.core.records import Sensor, frozen_array
from tests.messages import refused

FLAT = Sensor("flat", 120, 160, 0.1, 4.0)
DOMED = Sensor("domed", 120, 160, 0.1, 4.0, dome_radius_mm=30.0)


def pose_at(x_mm=0.0, y_mm=0.0, z_mm=0.0, rotation=None):
    pose = np.eye(4)
    pose[:3, 3] = x_mm, y_mm, z_mm
    if rotation is not None:
        pose[:3, :3] = rotation
    return pose


def mesh_of(shape):
    return np.asarray(shape.vertices), np.asarray(shape.faces)


def ball(radius_mm, subdivisions=4):
    return mesh_of(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm))


def test_a_pixel_centre_is_where_the_contract_says():
    # A tetrahedron whose tip points at the centre of row 10, column 130.
    x_mm, y_mm = (130 + 0.5 - 80) * 0.1, (10 + 0.5 - 60) * 0.1
    tip = np.array([[0, 0, 0], [0.3, 0, 1], [-0.2, 0.3, 1], [-0.2, -0.3, 1.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    gap = gap_map(tip, faces, pose_at(x_mm, y_mm, 2.0), FLAT)
    assert np.unravel_index(gap.argmin(), gap.shape) == (10, 130)
    assert gap[10, 130] == pytest.approx(2.0, abs=1e-5)


def test_a_tilted_plane_has_its_own_height_at_every_pixel():
    """Exact within the triangles and on the edge between them; no pixel falls through."""
    corners = np.array([[-50, -50], [50, -50], [50, 50], [-50, 50]], dtype=float)
    height = 3 + 0.37 * corners[:, 0] - 0.21 * corners[:, 1]
    vertices = np.column_stack([corners, height])
    gap = gap_map(vertices, np.array([[0, 1, 2], [0, 2, 3]]), np.eye(4), FLAT)
    x, y = pixel_centers_mm(FLAT)
    plane = 3 + 0.37 * x[None, :] - 0.21 * y[:, None]
    # The grain of the gap is 1.9 nm; float32 holds 10 mm to 1 nm.
    np.testing.assert_allclose(gap, plane, atol=3e-6)


def test_the_nearest_of_two_bodies_counts():
    near, far = ball(2.0), ball(5.0)
    vertices = np.concatenate([near[0] + [-3, 0, 3], far[0] + [0, 0, 9]])
    faces = np.concatenate([near[1], far[1] + len(near[0])])
    both = gap_map(vertices, faces, np.eye(4), FLAT)
    alone = [
        gap_map(v, f, np.eye(4), FLAT)
        for v, f in ((vertices, near[1]), (vertices[len(near[0]) :], far[1]))
    ]
    np.testing.assert_array_equal(both, np.minimum(*alone))


def test_a_mesh_has_no_holes_however_fine_and_turned():
    """A closed surface in front of the whole window leaves no pixel without an object."""
    rotation = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.5, 0.7]))[:3, :3]
    for subdivisions in (2, 4, 6):
        gap = gap_map(*ball(40.0, subdivisions), pose_at(0.013, 0.02, 40, rotation), FLAT)
        assert np.isfinite(gap).all()


@settings(max_examples=30, deadline=None)
@given(shift_mm=st.floats(-12, 12))
def test_a_shift_along_the_normal_moves_every_gap_alike(shift_mm):
    """To the last bit: the felt shape does not know where along z the object stands."""
    vertices, faces = ball(7.0)
    here = gap_map(vertices, faces, pose_at(0.3, -0.2, 7.0), DOMED)
    there = gap_map(vertices, faces, pose_at(0.3, -0.2, 7.0 + shift_mm), DOMED)
    np.testing.assert_array_equal(here - here.min(), there - there.min())
    assert there.min() - here.min() == pytest.approx(shift_mm, abs=1e-5)


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    reach_mm=st.floats(0.05, 3.0),
)
def test_leaving_out_what_is_out_of_reach_changes_nothing_within_it(seed, reach_mm):
    """Also for a spike between pixels, whose tip no pixel sees."""
    rng = np.random.default_rng(seed)
    spikes = rng.uniform(-6, 6, (6, 2))
    parts = []
    for x, y in spikes:
        cone = trimesh.creation.cone(radius=0.3, height=rng.uniform(1, 5), sections=7)
        cone.apply_scale([1, 1, -1])
        cone.apply_translation([x, y, 6])
        parts.append(cone)
    vertices, faces = mesh_of(trimesh.util.concatenate(parts))
    faces = faces.astype(np.int32)
    mapper = GapMapper(DOMED)
    whole = mapper.measure(vertices, faces, np.eye(4))
    top, bottom, left, right = whole.window
    everything = np.full(DOMED.shape_px, 2**30)
    everything[top:bottom, left:right] = whole.grains
    near = mapper.measure(vertices, faces, np.eye(4), reach_mm=reach_mm)
    assert near.first_touch_mm == whole.first_touch_mm
    top, bottom, left, right = near.window
    limited = np.full(DOMED.shape_px, 2**30)
    limited[top:bottom, left:right] = near.grains
    within = everything <= reach_mm * 2**19
    np.testing.assert_array_equal(limited[within], everything[within])
    assert (limited >= everything).all()


def test_a_mesh_that_is_used_often_is_cut_into_cells_and_has_the_same_gap():
    """Also where most of it, or all, is beside the window, and some triangles are as long as it."""
    spread = trimesh.creation.icosphere(subdivisions=4, radius=12.0)
    slab = trimesh.creation.box((40.0, 3.0, 3.0))
    mesh = mesh_of(trimesh.util.concatenate([spread, slab]))
    vertices, faces = frozen_array(mesh[0]), frozen_array(mesh[1], np.int32)
    mapper = GapMapper(DOMED)
    for _ in range(CUT_AFTER):
        mapper.measure(vertices, faces, np.eye(4))
    assert len(mapper._mesh.spheres_mm) > 100
    rng = np.random.default_rng(4)
    for distance_mm in (0.0, 5.0, 15.0, 19.0, 26.0, 90.0):
        rotation = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3]
        pose = pose_at(distance_mm, -0.6 * distance_mm, 9.0, rotation)
        again = mapper.measure(vertices, faces, pose, reach_mm=2.0)
        first = GapMapper(DOMED).measure(vertices, faces, pose, reach_mm=2.0)
        assert again.window == first.window
        assert again.first_touch_mm == first.first_touch_mm
        np.testing.assert_array_equal(again.grains, first.grains)
    assert not again.touches


def test_a_mesh_whose_memory_another_array_can_change_is_read_at_every_use():
    vertices, faces = mesh_of(trimesh.creation.icosphere(subdivisions=1, radius=3.0))
    view = vertices.view()
    view.flags.writeable = False
    faces = frozen_array(faces, np.int32)
    mapper = GapMapper(FLAT)
    for scale in (1.0, *[0.9] * (CUT_AFTER + 1)):
        vertices *= scale
        found = mapper.measure(view, faces, np.eye(4)).first_touch_mm
        assert found == GapMapper(FLAT).measure(vertices.copy(), faces, np.eye(4)).first_touch_mm


def test_bad_meshes_are_refused_with_everything_that_is_wrong():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]])
    with refused(ContactError):
        gap_map(vertices, np.array([[0, 1, 7]]), np.eye(3), FLAT)
    with refused(ContactError):
        gap_map(*ball(1.0), np.eye(4), FLAT, camera="kinect")
    with refused(ContactError):
        gel_map_mm(Sensor("small", 120, 160, 0.1, 4.0, dome_radius_mm=5.0))


PYRENDER = """
import sys, numpy as np, trimesh
from tacgen.contact import gap_map
from tacgen.core.errors import ContactError
from tacgen.core.records import Sensor
shape = trimesh.creation.icosphere(subdivisions=4, radius=6.0)
pose = np.eye(4); pose[:3, 3] = 0.31, -0.47, 7.5
try:
    for sensor in (Sensor("a", 120, 160, 0.05, 4.0, 30.0), Sensor("b", 160, 120, 0.1, 4.0)):
        by_gl = gap_map(shape.vertices, shape.faces, pose, sensor, camera="pyrender")
        exact = gap_map(shape.vertices, shape.faces, pose, sensor)
        both = np.isfinite(by_gl) & np.isfinite(exact)
        inner = both & (exact < exact.min() + 3)
        error = abs(by_gl - exact)[inner]
        differ = np.isfinite(by_gl) != np.isfinite(exact)
        print(sensor.name, error.max(), differ.sum(), both.sum())
        assert inner.sum() > 5000
        assert error.max() < 1e-3, error.max()
        assert differ.sum() <= 0.01 * both.sum(), differ.sum()
except ContactError as error:
    print(error); sys.exit(77)
"""


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["egl", "osmesa"])
def test_pyrender_sees_the_same_gap(platform):
    """On the slopes that a gel feels, to a thousandth of a millimetre; in a process of its own."""
    result = subprocess.run(
        [sys.executable, "-c", PYRENDER],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYOPENGL_PLATFORM": platform},
    )
    if result.returncode == 77:
        pytest.skip(f"no pyrender on {platform} here: {result.stdout.strip()[:200]}")
    assert result.returncode == 0, result.stderr[-1500:]
