"""`tacgen collect` and the folder that it is given."""

import json

import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import TacgenError
from tacgen.core.files import refuse_foreign
from tacgen.dataset.summary import write_card
from tacgen.learning.run_folder import RunFolder
from tests.dataset.conftest import collect_toy, make_spec
from tests.messages import refused
from tests.small_world import write_world


def run(*arguments):
    return CliRunner().invoke(app, [str(one) for one in arguments])


@pytest.fixture
def recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_world(tmp_path, grid="{force_n: 25, y_mm: 0, z_mm: [60, 90]}")


@pytest.mark.parametrize("out", [["--out", ""], ["--out="]])
@pytest.mark.parametrize("command", ["collect", "friction", "train"])
def test_an_empty_out_is_refused_by_every_command(recipe, command, out):
    before = recipe.read_text()
    result = run(command, recipe, *out)
    assert result.exit_code == 2
    assert "is empty (a variable that is not set?)" in " ".join(result.output.split())
    assert recipe.read_text() == before


def test_a_share_without_shards_is_done(recipe, tmp_path):
    result = run("collect", recipe, "--out", tmp_path / "out", "--shard", "999/1000")
    assert result.exit_code == 0, result.output
    assert "nothing to do: part 999 of 1000 has no shard" in result.stderr


@pytest.mark.slow
def test_what_another_job_claimed_is_said_only_where_there_is_some(recipe, tmp_path):
    result = run("collect", recipe, "--out", tmp_path / "out", "--json")
    counts = json.loads(result.stdout)
    assert counts["grasps_made"] == 2
    assert "shards_claimed_by_another_job" not in counts
    again = json.loads(run("collect", recipe, "--out", tmp_path / "out", "--json").stdout)
    assert (again["grasps_made"], again["grasps_held"]) == (0, 2)
    outcomes = ("successes", "failures", "not_executed")
    assert [again[name] for name in outcomes] == [counts[name] for name in outcomes]
    assert sum(again[name] for name in outcomes) == 2
    inspected = json.loads(run("inspect", tmp_path / "out", "--json").stdout)
    assert inspected["engine"] == "pybullet"
    assert {"recipe", "sensor", "table", "engine", "object/sugar_box"} <= set(inspected["inputs"])
    engine = f"pybullet {inspected['versions']['pybullet']}"
    assert engine in run("inspect", tmp_path / "out").stdout
    assert engine in (tmp_path / "out/README.md").read_text()


def test_a_card_that_somebody_else_wrote_is_left_as_it_is(tmp_path):
    toy = collect_toy(tmp_path, make_spec())
    toy.card_path.write_text("my own notes\n")
    write_card(toy.root)
    assert toy.card_path.read_text() == "my own notes\n"
    toy.card_path.unlink()
    assert "made by tacgen" in write_card(toy.root).read_text()


def test_files_of_others_are_never_replaced(tmp_path):
    ours = collect_toy(tmp_path, make_spec())
    refuse_foreign(ours.root, "dataset.json", ["README.md", "recipe.yaml"])
    (tmp_path / "dataset.json").unlink()
    refuse_foreign(ours.root, "dataset.json", ["README.md"])
    with refused(TacgenError):
        refuse_foreign(ours.root, "dataset.json", ["README.md", "recipe.yaml"])


def test_a_run_is_not_put_beside_a_recipe_of_the_users(tmp_path):
    recipe = tmp_path / "recipe.yaml"
    recipe.write_text("mine")
    with refused(TacgenError):
        RunFolder(tmp_path).prepare({}, {})
    assert recipe.read_text() == "mine"


def test_an_animation_does_not_replace_a_file(recipe, tmp_path):
    there = tmp_path / "grasp.gif"
    there.write_bytes(b"mine")
    result = run("render", recipe, "--gif", there)
    assert result.exit_code != 0
    assert "exists already; pass --force" in str(result.exception)
    assert there.read_bytes() == b"mine"


def test_an_animation_is_a_gif(recipe, tmp_path):
    result = run("render", recipe, "--gif", tmp_path / "a.mp4")
    assert result.exit_code != 0
    assert "a.mp4: only GIF is written; give a name that ends in .gif" in str(result.exception)
    assert not (tmp_path / "a.mp4").exists()
