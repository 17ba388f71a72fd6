"""Grasps that are suggested show something: where, and from just failing to firm."""

import numpy as np
import pytest
import trimesh

from tacgen.collection.recipe import load_recipe
from tacgen.core.records import Mesh
from tacgen.objects.add import MeshFacts, _turned, add_object
from tacgen.objects.grasp_ranges import FORCES_N, _heights, suggest_places
from tacgen.objects.showing import is_shown
from tacgen.objects.trial import SUCCESSES, _mixed
from validation.objects.visible_grasps import measured, recipe_of

BOX_MM = (60.0, 90.0, 120.0)
MUG_MM = 40.0  # radius of its body


def surface_of(solid):
    """The solid as an object: standing, the middle of its bounding box over the origin."""
    low, high = solid.bounds
    solid.apply_translation([*-(low + high)[:2] / 2, -low[2]])
    return Mesh(np.array(solid.vertices), np.array(solid.faces, dtype=np.int32))


def places_of(solid, mass_kg):
    surface = surface_of(solid)
    center_y_mm = float(solid.center_mass[1])
    ranges, notes = suggest_places(surface, mass_kg=mass_kg, center_y_mm=center_y_mm, friction=0.4)
    return surface, ranges, notes


def mug():
    """A mug with its handle along +y: the middle of its bounding box is 19 mm beside its axis."""
    body = trimesh.creation.cylinder(radius=MUG_MM, height=82.0, sections=180)
    handle = trimesh.creation.annulus(18.0, 26.0, height=10.0)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    handle.apply_translation([0.0, 52.0, 0.0])
    hollow = trimesh.creation.cylinder(radius=37.0, height=80.0, sections=180)
    hollow.apply_translation([0.0, 0.0, 4.0])
    whole = trimesh.boolean.union([body, handle], engine="manifold")
    return trimesh.boolean.difference([whole, hollow], engine="manifold")


def wrench():
    """A flat bar of 14 × 150 mm, 6 mm high, that lies on the table."""
    return trimesh.creation.box((14.0, 150.0, 6.0))


@pytest.mark.slow
def test_a_mug_is_held_by_its_body_and_not_by_the_middle_of_its_bounding_box():
    _, ranges, notes = places_of(mug(), 0.3)
    axis_mm = MUG_MM - (MUG_MM + 52.0 + 26.0) / 2
    assert notes == []
    assert min(abs(y - axis_mm) for y in ranges["y_mm"]) <= 1.0
    # A domed pad beside the axis touches beside its own middle by 30/(30 + 40) of the distance.
    assert max(abs(y - axis_mm) for y in ranges["y_mm"]) < 7.0 * 70.0 / 30.0


def test_a_mug_whose_handle_lies_under_a_finger_is_turned():
    """118 mm with its handle do not fit between the fingers, which would meet its rim alone."""
    across = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 0, 1])
    yaw_rad, turned, notes = _turned(surface_of(mug().apply_transform(across)), None)
    assert np.abs(turned.vertices_mm[:, 0]).max() < 55.0  # the fingers open 110 mm
    assert np.degrees(abs(yaw_rad)) > 25.0  # a finger is 20 mm wide, and beside the handle
    assert "turned by" in notes[0]


@pytest.mark.slow
def test_a_wrench_of_6_mm_is_held_as_near_the_pads_middle_as_the_table_allows_and_seen():
    surface, ranges, _ = places_of(wrench(), 0.12)
    assert ranges["z_mm"] == (10.5,)  # the pads' lower edge is 1 mm above the table
    assert all(is_shown(surface, y, 10.5, 5.0) for y in ranges["y_mm"])
    assert min(abs(y) for y in ranges["y_mm"]) <= 1.0  # by its middle


def test_a_tall_box_is_held_where_the_palm_clears_its_top_and_by_its_rim():
    lowest_mm, *_, below_mm, rim_mm = _heights(
        surface_of(trimesh.creation.box((70.0, 60.0, 213.0)))
    )
    assert lowest_mm == 213.0 - 150.0 + 5.0  # the fingers are 150 mm long, and 5 mm are clear
    assert (below_mm, rim_mm) == (213.0 - 6.0, 213.0 - 3.0)


def test_forces_are_taken_about_those_that_just_hold():
    """Of two places that hold from 5 and 10 N on and show from 2 N: about half of the grasps."""
    ranges = {"force_n": FORCES_N, "x_mm": (0.0,), "y_mm": (0.0, 10.0), "z_mm": (20.0,)}
    holds = {(0.0, 20.0): FORCES_N.index(5.0), (10.0, 20.0): FORCES_N.index(10.0)}
    chosen, notes = _mixed(ranges, holds, dict.fromkeys(holds, FORCES_N.index(2.0)))
    forces = np.array(chosen["force_n"])
    successes = np.mean([forces >= 5.0, forces >= 10.0])
    assert SUCCESSES[0] <= successes <= SUCCESSES[1]
    assert forces.min() >= 2.0
    assert chosen["y_mm"] == (0.0, 10.0)
    assert notes == []


def test_a_place_that_cannot_be_executed_is_left_out_and_one_sided_labels_are_noted():
    ranges = {"force_n": FORCES_N, "x_mm": (0.0,), "y_mm": (0.0, 10.0), "z_mm": (20.0,)}
    chosen, notes = _mixed(ranges, {(0.0, 20.0): 0}, {(0.0, 20.0): 0})
    assert chosen["y_mm"] == (0.0,)
    assert "about 100 % of the suggested grasps hold" in notes[0]


@pytest.mark.exhaustive
@pytest.mark.slow
def test_added_objects_show_their_grasps_in_every_sensor_with_both_labels(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    solids = {"crate": (trimesh.creation.box(BOX_MM), 0.4), "mug": (mug(), 0.3)}
    for name, (solid, mass_kg) in solids.items():
        solid.export(f"{name}.stl")
        add_object(f"{name}.stl", MeshFacts(mass_kg))
    for sensor in ("gelsight", "gelsight_mini", "digit"):
        rows = [row for name in solids for row in measured(recipe_of(name, 16, sensor))]
        assert sum(row.visible for row in rows) >= 0.9 * sum(row.executed for row in rows), rows
        for row in rows:
            assert 0.25 <= row.successes / row.executed <= 0.75, row


@pytest.mark.slow
def test_grasps_of_quickstart_show_their_contact_with_both_labels(tmp_path, monkeypatch):
    recipe = load_recipe("quickstart")
    assert recipe.grid.force_n is recipe.grid.y_mm is recipe.grid.z_mm is None
    monkeypatch.chdir(tmp_path)
    shown_and_mixed([entry.name for entry in recipe.objects], recipe.sensor.name)


def shown_and_mixed(names, sensor):
    """Of some objects' own ranges 95 % of the grasps are seen, and 25 to 75 % of each hold."""
    rows = [row for name in names for row in measured(recipe_of(name, 20, sensor))]
    assert sum(row.visible for row in rows) >= 0.95 * sum(row.executed for row in rows), rows
    for row in rows:
        assert 0.25 <= row.successes / row.executed <= 0.75, row
