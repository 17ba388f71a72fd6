"""A container: the package is read-only, and the user has no home."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DROPPED = "-dac_override,-dac_read_search"


@pytest.mark.exhaustive
@pytest.mark.slow
def test_commands_compile_into_a_temporary_folder_and_say_so(tmp_path: Path) -> None:
    """With the rights of root to write anywhere dropped, if it is root that tests."""
    setpriv = shutil.which("setpriv")
    if os.getuid() == 0 and setpriv is None:
        pytest.skip("root can write anywhere, and there is no setpriv")
    for name in ("tacgen", "recipes", "objects"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(["chmod", "-R", "a-w", *map(str, tmp_path.iterdir())], check=True)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    root = [f"--bounding-set={DROPPED}", f"--inh-caps={DROPPED}"]
    lower = [str(setpriv), *root] if os.getuid() == 0 else []
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR",)}
    environment |= {"HOME": "/proc/none", "PYTHONPATH": str(tmp_path), "TMPDIR": str(temporary)}
    environment.pop("XDG_CACHE_HOME", None)
    found = {}
    for command in ("doctor", "bench --repeats 5 --json"):
        found[command] = subprocess.run(
            [*lower, sys.executable, "-m", "tacgen", *command.split()],
            env=environment | {"PYTHONDONTWRITEBYTECODE": "1"},
            cwd=temporary, capture_output=True, text=True, check=False,
        )  # fmt: skip
    subprocess.run(["chmod", "-R", "u+w", str(tmp_path)], check=True)
    for done in found.values():
        assert done.returncode == 0, done.stderr
        assert done.stderr.count("set NUMBA_CACHE_DIR to a folder") == 1
    assert "set NUMBA_CACHE_DIR" in found["doctor"].stdout
    assert list(temporary.glob("tacgen-cache-*")) == []
