"""A user's own mesh: what is repaired, what is refused with its mend, what is written."""

import json
import os
import re

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import ObjectError
from tacgen.core.records import Mesh
from tacgen.core.resources import find_object_folder
from tacgen.objects import load_object
from tacgen.objects.add import STEPS, MeshFacts, add_object, meshes_in, object_name
from tacgen.objects.cutting import convex_parts, cut_again
from tacgen.objects.grasp_ranges import largest_grid, touch_error_mm, touch_errors
from tacgen.objects.mesh_import import import_surface
from tacgen.objects.meshes import volume_mm3
from tacgen.physics import GraspSimulator
from tests.messages import refused
from validation.physics.hold_thresholds import BY_FLATS, holds, imported


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def one_place(monkeypatch):
    """One place to grasp, which is not tried: what finds them takes most of an import's time."""
    ranges = {"force_n": (5.0, 20.0), "x_mm": (0.0,), "y_mm": (0.0,), "z_mm": (20.0, 30.0)}
    monkeypatch.setattr("tacgen.objects.add.suggest_places", lambda *_, **__: (ranges, []))
    monkeypatch.setattr("tacgen.objects.add.tried_ranges", lambda thing: (thing.grasp_ranges, []))


def box(x=30.0, y=40.0, z=60.0):
    return trimesh.creation.box((x, y, z)).subdivide()


def exported(mesh, name):
    mesh.export(name)
    return name


def test_a_box_in_metres_becomes_an_object_by_name(own_folder):
    solid = box().apply_translation([500.0, 20.0, -7.0]).apply_scale(1e-3)
    added = add_object(exported(solid, "tea_box.stl"), MeshFacts(0.2, scale=1000.0, friction=0.5))
    assert find_object_folder("tea_box") == added.object.folder
    obj = load_object("tea_box")
    low, high = obj.surface.vertices_mm.min(axis=0), obj.surface.vertices_mm.max(axis=0)
    np.testing.assert_allclose(low, [-15, -20, 0], atol=1e-3)
    np.testing.assert_allclose(high, [15, 20, 60], atol=1e-3)
    np.testing.assert_allclose(obj.center_of_mass_mm, [0, 0, 30], atol=1e-3)
    x, y, z = 30.0**2, 40.0**2, 60.0**2
    expected = np.diag([y + z, x + z, x + y]) * 0.2 / 12
    np.testing.assert_allclose(obj.inertia_kg_mm2, expected, rtol=1e-4, atol=1e-4)
    assert obj.friction == 0.5
    assert len(obj.collision) == 1
    assert volume_mm3(obj.collision[0]) == pytest.approx(30 * 40 * 60, rel=1e-3)
    # mg/(2μ) = 1.96 N, and more beside the centre of mass, which pads hold by an arm of 3.5 mm.
    least_n = 1.96 * np.hypot(1.0, max(obj.grasp_ranges["y_mm"]) / 3.5)
    assert min(obj.grasp_ranges["force_n"]) < least_n < max(obj.grasp_ranges["force_n"])
    assert all(0 < z_mm < 60 for z_mm in obj.grasp_ranges["z_mm"])
    assert sorted(path.name for path in own_folder.joinpath("objects").iterdir()) == ["tea_box"]


@pytest.mark.parametrize("kind", ["obj", "stl", "ply", "glb"])
def test_every_format_gives_the_same_solid(kind):
    surface = import_surface(exported(box(), f"solid.{kind}"))[0]
    assert volume_mm3(surface) == pytest.approx(30 * 40 * 60, rel=1e-5)
    assert trimesh.Trimesh(surface.vertices_mm, surface.faces, process=False).is_watertight


def test_the_up_axis_is_turned_to_z_without_mirroring():
    solid = trimesh.creation.cone(radius=10.0, height=50.0)
    for up, turn in (("y", [1, 0, 0]), ("x", [0, 1, 0])):
        angle = -np.pi / 2 if up == "y" else np.pi / 2
        lying = solid.copy().apply_transform(trimesh.transformations.rotation_matrix(angle, turn))
        surface = import_surface(exported(lying, f"cone_{up}.stl"), up=up)[0]
        tip = surface.vertices_mm[np.argmax(surface.vertices_mm[:, 2])]
        np.testing.assert_allclose(tip, [0, 0, 50], atol=1e-3)
        assert volume_mm3(surface) > 0


def test_unmerged_corners_inward_faces_and_a_small_hole_are_mended():
    solid = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    solid.update_faces(np.arange(len(solid.faces)) != 100)
    solid.invert()
    solid.unmerge_vertices()
    surface, notes = import_surface(exported(solid, "ball.ply"))
    closed = trimesh.Trimesh(surface.vertices_mm, surface.faces, process=False)
    assert closed.is_watertight
    assert closed.is_winding_consistent
    assert closed.volume == pytest.approx(4 / 3 * np.pi * 20**3, rel=0.02)
    assert any("hole" in note for note in notes)


def message_for(mesh, file_name, **arguments):
    path = exported(mesh, file_name) if mesh is not None else file_name
    facts = MeshFacts(**{"mass_kg": 0.1, **arguments})
    with refused(ObjectError) as caught:
        add_object(path, facts)
    assert not os.path.exists("objects")
    return str(caught.value)


def test_metres_taken_for_millimetres_are_refused_with_the_scale_that_mends_it(one_place):
    small = box().apply_scale(1e-3)
    message_for(small, "small.stl")
    assert add_object("small.stl", MeshFacts(0.1, scale=1000.0)).object.mass_kg == 0.1


def test_too_large_is_refused():
    message_for(box(300, 300, 300), "crate.stl")


def test_a_sheet_is_refused_with_its_open_edges_and_how_much_is_missing():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=30.0)
    ball.update_faces(ball.triangles_center[:, 0] > 0)
    message = message_for(ball, "sheet.stl")
    found = re.search(r"(\d+) open edges, and (\d+) % of the surface would be invented", message)
    assert int(found[1]) > 20
    # Of half a ball the flat side: π r² of 3 π r².
    assert int(found[2]) == pytest.approx(33, abs=3)


def test_a_nan_is_refused():
    text = "v 0 0 0\nv 30 0 0\nv 0 30 nan\nv 0 0 30\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    with open("nan.obj", "w", encoding="utf-8") as file:
        file.write(text)
    message_for(None, "nan.obj")


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        ("obj", b""),
        ("stl", b"not a mesh at all"),
        ("ply", b"ply\nformat ascii 1.0\n"),
        ("glb", b""),
    ],
)
def test_files_that_are_no_meshes_are_refused(content, kind):
    name = f"broken.{kind}"
    with open(name, "wb") as file:
        file.write(content)
    message_for(None, name)


def test_missing_and_foreign_files_are_refused():
    message_for(None, "absent.stl")
    exported(box(), "box.off")
    message_for(None, "box.off")


def test_every_bad_argument_is_named_at_once():
    message_for(box(), "b.stl", name="../escape", mass_kg=-1.0, scale=0.0, friction=9.0, up="w")


def test_grams_for_kilograms_are_refused():
    message_for(box(), "heavy.stl", mass_kg=200.0)


@pytest.mark.parametrize(
    ("files", "names"),
    [
        (["025_mug/google_16k/textured.obj", "Big-Box/tsdf/textured.obj"], ["025_mug", "big_box"]),
        (["A_Bin/meshes/model.obj", "cup/meshes/model.obj"], ["a_bin", "cup"]),
        (["a/mug.obj", "b/mug.obj"], ["mug", "mug"]),
        (["bowl/urdf/visual/mesh.stl"], ["bowl"]),
    ],
)  # fmt: skip
def test_a_tree_s_meshes_have_the_nearest_name_that_says_something(tmp_path, files, names):
    for file in files:
        (tmp_path / "tree" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tree" / file).write_bytes(b"")
    meshes, others = meshes_in(tmp_path / "tree")
    assert [str(mesh.relative_to(tmp_path / "tree")) for mesh in meshes] == sorted(files)
    assert sorted(map(object_name, meshes)) == sorted(names)
    assert not others


def test_of_an_object_s_meshes_one_is_taken(tmp_path):
    folder = tmp_path / "ycb" / "025_mug"
    files = ["clouds/merged_cloud.ply", "google_16k/nontextured.stl", "google_16k/textured.obj"]
    files += ["poisson/textured.obj"]
    for file in files:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(b"")
    meshes, others = meshes_in(tmp_path / "ycb")
    assert meshes == [folder / "google_16k" / "textured.obj"]
    assert others == sorted(folder / file for file in files if file != files[2])


def test_an_existing_object_is_kept_unless_forced(own_folder, one_place):
    exported(box(), "thing.stl")
    add_object("thing.stl", MeshFacts(0.1))
    with refused(ObjectError):
        add_object("thing.stl", MeshFacts(0.3))
    assert load_object("thing").mass_kg == 0.1
    add_object("thing.stl", MeshFacts(0.3), force=True)
    assert load_object("thing").mass_kg == 0.3
    (own_folder / "objects" / "notes").mkdir()
    with refused(ObjectError):
        add_object("thing.stl", MeshFacts(0.3, name="notes"), force=True)
    assert sorted(os.listdir("objects")) == ["notes", "thing"]


def test_a_folder_that_cannot_be_written_leaves_nothing(own_folder, monkeypatch, one_place):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tacgen.objects.add.write_meshes", full)
    with refused(ObjectError):
        add_object(exported(box(), "thing.stl"), MeshFacts(0.1))
    assert os.listdir("objects") == []


def test_an_l_shape_is_decomposed_into_convex_parts_the_same_way_twice():
    first = trimesh.creation.box((20.0, 20.0, 80.0))
    second = trimesh.creation.box((80.0, 20.0, 20.0)).apply_translation([30.0, 0.0, -30.0])
    solid = trimesh.boolean.union([first, second], engine="manifold")
    surface = Mesh(np.array(solid.vertices), np.array(solid.faces, dtype=np.int32))
    parts, again = convex_parts(surface), convex_parts(surface)
    assert len(parts) >= 2
    assert sum(volume_mm3(part) for part in parts) == pytest.approx(solid.volume, rel=0.1)
    for part, other in zip(parts, again, strict=True):
        np.testing.assert_array_equal(part.vertices_mm, other.vertices_mm)


def can(sections):
    """An upright cylinder of 66 × 100 mm."""
    solid = trimesh.creation.cylinder(radius=33.0, height=100.0, sections=sections)
    return solid.apply_transform(trimesh.transformations.rotation_matrix(0.11, [0, 0, 1]))


def test_a_convex_mesh_keeps_all_its_vertices():
    surface, _ = import_surface(exported(can(256), "can.stl"))
    (part,) = convex_parts(surface)
    assert sorted(map(tuple, part.vertices_mm.round(3))) == sorted(
        map(tuple, surface.vertices_mm[surface.vertices_mm[:, :2].any(axis=1)].round(3))
    )


def test_adding_reports_how_well_the_collision_shape_follows_the_surface():
    notes = add_object(exported(can(256), "can.stl"), MeshFacts(0.3)).notes
    assert any("(1 convex) within 0.0" in note and "° of the surface" in note for note in notes)
    ball = trimesh.creation.icosphere(subdivisions=5, radius=25.0)
    notes = add_object(exported(ball, "ball.stl"), MeshFacts(0.3)).notes
    # How far across depends on the place that is suggested; a ball's facets are up to 0.3 mm off.
    assert any(re.search(r"\(1 convex\) within 0\.00 mm along x, 0\.[0-3] mm", n) for n in notes)
    egg = ball.apply_scale((1.0, 1.0, 1.2))
    notes = add_object(exported(egg, "egg.stl"), MeshFacts(0.3)).notes
    assert any("of the surface, more than 0.6 mm" in note for note in notes)


@pytest.mark.slow
def test_a_finer_cut_follows_a_curved_waist_more_closely():
    """A turned body with a waist of 52 mm, curved over its whole height, between ends of 60 mm."""
    z_mm = np.linspace(0.0, 100.0, 81)
    profile = np.stack([26.0 + 4.0 * (z_mm / 50.0 - 1.0) ** 2, z_mm], axis=1)
    solid = trimesh.creation.revolve(np.array([(0, 0), *profile, (0, 100)]), sections=90)
    surface, _ = import_surface(exported(solid, "waist.stl"))
    ranges = {"y_mm": (0.0,), "z_mm": (25.0, 50.0, 75.0)}
    parts = convex_parts(surface)
    errors_mm = [touch_error_mm(touch_errors(surface, parts, ranges))]
    for _ in range(2):
        which = {error.part for error in touch_errors(surface, parts, ranges)}
        finer = cut_again(surface, parts, which)
        assert len(finer) > len(parts)
        parts = finer
        errors_mm.append(touch_error_mm(touch_errors(surface, parts, ranges)))
    assert errors_mm[2][0] < errors_mm[0][0]
    assert sum(map(volume_mm3, parts)) < 1.03 * volume_mm3(surface)


@pytest.mark.parametrize(
    ("bad", "grid"),
    [
        ([], ((-1.0, 0.0, 1.0), (10.0, 20.0))),
        ([(0.0, 10.0)], ((-1.0, 1.0), (10.0, 20.0))),
        ([(-1.0, 10.0), (0.0, 10.0), (1.0, 10.0)], ((-1.0, 0.0, 1.0), (20.0,))),
        ([(-1.0, 10.0), (0.0, 10.0)], ((-1.0, 0.0, 1.0), (20.0,))),
    ],
)
def test_the_largest_grid_without_bad_places_is_kept(bad, grid):
    ranges = {"force_n": (1.0,), "y_mm": (-1.0, 0.0, 1.0), "z_mm": (10.0, 20.0)}
    kept = largest_grid(ranges, bad)
    assert (kept["y_mm"], kept["z_mm"]) == grid
    assert kept["force_n"] == (1.0,)
    assert largest_grid(ranges, [(y, z) for y in ranges["y_mm"] for z in ranges["z_mm"]]) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "angle_rad"),
    [
        pytest.param("cylinder_16", 0.37, marks=pytest.mark.exhaustive),
        ("cylinder_256", 0.0),
        pytest.param("bottle", 0.37, marks=pytest.mark.exhaustive),
        ("sphere_4", 0.0),
    ],
)
def test_an_imported_mesh_holds_from_the_closed_form_on(name, angle_rad):
    """An import that simplified it held the cylinder of 256 sections from 1.15 mg/(2μ) on."""
    obj = imported(name, angle_rad)
    yaw_rad = angle_rad if name in BY_FLATS else 0.0
    with GraspSimulator() as simulator:
        assert not holds(simulator, obj, 0.4, yaw_rad, 0.97)
        assert holds(simulator, obj, 0.4, yaw_rad, 1.03)


@pytest.mark.slow
def test_the_commands_add_list_and_show(own_folder, one_place):
    runner = CliRunner()
    exported(box(), "my_box.stl")
    added = runner.invoke(app, ["objects", "add", "my_box.stl", "--mass", "0.25", "--json"])
    assert added.exit_code == 0, added.output
    listed = runner.invoke(app, ["objects", "list", "--json"])
    row = next(row for row in json.loads(listed.stdout) if row["name"] == "my_box")
    assert row["mass_kg"] == 0.25
    assert row["from"] == os.path.join("objects", "my_box")
    shown = runner.invoke(app, ["objects", "show", "my_box", "--out", "my_box.png"])
    assert shown.exit_code == 0, shown.output
    assert "given when the mesh was added" in shown.stdout
    picture = np.frombuffer((own_folder / "my_box.png").read_bytes()[:8], dtype=np.uint8)
    assert picture.tobytes() == b"\x89PNG\r\n\x1a\n"


def test_a_broken_object_does_not_hide_the_others(own_folder):
    (own_folder / "objects" / "torn").mkdir(parents=True)
    (own_folder / "objects" / "torn" / "object.yaml").write_text("name: torn\nmass: 3\n")
    listed = CliRunner().invoke(app, ["objects", "list"])
    assert listed.exit_code == 0
    assert "tomato_soup_can" in listed.stdout
    assert "mass is not a known key" in listed.stdout


def nut(turned_rad):
    """A hexagonal prism, 20 mm from corner to corner and 12 mm high; its corners point to x."""
    solid = trimesh.creation.cylinder(radius=10.0, height=12.0, sections=6)
    return solid.apply_transform(trimesh.transformations.rotation_matrix(turned_rad, [0, 0, 1]))


def suggested_yaw(notes):
    found = [re.search(r"--yaw (-?[0-9.]+)", note) for note in notes]
    return next((float(match[1]) for match in found if match), None)


def test_a_nut_is_to_be_grasped_by_its_flats(one_place):
    turned_deg = 12.0
    added = add_object(exported(nut(np.radians(turned_deg)), "nut.stl"), MeshFacts(0.02))
    yaw_rad = suggested_yaw(added.notes)
    # Flats face 30° from the corners, and every 60°.
    off_deg = (np.degrees(yaw_rad) - turned_deg - 30.0) % 60.0
    assert min(off_deg, 60.0 - off_deg) <= 1.5
    again = add_object("nut.stl", MeshFacts(0.02, yaw_rad=yaw_rad), force=True)
    assert suggested_yaw(again.notes) is None
    width_mm = np.ptp(again.object.surface.vertices_mm[:, 0])
    assert width_mm == pytest.approx(20.0 * np.cos(np.pi / 6), abs=0.3)


@pytest.mark.parametrize(("sections", "seen"), [(24, True), (360, False)])
def test_facets_that_the_gel_would_show_are_noted(sections, seen, one_place):
    solid = trimesh.creation.cylinder(radius=15.0, height=60.0, sections=sections)
    notes = add_object(exported(solid, "can.stl"), MeshFacts(0.1)).notes
    facets = [note for note in notes if "facets" in note]
    assert bool(facets) is seen
    if seen:
        # The chord of one section and the angle between two, in closed form.
        chord_mm, angle_deg = 30.0 * np.sin(np.pi / sections), 360.0 / sections
        assert f"facets of {chord_mm:.1f} mm meet at {angle_deg:.0f}°" in facets[0]


def test_adding_shows_a_picture(own_folder, one_place):
    exported(box(), "tea_box.stl")
    done = CliRunner().invoke(app, ["objects", "add", "tea_box.stl", "--mass", "0.2"])
    assert "look at objects/tea_box/picture.png" in done.stderr
    for step in STEPS:
        assert f"tacgen: tea_box.stl: {step}" in done.stderr
    assert (own_folder / "objects" / "tea_box" / "picture.png").stat().st_size > 10_000


def test_a_folder_of_meshes_is_added_and_what_is_refused_is_said(own_folder, one_place):
    (own_folder / "scans").mkdir()
    exported(box(), "scans/tea_box.stl")
    exported(box(25.0, 25.0, 50.0), "scans/post.ply")
    (own_folder / "scans/torn.obj").write_text("v 0 0 0\n")
    (own_folder / "scans/notes.txt").write_text("none of them")
    done = CliRunner().invoke(app, ["objects", "add", "scans", "--mass", "0.2", "--json"])
    assert done.exit_code == 0, done.output
    assert [row["name"] for row in json.loads(done.stdout)] == ["post", "tea_box"]
    assert "refused: scans/torn.obj: holds no triangles" in done.stderr
    both = CliRunner().invoke(app, ["objects", "add", "scans", "--mass", "0.2", "--name", "a"])
    assert "--name is for one mesh" in str(both.exception)
