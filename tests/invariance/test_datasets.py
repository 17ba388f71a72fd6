"""What a dataset depends on, and what it does not: content counts, and the grasp's own alone."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from tacgen.collection.grid import grown_plan, plan_recipe
from tacgen.collection.perturbed import Perturbation, simulate_perturbed
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.collection.recipe_inputs import recipe_inputs
from tacgen.collection.run import collect, prepare
from tacgen.core.errors import DatasetError
from tacgen.core.records import GraspConfig
from tacgen.core.resources import find_object_folder, gripper_path
from tacgen.dataset import Dataset, DatasetFolder
from tacgen.dataset.input_hashes import Inputs
from tacgen.dataset.verify import verify
from tests.dataset.conftest import collect_toy, make_spec
from tests.messages import refused
from tests.small_world import write_world

LAW = """
law: volume_linear
k_n_mm3_per_n: {value: 5.0, stderr: 0.1}
k_s_mm_per_n: {value: 1.0, stderr: 0.1}
marker_pitch_mm: 1.5
effects: []
provenance: {data: {log.csv: abc}}
"""


@pytest.fixture
def world(tmp_path, monkeypatch):
    """A recipe beside an object, a sensor and a contact law of its own."""
    home = tmp_path / "home"
    path = write_world(home, contact="{file: law.yaml}", robot="{name: own_gripper.yaml}")
    shutil.copy(gripper_path("wsg50"), home / "own_gripper.yaml")
    shutil.copytree(find_object_folder("sugar_box"), home / "objects" / "sugar_box")
    (home / "law.yaml").write_text(LAW)
    # The sensor is found from the recipe too.
    path.write_text(path.read_text().replace("coarse", "recipes/sensors/coarse.yaml"))
    monkeypatch.chdir(tmp_path)
    return path


def edit(path: Path, **figures: object) -> None:
    """Replace entries of a YAML file, the value of a stated figure at its ``value``."""
    content = yaml.safe_load(path.read_text())
    for name, value in figures.items():
        if isinstance(content.get(name), dict) and "value" in content[name]:
            content[name]["value"] = value
        else:
            content[name] = value
    path.write_text(yaml.safe_dump(content, sort_keys=False))


def remark(path: Path) -> Path:
    path.write_text(f"# a remark\n{path.read_text()}\n# and another\n")
    return path


def object_yaml(world: Path) -> Path:
    return world.parent / "objects" / "sugar_box" / "object.yaml"


def sensor_yaml(world: Path) -> Path:
    return world.parent / "recipes" / "sensors" / "coarse.yaml"


def moved(world: Path) -> Path:
    return Path(shutil.move(world.parent, world.parents[1] / "elsewhere")) / world.name


def law_of_another_name(world: Path) -> Path:
    shutil.move(world.parent / "law.yaml", world.parent / "recipes" / "other.yaml")
    world.write_text(world.read_text().replace("law.yaml", "recipes/other.yaml"))
    return world


def recalibrated(world: Path) -> Path:
    law = (world.parent / "law.yaml").read_text()
    (world.parent / "law.yaml").write_text(law.replace("0.1}", "0.2}").replace("abc", "def"))
    return world


def touched(world: Path) -> Path:
    for path in world.parent.rglob("*"):
        os.utime(path, (1, 1))
    return world


def renamed(world: Path) -> Path:
    edit(world, name="another", description="of another name")
    return world


def in_shards(world: Path) -> Path:
    edit(world, dataset={"shard_size": 3})
    return world


def with_more_forces(world: Path) -> Path:
    edit(world, grid={"force_n": [3, 10, 25], "y_mm": [0], "z_mm": [60, 90, 140]})
    return world


def from_another_source(world: Path) -> Path:
    path = object_yaml(world)
    path.write_text(path.read_text().replace("source: ", "source: as weighed, "))
    return world


@pytest.mark.parametrize(
    "change",
    [
        lambda world: remark(world),
        lambda world: remark(object_yaml(world)) and world,
        lambda world: remark(sensor_yaml(world)) and world,
        lambda world: remark(world.parent / "law.yaml") and world,
        *(moved, law_of_another_name, recalibrated, touched, renamed, in_shards),
        *(with_more_forces, from_another_source),
    ],
)
def test_what_does_not_count_changes_no_hash(world, change):
    before = recipe_inputs(load_recipe(world)).sha256
    assert recipe_inputs(load_recipe(change(world))).sha256 == before


def other_mesh(world: Path) -> None:
    path = world.parent / "objects" / "sugar_box" / "object.yaml"
    mesh = path.parent / yaml.safe_load(path.read_text())["shape"]["mesh"]
    raw = bytearray(mesh.read_bytes())
    raw[-1] ^= 1
    mesh.write_bytes(raw)


def other_table(world: Path) -> None:
    path = world.parent / "recipes" / "sensors" / "coarse.npz"
    path.write_bytes(path.read_bytes() + b"\0")


CHANGES = {
    "object/sugar_box": lambda world: edit(object_yaml(world), friction=0.05),
    "object/sugar_box/mesh": other_mesh,
    "object/sugar_box/recipe": lambda world: edit(
        world, objects=[{"name": "sugar_box", "mass_kg": 1.0}]
    ),
    "sensor": lambda world: edit(sensor_yaml(world), dome_radius_mm=0),
    "table": other_table,
    "contact_law": lambda world: edit(world.parent / "law.yaml", k_n_mm3_per_n=40.0),
    "gripper": lambda world: edit(world.parent / "own_gripper.yaml", stroke_mm=100.0),
    "recipe": lambda world: edit(world, optics={"shadows": True}),
}


@pytest.mark.parametrize("role", CHANGES)
def test_what_counts_is_named_and_not_resumed(world, role):
    prepare(load_recipe(world), Path("out"))
    CHANGES[role](world)
    with refused(DatasetError):
        prepare(load_recipe(world), Path("out"))


def test_a_dataset_of_another_engine_is_not_resumed(world):
    recipe = load_recipe(world)
    prepare(recipe, Path("out"))
    engine = DatasetFolder("out").plan()["engine"]
    assert engine == recipe.physics.engine
    another = {"pybullet": "mujoco", "mujoco": "pybullet"}[engine]
    other = recipe.model_copy(update={"physics": replace(recipe.physics, engine=another)})
    with refused(DatasetError):
        prepare(other, Path("out"))


def test_a_dataset_of_another_library_is_not_resumed(world, monkeypatch):
    prepare(load_recipe(world), Path("out"))
    monkeypatch.setattr(
        "tacgen.collection.recipe_inputs.library_versions",
        lambda engine="": {"numpy": "1.0", engine: "0"},
    )
    with refused(DatasetError):
        prepare(load_recipe(world), Path("out"))


# Two worlds in one folder.


def inputs(cup: str) -> Inputs:
    return Inputs({"sensor": "aa", "object/can": "bb", "object/cup": cup}, {}, "pybullet")


def test_verify_and_readers_find_shards_of_two_worlds(tmp_path):
    toy = collect_toy(tmp_path / "toy", make_spec(inputs=inputs("cc")))
    other = collect_toy(tmp_path / "other", make_spec(inputs=inputs("dd")))
    assert not verify(toy.root).problems
    for path in (toy.shard_path(1), toy.line_path(1)):
        shutil.copy(other.root / path.relative_to(toy.root), path)
    toy.merge()
    problems = verify(toy.root).problems
    assert [p.shard for p in problems if "another object/cup than dataset.json" in p.reason] == [1]
    assert verify(toy.root).bad_shards == (1,)
    toy.plan_path.unlink()
    assert any("another object/cup" in p.reason for p in verify(toy.root).problems)
    with refused(DatasetError):
        Dataset(toy.root)


def test_a_shard_of_another_world_is_not_taken_for_done(tmp_path):
    spec = make_spec(inputs=inputs("cc"))
    toy = collect_toy(tmp_path / "toy", spec)
    toy.line_path(1).write_text(toy.line_path(1).read_text().replace('"cc"', '"dd"'))
    with refused(DatasetError), toy.claim(1):
        pass
    with toy.claim(1, redo=True) as mine:
        assert mine


# Growing: what is there stays as it is.

GRID = {"force_n": [3, 25], "z_mm": [60, 90, 140], "y_mm": [0, 1]}


def recipe_of(objects=("sugar_box",), size=4, **grid):
    return Recipe.model_validate(
        {
            "name": "r",
            "objects": list(objects),
            "grid": GRID | grid,
            "dataset": {"shard_size": size},
        }
    )


def own(grasp):
    """What is a grasp's own, wherever it stands in a plan."""
    return replace(grasp.config, index=0), grasp.seed


@pytest.mark.parametrize(
    "other",
    [
        recipe_of(size=7),
        recipe_of(["cup", "sugar_box"]),
        recipe_of(force_n=[3, 10, 25]),
        recipe_of(z_mm=[140, 90, 60]),
        recipe_of(yaw_rad=[0.0, 0.5]),
    ],
)
def test_a_grasps_draws_are_its_own(other):
    grasps = set(map(own, plan_recipe(recipe_of())))
    assert grasps <= set(map(own, plan_recipe(other)))
    assert len({grasp.seed for grasp in plan_recipe(other)}) == len(plan_recipe(other))


@pytest.mark.parametrize(
    "grown",
    [
        recipe_of(force_n=[3, 10, 25]),
        recipe_of(["cup", "sugar_box"], y_mm=[0, 1, -1]),
        recipe_of(["cup", "sugar_box"], z_mm=[140, 90, 60]),
    ],
)
def test_a_grown_plan_keeps_the_grasps_and_shards_that_it_has(grown):
    first = grown_plan(recipe_of(), ())
    plan = grown_plan(grown, json.loads(json.dumps(first.grids)))
    n = len(first.grasps)
    kept = [replace(one, entry=0) for one in plan.grasps[:n]]
    assert kept == list(first.grasps)
    assert {own(g) for g in plan.grasps} == {own(g) for g in plan_recipe(grown)}
    assert [g.config.index for g in plan.grasps] == list(range(len(plan.grasps)))
    assert plan.grasps[n].shard == first.grasps[-1].shard + 1
    for name in {g.config.object for g in plan.grasps}:
        sides = [g.split for g in plan.grasps if g.config.object == name]
        assert sides.count("test") == round(0.2 * len(sides))
    # Again with the same recipe, it is the same plan; with the one of before, another dataset.
    assert grown_plan(grown, plan.grids) == plan
    assert grown_plan(recipe_of(), plan.grids) == first


def test_a_larger_sample_keeps_the_smaller():
    few, more = recipe_of(sample=4), recipe_of(sample=9, force_n=[3, 10, 25])
    first = grown_plan(few, ())
    plan = grown_plan(more, first.grids)
    assert plan.grasps[:4] == first.grasps
    assert len({own(g) for g in plan.grasps}) == 9
    third = grown_plan(recipe_of(sample=11, force_n=[3, 10, 25]), plan.grids)
    assert third.parts == (4, 5, 2)
    assert third.grasps[:9] == plan.grasps


def test_growing_is_asked_for(world):
    prepare(load_recipe(world), Path("out"))
    with refused(DatasetError):
        prepare(load_recipe(with_more_forces(world)), Path("out"))
    grasps, spec = prepare(load_recipe(world), Path("out"), grow=True)
    assert (len(grasps), spec.n_shards, spec.parts) == (9, 5, (6, 3))
    assert [spec.shard_range(k) for k in (2, 3, 4)] == [range(4, 6), range(6, 8), range(8, 9)]
    edit(world, grid={"force_n": [3, 10], "y_mm": [0], "z_mm": [60, 90, 140]})
    with refused(DatasetError):
        prepare(load_recipe(world), Path("out"), grow=True)


def content(root, *but):
    """Everything about each grasp, by what it was asked to do."""
    dataset = Dataset(root)
    found = {}
    for item in dataset:
        place = tuple(item.pop(key) for key in ("object", "force_n", "x_mm", "y_mm", "z_mm"))
        found[place] = {k: v for k, v in item.items() if k not in ("index", *but)}
    return found


@pytest.mark.slow
def test_a_grown_dataset_holds_what_one_collected_at_once_does(world):
    recipe = load_recipe(world)
    collect(recipe, Path("out"), progress=False)
    before = {p.name: p.read_bytes() for p in Path("out/shards").iterdir()}
    cup = {"name": "cup", "grid": {"z_mm": [60]}}
    grid = {"force_n": [25, 10, 3], "y_mm": [0], "z_mm": [60, 90, 140]}
    edit(world, grid=grid, objects=[cup, "sugar_box"])
    grown = load_recipe(world)
    collect(grown, Path("out"), grow=True, progress=False)
    plan = Path("out/dataset.json").read_text()
    assert {name: Path("out/shards", name).read_bytes() for name in before} == before
    assert not verify("out", decode=True).problems
    assert "6 grasps at first, then 6 more" in Path("out/README.md").read_text()
    lines = Dataset("out").lines
    assert [line.part for line in lines] == [0, 0, 0, 1, 1, 1]
    assert ["grid/1" in line.inputs for line in lines] == [line.part == 1 for line in lines]
    Path("out/dataset.json").unlink()
    with refused(DatasetError):
        prepare(grown, Path("out"))
    (Path("out/dataset.json")).write_text(plan)
    edit(world, dataset={"shard_size": 5}, objects=["sugar_box", cup])
    collect(load_recipe(world), Path("once"), workers=2, progress=False)
    # The share of test grasps is exact in both, so that sides may differ.
    one, other = content("out", "split"), content("once", "split")
    assert one.keys() == other.keys()
    for place, values in one.items():
        for name, value in values.items():
            np.testing.assert_array_equal(value, other[place][name], err_msg=f"{place} {name}")


def test_a_gel_does_not_count_the_grasps_before(world):
    """A conditioning acts on the first presses of a gel, which are long past."""
    law = LAW.replace(
        "effects: []",
        "effects: [{name: conditioning, channel: normal, parameters: {amount: {value: 0.5}, "
        "trials: {value: 3.0}}}]",
    )
    (world.parent / "law.yaml").write_text(law)
    recipe = load_recipe(world)
    planned = plan_recipe(recipe)[-1]
    first = replace(planned, config=replace(planned.config, index=0))
    with GraspPipeline(recipe) as pipeline:
        one, other = (pipeline.sample(grasp).pads["left"] for grasp in (planned, first))
        (world.parent / "law.yaml").write_text(LAW)
    with GraspPipeline(load_recipe(world)) as pipeline:
        settled = pipeline.sample(planned).pads["left"]
    np.testing.assert_array_equal(one.indentation_mm, other.indentation_mm)
    np.testing.assert_array_equal(one.rgb, other.rgb)
    np.testing.assert_allclose(one.indentation_mm, settled.indentation_mm)


# Kept simulations.


def outcome(recipe, mass_factor=1.0):
    # Beside the mass, so that the patch, which follows from the law, has a moment to hold.
    config = GraspConfig(0, "sugar_box", 30.0, 0.0, 5.0, 87.5)
    wanted = [(config, Perturbation(mass_factor=mass_factor))]
    seen = []
    (found,) = simulate_perturbed(
        recipe, wanted, Path("kept"), workers=1, show=lambda *counts: seen.append(counts)
    ).values()
    return found, len(seen) == 1  # whether it was kept


def test_a_kept_outcome_is_of_its_own_law_and_object(world):
    first, kept = outcome(load_recipe(world))
    assert not kept
    assert outcome(load_recipe(remark(world))) == (first, True)
    edit(world.parent / "law.yaml", k_n_mm3_per_n=40.0)
    other, kept = outcome(load_recipe(world))
    assert not kept
    assert other.swing_ratio != first.swing_ratio
    edit(object_yaml(world), friction=0.02)
    last, kept = outcome(load_recipe(world))
    assert (last.label, kept) == (0, False)


def test_an_object_beside_the_recipe_is_found_by_name_and_path(world):
    edit(world, objects=["cup"])
    recipe = load_recipe(world)
    edit(object_yaml(world), friction=0.02)
    assert outcome(recipe)[0].label == 0
    edit(world, objects=["objects/sugar_box"])
    assert {g.config.object for g in plan_recipe(load_recipe(world))} == {"sugar_box"}
