"""Recipes: what a user writes is what runs, and every mistake is named at once."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.core.errors import RecipeError
from tacgen.core.resources import packaged
from tacgen.core.schema import Axis
from tacgen.core.sensors import load_sensor
from tacgen.physics.robots import RobotSpec
from tests.messages import refused

AXIS = TypeAdapter(Axis)
OTHER_KINDS = ("rig", "train", "paper", "what")
SHIPPED = sorted(
    path for path in packaged("recipes").glob("*.yaml") if not path.stem.startswith(OTHER_KINDS)
)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A user's folder with an object and a sensor of their own."""
    for name in ("can", "box"):
        (tmp_path / "objects" / name).mkdir(parents=True)
        (tmp_path / "objects" / name / "object.yaml").write_text("")
    sensors = tmp_path / "recipes" / "sensors"
    sensors.mkdir(parents=True)
    (sensors / "mine.yaml").write_text(
        "name: mine\nheight_px: 48\nwidth_px: 64\nmm_per_px: 0.3\ngel_depth_mm: 2\n"
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def recipe_of(folder: Path, text: str) -> Recipe:
    path = folder / "r.yaml"
    path.write_text(f"name: r\nsensor: mine\n{text}")
    return load_recipe(path)


@pytest.mark.parametrize(
    ("given_axis", "values"),
    [
        (4, (4.0,)),
        ([3, 1, 3], (3.0, 1.0)),
        ({"linspace": [0, 1, 3]}, (0.0, 0.5, 1.0)),
        ({"geomspace": [1, 16, 5]}, (1.0, 2.0, 4.0, 8.0, 16.0)),
        ({"range": [0, 0.15, 0.05]}, (0.0, 0.05, 0.1, 0.15)),
        ({"range": [0, 0.17, 0.05]}, (0.0, 0.05, 0.1, 0.15)),
        ({"range": [2, 0, -1]}, (2.0, 1.0, 0.0)),
    ],
)
def test_an_axis_is_a_number_a_list_a_linspace_or_a_range(given_axis, values):
    assert AXIS.validate_python(given_axis) == pytest.approx(values, abs=1e-9)


@given(
    start=st.integers(-100, 100), count=st.integers(1, 200), step=st.sampled_from([0.05, 0.1, 2.5])
)
def test_a_range_keeps_its_end_whatever_the_step_is_in_binary(start, count, step):
    stop = start + (count - 1) * step
    values = AXIS.validate_python({"range": [start, stop, step]})
    assert len(values) == count
    assert values[-1] == pytest.approx(stop, abs=1e-8)


@pytest.mark.parametrize(
    "wrong",
    [
        [],
        {},
        {"linspace": [0, 1]},
        {"linspace": [0, 1, 2.5]},
        {"linspace": [0, 1, 0]},
        {"geomspace": [0, 1, 3]},
        {"geomspace": [1, 2, 2.5]},
        {"range": [0, 1, -0.1]},
        {"range": [0, 1, 0]},
        {"range": [0, 1, 1e-9]},
        {"steps": [0, 1, 2]},
        [float("nan")],
        [float("inf")],
        "5 N",
    ],
)
def test_an_axis_that_means_nothing_is_refused(wrong):
    with pytest.raises(ValidationError):
        AXIS.validate_python(wrong)


def test_every_mistake_is_listed_at_once_with_its_line(folder):
    with refused(RecipeError):
        recipe_of(folder, "objects: [can]\ngrid: {force: 3, x_mm: 5 mm}\nphysics: {hold: 1}\n")


def test_names_and_ranges_are_checked_against_what_there_is(folder):
    with refused(RecipeError):
        recipe_of(
            folder,
            "objects: [can, cann, can]\nrobot: {max_force_n: 40}\n"
            "grid: {force_n: [5, 20, 80.0, -1]}\n",
        )


def test_an_unknown_sensor_is_named(folder):
    path = folder / "r.yaml"
    path.write_text("name: r\nobjects: [can]\nsensor: geelsight\n")
    with refused(RecipeError):
        load_recipe(path)


def test_a_sensor_without_a_table_says_how_to_get_one(folder):
    with refused(RecipeError):
        load_sensor("mine")
    assert load_sensor("mine", needs_table=False).table == ""


def test_the_resolved_recipe_is_itself_a_recipe(folder):
    recipe = recipe_of(folder, "objects: [can]\ngrid: {force_n: [1, 2, 3]}\n")
    again = Recipe.model_validate(recipe.resolved())
    assert again.resolved() == recipe.resolved()
    robot = recipe.robot.model_copy(update={"max_force_n": 40.0})  # the gripper's own, written out
    assert again == recipe.model_copy(update={"robot": robot})


@pytest.mark.parametrize(("before", "now"), [("true", "grasp"), ("false", "none")])
def test_depth_is_also_true_or_false(folder, before, now):
    old, new = (
        recipe_of(folder, f"objects: [can]\ndataset: {{depth: {how}}}\n") for how in (before, now)
    )
    assert old == new
    assert old.dataset.depth == now


def test_what_is_kept_of_the_touch_is_part_of_the_recipe(folder):
    plain = recipe_of(folder, "objects: [can]\n")
    text = "objects: [can]\ndataset: {depth: all, markers: true, force_field: [9, 12]}\n"
    recipe = recipe_of(folder, text)
    options = recipe.resolved()["dataset"]
    assert options["depth"] == "all"
    assert (options["markers"], options["force_field"]) == (True, [9, 12])
    assert Recipe.model_validate(recipe.resolved()).resolved() == recipe.resolved()
    assert recipe.sha256() != plain.sha256()


@pytest.mark.parametrize(
    "option",
    [
        "depth: some",
        "depth: 1",
        "force_field: [9]",
        "force_field: [0, 3]",
        "force_field: [9, 5000]",
    ],
)
def test_what_cannot_be_kept_is_refused_with_its_line(folder, option):
    with refused(RecipeError):
        recipe_of(folder, f"objects: [can]\ndataset: {{{option}}}\n")


def test_a_recipe_that_is_written_elsewhere_names_the_same_files(folder):
    for name in ("laws/soft.yaml", "tables/t.npz", "grippers/wide.yaml"):
        (folder / "project" / name).parent.mkdir(parents=True)
        (folder / "project" / name).write_text("")
    shipped = packaged("recipes") / "grippers" / "wsg50.yaml"
    (folder / "project/grippers/wide.yaml").write_text(shipped.read_text())
    (folder / "objects").rename(folder / "project" / "objects")
    text = (
        "name: r\nobjects: [can, objects/box, golf_ball]\ncontact: {file: laws/soft}\n"
        "sensor: {name: mine, table: tables/t.npz}\nrobot: {name: ur5e_grippers/wide.yaml}\n"
    )
    (folder / "project/r.yaml").write_text(text)
    recipe = load_recipe(folder / "project" / "r.yaml")
    (folder / "out").mkdir()
    resolved = recipe.resolved(folder / "out")
    assert resolved["sensor"]["name"] == "mine"
    assert resolved["objects"][2]["name"] == "golf_ball"
    (folder / "out/recipe.yaml").write_text(yaml.safe_dump(resolved))
    again = load_recipe(folder / "out" / "recipe.yaml")
    assert again.resolved(folder / "out") == resolved
    files = [
        [
            one.contact.path().resolve(),
            one.robot.gripper_file().resolve(),
            Path(load_sensor(one.sensor).table).resolve(),
            *(entry.object_folder().resolve() for entry in one.objects),
        ]
        for one in (recipe, again)
    ]
    assert files[0] == files[1]
    assert [entry.object_name for entry in again.objects] == ["can", "box", "golf_ball"]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_recipe_loads(path):
    recipe = load_recipe(path)
    assert recipe.name == path.stem
    assert isinstance(recipe.robot.spec(), RobotSpec)  # which every engine has


@pytest.fixture
def elsewhere(folder, monkeypatch):
    """A recipe with a table, a contact law and an object beside it, read from another folder."""
    home, work = folder / "home", folder / "work"
    (home / "objects" / "mug").mkdir(parents=True)
    (home / "objects" / "mug" / "object.yaml").write_text("")
    for path in (home / "law.yaml", home / "table.npz"):
        path.write_text("")
    work.mkdir()
    (home / "base.yaml").write_text(
        "contact: {file: law.yaml}\nsensor: {name: gelsight, table: table.npz}\nobjects: [mug]\n"
    )
    monkeypatch.chdir(work)
    return home


def test_paths_in_a_recipe_start_at_its_folder(elsewhere):
    path = elsewhere / "r.yaml"
    path.write_text("name: r\nextends: base.yaml\n")
    recipe = load_recipe(path)
    assert recipe.contact.path() == elsewhere / "law.yaml"
    assert load_sensor(recipe.sensor).table == str(elsewhere / "table.npz")
    assert recipe.objects[0].object_folder() == elsewhere / "objects" / "mug"


@pytest.mark.parametrize(
    "text",
    [
        "name: r\nmodel: {kind: single}\n",
        "name: r\nindenters: []\n",
        "name: r\nrows: []\nobjects: [can]\n",
        "name: r\nheight_px: 3\n",
        "law: volume_linear\nk_n_mm3_per_n: {value: 1}\n",
    ],
)
def test_a_file_of_another_kind_is_named_with_its_command(folder, text):
    path = folder / "r.yaml"
    path.write_text(text)
    with refused(RecipeError):
        load_recipe(path)


@pytest.mark.parametrize(
    "text",
    [
        "frames: {count: 0}",
        "frames: {count: 2.5}",
        "frames: {mode: film}",
        "frames: 3",
        "optics: {shadows: often}",
        "split: {test_fraction: 1}",
        "seed: -1",
        "description: [a]",
        "grid: {force_n: {steps: 3}}",
        "grid: {force_n: {linspace: 3}}",
    ],
)
def test_problems_are_worded_without_the_validator_s_own_terms(folder, text):
    with refused(RecipeError):
        recipe_of(folder, f"objects: [can]\n{text}\n")


def test_a_similar_name_is_suggested(folder):
    with refused(RecipeError):
        recipe_of(folder, "objects: [boxx]\n")
    path = folder / "r.yaml"
    path.write_text("name: r\nobjects: [can]\nsensor: gelsite_mini\n")
    with refused(RecipeError):
        load_recipe(path)


def test_metres_and_degrees_are_suspected(folder):
    with refused(RecipeError):
        recipe_of(folder, "objects: [can]\ngrid: {z_mm: [0.03, 0.06], yaw_rad: [0, 90]}\n")


@pytest.mark.parametrize("name", ["mine", "digit"])
def test_markers_of_a_sensor_without_any_are_refused(folder, name):
    text = f"objects: [can]\noptics: {{markers: true}}\nsensor: {name}\n"
    (folder / "r.yaml").write_text(f"name: r\n{text}")
    with refused(RecipeError):
        load_recipe(folder / "r.yaml")
    (folder / "r.yaml").write_text(f"name: r\n{text.replace('true', 'false')}")
    assert not load_recipe(folder / "r.yaml").optics.markers


def test_markers_of_a_rigs_sensor_without_any_are_refused(tmp_path):
    from tacgen.rig import load_rig_recipe

    path = tmp_path / "rig.yaml"
    path.write_text("name: r\nsensor: digit\nimages: {markers: true}\n")
    with refused(RecipeError):
        load_rig_recipe(path)


@pytest.mark.parametrize(
    "text",
    [
        "pads: both\n",
        "robot: {pads: both}\n",
    ],
)
def test_a_part_of_a_key_hints_the_key(tmp_path, text):
    (tmp_path / "r.yaml").write_text(f"name: a\nobjects: [can]\n{text}")
    with refused(RecipeError):
        load_recipe(tmp_path / "r.yaml")


@pytest.mark.parametrize(
    "text",
    [
        "objects: [can]\ncontact: {collision_margin_mm: 1}\n",
        "objects: [{name: can, added_mass_at_mm: [0, 0, 9]}]\n",
        "objects: [can, {name: can, added_mass_kg: 1}]\n",
    ],
)
def test_keys_that_need_others_say_which(folder, text):
    with refused(RecipeError):
        recipe_of(folder, text)
