"""``friction`` and ``train`` as one batch job each, through submitit's local executor."""

import json
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from tacgen.cli import app, main
from tacgen.cluster import states, submission
from tacgen.cluster.records import JobsFolder, Note, Submission, Task, write_record
from tacgen.collection.recipe import Cluster
from tacgen.core.errors import ClusterError
from tests.messages import refused

from .friction_case import BOX, MU, write_friction_case

PATIENCE_S = 180


def submit(folder, *words):
    """The command as a user types it."""
    command = [sys.executable, "-m", "tacgen", "submit", "--executor", "local", "--wait", *words]
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )


@pytest.mark.exhaustive
@pytest.mark.slow
def test_friction_as_a_job_finds_what_it_finds_by_itself(tmp_path):
    run = submit(tmp_path, "--json", "--", *write_friction_case(tmp_path))
    assert run.returncode == 0, run.stderr
    assert "done" in run.stderr
    found = json.loads((tmp_path / "fit/friction.json").read_text())[BOX]
    assert found["mu"] == pytest.approx(MU)
    told = CliRunner().invoke(app, ["status", str(tmp_path / "fit"), "--json"])
    (job,) = json.loads(told.stdout)["jobs"]
    assert (job["state"], job["job_id"]) == ("done", json.loads(run.stdout)["job"])


@pytest.mark.slow
def test_what_ended_a_job_is_told_with_its_log(tmp_path):
    run = submit(tmp_path, "--", "friction", "quickstart", "--real", "none", "--out", "fit")
    assert run.returncode == 1
    assert "failed: none/grasps.csv: no such file" in run.stderr
    assert "log: " in run.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["collect", "quickstart", "--out", "x"], "give friction or train"),
        ([], "Missing argument"),
        (["stability"], "or a recipe with --out"),
        (["train", "train_single", "--out", "x"], "Missing option '--data'"),
        (["friction", "x", "--real", "r", "--out", "y", "--moo", "1"], "No such option: --moo"),
    ],
)
def test_what_could_not_run_is_refused_at_once(tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["tacgen", "submit", "--executor", "local", "--", *words])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--failed", "--", "train", "train_single"], "--failed: only for a recipe"),
        (["--grow", "--", "train", "train_single"], "--grow: only for a recipe"),
        (["quickstart", "--out", "x", "--gpus", "1"], "--gpus: only for a command"),
        (["quickstart", "again", "--out", "x"], "with --out, give exactly one recipe"),
    ],
)
def test_options_of_the_other_kind_of_work_are_refused(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke(app, ["submit", *words])
    assert isinstance(run.exception, ClusterError)
    assert message in str(run.exception)


def test_a_second_job_for_the_same_folder_is_refused_while_the_first_runs(tmp_path, monkeypatch):
    command = ["train", "train_single", "--data", "d", "--out", str(tmp_path)]
    folder = JobsFolder(tmp_path).create()
    write_record(folder / "submission.json", Submission("slurm", "here", (Task(0, "77", ()),)))
    live = {"77": ("queued", "Priority")}
    monkeypatch.setattr("tacgen.cluster.states.live_jobs", lambda _: live)
    with refused(ClusterError):
        submission.submit_command(command, tmp_path, print, "local", Cluster())
    text = states.jobs_text(tmp_path, states.job_states(tmp_path))
    assert "1 job\n" in text
    assert "job 77 queued: Priority" in text
    live.clear()
    write_record(folder / "task-00000.json", Note("running", 3, "n1", 5))
    (job,) = states.job_states(tmp_path)
    assert (job.state, job.attempt) == ("failed", 3)
    assert "killed, or out of memory" in job.reason
