"""Objects that cannot stand as given are rested; suggested grasps are tried before written."""

import numpy as np
import pytest
import trimesh

from tacgen.core.records import Mesh
from tacgen.objects import load_object
from tacgen.objects.add import MeshFacts, add_object
from tacgen.objects.meshes import mass_properties
from tacgen.physics import rest


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def mesh_of(solid):
    return Mesh(np.array(solid.vertices), np.array(solid.faces, dtype=np.int32))


def toppled(surface):
    """Of a solid, evenly filled."""
    return rest.toppled(surface.vertices_mm, mass_properties([(surface, 1.0)], 1.0)[0])


def turned(solid, angle_deg, axis):
    turn = trimesh.transformations.rotation_matrix(np.radians(angle_deg), axis)
    return solid.apply_transform(turn)


def angle_deg(rotation):
    return np.degrees(np.arccos((np.trace(rotation) - 1) / 2))


def box(x=30.0, y=40.0, z=80.0):
    return trimesh.creation.box((x, y, z))


@pytest.mark.parametrize("lean_deg", [3.0, 9.0, 20.0, 26.0])
def test_a_leaning_box_falls_back_before_and_over_beyond_its_critical_angle(lean_deg):
    """Its centre of mass is over the edge at atan(40 / 80) = 26.6°."""
    rotation = toppled(mesh_of(turned(box(), lean_deg, [1, 0, 0])))
    np.testing.assert_allclose(rotation, turn_about_x(-lean_deg), atol=1e-6)
    over = 53.0 - lean_deg  # beyond it
    rotation = toppled(mesh_of(turned(box(), over, [1, 0, 0])))
    np.testing.assert_allclose(rotation, turn_about_x(90.0 - over), atol=1e-6)


def turn_about_x(degrees):
    return trimesh.transformations.rotation_matrix(np.radians(degrees), [1, 0, 0])[:3, :3]


@pytest.mark.parametrize(
    "solid",
    [
        box(),
        box(1.5, 60.0, 60.0),
        trimesh.creation.cylinder(radius=20.0, height=60.0),
        trimesh.creation.icosphere(subdivisions=4, radius=20.0),
        turned(trimesh.creation.cylinder(radius=20.0, height=60.0, sections=64), 90.0, [1, 0, 0]),
        turned(box(), 1.0, [0, 1, 0]),
    ],
)
def test_what_stands_or_rolls_freely_is_left(solid):
    assert toppled(mesh_of(solid)) is None


def overhang():
    """A foot of 20 mm below a slab that reaches 80 mm to one side."""
    foot = trimesh.creation.box((20.0, 30.0, 40.0)).apply_translation([0, 0, 20])
    slab = trimesh.creation.box((100.0, 30.0, 10.0)).apply_translation([40.0, 0, 45.0])
    return trimesh.boolean.union([foot, slab], engine="manifold")


def test_an_overhang_topples_to_its_hull_and_lies_flat():
    surface = mesh_of(overhang())
    rotation = toppled(surface)
    # About y, until the foot's edge and the slab's lower one are level: atan(40 / 80).
    assert angle_deg(rotation) == pytest.approx(np.degrees(np.arctan2(40.0, 80.0)), abs=0.01)
    lying = surface.vertices_mm @ rotation.T
    assert (np.abs(lying[:, 2] - lying[:, 2].min()) < 1e-6).sum() >= 4


def test_the_import_rests_it_and_says_how():
    turned(box(), 20.0, [1, 0, 0]).export("leaning.stl")
    added = add_object("leaning.stl", MeshFacts(0.1))
    size = np.ptp(added.object.surface.vertices_mm, axis=0)
    np.testing.assert_allclose(size, [30.0, 40.0, 80.0], atol=1e-3)
    assert "turned by 20° about (-1.00, 0.00, 0.00)" in added.notes[0]
    kept = add_object("leaning.stl", MeshFacts(0.1, keep_pose=True), force=True)
    assert np.ptp(kept.object.surface.vertices_mm[:, 2]) > 85.0
    (note,) = [note for note in kept.notes if "topples" in note]
    assert note.startswith("none of the suggested grasps can be executed (the object topples by 20")


def mug(handle_deg):
    """A cup of 80 mm with a handle that reaches 35 mm out of it."""
    outer = trimesh.creation.cylinder(radius=40.0, height=90.0, sections=96)
    inner = trimesh.creation.cylinder(radius=36.0, height=90.0, sections=96)
    ring = trimesh.creation.annulus(r_min=20.0, r_max=28.0, height=12.0, sections=48)
    turned(ring, 90.0, [1, 0, 0]).apply_translation([47.0, 0.0, 0.0])
    cup = trimesh.boolean.union([outer, ring], engine="manifold")
    cup = trimesh.boolean.difference([cup, inner.apply_translation([0, 0, 5.0])], engine="manifold")
    return turned(cup, handle_deg, [0, 0, 1])


@pytest.mark.slow
@pytest.mark.parametrize("handle_deg", [0.0, 90.0])
def test_a_mug_can_be_grasped_as_suggested_wherever_its_handle_points(handle_deg):
    mug(handle_deg).export("mug.stl")
    added = add_object("mug.stl", MeshFacts(0.3))
    notes = "\n".join(added.notes)
    assert "none of the suggested" not in notes
    assert ("turned by" in notes) is (handle_deg == 0.0)
    assert np.ptp(added.object.surface.vertices_mm[:, 0]) < 100.0
    ranges = load_object("mug").grasp_ranges
    assert ranges["z_mm"]
    # The handle's 35 mm are half beside the middle of the bounding box: there is no body.
    assert min(abs(abs(y_mm) - 17.5) for y_mm in ranges["y_mm"]) < 1.0


def test_heights_at_which_nothing_is_met_are_not_suggested():
    """A bar on two high feet: below 50 mm there is nothing between them."""
    bar = trimesh.creation.box((30.0, 120.0, 20.0)).apply_translation([0, 0, 60.0])
    feet = [
        trimesh.creation.box((30.0, 15.0, 55.0)).apply_translation([0, y, 27.5]) for y in (-52, 52)
    ]
    trimesh.boolean.union([bar, *feet], engine="manifold").export("bridge.stl")
    added = add_object("bridge.stl", MeshFacts(0.2))
    assert min(added.object.grasp_ranges["z_mm"]) > 40.0
