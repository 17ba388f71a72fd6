"""A real Slurm of one node: arrays, a kill, a drain, a requeue, and the bytes in the end."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tacgen.cluster import states, submission
from tacgen.collection.recipe import load_recipe, with_cluster
from tacgen.collection.run import collect
from tacgen.core.errors import ClusterError
from tacgen.core.resources import packaged
from tests.cluster.friction_case import BOX, MU, write_friction_case
from tests.small_world import write_world

SCRIPT = Path(__file__).with_name("slurm.sh")
PROGRAMS = ("slurmctld", "slurmd", "munged", "sbatch", "srun", "squeue", "scontrol")
PATIENCE_S = 180


@pytest.fixture(scope="module")
def slurm(tmp_path_factory):
    """A running Slurm; its commands find it by ``SLURM_CONF``."""
    missing = [name for name in PROGRAMS if shutil.which(name) is None]
    if missing or os.geteuid() != 0:
        pytest.skip("a Slurm of one's own takes root and `apt-get install slurm-wlm munge`")
    folder = tmp_path_factory.mktemp("slurm")
    subprocess.run(["bash", SCRIPT, "start", folder], check=True, timeout=60)
    try:
        with pytest.MonkeyPatch.context() as environment:
            environment.setenv("SLURM_CONF", str(folder / "slurm.conf"))
            yield folder
            subprocess.run(["scancel", "--me", "--signal=KILL", "--full"], check=False)
            subprocess.run(["scancel", "--me"], check=False)
            wait_until(lambda: not said("squeue", "--me", "--noheader"), "jobs would not end")
    finally:
        subprocess.run(["bash", SCRIPT, "stop", folder], check=True, timeout=60)


@pytest.fixture
def world(slurm, tmp_path, monkeypatch):
    """Four grasps in four shards: two at a time on two processors."""
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    grid = "{force_n: [3, 25], y_mm: [0], z_mm: [60, 90]}"
    return write_world(tmp_path, dataset="{shard_size: 1}", grid=grid)


def said(*command):
    return subprocess.run(
        command, capture_output=True, text=True, check=True, timeout=PATIENCE_S
    ).stdout.strip()


def wait_until(true, what):
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline, what
        time.sleep(0.1)


def hashes(folder):
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.glob("shards/*.h5"))
    }


def state_of(out, task):
    return next(entry for entry in states.status(out).tasks if entry.task == task)


def set_node(state, *reason):
    node = said("sinfo", "--noheader", "--format=%n")
    said("scontrol", "update", f"NodeName={node}", f"State={state}", *reason)


@pytest.mark.slow
def test_killed_drained_and_requeued_the_dataset_is_the_local_one(world, tmp_path):
    """Four jobs in two arrays (the site takes three at a time); three of them meet with trouble."""
    out = tmp_path / "out"
    world.write_text(world.read_text() + "\ncluster: {shards_per_task: 1}\n", encoding="utf-8")
    options = ["--out", str(out), "--mem-gb", "0.5", "--json"]
    submitted = subprocess.run(
        [sys.executable, "-m", "tacgen", "submit", str(world), *options],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert submitted.returncode == 0, submitted.stderr
    handed = json.loads(submitted.stdout)
    assert (len(handed["jobs"]), handed["arrays"]) == (4, 2)

    notes = [out / "jobs/000" / f"task-{task:05d}.json" for task in range(4)]
    wait_until(lambda: notes[0].is_file() and notes[1].is_file(), "no two jobs began")
    # The node is drained: what runs goes on, the rest waits.
    set_node("drain", "Reason=test")
    said("scontrol", "requeue", handed["jobs"][0])
    os.kill(json.loads(notes[1].read_text())["pid"], signal.SIGKILL)
    wait_until(lambda: state_of(out, 1).state == "failed", "the killed job never failed")
    wait_until(lambda: state_of(out, 0).state == "queued", "the requeued job does not wait")
    assert state_of(out, 3).state == "queued"
    assert not notes[3].exists()
    found = states.status(out)
    assert found.failed == state_of(out, 1).shards
    assert Path(state_of(out, 1).log).is_file()
    set_node("resume")

    recipe = with_cluster(load_recipe(world), mem_gb=0.5)
    again = submission.submit(recipe, out, "slurm", failed_only=True)
    assert again.shards == 1
    found = submission.wait_for(out)
    assert found.not_begun == (), states.status_text(found)
    assert state_of(out, 0).attempt == 2
    collect(recipe, tmp_path / "local", progress=False)
    assert hashes(out) == hashes(tmp_path / "local")


@pytest.mark.slow
def test_a_job_told_to_make_way_puts_itself_back_and_goes_on(world, tmp_path):
    """The signal that submitit asks Slurm for before a time limit or a preemption."""
    out = tmp_path / "out"
    recipe = with_cluster(load_recipe(world), mem_gb=0.5)
    (job,) = submission.submit(recipe, out, "slurm").jobs
    wait_until(lambda: states.status(out).done >= 1, "the job made no shard")
    said("scancel", "--signal=USR2", job)
    wait_until(lambda: (out / "jobs/000/task-00000.json").read_text().count("interrupted"), "?")
    assert states.status(out).alive
    found = submission.wait_for(out)
    assert found.done == 4, states.status_text(found)
    assert found.tasks[0].attempt == 2


@pytest.mark.slow
def test_the_shipped_script_collects_as_an_array(world, tmp_path):
    """``recipes/cluster/collect.sbatch`` as it stands, but for the size of this node."""
    out = tmp_path / "out"
    options = ["--wait", "--array=1-2", "--cpus-per-task=1", "--mem=500M"]
    said("sbatch", *options, str(packaged("recipes") / "cluster/collect.sbatch"), world, out)
    logs = "".join(path.read_text() for path in tmp_path.glob("tacgen-*.log"))
    assert "part 0 of 2 (SLURM_ARRAY_TASK_ID): 2 shards" in logs
    assert "part 1 of 2" in logs
    assert states.status(out).done == 4
    collect(load_recipe(world), tmp_path / "local", progress=False)
    assert hashes(out) == hashes(tmp_path / "local")


@pytest.mark.slow
def test_a_command_told_to_make_way_puts_itself_back_and_goes_on(world, tmp_path):
    """``tacgen friction`` as one job: what it simulated before the signal is not done again."""
    command = write_friction_case(tmp_path)
    options = ["--mem-gb", "0.7", "--cpus-per-task", "1", "--time-min", "5", "--json"]
    handed = json.loads(said(sys.executable, "-m", "tacgen", "submit", *options, "--", *command))
    outcomes, note = tmp_path / "fit/outcomes.jsonl", tmp_path / "fit/jobs/000/task-00000.json"
    wait_until(lambda: outcomes.is_file() and outcomes.read_text().count("\n") >= 1, "no outcome")
    said("scancel", "--signal=USR2", handed["job"])
    wait_until(lambda: "interrupted" in note.read_text() or "done" in note.read_text(), "?")
    before = outcomes.read_text()
    (job,) = submission.wait_for_command(tmp_path / "fit")
    assert (job.state, job.attempt) == ("done", 2), job
    assert outcomes.read_text().startswith(before)
    assert json.loads((tmp_path / "fit/friction.json").read_text())[BOX]["mu"] == pytest.approx(MU)


@pytest.mark.slow
def test_what_slurm_refuses_is_said_in_its_words(world, tmp_path):
    recipe = with_cluster(load_recipe(world), partition="nowhere")
    with pytest.raises(ClusterError, match=r"nvalid partition.*section `cluster`"):
        submission.submit(recipe, tmp_path / "out", "slurm")
