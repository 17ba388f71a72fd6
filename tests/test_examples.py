"""Every script in ``examples/`` runs as its first line says, and gives the force that it should."""

import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from tests.dataset.conftest import collect_toy, make_spec

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(name, *arguments, cwd):
    environment = os.environ | {"PYTHONPATH": str(EXAMPLES.parent)}
    result = subprocess.run(
        [sys.executable, EXAMPLES / name, *arguments],
        cwd=cwd, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.slow
def test_own_mesh(tmp_path):
    depth_mm, volume_mm3 = map(float, re.findall(r"[\d.]+", run("own_mesh.py", cwd=tmp_path))[:2])
    assert 0 < depth_mm < 4
    assert volume_mm3 == pytest.approx(5.135 * 4, rel=0.01)
    assert cv2.imread(str(tmp_path / "own_mesh.png")).shape == (240, 320, 3)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_digit_reads_the_weight_of_the_ball(engine, tmp_path):
    pytest.importorskip(engine)
    said = run(f"digit_in_{engine}.py", cwd=tmp_path)
    assert float(re.findall(r"[\d.]+", said)[0]) == pytest.approx(0.4 * 9.81, rel=0.01)
    assert (tmp_path / "digit.png").is_file()


@pytest.mark.slow
def test_training_loop(tmp_path):
    pytest.importorskip("torch")
    collect_toy(tmp_path / "data", make_spec())
    assert "epoch 2" in run("train_in_torch.py", tmp_path / "data", cwd=tmp_path)
