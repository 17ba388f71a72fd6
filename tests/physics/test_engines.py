"""Engines by name: what is missing or unknown is refused, with what can be used instead."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tacgen.core.errors import PhysicsError
from tacgen.core.records import GraspConfig
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp
from tests.messages import refused

from .conftest import block, opened

ROOT = Path(__file__).resolve().parents[2]


def test_settings_of_another_engine_are_refused() -> None:
    config = GraspConfig(0, "block", 5.0, 0.0, 0.0, 50.0)
    settings = PhysicsSettings(engine="mujoco")
    with opened("wsg50", "pybullet") as simulator, refused(PhysicsError):
        run_grasp(simulator, block(), config, settings, frames=FrameRequest())


def test_an_unknown_engine() -> None:
    with refused(PhysicsError):
        GraspSimulator("wsg50", "bullet")  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(("missing", "engine", "code"), [
    ("pybullet", "auto", 0), ("pybullet", "pybullet", 2), ("mujoco", "mujoco", 2),
])  # fmt: skip
def test_collect_needs_its_own_engine_alone(
    missing: str, engine: str, code: int, tmp_path: Path
) -> None:
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / f"{missing}.py").write_text("raise ImportError('hidden')\n")
    (tmp_path / "recipe.yaml").write_text(
        "name: one\nobjects: [golf_ball]\ngrid: {sample: 1}\n"
        f"physics: {{engine: {engine}}}\nsensor: gelsight_mini\n"
    )
    path = os.pathsep.join([str(tmp_path / "hidden"), str(ROOT)])
    result = subprocess.run(
        [sys.executable, "-m", "tacgen", "collect", "recipe.yaml", "--out", "data"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert result.returncode == code, result.stderr
    if code:
        assert "pip install" in result.stderr
        assert f"physics: {{engine: {'mujoco' if engine == 'pybullet' else 'pybullet'}}}" in (
            result.stderr
        )
    else:
        assert list((tmp_path / "data" / "shards").glob("*.h5"))
        assert "engine: mujoco" in (tmp_path / "data" / "recipe.yaml").read_text()
