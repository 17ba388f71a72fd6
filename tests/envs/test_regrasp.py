"""``tacgen regrasp`` from a collected dataset to its page, and what it refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("torch")

from tacgen.cli import main
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import collect
from tacgen.core.errors import LearningError
from tacgen.envs.regrasp import (
    RESULT,
    WORLDS,
    Drawn,
    Look,
    Tried,
    _checked_pad,
    _grasps_of,
    _network_scores,
    look_rise_mm,
    regrasp,
    standing_seeds,
)
from tacgen.envs.regrasp_page import _drawn, shown_episodes, write_regrasp_page
from tacgen.envs.regrasp_policies import POLICIES, Costs
from tacgen.learning.run_folder import RunFolder
from tacgen.learning.train import train
from tacgen.learning.training_recipe import TrainRecipe
from tests.small_world import write_world

SECTIONS = {
    "sensor": "recipes/sensors/coarse.yaml",
    "grid": "{force_n: 22, y_mm: [-24, -8, 8, 24], z_mm: 90}",
    "frames": "{mode: sequence, count: 3, span_s: 0.9}",
    "dataset": "{shard_size: 4, markers: true, scene_pictures: false}",
    "randomize": "{center_of_mass_mm: 15, friction_relative: 0.3}",
}
NETWORK = {
    "name": "tiny",
    "model": {"kind": "sequence", "weights": "none"},
    "input": {
        "size_px": [32, 32],
        "channels": ["image", "markers"],
        "frames": 2,
        "until": "outcome",
    },
    "training": {"epochs": 1, "batch_size": 2},
}
SIDES = slice(12, 20), slice(22, 32)  # of an arrow from column 10 to 30
FEW = {"costs": Costs(), "regrasps": 2, "episodes": 3, "worlds": 3}


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Path:
    """A folder with a recipe and a network that was trained on 16 grasps of it."""
    folder = tmp_path_factory.mktemp("regrasp")
    recipe = write_world(folder, **SECTIONS)
    more = {"grid": "{force_n: [10, 40], y_mm: {linspace: [-28, 28, 8]}, z_mm: 90}", "seed": "6"}
    training = write_world(folder / "training", **(SECTIONS | more))
    collect(load_recipe(training), folder / "data", workers=2)
    train(TrainRecipe.model_validate(NETWORK), folder / "data", folder / "run")
    assert recipe.name == "small.yaml"
    return folder


@pytest.fixture(scope="module")
def result(world):
    return regrasp(world / "run", load_recipe(world / "small.yaml"), world / "out", **FEW)


pytestmark = pytest.mark.slow


def test_every_policy_is_played_on_the_same_episodes(result):
    scores, played = result
    first = {key: listed for key, listed in played.episodes.items() if key[1] == 0}
    starts = {tuple((e.seed, e.steps[0].grasp) for e in listed) for listed in first.values()}
    assert len(starts) == 1
    assert {key[0] for key in first} == set(POLICIES)
    assert scores["policies"]["oracle"][2]["success"]["value"] >= max(
        scores["policies"][name][2]["success"]["value"] for name in POLICIES
    )


def test_every_episode_ends_in_a_lift_that_is_counted(result):
    scores, _ = result
    for by_regrasps in scores["policies"].values():
        for one in by_regrasps:
            failed = sum(one["drops"].values()) + one["not_executed"]
            assert one["success"]["value"] == pytest.approx(1 - failed / 3)


def test_the_outcome_is_that_of_the_pipeline(result, world):
    scores, played = result
    recipe = load_recipe(world / "small.yaml")
    with GraspPipeline(recipe) as pipeline:
        for episode in played.episodes["touch", 2][:2]:
            planned = played.grasps[episode.object][episode.steps[-1].grasp]
            trace = pipeline.simulate(replace(planned, seed=episode.seed)).trace
            assert episode.held == (trace.label == 1)
    assert 5 < scores["test_lift_mm"] < 8  # 0.34 s at 120 mm/s² are 6.9 mm


def test_it_goes_on_where_it_was_and_gives_the_same(result, world, tmp_path):
    out = tmp_path / "again"
    shutil.copytree(world / "out", out)
    lines = (out / WORLDS).read_text().splitlines(keepends=True)
    (out / WORLDS).write_text("".join(lines[:2]) + lines[2][: len(lines[2]) // 2])
    (out / RESULT).unlink()
    recipe = load_recipe(world / "small.yaml")
    again, _ = regrasp(world / "run", recipe, out, workers=2, **FEW)
    assert again == result[0]
    assert json.loads((out / RESULT).read_text()) == again


def test_other_costs_simulate_nothing_anew(result, world, tmp_path):
    out = tmp_path / "costs"
    shutil.copytree(world / "out", out)
    before = (out / WORLDS).read_bytes()
    recipe = load_recipe(world / "small.yaml")
    cheap, _ = regrasp(world / "run", recipe, out, **(FEW | {"costs": Costs(1.0, 2.0)}))
    assert (out / WORLDS).read_bytes() == before
    # A regrasp that costs more than a drop is never made.
    assert [one["mean_regrasps"] for one in cheap["policies"]["touch"]] == [0, 0, 0]


def test_the_page_shows_three_episodes(result, tmp_path):
    scores, played = result
    write_regrasp_page(tmp_path / "index.html", scores, played)
    page = (tmp_path / "index.html").read_text()
    shown = shown_episodes(played.episodes["touch", 2])
    assert page.count("<figure>") == sum(len(one.steps) for one in shown)
    assert "sugar_box" in page


def test_markers_are_drawn_with_arrows_that_have_heads():
    moved_mm = np.array([[[20.0, 0.0], [0.0, 0.0]]])
    pad = SimpleNamespace(rgb=np.zeros((1, 60, 60, 3), np.uint8), markers_mm=moved_mm)
    image = _drawn(Look(None, pad, [0]), np.array([[10.0, 30.0], [40.0, 30.0]]), 1.0)
    height_px = [int((image[:, columns].max(axis=(1, 2)) > 100).sum()) for columns in SIDES]
    assert height_px[0] == 1 < 3 <= height_px[1]


def test_the_command_prints_json(world, capsys, monkeypatch, result):
    words = [str(world / "run"), str(world / "small.yaml"), "--out", str(world / "out")]
    options = ["--episodes", "3", "--worlds", "3", "--regrasps", "2", "--json"]
    monkeypatch.setattr("sys.argv", ["tacgen", "regrasp", *words, *options])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(result[0]))
    assert (world / "out" / "index.html").is_file()


def changed(world: Path, **sections: str):
    folder = world / "_".join(sections)
    return load_recipe(write_world(folder, **(SECTIONS | sections)))


@pytest.mark.parametrize(
    ("section", "text", "says"),
    [
        ("objects", "[sugar_box, cup]", "no model of cup, only of sugar_box"),
        ("frames", "{mode: sequence, count: 4, span_s: 0.9}", "another time_s"),
        ("optics", "{markers: true}", "another markers"),
        ("dataset", "{scene_pictures: false}", "also sees markers"),
        ("grid", "{force_n: 22, y_mm: 0, z_mm: 90}", "single grasp"),
        ("sensor", "digit", "another sensor, table"),
    ],
)
def test_a_run_of_other_images_or_objects_is_refused(world, tmp_path, section, text, says):
    recipe = changed(tmp_path, **{section: text})
    with pytest.raises(LearningError, match=says):
        regrasp(world / "run", recipe, tmp_path / "out", **FEW)
    assert not (tmp_path / "out").exists()


def test_a_run_that_sees_a_camera_is_refused(world, tmp_path):
    shutil.copytree(world / "run", tmp_path / "run")
    path = RunFolder(tmp_path / "run").plan_path
    plan = json.loads(path.read_text())
    plan["recipe"]["input"]["channels"] = ["image", "vision"]
    path.write_text(json.dumps(plan))
    with pytest.raises(LearningError, match="sees a camera.*without the channel vision"):
        _checked_pad(tmp_path / "run", load_recipe(world / "small.yaml"))


def test_the_networks_accuracy_is_that_of_what_it_saw():
    """Two of three looks are right; grasps that show nothing would have made it 5 of 6."""
    listed = [Tried(0.9, "held"), Tried(0.2, "rotational_slip"), Tried(0.7, "translational_slip")]
    listed += [Tried(0.0, status) for status in ("no_contact", "unreachable", "crashed")]
    worlds = {Drawn(0, 1, True): listed, Drawn(0, 2, False): [Tried(0.1, "held")] * 6}
    scores = _network_scores(list(worlds), worlds)
    assert scores == {"accuracy": pytest.approx(2 / 3), "holds": pytest.approx(1 / 3)}
    nothing = {Drawn(0, 1, True): listed[3:]}
    with pytest.raises(LearningError, match="no grasp of the episodes could be executed"):
        _network_scores(list(nothing), nothing)


def test_a_recipe_that_leaves_nothing_unknown_is_warned_of(world, tmp_path, capsys):
    few = FEW | {"episodes": 2, "worlds": 2}
    regrasp(world / "run", changed(tmp_path, randomize="{yaw_rad: 0.01}"), tmp_path / "out", **few)
    assert "nothing of an object is unknown" in capsys.readouterr().err


def test_a_look_that_shows_how_the_lift_ends_is_refused(tmp_path):
    recipe = changed(tmp_path, frames="{mode: sequence, count: 3, span_s: 1.5}")
    with GraspPipeline(recipe) as pipeline:
        trace = pipeline.simulate(_grasps_of(recipe)["sugar_box"][1]).trace
    assert look_rise_mm(trace, recipe, 1) == 0.0  # the moment of grasp
    with pytest.raises(LearningError, match=r"shorten frames\.span_s in both recipes"):
        look_rise_mm(trace, recipe, 2)


def test_what_is_no_run_is_refused(world, tmp_path):
    recipe = load_recipe(world / "small.yaml")
    with pytest.raises(LearningError, match="tacgen train"):
        regrasp(world / "data", recipe, tmp_path / "out", **FEW)


def test_seeds_of_imagined_worlds_and_episodes_differ_and_depend_on_the_seed_alone(world):
    recipe = load_recipe(world / "small.yaml")
    pipeline, planned = GraspPipeline(recipe), _grasps_of(recipe)["sugar_box"][0]
    seeds = [
        standing_seeds(pipeline, planned, seed, 4, is_episode=is_episode)
        for seed in (0, 1)
        for is_episode in (False, True)
    ]
    assert len({one for listed in seeds for one in listed}) == 16
    assert standing_seeds(pipeline, planned, 0, 2, is_episode=True) == seeds[1][:2]
