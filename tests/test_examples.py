"""Every script in ``examples/`` runs as its first line says, and gives the force that it should."""

import doctest
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

import tacgen
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
def test_digits_in_mujoco_warp(tmp_path):
    pytest.importorskip("mujoco_warp")
    said = run("digits_in_mujoco_warp.py", cwd=tmp_path)
    least_n, most_n = map(float, re.findall(r"([\d.]+) to ([\d.]+) N", said)[0])
    # A ball of 0.1 kg, pushed by 0 to 6 N.
    assert least_n == pytest.approx(0.1 * 9.81, rel=0.02)
    assert most_n == pytest.approx(0.1 * 9.81 + 6, rel=0.02)
    assert cv2.imread(str(tmp_path / "digits.png")).shape == (1280, 960, 3)


@pytest.mark.slow
def test_training_loop(tmp_path):
    pytest.importorskip("torch")
    collect_toy(tmp_path / "data", make_spec())
    assert "epoch 2" in run("train_in_torch.py", tmp_path / "data", cwd=tmp_path)


@pytest.mark.slow
def test_examples_in_docstrings(tmp_path, monkeypatch):
    """Of every public name, in the order in which one example needs what another has written."""
    monkeypatch.chdir(tmp_path)
    Path("two_grasps.yaml").write_text(
        "name: two_grasps\nobjects: [tomato_soup_can]\nsensor: gelsight_mini\n"
        "grid: {force_n: [5, 30], x_mm: 0, y_mm: 0, z_mm: 50}\n"
    )
    Path("contact.yaml").write_text(
        "law: volume_linear\nk_n_mm3_per_n: {value: 5.135}\nk_s_mm_per_n: {value: 1.0}\n"
    )
    names = ("load_recipe", "collect", "load_table", "load_law", "Sensor")
    names += ("read_image", "ImageReader", "Dataset")
    assert {*names, "BatchSensor", "Predictor", "__version__"} == set(dir(tacgen))
    if importlib.util.find_spec("warp"):
        import warp

        monkeypatch.setattr(warp.config, "log_level", warp.LOG_WARNING)  # it prints what it loads
        names += ("BatchSensor",)
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner()
    for name in names:
        globs = {"tacgen": tacgen, "Path": Path}
        (examples,) = finder.find(getattr(tacgen, name), name, globs=globs)
        assert examples.examples, f"{name} has no example"
        runner.run(examples)
    assert runner.summarize().failed == 0


@pytest.mark.slow
def test_notebook(tmp_path):
    cells = json.loads((EXAMPLES / "first_steps.ipynb").read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    (tmp_path / "notebook.py").write_text(f"import matplotlib\nmatplotlib.use('agg')\n{code}\n")
    said = run(tmp_path / "notebook.py", cwd=tmp_path)
    volume_mm3, _, force_n, stderr_n = map(float, re.findall(r"\d+\.\d+", said))
    assert volume_mm3 == pytest.approx(5.135 * 4, rel=0.01)
    assert force_n == pytest.approx(3.0, abs=max(0.2, 3 * stderr_n))


@pytest.mark.slow
def test_policy_that_regrasps(tmp_path):
    pytest.importorskip("stable_baselines3")
    text = (EXAMPLES / "regrasp_with_sb3.py").read_text(encoding="utf-8")
    for old, new in {"n_envs=4": "n_envs=2", "n_steps=64, batch_size=64": "n_steps=16",
                     "n_eval_episodes=20": "n_eval_episodes=2"}.items():  # fmt: skip
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (tmp_path / "shorter.py").write_text(text, encoding="utf-8")
    said = run(tmp_path / "shorter.py", "32", cwd=tmp_path)
    rewards = [float(one) for one in re.findall(r"reward (-?[\d.]+)", said)]
    assert len(rewards) == 2
    assert all(-0.3 <= reward <= 1 for reward in rewards)  # three regrasps and a drop, or none
    assert (tmp_path / "regrasp_policy.zip").is_file()
