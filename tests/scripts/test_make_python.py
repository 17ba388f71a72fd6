"""`make` takes the newest Python that really runs, also one that pyenv has but does not show."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]


def program(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize("has_new", [True, False])
def test_make_passes_over_a_shim_without_a_version(tmp_path, has_new):
    works = f'exec {sys.executable} "$@"'
    program(
        tmp_path / "bin/python3.13", 'echo "pyenv: python3.13: command not found" >&2; exit 127'
    )
    program(tmp_path / "bin/python3.12", "exit 127")
    old = program(tmp_path / "bin/python3.11", works)
    new = tmp_path / "pyenv/versions/3.13.0/bin/python"
    if has_new:
        program(new, works)
    environment = {
        **{
            name: value for name, value in os.environ.items() if name not in ("PYTHON", "MAKEFLAGS")
        },
        "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}",
        "PYENV_ROOT": str(tmp_path / "pyenv"),
    }
    command = ["make", "--no-print-directory", "--eval", "show: ; @echo $(PYTHON)", "show"]
    shown = subprocess.run(
        command, cwd=CHECKOUT, env=environment, capture_output=True, text=True, check=True
    )
    assert shown.stdout.strip() == (str(new) if has_new else old.name)
