"""Batch jobs through submitit's local executor, and what is told of them."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.cluster import scheduler, states, submission
from tacgen.cluster.records import JobsFolder, Note, Submission, Task, write_record
from tacgen.cluster.submission import slurm_parameters
from tacgen.collection.pipeline import dataset_spec
from tacgen.collection.recipe import Cluster, load_recipe, with_cluster
from tacgen.collection.run import collect, prepare
from tacgen.core.errors import ClusterError, DatasetError, RecipeError, TacgenError
from tacgen.dataset import DatasetFolder
from tests.messages import refused
from tests.small_world import write_world

LOCAL = "local"
PATIENCE_S = 90


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_world(tmp_path)


def hashes(folder):
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.glob("shards/*.h5"))
    }


def wait_until(true, what):
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline, what
        time.sleep(0.05)


@pytest.fixture
def prepared(world, tmp_path):
    """An empty dataset of three shards, and its recipe."""
    recipe = load_recipe(world)
    DatasetFolder(tmp_path / "out").prepare(dataset_spec(recipe, 6))
    return tmp_path / "out", recipe


def record(out, jobs, executor="slurm", host="here"):
    """A submission of one shard a job: job id → the note of its task, or None."""
    folder = JobsFolder(out).create()
    tasks = tuple(Task(k, job, (k,)) for k, job in enumerate(jobs))
    write_record(folder / "submission.json", Submission(executor, host, tasks))
    for k, note in enumerate(jobs.values()):
        if note:
            write_record(folder / f"task-{k:05d}.json", note)
    return folder


@pytest.mark.slow
def test_jobs_make_the_bytes_that_collect_makes_and_lost_ones_are_made_up(world, tmp_path):
    """One of two jobs is killed: its shards show as failed, ``--failed`` makes just those."""
    recipe = with_cluster(load_recipe(world), shards_per_task=2)
    out = tmp_path / "out"
    first = submission.submit(recipe, out, LOCAL)
    assert first.shards == 3
    note = tmp_path / "out/jobs/000/task-00000.json"
    wait_until(note.is_file, "the first task never began")
    with refused(ClusterError, hide=r"jobs \d+, \d+"):
        submission.submit(recipe, out, LOCAL)
    os.kill(json.loads(note.read_text())["pid"], signal.SIGKILL)
    found = submission.wait_for(out)
    lost = [task for task in found.tasks if task.task == 0]
    assert lost[0].state == "failed"
    assert "killed, or out of memory" in lost[0].reason
    assert set(found.failed) == set(lost[0].shards)
    assert "--failed" in states.status_text(found)
    again = submission.submit(recipe, out, "local", failed_only=True)
    assert again.shards == len(found.failed)
    found = submission.wait_for(out)
    assert (found.done, found.not_begun) == (3, ())
    collect(recipe, tmp_path / "direct", progress=False)
    assert hashes(out) == hashes(tmp_path / "direct")
    assert submission.submit(recipe, out, LOCAL).jobs == ()


def test_jobs_make_what_a_dataset_grows_by(prepared, world, monkeypatch):
    """Two shards more, of three grasps; the jobs find them in the plan that is there."""
    out, recipe = prepared
    prepare(recipe, out)
    text = world.read_text().replace("force_n: [3, 25]", "force_n: [3, 10, 25]")
    world.write_text(text)
    grown = load_recipe(world)
    with refused(DatasetError):
        submission.submit(grown, out, LOCAL)
    handed = []
    monkeypatch.setattr(submission, "_hand_over", lambda tasks, *_: handed.extend(tasks) or ("1",))
    assert submission.submit(grown, out, LOCAL, grow=True).shards == 5
    assert sorted(shard for job in handed for shard in job.shards) == [0, 1, 2, 3, 4]
    grasps, spec = prepare(grown, out)
    assert (len(grasps), spec.parts) == (9, (6, 3))


def run_submit(world, out):
    """The command as a user types it, its output in pipes that must close."""
    options = ["--out", str(out), "--executor", "local", "--wait", "--json"]
    return subprocess.run(
        [sys.executable, "-m", "tacgen", "submit", str(world), *options],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )


@pytest.mark.slow
def test_the_command_refuses_what_could_not_run_and_else_waits_for_the_jobs(world, tmp_path):
    table = tmp_path / "recipes/sensors/coarse.npz"
    sound = table.read_bytes()
    table.write_bytes(b"not a table")
    options = ["--out", str(tmp_path / "out"), "--executor", LOCAL]
    refused = CliRunner().invoke(app, ["submit", str(world), *options])
    assert isinstance(refused.exception, TacgenError)
    assert "coarse.npz" in str(refused.exception)
    assert not (tmp_path / "out/jobs").exists()
    table.write_bytes(sound)
    done = run_submit(world, tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["shards"] == 3
    assert "3 of 3 shards done, 6 of 6 grasps" in done.stderr


def test_every_shard_is_in_one_state(prepared, monkeypatch):
    out, _ = prepared
    record(
        out,
        {
            "7_0": Note("failed", 1, "n1", 5, "no space left"),
            "7_1": None,
            "7_2": Note("running", 2, "n2", 6),
        },
    )
    live = {"7_1": ("queued", "Priority"), "7_2": ("running", "")}
    monkeypatch.setattr("tacgen.cluster.states.live_jobs", lambda _: live)
    found = states.status(out)
    assert (found.failed, found.queued, found.missing) == ((0,), (1, 2), ())
    assert [task.state for task in found.tasks] == ["failed", "queued", "running"]
    assert found.shards == 3
    text = states.status_text(found)
    assert "job 7_0 failed: no space left" in text
    assert str(out / "jobs/000/7_0_0_log.err") in text
    assert "job 7_1 queued: Priority" in text


@pytest.mark.parametrize(
    ("note", "words"),
    [
        (None, "before it began"),
        (Note("running", 1, "n1", 5), "without a message on n1"),
        (Note("interrupted", 1, "n1", 5, "preempted"), "preempted"),
    ],
)
def test_a_job_that_the_scheduler_forgot_has_failed(prepared, monkeypatch, note, words):
    out, _ = prepared
    record(out, {"7": note})
    monkeypatch.setattr("tacgen.cluster.states.live_jobs", lambda _: {})
    found = states.status(out)
    assert (found.failed, found.missing) == ((0,), (1, 2))
    assert words in found.tasks[0].reason
    assert not found.alive


def test_a_job_of_another_machine_is_not_called_dead(prepared):
    out, _ = prepared
    record(out, {"123456": Note("running", 1, "there", 5)}, executor="local", host="there")
    found = states.status(out)
    assert found.tasks[0].state == "unknown"
    assert found.alive


def test_a_shard_in_hand_is_running_whoever_makes_it(prepared):
    out, _ = prepared
    with DatasetFolder(out).claim(1):
        found = states.status(out)
        assert [shard for shard, _ in found.running] == [1]
        assert f"process {os.getpid()}" in found.running[0][1]
        assert found.missing == (0, 2)
    assert states.status(out).missing == (0, 1, 2)


def test_a_later_submission_takes_over_what_an_earlier_one_lost(prepared, monkeypatch):
    out, _ = prepared
    record(out, {"7": Note("running", 1, "n1", 5)})
    record(out, {"8": None})
    monkeypatch.setattr("tacgen.cluster.states.live_jobs", lambda _: {"8": ("queued", "")})
    assert states.status(out).failed == ()
    assert states.status(out).queued == (0,)


def test_a_broken_record_is_named(prepared):
    out, _ = prepared
    record(out, {"7": None}).joinpath("submission.json").write_text('{"tasks": 3}')
    with refused(ClusterError):
        states.status(out)


def test_status_of_no_dataset(tmp_path):
    result = CliRunner().invoke(app, ["status", str(tmp_path)])
    assert isinstance(result.exception, DatasetError)


def test_another_recipe_is_refused_before_anything_is_submitted(prepared):
    out, recipe = prepared
    with refused(DatasetError):
        submission.submit(recipe.model_copy(update={"seed": 6}), out, LOCAL)
    assert not (out / "jobs").exists()


def test_what_is_missing_is_said_with_its_mend(prepared, monkeypatch):
    out, recipe = prepared
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setattr("tacgen.core.errors.find_spec", lambda _: None)
    with refused(ClusterError):
        submission.submit(recipe, out, "slurm")
    with refused(ClusterError):
        submission.submit(recipe, out, "pbs")


def test_the_section_cluster_changes_no_byte(world, tmp_path):
    plain = load_recipe(world)
    world.write_text(world.read_text() + "\ncluster: {time_min: 5, partition: fast, mem_gb: 2}\n")
    told = load_recipe(world)
    assert told.cluster.partition == "fast"
    assert told.sha256() == plain.sha256()
    assert "cluster" not in told.resolved()


def test_flags_win_over_the_section_and_are_checked_like_it(world):
    recipe = with_cluster(load_recipe(world), partition="slow", mem_gb=None)
    assert (recipe.cluster.partition, recipe.cluster.mem_gb) == ("slow", 4.0)
    with refused(RecipeError):
        with_cluster(recipe, time_min=0, mem_gb=-1.0)


def test_what_slurm_is_asked_for():
    asked = slurm_parameters(
        Cluster(time_min=90, mem_gb=1.5, account="robots", sbatch={"exclusive": True}), "r"
    )
    assert (asked["time"], asked["mem"], asked["account"]) == (90, "1536MB", "robots")
    assert asked["additional_parameters"] == {"requeue": True, "exclusive": True}
    assert "partition" not in asked
    slurm = pytest.importorskip("submitit.slurm.slurm")
    script = slurm._make_sbatch_string("run", "/logs", map_count=3, **asked)
    for line in ("--time=90", "--mem=1536MB", "--requeue", "--exclusive", "--array=0-2%3"):
        assert f"#SBATCH {line}" in script


def test_a_setting_of_two_lines_cannot_slip_into_a_script(world):
    world.write_text(world.read_text() + '\ncluster: {partition: "a\\n#SBATCH --uid=0"}\n')
    with refused(RecipeError):
        load_recipe(world)


def test_squeue_is_understood(monkeypatch):
    said = "7_0|RUNNING|None\n7_1|PENDING|Priority\n9|PENDING|BeginTime\n"
    monkeypatch.setattr(scheduler, "_ask", lambda _: said)
    monkeypatch.setattr(scheduler.shutil, "which", lambda _: "/usr/bin/squeue")
    asked = Submission("slurm", "h", (Task(0, "7_0", (0,)),))
    assert scheduler.live_jobs([asked]) == {
        "7_0": ("running", ""),
        "7_1": ("queued", "Priority"),
        "9": ("queued", "BeginTime"),
    }
    monkeypatch.setattr(scheduler.shutil, "which", lambda _: None)
    assert scheduler.live_jobs([asked]) is None
    assert scheduler.live_jobs([replace(asked, executor="local")]) is None


def test_the_sites_limit_is_asked_for(monkeypatch):
    monkeypatch.setattr(
        scheduler, "_ask", lambda _: "MailProg = /bin/mail\nMaxArraySize    = 501\n"
    )
    assert scheduler.site_array_limit() == 501
    monkeypatch.setattr(scheduler, "_ask", lambda _: "")
    assert scheduler.site_array_limit() == 1000


def test_a_scheduler_that_is_down_is_said():
    with refused(ClusterError):
        scheduler._ask([sys.executable, "-c", "import sys; sys.exit('no controller')"])
