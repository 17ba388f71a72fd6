"""Ctrl-C at any moment: exit code 130 at once, one line, and nothing left running."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tacgen.core.errors import Interrupted
from tacgen.core.files import DiskFile
from tacgen.optics.deform import deform
from tests.dataset.conftest import collect_toy, make_spec
from validation.processes.random_kills import processes_of, wait_for_tacgen

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 10.0  # of a loaded machine; a fifth of a second on an idle one


def interrupted(arguments: list[str], after_s: float, folder: Path) -> tuple[int, str]:
    """Exit code and standard error of a command, Ctrl-C after it has run for ``after_s``."""
    errors = folder / "stderr.txt"
    with errors.open("w") as stream:
        run = subprocess.Popen(
            [sys.executable, "-m", "tacgen", *arguments],
            cwd=folder, env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL, stderr=stream, start_new_session=True,
        )  # fmt: skip
    wait_for_tacgen(run)
    time.sleep(after_s)
    os.killpg(run.pid, signal.SIGINT)
    code = run.wait(timeout=PATIENCE_S)
    deadline = time.monotonic() + PATIENCE_S
    while left := processes_of(run.pid):
        assert time.monotonic() < deadline, left
        time.sleep(0.05)
    return code, errors.read_text()


@pytest.mark.slow
def test_collect_ends_whenever_it_is_interrupted(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for k, after_s in enumerate([0.0, 0.2, *rng.uniform(0.0, 4.0, 6)]):
        code, said = interrupted(["collect", "quickstart", "--out", f"d{k}"], after_s, tmp_path)
        assert code == 130, said
        assert "Traceback" not in said, said
        assert said.splitlines()[-1].startswith("tacgen: interrupted")


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("layout", ["robomimic", "images"])
def test_exports_end_whenever_they_are_interrupted(layout: str, tmp_path: Path) -> None:
    data = collect_toy(tmp_path / "data", make_spec(n_grasps=400, shard_size=50)).root
    for k, after_s in enumerate((1.0, 1.3, 1.6)):
        arguments = ["export", str(data), "--format", layout, "--out", f"e{k}"]
        code, said = interrupted(arguments, after_s, tmp_path)
        if code == 0:
            continue  # it had finished
        assert code == 130, said
        assert "Traceback" not in said, said
        assert [path.name for path in tmp_path.glob(f"*e{k}*")] == []


def test_an_interruption_waits_until_a_write_is_done(tmp_path: Path) -> None:
    """Raised in a callback of HDF5 it would end the process there."""
    assert not DiskFile.holds_interruptions()
    with DiskFile(tmp_path / "a") as disk:
        assert DiskFile.holds_interruptions()
        disk.write(b"whole")
        with pytest.raises(Interrupted):
            disk.raise_failure()
        disk.raise_failure()  # once
    assert (tmp_path / "a").read_bytes() == b"whole"
    with pytest.raises(Interrupted), DiskFile(tmp_path / "a"):
        assert DiskFile.holds_interruptions()
    with pytest.raises(KeyError), DiskFile(tmp_path / "a"):
        {}[DiskFile.holds_interruptions()]
    with DiskFile(tmp_path / "a"):
        pass  # nothing waits any more
    assert not DiskFile.holds_interruptions()


def test_what_a_library_makes_of_an_interruption_is_one():
    """Of a writer that ends in an error of its own when it is cut off, as PyTorch's does."""
    script = """
import os, signal, time
import tacgen.cli
def app():
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
    except BaseException:
        raise RuntimeError("unexpected position")
tacgen.cli.app = app
tacgen.cli.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.returncode == 130
    assert done.stderr == "tacgen: interrupted; finished work is kept\n"


AMID_AN_IMPORT = """
import importlib.machinery, importlib.util, pathlib, manifold3d
def app():
    # An extension module that calls Python as it starts, where an exception would abort it.
    class Loader(importlib.machinery.ExtensionFileLoader):
        def exec_module(self, module):
            try:
                interrupt()
            except BaseException:
                os.abort()
    file = manifold3d.__file__
    spec = importlib.util.spec_from_loader("again", Loader("again", file))
    Loader("again", file).exec_module(None)
    time.sleep(5)
"""
AMID_COMPILING = """
from numba.core.codegen import JITCodeLibrary
def app():
    before = JITCodeLibrary._object_getbuffer_hook.__func__
    def hook(cls, *given):
        code = before(cls, *given)
        if code is not None:  # of a kernel on disk: an exception here would leave it no address
            interrupt()
        return code
    JITCodeLibrary._object_getbuffer_hook = classmethod(hook)
    import numpy as np
    from tacgen.optics.deform import deform
    deform(np.zeros((8, 8)), 0.1)
    time.sleep(5)
"""


@pytest.mark.parametrize("amid", [AMID_AN_IMPORT, AMID_COMPILING])
def test_an_interruption_waits_for_c_code_that_it_would_crash(amid):
    deform(np.zeros((8, 8)), 0.1)  # whose kernel is on disk then
    begin = """
import os, signal, time
import tacgen.cli
def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    for _ in range(1000):
        pass
"""
    end = """
tacgen.cli.app = app
tacgen.cli.main()
"""
    done = subprocess.run(
        [sys.executable, "-c", begin + amid + end], capture_output=True, text=True, check=False
    )
    assert done.stderr == "tacgen: interrupted; finished work is kept\n"
    assert done.returncode == 130
