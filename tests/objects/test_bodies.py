"""Meshes of several bodies: each turned outward by itself, cavities kept; slivers stay closed."""

import numpy as np
import pytest
import trimesh

from tacgen.core.errors import ObjectError
from tacgen.objects.mesh_import import import_surface
from tacgen.objects.meshes import mass_properties, volume_mm3
from tests.messages import refused


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def box(size, at=(0.0, 0.0, 0.0)):
    return trimesh.creation.box(size).apply_translation(at)


def inverted(mesh):
    mesh.invert()
    return mesh


def read(*bodies, name="mesh.stl", **options):
    trimesh.util.concatenate(bodies).export(name)
    return import_surface(name, **options)


def center_mm(surface):
    return mass_properties([(surface, 1.0)], 1.0)[0]


BODY, HANDLE = (60.0, 40.0, 80.0), (40.0, 10.0, 12.0)


@pytest.mark.parametrize("turned", [(), (0,), (1,), (0, 1)])
def test_the_handle_adds_its_mass_whichever_way_its_faces_look(turned):
    """A box with a bar that sticks 30 mm out of it: volume and centre of mass in closed form."""
    bodies = [box(BODY), box(HANDLE, (40.0, 0.0, 0.0))]
    surface, notes = read(*(inverted(b) if k in turned else b for k, b in enumerate(bodies)))
    whole, bar = 60.0 * 40.0 * 80.0, 30.0 * 10.0 * 12.0
    assert volume_mm3(surface) == pytest.approx(whole + bar, rel=1e-6)
    x = (whole * 0.0 + bar * 45.0) / (whole + bar) - 15.0  # from the middle of the footprint
    assert center_mm(surface) == pytest.approx([x, 0.0, 40.0], abs=1e-3)
    said = [f"{len(turned)} of 2 bodies turned outward"] if turned else []
    assert [note for note in notes if "turned" in note] == said


OUTER, INNER = (30.0, 40.0, 50.0), (20.0, 28.0, 30.0)
SHELL_MM3 = 30.0 * 40 * 50 - 20 * 28 * 30.0


@pytest.mark.parametrize("all_inverted", [False, True])
def test_a_closed_cavity_stays_hollow(all_inverted):
    bodies = [box(OUTER), inverted(box(INNER, (0.0, 0.0, 5.0)))]
    surface, notes = read(*map(inverted, bodies) if all_inverted else bodies)
    assert volume_mm3(surface) == pytest.approx(SHELL_MM3, rel=1e-6)
    hollow = 20 * 28 * 30.0
    z = (60_000.0 * 25.0 - hollow * 30.0) / SHELL_MM3
    assert center_mm(surface)[2] == pytest.approx(z, abs=1e-3)
    assert any("1 closed cavities of 16.8 cm³ kept" in note for note in notes)


def test_single_faces_that_look_the_wrong_way_are_turned():
    solid = box((20.0, 30.0, 40.0)).subdivide()
    solid.faces[5] = solid.faces[5][::-1]
    solid.faces[17] = solid.faces[17][::-1]
    surface, notes = read(solid, name="faces.ply")
    assert volume_mm3(surface) == pytest.approx(24_000.0, rel=1e-6)
    assert any("agree with their neighbours" in note for note in notes)


@pytest.mark.parametrize("height", [0.0, 1e-9, 1e-7, 3e-6])
@pytest.mark.parametrize("place", [0.5, 0.2])
def test_slivers_are_no_holes(height, place):
    """An edge cut at a point that lies on it, or nearly so: the triangle beyond it is a sliver."""
    solid = box((30.0, 30.0, 30.0))
    edge = solid.edges_unique[0]
    a, b = solid.vertices[edge]
    across = np.cross(b - a, [0.3, 0.5, 0.8])
    middle = a + place * (b - a) + height * across / np.linalg.norm(across)
    vertices = np.vstack([solid.vertices, middle])
    faces = []
    for k, face in enumerate(solid.faces):
        if k == next(j for j, f in enumerate(solid.faces) if set(edge) <= set(f)):
            tip = next(v for v in face if v not in edge)
            order = list(np.roll(face, -list(face).index(tip)))
            faces += [[order[0], order[1], 8], [order[0], 8, order[2]], [order[1], order[2], 8]]
        else:
            faces.append(list(face))
    cut = trimesh.Trimesh(vertices, faces, process=False)
    surface, notes = read(cut, name="sliver.ply")
    assert volume_mm3(surface) == pytest.approx(27_000.0, rel=1e-4)
    assert notes == []


def test_a_hole_is_filled_and_said_with_its_size():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=20.0)
    low = ball.triangles_center[:, 2] < -19.3
    rim_mm = 2 * np.pi * np.sqrt(20.0**2 - 19.3**2)
    ball.update_faces(~low)
    surface, notes = read(ball, name="ball.ply")
    cap = np.pi * 0.7**2 * (20.0 - 0.7 / 3)
    assert volume_mm3(surface) == pytest.approx(4 / 3 * np.pi * 20.0**3 - cap, rel=0.02)
    (note,) = [note for note in notes if "hole(s) or cracks filled" in note]
    assert float(note.split("rim of ")[1].split()[0]) == pytest.approx(rim_mm, rel=0.25)


def test_a_scan_without_its_bottom_is_closed_and_what_changed_is_said():
    """A can of 60 × 100 mm: the bottom is a tenth of the surface, and closed flat."""
    can = trimesh.creation.cylinder(radius=30.0, height=100.0, sections=128)
    can.update_faces(can.face_normals[:, 2] > -0.9)
    surface, notes = read(can, name="can.ply")
    area = 64 * 900.0 * np.sin(2 * np.pi / 128)
    assert volume_mm3(surface) == pytest.approx(100 * area, rel=1e-5)
    np.testing.assert_allclose(center_mm(surface), [0, 0, 50], atol=1e-3)
    (note,) = [note for note in notes if "filled" in note]
    share = np.pi * 30**2 / (2 * np.pi * 30**2 + np.pi * 60 * 100)
    assert float(note.split("; ")[1].split()[0]) == pytest.approx(100 * share, abs=0.5)
    # Without the bottom the faces about the middle enclose a sixth less.
    before, after = (float(word.split()[0]) for word in note.split("volume ")[1].split(" → "))
    assert before == pytest.approx(5 / 6 * after, rel=1e-3)
    assert "centre of mass moved by" in note


def test_a_crack_along_a_seam_is_zipped_up():
    """Both sides of the seam have corners of their own, 0.02 mm apart, not at the same places."""
    upper = trimesh.creation.cylinder(radius=20.0, height=30.0, sections=90)
    lower = trimesh.creation.cylinder(radius=20.0, height=30.0, sections=77)
    upper.update_faces(upper.face_normals[:, 2] > -0.9)
    lower.update_faces(lower.face_normals[:, 2] < 0.9)
    upper.apply_translation([0, 0, 15.01])
    lower.apply_translation([0, 0, -15.01])
    surface, _ = read(upper, lower, name="seam.ply")
    assert volume_mm3(surface) == pytest.approx(np.pi * 400 * 60, rel=5e-3)
    np.testing.assert_allclose(center_mm(surface)[:2], 0, atol=0.05)


def test_parts_whose_open_ends_lie_inside_another_are_whole():
    """A spout's root is open within the pot: its cap is not part of the surface."""
    pot = trimesh.creation.cylinder(radius=30.0, height=60.0, sections=96)
    spout = trimesh.creation.cylinder(radius=8.0, height=40.0, sections=48)
    turn = trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
    spout.apply_transform(turn).apply_translation([40.0, 0.0, 0.0])
    whole = trimesh.boolean.union([pot, spout], engine="manifold")
    spout.update_faces(spout.face_normals[:, 0] > -0.9)
    surface, notes = read(pot, spout, name="pot.ply")
    assert volume_mm3(surface) == pytest.approx(whole.volume, rel=1e-4)
    (note,) = [note for note in notes if "filled" in note]
    assert "; 0 % of the surface" in note


def test_a_strip_with_one_side_is_refused():
    """A Möbius strip encloses nothing, however its faces are turned."""
    around = np.linspace(0.0, 2 * np.pi, 61)[:-1]
    rows = [
        np.stack(
            [
                (30 + w * np.cos(around / 2)) * np.cos(around),
                (30 + w * np.cos(around / 2)) * np.sin(around),
                w * np.sin(around / 2),
            ],
            axis=1,
        )
        for w in (-10.0, 10.0)
    ]
    faces = []
    for k in range(60):
        here, there = (k, k + 60), ((k + 1), (k + 61)) if k < 59 else (60, 0)
        faces += [[here[0], there[0], here[1]], [there[0], there[1], here[1]]]
    with refused(ObjectError):
        read(trimesh.Trimesh(np.vstack(rows), faces, process=False), name="strip.ply")


def test_a_tilted_bar_is_as_wide_as_across_it():
    """140 mm along each axis, 30 mm thick: a gripper that opens 110 mm holds it."""
    turn = trimesh.transformations.rotation_matrix(np.pi / 4, [1, 1, 0.3])
    bar = box((30.0, 30.0, 240.0)).apply_transform(turn)
    assert np.ptp(bar.vertices, axis=0).min() > 110.0
    surface, _ = read(bar)
    assert volume_mm3(surface) == pytest.approx(30.0 * 30 * 240, rel=1e-5)
    with refused(ObjectError):
        read(box((130.0, 130.0, 240.0)).apply_transform(turn))
