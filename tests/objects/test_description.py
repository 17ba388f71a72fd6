"""``object.yaml``: every problem at once, with its place; the user's folder wins."""

import shutil

import numpy as np
import pytest
import trimesh
import yaml

from tacgen.core.errors import ObjectError
from tacgen.core.resources import packaged
from tacgen.objects import load_object
from tests.messages import refused


@pytest.fixture
def can(tmp_path, monkeypatch):
    """A copy of the soup can in the user's own folder, and its content to change."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "objects" / "tomato_soup_can"
    shutil.copytree(packaged("objects") / "tomato_soup_can", folder)
    path = folder / "object.yaml"
    return path, yaml.safe_load(path.read_text(encoding="utf-8"))


def refusal(path, content):
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    with refused(ObjectError) as caught:
        load_object("tomato_soup_can")
    return str(caught.value)


def test_the_users_own_object_wins(can):
    path, content = can
    content["mass_kg"]["value"] = 0.3
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert load_object("tomato_soup_can").mass_kg == 0.3
    assert load_object(packaged("objects") / "tomato_soup_can").mass_kg == 0.349


def test_every_problem_is_listed_with_its_place(can):
    path, content = can
    content["mass_kg"]["value"] = -1.0
    content["colour"] = [1, 2, 3]
    del content["friction"]["source"]
    content["grasp_ranges"]["z_mm"] = []
    content["shape"] = {"builder": "cylinder", "parameters": {"hight_mm": 1.0}, "source": "test"}
    message = refusal(path, content)
    for text in (
        "mass_kg.value = -1.0",
        "colour is not a known key",
        "friction.source is missing",
        "grasp_ranges.z_mm",
        "a cylinder has the parameters diameter_mm, height_mm; give exactly these",
    ):
        assert text in message
    assert "object.yaml:" in message


CYLINDER = {"diameter_mm": 66.0, "height_mm": 101.0}


def solid(builder, **parameters):
    return {"builder": builder, "parameters": parameters, "source": "test"}


def test_unknown_builder_lists_the_known_ones(can):
    path, content = can
    content["shape"] = solid("teapot")
    assert "'box', 'cylinder' or 'sphere'" in refusal(path, content)


@pytest.mark.parametrize(
    "value", [float("nan"), float("inf"), "wide", True, None, -101.0, 0.0, 1e9]
)
def test_a_dimension_that_is_no_length_is_refused(can, value):
    path, content = can
    content["shape"] = solid("cylinder", diameter_mm=66.0, height_mm=value)
    assert "height_mm" in refusal(path, content)


@pytest.mark.parametrize(
    ("builder", "parameters", "size_mm", "volume_mm3"),
    [
        ("box", {"x_mm": 20.0, "y_mm": 30.0, "z_mm": 60.0}, (20, 30, 60), 36_000.0),
        ("cylinder", CYLINDER, (66, 66, 101), np.pi * 33**2 * 101),
        ("sphere", {"diameter_mm": 50.0}, (50, 50, 50), np.pi / 6 * 50**3),
    ],
)
def test_a_solid_stands_on_the_table_and_has_its_volume(
    can, builder, parameters, size_mm, volume_mm3
):
    path, content = can
    content["shape"] = solid(builder, **parameters)
    content["dimensions_mm"]["value"] = list(size_mm)
    content["center_of_mass_mm"]["value"] = [0.0, 0.0, size_mm[2] / 2]
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    made = load_object("tomato_soup_can")
    surface = trimesh.Trimesh(made.surface.vertices_mm, made.surface.faces, process=False)
    assert surface.is_watertight
    # Chords of half a millimetre lie at most a thousandth inside a circle of this size.
    assert surface.volume == pytest.approx(volume_mm3, rel=1e-3)
    middle = np.array(size_mm) / 2
    np.testing.assert_allclose(surface.bounds[1], [*middle[:2], size_mm[2]], atol=0.01)
    np.testing.assert_allclose(surface.bounds[0], [*-middle[:2], 0.0], atol=0.01)
    (part,) = made.collision
    assert trimesh.Trimesh(part.vertices_mm, part.faces, process=False).is_convex
    np.testing.assert_allclose(np.ptp(part.vertices_mm, axis=0), size_mm, rtol=0.02)


def test_an_inertia_that_no_body_has_is_refused(can):
    path, content = can
    rows = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
    content["inertia_kg_mm2"] = {"value": rows, "source": "test"}
    assert "inertia_kg_mm2 is not symmetric with positive moments" in refusal(path, content)
    content["inertia_kg_mm2"]["value"] = np.diag([1.0, 1.0, 5.0]).tolist()
    assert "principal moments 1, 1, 5, which no body has" in refusal(path, content)


def test_a_mesh_that_is_missing_or_torn_is_refused(can):
    path, content = can
    content["shape"] = {"mesh": "surface.ply", "collision": "collision.npz", "source": "test"}
    assert "no such file, or a link" in refusal(path, content)
    (path.parent / "surface.ply").write_bytes(b"ply\nno mesh")
    assert "cannot be read" in refusal(path, content)


def test_a_mesh_outside_the_folder_is_refused(can):
    path, content = can
    content["shape"] = {"mesh": "../x.ply", "collision": "collision.npz", "source": "test"}
    assert "shape.mesh" in refusal(path, content)


def test_an_unknown_object_is_refused_with_the_known_ones():
    with refused(ObjectError):
        load_object("soup")
