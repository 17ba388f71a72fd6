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


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_a_spoiled_file_is_read_or_refused(tmp_path, name):
    """In a process of its own, with a limit on its memory and on the time of each file."""
    if name in LEARNED:
        pytest.importorskip("torch")
    command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz.spoil", name, str(tmp_path)]
    run = subprocess.run(
        [*command, "1", str(SECONDS)],
        cwd=CHECKOUT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    told = json.loads(run.stdout)
    assert not told["failure"], told["failure"]
    assert told["read"] + told["refused"] > 10
    assert told["extra_mb"] < MAX_EXTRA_MB


@pytest.fixture(scope="module")
def led(tmp_path_factory):
    """Where atheris' logs are, and how each reader's runs ended."""
    pytest.importorskip("atheris", reason="atheris is not installed")
    names = [name for name in READERS if name not in LEARNED or find_spec("torch")]
    folder = tmp_path_factory.mktemp("led")
    command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz.led", str(folder), str(RUNS)]
    run = subprocess.run(
        [*command, *names], cwd=CHECKOUT, capture_output=True, text=True, timeout=600, check=False
    )
    assert run.returncode == 0, run.stderr[-3000:]
    return folder, json.loads(run.stdout)


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
