"""The gel is larger than what the camera sees: what touches beside the window carries its part."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tacgen.contact.gap import CUT_AFTER
from tacgen.contact.gel_response import GelLoad
from tacgen.contact.indenter import Indenter
from tacgen.core.records import Mesh, Sensor

# A window of 16 mm × 12 mm on a gel of 24 mm × 20 mm.
FLAT = Sensor("flat", 120, 160, 0.1, 4.0, gel_size_mm=(24.0, 20.0))
WINDOW_MM2, GEL_MM2 = 16.0 * 12.0, 24.0 * 20.0
DOMED = replace(FLAT, dome_radius_mm=30.0)


def solid(*parts):
    whole = trimesh.util.concatenate([part.copy() for part in parts])
    return Mesh.fixed(whole.vertices, whole.faces)


def box(size_mm, center_mm):
    return trimesh.creation.box(size_mm).apply_translation(center_mm)


def at(x_mm, y_mm=0.0, z_mm=0.0):
    pose = np.eye(4)
    pose[:3, 3] = x_mm, y_mm, z_mm
    return pose


def pressed(sensor, mesh, volume_mm3, pose=None):
    return Indenter(sensor).indent(mesh, np.eye(4) if pose is None else pose, GelLoad(volume_mm3))


def test_a_face_larger_than_the_gel_shares_its_force_by_area():
    imprint = pressed(FLAT, solid(box((60, 60, 10), (0, 0, 5))), 24.0)
    assert imprint.indentation_mm == pytest.approx(24.0 / GEL_MM2, rel=1e-3)
    assert imprint.share == pytest.approx(WINDOW_MM2 / GEL_MM2, rel=1e-3)
    assert imprint.status == "outside_window"


def test_what_is_beyond_the_window_is_counted_by_its_edge():
    indenter = Indenter(FLAT)
    imprint = indenter.indent(solid(box((60, 60, 10), (0, 0, 5))), np.eye(4), GelLoad(24.0))
    # A ring of 4 mm, whose corners of 4 mm × 4 mm are halved by their diagonals.
    left_mm2, top_mm2 = 4 * 12 + 4 * 4, 4 * 16 + 4 * 4
    expected = np.array([left_mm2, top_mm2, left_mm2, top_mm2]) / GEL_MM2
    np.testing.assert_allclose(indenter.outside_share(imprint), expected, atol=0.01)
    ball = solid(trimesh.creation.icosphere(subdivisions=4, radius=4.0))
    for edge, (x_mm, y_mm) in enumerate([(-8, 0), (0, -6), (8, 0), (0, 6)]):
        imprint = indenter.indent(ball, at(x_mm, y_mm), GelLoad(12.0))
        beyond = indenter.outside_share(imprint)
        assert beyond[edge] == pytest.approx(1.0 - imprint.share) == pytest.approx(beyond.sum())
    inside = indenter.indent(ball, at(0.0), GelLoad(12.0))
    assert not indenter.outside_share(inside).any()


def test_a_gel_that_ends_at_the_window_bears_all_of_it():
    ends = replace(FLAT, gel_size_mm=(16.0, 12.0))
    imprint = pressed(ends, solid(box((60, 60, 10), (0, 0, 5))), 24.0)
    assert imprint.volume_mm3 == pytest.approx(24.0, rel=1e-4)
    assert (imprint.share, imprint.status) == (1.0, "ok")


@pytest.mark.parametrize("x_mm", [0.0, 4.0, 6.0, 7.0, 8.0, 9.0, 10.5])
def test_a_ball_across_the_windows_edge_is_as_deep_and_shows_its_part(x_mm):
    """A cap of V = π δ² (R − δ/3); what is within the window of it by a sum over circles."""
    radius_mm, volume_mm3 = 4.0, 12.0
    ball = solid(trimesh.creation.icosphere(subdivisions=5, radius=radius_mm))
    roots = np.roots([-np.pi / 3, np.pi * radius_mm, 0.0, -volume_mm3])
    delta_mm = float(min(r.real for r in roots if abs(r.imag) < 1e-9 and r.real > 0))
    places = np.linspace(-3, 3, 1201)
    x, y = np.meshgrid(places, places)
    under = radius_mm**2 - x**2 - y**2
    depth = np.maximum(0.0, delta_mm - radius_mm + np.sqrt(np.maximum(under, 0.0)))
    shown = depth[(x + x_mm) < 8.0].sum() / depth.sum()
    imprint = pressed(FLAT, ball, volume_mm3, at(x_mm))
    assert imprint.share == pytest.approx(shown, abs=0.02)
    assert imprint.volume_mm3 == pytest.approx(volume_mm3 * shown, abs=0.02 * volume_mm3)
    if x_mm < 8.0:
        assert imprint.indentation_mm == pytest.approx(delta_mm, rel=0.02)
    assert imprint.status == ("ok" if shown >= 0.95 else "outside_window")


@pytest.mark.parametrize(("volume_mm3", "touches"), [(10.0, False), (60.0, True)])
def test_a_rib_beside_the_window_is_pressed_in_before_the_plate_behind_it(volume_mm3, touches):
    """V = A_rib δ + A_plate max(0, δ − g), with the rib g = 1 mm before the plate.

    The rib covers whole pixels of the gel beside the window, which are of 0.4 mm here.
    """
    rib, plate = box((2, 9.6, 4), (10.2, 0, 2)), box((10, 10, 4), (0, 0, 3))
    imprint = pressed(FLAT, solid(rib, plate), volume_mm3)
    delta_mm = (volume_mm3 + 100.0) / 119.2 if touches else volume_mm3 / 19.2
    assert imprint.indentation_mm == pytest.approx(max(0.0, delta_mm - 1.0), rel=0.02)
    shown = 100.0 * max(0.0, delta_mm - 1.0) / volume_mm3
    assert imprint.share == pytest.approx(shown, abs=0.02)
    assert imprint.status == "outside_window"


def test_the_depth_law_counts_from_first_touch_on_the_whole_gel():
    rib, plate = box((2, 10, 4), (10, 0, 2)), box((10, 10, 4), (0, 0, 3))
    load = GelLoad(indentation_mm=1.4)
    imprint = Indenter(FLAT).indent(solid(rib, plate), np.eye(4), load)
    assert imprint.indentation_mm == pytest.approx(0.4, abs=1e-5)


@pytest.mark.parametrize("sensor", [FLAT, DOMED], ids=["flat", "domed"])
def test_it_depends_on_nothing_but_the_pose(sensor):
    """Not on the frames before, nor on whether the mesh has been cut, nor on its place along z."""
    rng = np.random.default_rng(3)
    body = solid(
        trimesh.creation.icosphere(subdivisions=4, radius=25.0).apply_translation([0, 0, 25]),
        box((2, 14, 6), (10, 0, 3.2)),
    )
    used = Indenter(sensor)
    for _ in range(CUT_AFTER + 1):
        used.indent(body, np.eye(4), GelLoad(20.0))
    for _ in range(12):
        turn = trimesh.transformations.rotation_matrix(rng.uniform(-0.3, 0.3), rng.normal(size=3))
        turn[:3, 3] = rng.uniform(-6, 6, 3)
        load = GelLoad(float(rng.uniform(1, 80)))
        again, fresh = used.indent(body, turn, load), Indenter(sensor).indent(body, turn, load)
        turn[2, 3] += 7.0
        moved = Indenter(sensor).indent(body, turn, load)
        for other in (again, moved):
            assert other.window == fresh.window
            np.testing.assert_array_equal(other.depth_mm, fresh.depth_mm)
            np.testing.assert_array_equal(other.beside_depth_mm, fresh.beside_depth_mm)
            assert other.share == fresh.share
