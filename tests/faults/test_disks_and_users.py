"""Full disks, parts of killed processes, other users, links to nothing, other locales."""

import contextlib
import os
import resource
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tacgen.cluster import submission
from tacgen.collection.recipe import Cluster
from tacgen.core.errors import DatasetError, LearningError, TacgenError
from tacgen.core.files import (
    atomic_folder,
    atomic_path,
    disk_message,
    holder_of,
    locked,
    refuse_existing,
)
from tacgen.dataset.export import export_dataset
from tacgen.dataset.shard import open_shard
from tacgen.dataset.verify import verify
from tacgen.learning.run_folder import RunFolder
from tacgen.rig import load_rig_recipe, run_rig
from tests.dataset.conftest import collect_toy, make_spec
from tests.messages import refused
from tests.small_world import write_world

NOBODY = 65534
CHECKPOINT = "tacgen.learning.checkpoint"  # imports PyTorch


@contextlib.contextmanager
def largest_file(n_bytes: int) -> Iterator[None]:
    """No file of this process may grow beyond ``n_bytes``: its disk is as good as full.

    Modules that are imported meanwhile are not compiled to files: some Pythons leave such
    files cut short, and every later process would fail on them.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    compiles = sys.dont_write_bytecode
    sys.dont_write_bytecode = True
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = compiles


def files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, hidden ones too, with its content."""
    found = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


@pytest.mark.parametrize("layout", ["lerobot", "images", "webdataset", "robomimic", "real-grasps"])
def test_a_full_disk_ends_an_export_with_one_message_and_nothing_left(layout, tmp_path):
    data = collect_toy(tmp_path / "data", make_spec(n_grasps=20)).root
    before = files(tmp_path)
    with refused(DatasetError), largest_file(1024):
        export_dataset(data, tmp_path / "out", layout)
    assert files(tmp_path) == before


def test_a_full_disk_amid_training_states_names_the_file(tmp_path):
    path = tmp_path / "checkpoint.pt"
    torch, checkpoint = pytest.importorskip("torch"), pytest.importorskip(CHECKPOINT)
    state = {"weights": torch.arange(100_000.0), "epoch": 3}
    checkpoint.save_state(path, state)
    whole = path.read_bytes()
    with largest_file(1024), pytest.raises(OSError) as caught:
        checkpoint.save_state(path, state)
    said = disk_message(caught.value, caught.value.filename, "")
    assert said.startswith(f"{path}: file too large; raise the limit")
    assert files(tmp_path) == {path.name: whole}


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_rig_session_that_was_cut_short_is_finished(tmp_path):
    given = load_rig_recipe("rig_images")
    recipe = given.model_copy(
        update={"schedule": given.schedule.model_copy(update={"presses": 3}), "output": "images"}
    )
    run_rig(recipe, tmp_path / "whole")
    whole = files(tmp_path / "whole")
    presses = tmp_path / "cut/presses"
    with largest_file(60_000), pytest.raises(OSError) as caught:
        run_rig(recipe, tmp_path / "cut")
    assert str(presses) in str(caught.value.filename)
    run_rig(recipe, tmp_path / "cut")
    assert files(tmp_path / "cut") == whole
    # Of a session that is whole, or of another recipe's, nothing is replaced unasked.
    with refused(DatasetError):
        run_rig(recipe, tmp_path / "cut")
    (presses / "sensor.yaml").unlink()
    (presses / "press_0001_0.png").unlink()
    kept = (presses / "press_0000_0.png").stat().st_mtime_ns
    with refused(DatasetError):
        run_rig(recipe.model_copy(update={"seed": 9}), tmp_path / "cut")
    run_rig(recipe, tmp_path / "cut")
    assert files(tmp_path / "cut") == whole
    assert (presses / "press_0000_0.png").stat().st_mtime_ns == kept
    run_rig(recipe.model_copy(update={"seed": 9}), tmp_path / "cut", force=True)
    run_rig(recipe.model_copy(update={"seed": 9}), tmp_path / "other")
    assert files(tmp_path / "cut") == files(tmp_path / "other")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/press_log.csv").write_text("my own")
    with refused(TacgenError):
        run_rig(recipe, tmp_path / "mine", force=True)


def test_parts_of_processes_that_are_gone_are_removed_and_others_stay(tmp_path):
    with subprocess.Popen(["true"]) as gone:
        gone.wait()
    host = socket.gethostname()
    left = tmp_path / f".x.csv.{host}.{gone.pid}.part"
    others = [tmp_path / f".x.csv.{host}.1.part", tmp_path / f".x.csv.elsewhere.{gone.pid}.part"]
    for path in (left, *others):
        path.write_text("half")
    with atomic_path(tmp_path / "y.csv") as partial:
        partial.write_text("whole")
    assert sorted(files(tmp_path)) == sorted([path.name for path in others] + ["y.csv"])


def test_an_export_removes_what_a_killed_one_left_but_not_of_one_at_work(tmp_path):
    left = tmp_path / ".out.abcdefgh.part"
    left.mkdir()
    (left / "half").write_text("half")
    at_work = refused(TacgenError, hide=rf"(?<=process ){os.getpid()} on \S+")
    with locked(tmp_path / ".out.lock"), at_work, atomic_folder(tmp_path / "out"):
        pass
    assert left.exists()
    with atomic_folder(tmp_path / "out") as partial:
        (partial / "file").write_text("whole")
    assert files(tmp_path) == {"out/file": b"whole"}
    assert not left.exists()


def as_nobody(ask) -> str:
    """What ``ask`` returns, or the error that it raises, in a process of another user."""
    if os.getuid():
        pytest.skip("becoming another user takes root")
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
            answer = str(ask())
        except BaseException as error:
            answer = f"{type(error).__name__}: {error}"
        os.write(writer, answer.encode())
        os._exit(0)
    os.close(writer)
    os.waitpid(child, 0)
    with os.fdopen(reader, encoding="utf-8") as answers:
        return answers.read()


@pytest.fixture
def public(tmp_path):
    """A folder that other users may look into."""
    for folder in (tmp_path, *tmp_path.parents[:3]):  # one more below a parallel run
        if len(folder.parts) > 2:
            folder.chmod(0o755)
    return tmp_path


def test_another_user_sees_who_holds_a_lock_and_does_not_free_it(public):
    with locked(public / "a.lock"):
        assert as_nobody(lambda: holder_of(public / "a.lock")).startswith(f"process {os.getpid()}")
        assert holder_of(public / "a.lock") is not None
    assert as_nobody(lambda: holder_of(public / "a.lock")) == "None"


def test_what_may_not_be_read_is_not_called_broken(public):
    folder = collect_toy(public / "data", make_spec())
    folder.plan_path.chmod(0o600)
    assert "ermission denied" in as_nobody(folder.plan)
    shard = folder.shard_path(0)
    shard.chmod(0o600)
    denied = "permission denied; ask its owner for the right to read it"
    assert as_nobody(lambda: open_shard(shard)) == f"DatasetError: {shard}: {denied}"
    model = public / "model.safetensors"
    model.write_bytes(b"0")
    model.chmod(0o600)
    pytest.importorskip("torch")
    load_model = pytest.importorskip(CHECKPOINT).load_model
    assert as_nobody(lambda: load_model(model)) == f"LearningError: {model}: {denied}"


def test_a_link_to_nothing_is_named_and_never_replaced(tmp_path):
    link = tmp_path / "link"
    link.symlink_to("/nowhere/x")
    with refused(DatasetError):
        collect_toy(link, make_spec())
    with refused(LearningError):
        RunFolder(link).prepare({}, {})
    with refused(DatasetError):
        refuse_existing(False, link)
    with refused(TacgenError), atomic_folder(link):
        pass


def test_words_are_printed_in_every_locale(tmp_path):
    locale = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    recipe = write_world(tmp_path)
    recipe.write_text(f"{recipe.read_text()}\ndescription: µ is a guess\n", encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "tacgen", "recipe", "show", str(recipe)],
        cwd=tmp_path, env=os.environ | locale, capture_output=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert "µ is a guess" in run.stdout.decode("utf-8")


@pytest.mark.parametrize(("minutes", "warned"), [(1, True), (2, True), (5, False)])
def test_a_time_limit_that_leaves_no_time_is_warned_of(minutes, warned, tmp_path, capsys):
    with contextlib.suppress(RuntimeError, FileNotFoundError, AssertionError):  # without Slurm
        submission._engine(tmp_path, "slurm", Cluster(time_min=minutes), "r")
    said = "leaves hardly any time to work" in capsys.readouterr().err
    assert said == warned


def test_what_repair_cannot_mend_is_told_apart_from_what_it_can(tmp_path):
    folder = collect_toy(tmp_path / "data", make_spec())
    folder.merge()
    assert verify(folder.root).foreign == ()
    shard = folder.shard_path(0).read_bytes()
    folder.shard_path(7).write_bytes(shard)  # the dataset has three
    folder.line_path(2).unlink()
    folder.manifest_path.unlink()
    found = verify(folder.root)
    assert found.bad_shards == (2,)  # a file without its line is made again
    (line,) = found.foreign
    assert line.startswith("shards/shard-00007.h5")
    assert line.endswith("remove it, and the .json of its name")
    folder.shard_path(7).unlink()
    assert verify(folder.root).foreign == ()
    np.testing.assert_equal(folder.shard_path(0).read_bytes(), shard)
