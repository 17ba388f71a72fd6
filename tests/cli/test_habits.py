"""What all commands share: quiet and verbose, colours, progress in logs, the next command."""

import io
import json
import logging
import os
import re
import subprocess
import sys

import pytest
import yaml
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.cli.recipes import recipe_kinds
from tacgen.core import progress
from tacgen.core.schema import FILE_KINDS
from tacgen.core.sensors import SensorChoice, load_sensor, sensor_lines
from tacgen.optics import save_table
from tests.small_world import slope_table, write_world


@pytest.fixture(autouse=True)
def usual_level():
    yield
    progress.LOG.setLevel(logging.NOTSET)


def run(*arguments, **options):
    return CliRunner().invoke(app, [str(part) for part in arguments], **options)


@pytest.mark.parametrize("arguments", [("-q", "objects", "list"), ("objects", "list", "--quiet")])
def test_quiet_prints_the_result_alone(arguments):
    assert "golf_ball" in run(*arguments).stdout
    assert run(*arguments).stderr == ""
    assert "next:\n  tacgen objects show" in run("objects", "list").stderr


def shell(*arguments, **environment):
    command = [sys.executable, "-m", "tacgen", *arguments]
    return subprocess.run(
        command, env=os.environ | environment, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_verbose_prints_the_traceback_of_an_error_and_no_colour_is_kept():
    plain = shell("grid", "nowhere.yaml")
    assert plain.returncode == 2
    assert "Traceback" not in plain.stderr
    assert "Traceback" in shell("grid", "nowhere.yaml", "-v").stderr
    coloured = re.compile(r"\x1b\[[0-9;]*3\d")
    assert coloured.search(shell("--help", FORCE_COLOR="1").stdout)
    assert not coloured.search(shell("--help", FORCE_COLOR="1", NO_COLOR="1").stdout)


def test_progress_without_a_terminal_is_one_line_a_minute(monkeypatch):
    log, now_s = io.StringIO(), [0.0]
    monkeypatch.setattr(progress.sys, "stderr", log)
    monkeypatch.setattr(progress.time, "monotonic", lambda: now_s[0])
    with progress.progress_counter("grasp") as show:
        for done in range(1, 181):
            now_s[0] = float(done)
            show(done, 360, "5 succeeded")
    assert log.getvalue().splitlines() == [
        "tacgen: 60 of 360 grasps, about 5 min left, 5 succeeded",
        "tacgen: 120 of 360 grasps, about 4 min left, 5 succeeded",
        "tacgen: 180 of 360 grasps, about 3 min left, 5 succeeded",
    ]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("help",), "Usage:"),
        (("help", "collect"), "collect [OPTIONS]"),
        (("calibrate", "help", "contact"), "calibrate contact [OPTIONS]"),
    ],
)
def test_help_is_a_command_too(arguments, words):
    shown = run(*arguments)
    assert shown.exit_code == 0
    assert words in shown.output


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("inspct",), "No such command 'inspct' (did you mean 'inspect'?)"),
        (("calibrate", "lokup"), "No such command 'lokup' (did you mean 'lookup'?)"),
        (("quux",), "No such command 'quux'"),
    ],
)
def test_an_unknown_command_names_the_nearest_one(arguments, words):
    shown = run(*arguments)
    assert shown.exit_code == 2
    text = " ".join(re.sub("[│\n]", " ", shown.output).split())
    assert words in text
    assert text.count("did you mean") == ("mean" in words)


def test_results_are_replaced_with_force_only(tmp_path):
    assert run("rig", "rig", "--out", tmp_path / "rig").exit_code == 0
    again = run("rig", "rig", "--out", tmp_path / "rig")
    assert "truth.yaml: exists already; pass --force" in str(again.exception)
    assert run("rig", "rig", "--out", tmp_path / "rig", "--force").exit_code == 0


def test_calibrating_ends_with_lines_that_a_recipe_takes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("rig", "rig", "--out", "rig").exit_code == 0
    done = run("calibrate", "contact", "rig/press_log.csv", "--out", "contact.yaml")
    heading, line = done.stderr.split("next:\n")[1].splitlines()[:2]
    assert heading.strip() == "in a recipe in this folder:"
    recipe = write_world(tmp_path, contact="{}")
    recipe.write_text(recipe.read_text().replace("contact: {}", line.strip()))
    shown = run("recipe", "show", recipe)
    assert "file: contact.yaml" in shown.stdout
    assert run("grid", recipe).exit_code == 0


def test_tables_hand_over_a_sensor_that_loads(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for shape_px, dome_mm in (
        ((240, 320), 0.0),
        ((480, 640), 0.0),
        ((48, 64), 0.0),
        ((48, 64), 25),
    ):
        save_table(slope_table(shape_px, 0.071), tmp_path / "table.npz")
        lines = sensor_lines(tmp_path / "table.npz", shape_px, 0.071, dome_mm)
        if len(lines) > 2:
            (tmp_path / "my_sensor.yaml").write_text("\n".join(lines[1:-2]))
        choice = yaml.safe_load(lines[-1])["sensor"]
        choice = choice if isinstance(choice, dict) else {"name": choice}
        sensor = load_sensor(SensorChoice(**choice))
        assert sensor.table == str(tmp_path / "table.npz")
        assert (sensor.shape_px, sensor.mm_per_px) == (shape_px, 0.071)
        assert sensor.dome_radius_mm == dome_mm


@pytest.mark.parametrize(
    ("recipe", "words", "command"),
    [
        ("quickstart", "mode: sequence", "collect"),
        ("rig_creep", "name: creep", "rig"),
        ("train_single", "learning_rate: 0.0001", "train"),
        ("paper_table", "rows:", "study"),
    ],
)
def test_show_prints_every_setting_of_every_kind_of_recipe(recipe, words, command):
    shown = run("recipe", "show", recipe)
    assert words in shown.stdout
    assert "extends" not in shown.stdout
    assert f"next:\n  tacgen {command} {recipe}" in shown.stderr


def test_the_kinds_of_files_are_told_apart_by_keys_that_their_models_have():
    for model, _ in recipe_kinds().values():
        assert FILE_KINDS[model.__name__][1] <= set(model.model_fields)
    every = [key for _, keys in FILE_KINDS.values() for key in keys]
    assert len(every) == len(set(every))


@pytest.mark.parametrize("kind", recipe_kinds())
def test_every_key_of_a_schema_is_described(kind):
    schema = json.loads(run("recipe", "schema", kind).stdout)
    sections = [schema, *schema.get("$defs", {}).values()]
    missing = [
        f"{section.get('title')}.{name}"
        for section in sections
        for name, key in section.get("properties", {}).items()
        if "description" not in key and "$ref" not in key  # the section then has the same one
    ]
    assert missing == []


def test_init_writes_a_project_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = run("init", "demo")
    assert made.exit_code == 0
    assert "cd demo\n  tacgen collect recipe.yaml" in made.stderr
    assert "exists already" in str(run("init", "demo").exception)
    monkeypatch.chdir(tmp_path / "demo")
    assert len(run("grid", "recipe.yaml").stdout.splitlines()) == 201


@pytest.mark.slow
def test_a_new_project_collects_at_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run("init", "demo")
    recipe = tmp_path / "demo/recipe.yaml"
    shorter = recipe.read_text().replace("sample: 100", "sample: 3")
    assert shorter != recipe.read_text()
    recipe.write_text(shorter)
    done = run("collect", "demo/recipe.yaml", "--out", "data", "--workers", "2")
    assert done.exit_code == 0
    assert "tacgen inspect data" in done.stderr
    assert (tmp_path / "data" / "index.html").is_file()


@pytest.mark.slow
def test_a_dataset_without_an_executed_grasp_exits_1_and_names_the_reason(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = write_world(tmp_path, grid="{force_n: [3, 25], y_mm: [300], z_mm: [60]}")
    for command in (("collect", recipe, "--out", "data"), ("inspect", "data")):
        done = run(*command)
        assert done.exit_code == 1
        assert "2 of 2 grasps could not be executed" in done.output
