"""No file, however spoiled, ends a reader with a traceback, a hang, or a heap of memory."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.fuzz.readers import LEARNED, READERS

CHECKOUT = Path(__file__).parents[2]
SECONDS = 0.2
MAX_EXTRA_MB = 250
"""On top of a sound file's: an image of the largest size allowed takes 200 MB."""


def fuzzed(folder, *arguments):
    """What ``spoil`` prints of all readers that are installed, in a process of its own."""
    names = [name for name in READERS if name not in LEARNED or find_spec("torch")]
    command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz.spoil", str(folder)]
    command += [*map(str, arguments)]
    run = subprocess.run(
        [*command, *names], cwd=CHECKOUT, capture_output=True, text=True, timeout=600, check=False
    )
    assert run.returncode == 0, run.stderr[-3000:]
    return json.loads(run.stdout)


@pytest.mark.slow
def test_spoiled_files_are_read_or_refused(tmp_path):
    """In processes of their own, with a limit on their memory and on the time of each file."""
    for name, told in fuzzed(tmp_path, 1, SECONDS).items():
        assert not told["failure"], f"{name}: {told['failure']}"
        assert told["read"] + told["refused"] > 10, name
        assert told["extra_mb"] < MAX_EXTRA_MB, name
