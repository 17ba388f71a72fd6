"""No file, however spoiled, ends a reader with a traceback, a hang, or a heap of memory."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.fuzz.readers import NEED_TORCH, READERS

CHECKOUT = Path(__file__).parents[2]
SECONDS = 1.0
MAX_EXTRA_MB = 250
"""On top of a sound file's: an image of the largest size allowed takes 200 MB."""


@pytest.mark.slow
@pytest.mark.parametrize("name", READERS)
def test_a_spoiled_file_is_read_or_refused(tmp_path, name):
    """In a process of its own, with a limit on its memory and on the time of each file."""
    if name in NEED_TORCH:
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


@pytest.mark.slow
@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris is not installed")
@pytest.mark.parametrize(
    "name", ["recipe", "contact law", "lookup table", "manifest", "batch jobs"]
)
def test_what_atheris_finds_is_read_or_refused(tmp_path, name):
    """Inputs led by the code that they reach, for a few seconds."""
    command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz.led", name, str(tmp_path)]
    options = ["-max_total_time=8", "-timeout=20", "-rss_limit_mb=3000", "-seed=1"]
    run = subprocess.run(
        [*command, *options],
        cwd=CHECKOUT,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert run.returncode == 0, run.stderr[-3000:]
