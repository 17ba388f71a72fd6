"""The pinhole view: depth, silhouettes and occlusion in closed form."""

import numpy as np
import pytest
import trimesh

from tacgen.core.records import Camera, Mesh
from tacgen.objects.meshes import is_inside
from tacgen.objects.pinhole import DEPTH_STEP_MM, Solid, camera_around, pinhole_view

H, W, FOCAL_PX = 96, 128, 150.0
K = np.array([[FOCAL_PX, 0, (W - 1) / 2], [0, FOCAL_PX, (H - 1) / 2], [0, 0, 1]])
HALF_STEP = DEPTH_STEP_MM / 2 * 1.001


def parts(mesh):
    return np.array(mesh.vertices), np.array(mesh.faces, np.int32)


def box(size_mm):
    return parts(trimesh.creation.box(size_mm))


def sphere(radius_mm, subdivisions):
    return parts(trimesh.creation.icosphere(subdivisions, radius_mm))


def camera(pose=None, k_px=K):
    return Camera("test", H, W, k_px, np.eye(4) if pose is None else pose)


def turned(axis, angle_rad):
    """A rotation about one of the camera's axes, as a pose."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    pose, (i, j) = np.eye(4), [k for k in range(3) if k != axis]
    pose[i, i], pose[i, j], pose[j, i], pose[j, j] = c, -s, s, c
    return pose


def rays():
    """(H, W, 3): the direction of each pixel's middle, 1 along the camera's axis."""
    column, row = np.meshgrid(np.arange(W), np.arange(H))
    return np.stack(
        [(column - K[0, 2]) / FOCAL_PX, (row - K[1, 2]) / FOCAL_PX, np.ones((H, W))], axis=-1
    )


def slab(size_mm, middle_mm, segment=1, color=(200, 100, 50)):
    vertices, faces = box(size_mm)
    return Solid(vertices + np.asarray(middle_mm), faces, color, segment)


@pytest.mark.parametrize("axis", [0, 1])
def test_depth_of_a_tilted_plane_is_that_of_its_equation(axis):
    """The face z = 300 of a wide slab, seen by a camera that is turned: z t·r = 300."""
    pose = turned(axis, 0.35)
    _, depth_mm, ids = pinhole_view(camera(pose), [slab((4000, 4000, 10), (0, 0, 305))])
    expected = 300 / (rays() @ pose[2, :3])
    assert (ids == 1).all()
    np.testing.assert_allclose(depth_mm, expected, atol=HALF_STEP)


def test_the_silhouette_and_depth_of_a_sphere_are_those_of_its_equation():
    """A ray d meets |t d − c| = r where (d·c)² ≥ d·d (c·c − r²); a fine mesh lies just inside."""
    center, radius = np.array([12.0, -9.0, 400.0]), 60.0
    vertices, faces = sphere(radius, 6)
    ball = Solid(vertices + center, faces, (200, 100, 50), 2)
    _, depth_mm, ids = pinhole_view(camera(), [ball])
    d = rays()
    b, a, c = d @ center, (d * d).sum(axis=-1), center @ center - radius**2
    room = b**2 - a * c
    clear = np.abs(room) > 0.005 * np.abs(room).max()  # a pixel's middle well off the outline
    assert clear.mean() > 0.95
    np.testing.assert_array_equal(ids[clear] == 2, room[clear] > 0)
    hit = (room > 0) & clear
    nearest = (b[hit] - np.sqrt(room[hit])) / a[hit]
    # Where it is hit at a slant, what the mesh's chords lack (below 0.03 mm) is some times as much.
    np.testing.assert_allclose(depth_mm[hit], nearest, atol=0.3)
    assert np.abs(depth_mm[hit] - nearest).mean() < 0.03
    assert (depth_mm[ids == 0] == 0).all()


def test_what_is_nearer_hides_what_is_behind_in_any_order():
    near, far = slab((40, 40, 10), (0, 0, 205), 3), slab((400, 400, 10), (0, 0, 505), 2)
    views = [pinhole_view(camera(), solids) for solids in ([near, far], [far, near])]
    for one, other in zip(*views, strict=True):
        np.testing.assert_array_equal(one, other)
    _, depth_mm, ids = views[0]
    assert (ids[48, 64], ids[5, 5]) == (3, 2)
    assert (depth_mm[48, 64], depth_mm[5, 5]) == (200, 500)


def test_what_reaches_behind_the_camera_is_cut_and_not_lost():
    """A floor 100 mm below runs past the camera: its depth is 100 / slope down to the edge."""
    floor = slab((4200, 10, 4200), (0, 105, 0))
    _, depth_mm, ids = pinhole_view(camera(), [floor])
    d = rays()[..., 1]
    seen = (d > 0) & (100 / np.maximum(d, 1e-9) < 2100)
    np.testing.assert_array_equal(ids == 1, seen)
    np.testing.assert_allclose(depth_mm[seen], 100 / d[seen], atol=HALF_STEP)


def test_pixels_along_an_outline_have_the_mean_of_both_colours():
    """An edge through the middle of a column's pixels: one of its three samples, or two."""
    lit = slab((4000, 4000, 10), (0, 0, 305))
    plain = pinhole_view(camera(), [lit])[0][0, 0].astype(float)
    half = slab((4000, 4000, 10), (2000 - 0.4, 0, 305))  # its edge is 0.2 px left of the axis
    rgb = pinhole_view(camera(), [half])[0]
    column = 63  # spans 63 − 0.5 to 63 + 0.5; samples at 62.67, 63, 63.33; the edge at 63.3
    np.testing.assert_allclose(rgb[0, column], plain / 3 + 255 * 2 / 3, atol=1)
    assert (rgb[:, 64] == plain).all()
    assert (rgb[:, 62] == 255).all()


def test_inside_and_outside_of_a_closed_mesh():
    vertices, faces = sphere(10.0, 3)
    ball = Mesh(vertices, faces)
    assert is_inside(ball, np.array([0.0, 0.0, 9.0]))
    assert is_inside(ball, np.array([5.0, -5.0, 5.0]))
    assert not is_inside(ball, np.array([0.0, 0.0, 10.5]))
    assert not is_inside(ball, np.array([400.0, 0.0, 0.0]))


@pytest.mark.parametrize(("azimuth_deg", "elevation_deg"), [(-58.0, 22.0), (0.0, 89.9)])
def test_a_camera_around_things_is_filled_by_their_box(azimuth_deg, elevation_deg):
    """The box takes 92 % of the side that it fills, and its middle is that of the picture."""
    box = slab((40, 90, 20), (5, -3, 60))
    found = camera_around(box.vertices_mm, (150, 200), azimuth_deg, elevation_deg)
    ids = pinhole_view(found, [box])[2]
    rows, columns = (np.flatnonzero(ids.any(axis=axis)) for axis in (1, 0))
    shares = np.array([np.ptp(rows) + 1, np.ptp(columns) + 1]) / (150, 200)
    assert shares.max() == pytest.approx(0.92, abs=0.01)
    middle_px = [(one[0] + one[-1]) / 2 for one in (rows, columns)]
    assert middle_px == pytest.approx([74.5, 99.5], abs=1.0)
