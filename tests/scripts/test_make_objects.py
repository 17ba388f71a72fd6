"""The solids that the builders are made of, against closed forms."""

import numpy as np
import pytest
import trimesh

from scripts.make_objects.all_objects import OBJECTS
from scripts.make_objects.profiles import (
    polar,
    rounded_polygon,
)
from scripts.make_objects.resting import resting_tilt_rad, settled
from scripts.make_objects.shape import Shape, angles_rad, loft, moved, revolve, sweep, union
from tacgen.core.resources import packaged
from tacgen.objects import load_object
from tacgen.objects.description import read_description
from tacgen.objects.meshes import hull, mass_properties, volume_mm3


def as_trimesh(mesh):
    return trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)


def polygon_area(points):
    x, y = points.T
    return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))


def box(x, y, z):
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
    return hull(signs * np.array([x, y, z]) / 2)


def test_turned_cylinder_is_closed_outward_and_has_the_volume_of_its_polygon():
    n, radius, height = 96, 10.0, 30.0
    solid = loft(revolve(np.array([[radius, 0.0], [radius, height]]), n))
    prism = 0.5 * n * radius**2 * np.sin(2 * np.pi / n) * height
    assert as_trimesh(solid).is_watertight
    assert as_trimesh(solid).is_winding_consistent
    assert volume_mm3(solid) == pytest.approx(prism, rel=1e-6)  # vertices are rounded to 1e-6


def test_swept_arc_has_the_volume_of_pappus():
    turn = np.linspace(0, np.pi, 400)
    path = 50 * np.stack([np.zeros_like(turn), np.cos(turn), np.sin(turn)], axis=-1)
    solid = loft(sweep(path, np.array([1.0, 0.0, 0.0]), polar(4.0, angles_rad(200))))
    assert as_trimesh(solid).is_watertight
    assert volume_mm3(solid) == pytest.approx(np.pi * 4**2 * np.pi * 50, rel=2e-3)


def test_union_counts_the_overlap_once():
    a = box(10.0, 10.0, 10.0)
    both = union([a, moved(a, shift_mm=np.array([4.0, 3.0, 2.0]))])
    assert as_trimesh(both).is_watertight
    assert volume_mm3(both) == pytest.approx(2000.0 - 6.0 * 7.0 * 8.0)


def test_rounded_polygon_area_and_normals():
    square = np.array([[-10, -10], [10, -10], [10, 10], [-10, 10]])
    points, normals = rounded_polygon(square, 3.0, steps=60, spacing_mm=1.0)
    assert polygon_area(points) == pytest.approx(400 - (4 - np.pi) * 3**2, rel=1e-4)
    shrunk = polygon_area(points - 3 * normals)
    assert shrunk == pytest.approx(14.0**2, rel=1e-6)


def test_inertia_of_a_box_away_from_the_origin():
    solid = moved(box(20.0, 30.0, 60.0), shift_mm=np.array([100.0, -50.0, 7.0]))
    center_mm, inertia = mass_properties([(solid, 3.0)], 2.0)
    x, y, z = 20.0**2, 30.0**2, 60.0**2
    np.testing.assert_allclose(center_mm, [100.0, -50.0, 7.0], atol=1e-9)
    expected = np.diag([y + z, x + z, x + y]) * 2.0 / 12
    np.testing.assert_allclose(inertia, expected, atol=1e-6)


def test_inertia_of_a_ball():
    ball = trimesh.creation.icosphere(subdivisions=6, radius=10.0)
    solid = hull(np.asarray(ball.vertices))
    inertia = mass_properties([(solid, 1.0)], 0.5)[1]
    np.testing.assert_allclose(inertia, 0.4 * 0.5 * 100 * np.eye(3), rtol=1e-3, atol=1e-6)


def test_two_materials_pull_the_centre_to_the_denser():
    light = box(10.0, 10.0, 10.0)
    heavy = moved(light, shift_mm=np.array([20.0, 0.0, 0.0]))
    center_mm, inertia = mass_properties([(light, 1.0), (heavy, 3.0)], 4.0)
    np.testing.assert_allclose(center_mm, [15.0, 0.0, 0.0], atol=1e-9)
    # Cubes of 1 and 3 kg, 15 and 5 mm from the common centre.
    yy = 4.0 * 200 / 12 + 1 * 15**2 + 3 * 5**2
    assert inertia[1, 1] == pytest.approx(yy)


def test_a_cone_comes_to_rest_on_its_flank():
    radius, height = 10.0, 40.0
    lying = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    cone = loft(revolve(np.array([[radius, 0.0], [1e-3, height]]), 64))
    rested = settled(Shape(moved(cone, turn=lying), (moved(cone, turn=lying),)))
    vertices = rested.surface.vertices_mm
    half = np.arctan(radius / height)
    # On its flank the cone's axis slants by the half angle, and its whole flank is on the table.
    assert np.ptp(vertices[:, 2]) == pytest.approx(2 * radius * np.cos(half), rel=1e-4)
    touching = vertices[vertices[:, 2] < 0.01]
    assert np.ptp(touching[:, 1]) == pytest.approx(np.hypot(radius, height), rel=1e-3)
    np.testing.assert_allclose(rested.collision[0].vertices_mm, vertices, atol=1e-5)


def test_a_block_tips_off_its_edge_to_the_nearer_face():
    corners = np.array([[-20, -10], [20, -10], [20, 10], [-20, 10.0]])
    for given in (0.3, -0.3, 0.9):
        c, s = np.cos(given), np.sin(given)
        tilt = resting_tilt_rad(corners @ np.array([[c, s], [-s, c]]), np.zeros(2))
        nearest = -given if abs(given) < np.pi / 4 else np.pi / 2 - given
        assert tilt == pytest.approx(nearest)


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("name", OBJECTS)
def test_shipped_meshes_are_those_that_the_script_makes(name):
    """To the last bit, but for the last digit of a sine on another machine: 1e-6 mm."""
    shipped, made = load_object(packaged("objects") / name), OBJECTS[name]()
    for given, again in zip(
        (shipped.surface, *shipped.collision), (made.surface, *made.collision), strict=True
    ):
        np.testing.assert_array_equal(given.faces, again.faces)
        np.testing.assert_allclose(given.vertices_mm, again.vertices_mm, rtol=0, atol=1.5e-6)
    bodies = [(body.mesh, body.density_kg_m3) for body in made.bodies] or [(made.surface, 1.0)]
    center_mm, inertia = mass_properties(bodies, shipped.mass_kg)
    np.testing.assert_allclose(inertia, shipped.inertia_kg_mm2, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(center_mm, shipped.center_of_mass_mm, atol=0.1)


@pytest.mark.parametrize("name", ["scissors", "flat_screwdriver"])
def test_two_materials_together_weigh_about_what_was_weighed(name):
    bodies = OBJECTS[name]().bodies
    grams = sum(volume_mm3(body.mesh) * body.density_kg_m3 for body in bodies) * 1e-6
    description = read_description(packaged("objects") / name)
    assert grams == pytest.approx(description.mass_kg.value * 1e3, rel=0.25)
