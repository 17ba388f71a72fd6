"""``tacgen regrasp`` from a collected dataset to its result, and what it refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tests.messages import refused

pytest.importorskip("torch")

from tacgen.cli import main
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import load_recipe
from tacgen.core.errors import LearningError
from tacgen.envs.regrasp import (
    RESULT,
    WORLDS,
    Costs,
    Question,
    by_touch,
    regrasp,
    simulate,
)
from tacgen.learning.run_folder import RunFolder
from tests.envs.regrasp_world import FEW, SECTIONS, regrasp_world
from tests.small_world import write_world


@pytest.fixture(scope="module")
def world() -> Path:
    return regrasp_world()


@pytest.fixture(scope="module")
def result(world):
    return regrasp(world / "run", load_recipe(world / "small.yaml"), world / "out", FEW)


pytestmark = pytest.mark.slow


def simulated_of(world: Path):
    """From the finished worlds of ``result``."""
    recipe = load_recipe(world / "small.yaml")
    asked = Question.checked(world / "run", recipe)
    return recipe, simulate(asked, world / "out", FEW)["sugar_box"]


def test_every_episode_ends_in_a_lift_that_is_counted(result):
    for one in result["by_touch"]:
        failed = sum(one["drops"].values()) + one["not_executed"]
        assert one["success"] == pytest.approx(1 - failed / 3)
        low, high = one["interval"]
        assert 0 <= low <= one["success"] <= high <= 1
    own = result["by_object"]["sugar_box"]
    assert own == {
        "first": result["by_touch"][0]["success"],
        "touch": result["by_touch"][2]["success"],
    }


def test_the_outcomes_are_those_of_the_pipeline(result, world):
    recipe, simulated = simulated_of(world)
    tried = simulated.episodes
    with GraspPipeline(recipe) as pipeline:
        for planned, holds in zip(simulated.grasps, tried.holds[0], strict=True):
            assert holds == (
                pipeline.simulate(replace(planned, seed=tried.seeds[0])).trace.label == 1
            )
    assert 5 < result["test_lift_mm"] < 8  # 0.34 s at 120 mm/s² are 6.9 mm


def test_it_goes_on_where_it_was_and_gives_the_same(result, world, tmp_path):
    out = tmp_path / "again"
    shutil.copytree(world / "out", out)
    lines = (out / WORLDS).read_text().splitlines(keepends=True)
    (out / WORLDS).write_text("".join(lines[:2]) + lines[2][: len(lines[2]) // 2])
    (out / RESULT).unlink()
    recipe = load_recipe(world / "small.yaml")
    again = regrasp(world / "run", recipe, out, FEW, workers=2)
    assert again == result
    assert json.loads((out / RESULT).read_text()) == again


def test_the_command_prints_json(world, capsys, monkeypatch, result):
    words = [str(world / "run"), str(world / "small.yaml"), "--out", str(world / "out")]
    options = ["--episodes", "3", "--worlds", "3", "--regrasps", "2", "--json"]
    monkeypatch.setattr("sys.argv", ["tacgen", "regrasp", *words, *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(result))


def test_the_path_is_that_of_the_decision():
    """The best other grasp is always the last but this; it holds for certain."""
    path = by_touch(0, [0.2, 0.95, 0.6], Costs(1.0, 0.1), 3, lambda seen: (1, 1.0))
    assert [(one.grasp, one.probability) for one in path] == [(0, 0.2), (1, 0.95)]


def changed(world: Path, **sections: str):
    folder = world / "_".join(sections)
    return load_recipe(write_world(folder, **(SECTIONS | sections)))


@pytest.mark.parametrize(
    ("section", "text"),
    [
        ("objects", "[sugar_box, cup]"),
        ("frames", "{mode: sequence, count: 4, span_s: 0.9}"),
        ("optics", "{markers: true}"),
        ("dataset", "{scene_pictures: false}"),
        ("grid", "{force_n: 22, y_mm: 0, z_mm: 90}"),
        ("sensor", "digit"),
    ],
)
def test_a_run_of_other_images_or_objects_is_refused(world, tmp_path, section, text):
    recipe = changed(tmp_path, **{section: text})
    with refused(LearningError):
        regrasp(world / "run", recipe, tmp_path / "out", FEW)
    assert not (tmp_path / "out").exists()


def test_a_run_that_sees_a_camera_is_refused(world, tmp_path):
    shutil.copytree(world / "run", tmp_path / "run")
    path = RunFolder(tmp_path / "run").plan_path
    plan = json.loads(path.read_text())
    plan["recipe"]["input"]["channels"] = ["image", "vision"]
    path.write_text(json.dumps(plan))
    with refused(LearningError):
        Question.checked(tmp_path / "run", load_recipe(world / "small.yaml"))


def test_what_is_no_run_is_refused(world, tmp_path):
    recipe = load_recipe(world / "small.yaml")
    with refused(LearningError):
        regrasp(world / "data", recipe, tmp_path / "out", FEW)
