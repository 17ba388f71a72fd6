"""The documentation: it builds, its commands run, its reference is that of the models."""

import json
import os
import re
import shlex
import subprocess
import sys
from copy import deepcopy
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from docs import hooks
from tacgen.cli import app
from tacgen.contact.effects import all_effects
from tacgen.diagnose.rules import ContactRules

ROOT = Path(__file__).resolve().parents[1]
FILE = re.compile(r'```yaml title="(.+?)"\n(.*?)```', re.S)
COMMANDS = re.compile(r"```bash\n(.*?)```", re.S)


def run(command: str) -> None:
    """Run a line of ``tacgen`` in this process, as starting Python takes longer; or of Python."""
    program, *words = shlex.split(command, comments=True)
    if program == "python":
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, *words], env=environment, check=True)
        return
    assert program == "tacgen", command
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, f"{command}\n{done.output[-3000:]}{done.exception}"


def replaced(text: str, old: str, new: str) -> str:
    """``text`` with ``old``, which must occur once, replaced."""
    assert text.count(old) == 1, old
    return text.replace(old, new)


SHORTER = {
    "train_single_small.yaml": (
        "extends: train_single_small\nper_object: false\ntraining: {epochs: 2}\n"
    ),
    "rig_images.yaml": (
        "extends: rig_images\nsensor: {name: gelsight_mini}\nschedule: {presses: 8}\n"
    ),
}
"""Recipes that a folder may have in place of the shipped ones of the same names."""


def write_shorter_recipes(folder: Path) -> None:
    for name, content in SHORTER.items():
        (folder / name).write_text(content, encoding="utf-8")


@pytest.mark.slow
def test_every_command_of_the_tutorial_of_a_real_sensor_runs(tmp_path, monkeypatch):
    """As written, on all of the package's presses."""
    pytest.importorskip("taxim", reason="pip install --no-deps taxim==1.4.1: its real presses")
    text = (ROOT / "docs" / "tutorial" / "real_sensor.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for name, content in FILE.findall(text):
        (tmp_path / name).write_text(content, encoding="utf-8")
    for command in "".join(COMMANDS.findall(text)).splitlines():
        if not command.startswith("pip "):
            run(command)
    held_out = json.loads((tmp_path / "optics" / "diagnosis.json").read_text())
    assert held_out["channels"]["rgb"]["verdict"] == "sufficient"
    readings = (tmp_path / "readings" / "readings.csv").read_text().splitlines()
    columns = readings[0].split(",")
    forces = [float(row.split(",")[columns.index("force_normal_n")]) for row in readings[1:]]
    assert forces == pytest.approx([4.0, 12.0], rel=0.1)


@pytest.mark.slow
def test_every_command_of_readme_and_tutorial_runs(tmp_path, monkeypatch):
    """As written, with fewer presses, grasps and epochs; the recipe of ``init`` is edited.

    Of the tutorial what trains is not run again: it is the README's, word by word.
    """
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    lines = [line.strip() for line in text.splitlines() if line.startswith("    ")]
    commands = [line for line in lines if line.startswith(("tacgen ", "cd ", "python "))]
    assert len(commands) > 15
    monkeypatch.chdir(tmp_path)
    for command in commands:
        if not command.startswith("cd "):
            run(command)
            continue
        monkeypatch.chdir(command.removeprefix("cd "))
        write_shorter_recipes(Path.cwd())
        recipe = Path("recipe.yaml")
        recipe.write_text(replaced(recipe.read_text(), "sample: 100", "sample: 16"))
    text = (ROOT / "docs" / "tutorial" / "first_network.md").read_text(encoding="utf-8")
    files = dict(FILE.findall(text))
    files["session.yaml"] = replaced(files["session.yaml"], "presses: 30", "presses: 8")
    files["recipe.yaml"] = replaced(files["recipe.yaml"], "sample: 120", "sample: 2")
    (tmp_path / "tutorial").mkdir()
    monkeypatch.chdir(tmp_path / "tutorial")
    for name, content in files.items():
        Path(name).write_text(content, encoding="utf-8")
    ran = [shlex.split(command, comments=True) for command in commands]
    for command in "".join(COMMANDS.findall(text)).splitlines():
        if command.startswith(("tacgen train", "tacgen eval")):
            assert shlex.split(command) in ran
        else:
            run(command)


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "reference" / "recipes" / "index.html").read_text(encoding="utf-8")
    for word in ("randomize", "tactile_pads", "depth", "extends", "learning_rate", "indenters"):
        assert word in page
    page = (tmp_path / "reference" / "commands" / "index.html").read_text(encoding="utf-8")
    for word in ("tacgen calibrate contact", "--radius-mm", "Ball of presses with depths, mm."):
        assert word in page
    page = (tmp_path / "reference" / "files" / "index.html").read_text(encoding="utf-8")
    for effect in all_effects():
        assert f"<code>{effect.name}</code>" in page
    page = (tmp_path / "howto" / "calibrate_contact" / "index.html").read_text(encoding="utf-8")
    assert "V = k<sub>n</sub> F<sub>n</sub>" in page  # in prose, but not in code
    assert "k_n = 5.1341" in page
    page = (tmp_path / "reference" / "rules" / "index.html").read_text(encoding="utf-8")
    for rule in fields(ContactRules):
        assert f"<code>{rule.name}</code>" in page


@pytest.mark.parametrize("kind", hooks.KINDS)
def test_every_key_has_a_meaning_and_examples_that_the_model_takes(kind):
    model = hooks.KINDS[kind]
    part = {"column": "x_mm", "above": 1.0, "up_to": 2.0}
    look_at = {"from_mm": [300, -400, 300], "to_mm": [0, 0, 90]}
    valid = {
        "name": "x",
        "objects": [{"name": "cup"}],
        "rows": [{"name": "a"}],
        "indenters": [{"name": "ball", "radius_mm": 2.0}],
        "effects": [{"name": "creep", "strength": 1.0, "where": part}],
        "scene": {"cameras": [{"name": "front", "look_at": look_at}]},
    }
    for key in hooks.keys_of(kind):
        assert key.meaning, key.path
        if not key.example or kind in ("sensor", "object"):
            continue  # examples of these two are those of the shipped files, which load
        data = {k: deepcopy(value) for k, value in valid.items() if k in model.model_fields}
        if kind == "train":
            data.pop("objects")
        place = data
        *sections, last = key.path.split(".")
        for section in sections:
            place = place.setdefault(section, {})
            place = place[0] if isinstance(place, list) else place
        place[last] = yaml.safe_load(key.example)
        if key.path == "effects.parameters":
            place.pop("strength", None)
        model.model_validate(data)


@pytest.mark.slow
def test_the_command_for_a_labs_csv_gives_the_law(tmp_path, monkeypatch):
    """Presses of a ball of 4 mm into a gel of 5.2 mm³/N, as the page describes the file."""
    text = (ROOT / "docs" / "howto" / "csv_to_law.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(0)
    lines = ["# rig 3, 4 May", "Timestamp [ms];Press #;Fz [N];Depth [mm]"]
    for row in range(640):
        press, sample = divmod(row, 80)
        depth = max(0.0, (0.6 + 0.05 * press) * np.sin(np.pi * sample / 79) - 0.05)
        force = np.pi * depth**2 * (4.0 - depth / 3) / 5.2 + 0.05 + rng.normal(0.0, 0.01)
        lines.append(f"{20 * row};{press};{-force:.4f};{depth:.4f}".replace(".", ","))
    (tmp_path / "lab.csv").write_text("\n".join(lines), encoding="utf-8")
    commands = re.findall(r"^    (tacgen calibrate contact .*)$", text, re.M)
    assert len(commands) == 1
    run(commands[0])
    law = yaml.safe_load((tmp_path / "contact.yaml").read_text(encoding="utf-8"))
    assert law["k_n_mm3_per_n"]["value"] == pytest.approx(5.2, rel=0.02)  # three times the noise


def test_pictures_are_small():
    for path in (ROOT / "docs").rglob("figures/*.*"):
        assert path.stat().st_size <= 100_000, path
