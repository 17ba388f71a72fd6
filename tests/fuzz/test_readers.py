"""No file, however spoiled, ends a reader with a traceback, a hang, or a heap of memory."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.fuzz.readers import LEARNED, READERS

CHECKOUT = Path(__file__).parents[2]
SECONDS = 0.5
RUNS = 60
MAX_EXTRA_MB = 250
"""On top of a sound file's: an image of the largest size allowed takes 200 MB."""


def fuzzed(module, folder, *arguments):
    """What ``module`` prints of all readers, in a process of its own."""
    names = [name for name in READERS if name not in LEARNED or find_spec("torch")]
    command = [sys.executable, "-W", "ignore", "-m", module, str(folder), *map(str, arguments)]
    run = subprocess.run(
        [*command, *names], cwd=CHECKOUT, capture_output=True, text=True, timeout=600, check=False
    )
    assert run.returncode == 0, run.stderr[-3000:]
    return json.loads(run.stdout)


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory):
    """What each reader made of spoiled files, and whether it took too much memory or time."""
    return fuzzed("tests.fuzz.spoil", tmp_path_factory.mktemp("spoiled"), 1, SECONDS)


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_a_spoiled_file_is_read_or_refused(spoiled, name):
    """In a process of its own, with a limit on its memory and on the time of each file."""
    if name not in spoiled:
        pytest.skip("PyTorch is not installed")
    told = spoiled[name]
    assert not told["failure"], told["failure"]
    assert told["read"] + told["refused"] > 10
    assert told["extra_mb"] < MAX_EXTRA_MB


@pytest.fixture(scope="module")
def led(tmp_path_factory):
    """Where atheris' logs are, and how each reader's runs ended."""
    pytest.importorskip("atheris", reason="atheris is not installed")
    folder = tmp_path_factory.mktemp("led")
    return folder, fuzzed("tests.fuzz.led", folder, RUNS)


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_what_atheris_finds_is_read_or_refused(led, name):
    """Inputs led by the code that they reach."""
    folder, ended = led
    if name not in ended:
        pytest.skip("PyTorch is not installed")
    log = (folder / name / "log").read_text(errors="replace")
    assert ended[name] == 0, log[-3000:]
    assert f"Done {RUNS} runs" in log
