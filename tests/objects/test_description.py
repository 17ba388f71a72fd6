"""``object.yaml``: every problem at once, with its place; the user's folder wins."""

import shutil

import pytest
import yaml

from tacgen.core.errors import ObjectError
from tacgen.core.resources import packaged
from tacgen.objects import load_object


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
    with pytest.raises(ObjectError) as caught:
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
    content["shape"]["parameters"] = {"hight_mm": 101.0, "body_diameter_mm": 66.0}
    message = refusal(path, content)
    for text in (
        "mass_kg.value = -1.0",
        "colour is not a known key",
        "friction.source is missing",
        "grasp_ranges.z_mm",
        "parameters.hight_mm is not one of round_can's",
        "parameters.height_mm is missing",
        "parameters.seam_diameter_mm is missing",
    ):
        assert text in message
    assert "object.yaml:" in message


def test_unknown_builder_lists_the_known_ones(can):
    path, content = can
    content["shape"]["builder"] = "teapot"
    assert "known: carton, drawn_can" in refusal(path, content)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), "wide", True, None])
def test_a_parameter_that_is_no_number_is_refused(can, value):
    path, content = can
    content["shape"]["parameters"]["height_mm"] = value
    assert "height_mm" in refusal(path, content)


@pytest.mark.parametrize("value", [-101.0, 0.0, 1e9])
def test_dimensions_that_make_no_object_are_refused(can, value):
    path, content = can
    content["shape"]["parameters"]["height_mm"] = value
    assert "tomato_soup_can" in refusal(path, content)


def test_a_name_that_is_not_the_folders_is_refused(can):
    path, content = can
    content["name"] = "soup"
    assert "make them the same" in refusal(path, content)


def test_ranges_may_be_a_linspace(can):
    path, content = can
    content["grasp_ranges"]["force_n"] = {"linspace": [2, 10, 5]}
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    assert load_object("tomato_soup_can").grasp_ranges["force_n"] == (2, 4, 6, 8, 10)


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
    with pytest.raises(ObjectError, match=r"no object named 'soup'; known: .*tomato_soup_can"):
        load_object("soup")
