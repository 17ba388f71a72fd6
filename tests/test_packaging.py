"""What travels in the wheel, and that the wheel alone does the main job."""

import os
import re
import subprocess
import sys
import tomllib
from itertools import chain
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
OTHER_PYTHON = "TACGEN_OTHER_PYTHON"
"""Names another Python than the tests' own to test the wheel with; `.ci/run` sets it."""


def test_the_lock_file_pins_every_dependency():
    pinned = {
        line.split("==")[0].lower()
        for lock in ("requirements.lock", "requirements-learn.lock")
        for line in (ROOT / lock).read_text(encoding="utf-8").splitlines()
    }
    project = tomllib.loads(PYPROJECT)["project"]
    lines = chain(project["dependencies"], *project["optional-dependencies"].values())
    named = {re.split(r"[><=\[;]", line)[0].lower().replace("_", "-") for line in lines}
    assert named <= pinned


def test_no_registry_is_named():
    for lock in ("requirements.lock", "requirements-learn.lock"):
        assert "://" not in (ROOT / lock).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    _run(sys.executable, "-m", "build", "--outdir", str(out), cwd=ROOT)
    _run(sys.executable, "-m", "twine", "check", "--strict", *map(str, out.iterdir()), cwd=ROOT)
    (found,) = out.glob("*.whl")
    return found


@pytest.mark.slow
def test_the_wheel_alone_runs_in_an_empty_folder(wheel: Path, tmp_path: Path) -> None:
    """Installed without extras: a dataset, a project, a calibration, the gallery."""
    python = os.environ.get(OTHER_PYTHON, sys.executable)
    folder, bin_folder = tmp_path / "empty", tmp_path / "env" / "bin"
    folder.mkdir()
    uv = (sys.executable, "-m", "uv", "--quiet")
    _run(*uv, "venv", "--python", python, str(tmp_path / "env"), cwd=folder)
    options = ("--python", str(bin_folder / "python"), "--constraint", ROOT / "requirements.lock")
    _run(*uv, "pip", "install", *map(str, options), str(wheel), cwd=folder)
    for line in (
        "collect quickstart --out data",
        "view data --no-browser",
        "init project",
        "rig rig --out session",
        "calibrate contact session/press_log.csv --out contact.yaml --report report",
    ):
        _run(str(bin_folder / "tacgen"), *line.split(), cwd=folder)
    assert (folder / "data" / "index.html").is_file()
    assert (folder / "contact.yaml").is_file()


def _run(*command: str, cwd: Path) -> None:
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        command, cwd=cwd, env=kept, capture_output=True, text=True, check=False, timeout=900
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"
