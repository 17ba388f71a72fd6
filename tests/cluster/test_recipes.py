"""The examples of ``recipes/cluster``: they parse, and what they call exists."""

import json
import os
import re
import shlex
import subprocess
import sys

import pytest
import yaml
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.resources import packaged

FOLDER = packaged("recipes") / "cluster"
ROOT = FOLDER.parents[1]


@pytest.fixture
def node(tmp_path):
    """An environment where ``srun tacgen …`` writes down its arguments."""
    stub = tmp_path / "srun"
    note = tmp_path / "called.json"
    stub.write_text(
        f"#!{sys.executable}\nimport json, sys\njson.dump(sys.argv[1:], open({str(note)!r}, 'w'))\n"
    )
    stub.chmod(0o755)
    return os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}, note


def run_script(name, node, *arguments):
    environment, note = node
    run = subprocess.run(
        ["bash", FOLDER / name, *arguments],
        env=environment | {"SLURM_CPUS_PER_TASK": "2"},
        capture_output=True,
        text=True,
        timeout=60,
    )
    return run, json.loads(note.read_text()) if note.exists() else []


def options_of(command):
    """Every option that a command of the real command line knows."""
    text = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "300"}).stdout
    return set(re.findall(r"--[a-z-]+", re.sub(r"\x1b\[[0-9;]*m", "", text)))


def test_the_array_script_collects_a_part_of_the_shards(node, tmp_path):
    run, called = run_script("collect.sbatch", node, "quickstart", str(tmp_path / "out"))
    assert run.returncode == 0, run.stderr
    assert called[:3] == ["tacgen", "collect", "quickstart"]
    asked = CliRunner().invoke(
        app,
        [*called[1:], "--dry-run", "--json"],
        env={"SLURM_ARRAY_TASK_ID": "1", "SLURM_ARRAY_TASK_COUNT": "2"},
    )
    assert asked.exit_code == 0, asked.output
    assert json.loads(asked.stdout)["recipe"] == "quickstart"


def test_the_training_script_calls_train(node):
    run, called = run_script("train.sbatch", node, "train_single", "data", "run")
    assert run.returncode == 0, run.stderr
    assert called == ["tacgen", "train", "train_single", "--data", "data", "--out", "run"]
    assert {"--data", "--out"} <= options_of("train")


@pytest.mark.parametrize("name", ["collect.sbatch", "train.sbatch"])
def test_scripts_say_how_they_are_used(name, node):
    run, called = run_script(name, node)
    assert (run.returncode, called) == (2, [])
    assert "usage: sbatch" in run.stderr


def test_the_kubernetes_job_counts_its_parts_once():
    job = yaml.safe_load((FOLDER / "collect-job.yaml").read_text())
    assert (job["apiVersion"], job["kind"]) == ("batch/v1", "Job")
    spec = job["spec"]
    assert spec["completionMode"] == "Indexed"
    (container,) = spec["template"]["spec"]["containers"]
    environment = {entry["name"]: entry["value"] for entry in container["env"]}
    assert environment["JOB_COMPLETIONS"] == str(spec["completions"])
    assert all(isinstance(word, str) for word in container["command"])
    volumes = {volume["name"] for volume in spec["template"]["spec"]["volumes"]}
    assert {mount["name"] for mount in container["volumeMounts"]} == volumes
    command = container["command"]
    out = command[command.index("--out") + 1]
    assert any(out.startswith(mount["mountPath"]) for mount in container["volumeMounts"])
    asked = CliRunner().invoke(
        app,
        [*command[1:], "--dry-run", "--json"],
        env=environment | {"JOB_COMPLETION_INDEX": "15"},
    )
    assert asked.exit_code == 0, asked.output


def test_the_image_copies_what_is_there_and_tests_what_exists():
    text = (FOLDER / "tacgen.def").read_text()
    sections = {
        name: body.strip().splitlines()
        for name, body in re.findall(r"^%(\w+)\n(.*?)(?=^%|\Z)", text, re.M | re.S)
    }
    assert set(sections) == {"files", "post", "environment", "runscript", "test"}
    if (ROOT / "pyproject.toml").is_file():
        for line in sections["files"]:
            assert (ROOT / line.split()[0]).exists(), line
    for name in ("post", "environment", "runscript", "test"):
        script = "\n".join(sections[name])
        assert not subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode
    for line in sections["test"]:
        command = shlex.split(line.split(">")[0])
        assert CliRunner().invoke(app, command[1:]).exit_code == 0
