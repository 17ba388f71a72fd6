"""The whole diagnosis with the simulator in it, and what it says to bad input."""

import json

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.collection.perturbed import Perturbation, simulate_perturbed
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.core.errors import DatasetError
from tacgen.core.records import GraspConfig
from tacgen.dataset.real_grasps import read_real_grasps
from tacgen.diagnose.grasps.command import diagnose_grasps, record_of
from tacgen.diagnose.grasps.force_from_images import imprint_strength
from tacgen.diagnose.grasps.report import write_grasp_report
from tests.messages import refused
from tests.small_world import SHORT_LIFT

BOX = "sugar_box"
PHYSICS = SHORT_LIFT | {"time_step_s": 1 / 240, "hold_s": 0.1}
RECIPE = Recipe.model_validate(
    {"name": "declared", "objects": [BOX], "grid": {"sample": 6}, "physics": PHYSICS}
)
HEADER = "grasp_id,object,force_n,x_mm,y_mm,z_mm,label"


def write_grasps(folder, rows, header=HEADER):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "grasps.csv").write_text("\n".join([header, *rows]) + "\n")
    return folder


@pytest.fixture(scope="module")
def shifted_folder(tmp_path_factory):
    """Grasps beside the centre of a box whose centre of mass is 20 mm off, labels simulated."""
    rng = np.random.default_rng(3)
    forces_n, places_mm = rng.uniform(8, 38, 12), rng.uniform(-10, 35, 12)
    configs = [
        GraspConfig(k, BOX, round(force, 2), 0.0, round(y, 1), 87.5)
        for k, (force, y) in enumerate(zip(forces_n, places_mm, strict=True))
    ]
    world = Perturbation(center_of_mass_y_mm=20.0)
    out = tmp_path_factory.mktemp("truth")
    found = simulate_perturbed(RECIPE, [(c, world) for c in configs], out, workers=1)
    rows = [
        f"g{c.index},{BOX},{c.force_n},0,{c.y_mm},{c.z_mm},{found[c.point, world].label}"
        for c in configs
    ]
    return write_grasps(tmp_path_factory.mktemp("real"), rows)


@pytest.mark.slow
def test_a_shifted_centre_of_mass_is_found_written_and_reported(shifted_folder, tmp_path):
    real = read_real_grasps(shifted_folder)
    findings = diagnose_grasps(RECIPE, real, tmp_path, workers=1)
    record = record_of(findings, RECIPE, [BOX])
    before, after = findings.diagnosis.simulated_before, findings.simulated_after
    write_grasp_report(tmp_path / "report.html", record, real, before, after)
    channel = json.loads((tmp_path / "diagnosis.json").read_text())["channels"]["grasp"]
    assert channel["verdict"] == "effect_found"
    assert channel["effects"][0]["name"] == "center_of_mass"
    value = channel["effects"][0]["parameters"]["center_of_mass_y_mm"]["value"]
    assert abs(value - 20.0) < 6.0
    assert channel["error_before"]["rmse"] > channel["error_after"]["rmse"]
    assert channel["simulated_again"]["mislabels"] <= 1
    extended = load_recipe(tmp_path / "recipe.yaml")
    assert extended.objects[0].center_of_mass_offset_mm[1] == pytest.approx(value, abs=1e-3)
    page = (tmp_path / "report.html").read_text()
    assert "center_of_mass" in page
    assert "http" not in page.replace("http://www.w3.org", "")
    proposed = pd.read_csv(tmp_path / "next_grasps.csv")
    made = {(g.config.force_n, g.config.y_mm, g.config.z_mm) for g in real.grasps}
    assert not made & set(zip(proposed.force_n, proposed.y_mm, proposed.z_mm, strict=True))


@pytest.mark.parametrize(
    "rows",
    [
        [f"a,{BOX},5,0,0,87,2"],
        ["a,no_such_thing,5,0,0,87,1"],
        [f"a,{BOX},5,0,0,87,1", f"a,{BOX},6,0,0,87,1"],
        [f"a,{BOX},x,0,0,87,1"],
    ],
)
def test_bad_rows_end_with_exit_2_and_their_line(rows, tmp_path):
    folder = write_grasps(tmp_path / "real", rows)
    (tmp_path / "r.yaml").write_text(f"name: r\nobjects: [{BOX}]\n")
    for command in (
        ["diagnose", "grasps", str(folder), "--recipe", str(tmp_path / "r.yaml")],
        ["friction", str(tmp_path / "r.yaml"), "--real", str(folder)],
    ):
        with refused(DatasetError) as raised:
            CliRunner().invoke(
                app, [*command, "--out", str(tmp_path / "out")], catch_exceptions=False
            )
        assert raised.value.exit_code == 2


def test_a_force_that_the_gripper_cannot_give_is_named(tmp_path):
    real = read_real_grasps(write_grasps(tmp_path / "real", [f"a,{BOX},55,0,0,87,1"]))
    with refused(DatasetError):
        diagnose_grasps(RECIPE, real, tmp_path / "out", workers=1)


@pytest.mark.slow
def test_three_grasps_that_contradict_each_other_still_get_a_verdict(tmp_path):
    rows = [f"a,{BOX},9,0,0,87,1", f"b,{BOX},9,0,0,87,0", f"c,{BOX},3,0,0,400,0"]
    real = read_real_grasps(write_grasps(tmp_path / "real", rows))
    findings = diagnose_grasps(RECIPE, real, tmp_path / "out", workers=1)
    notes = " ".join(findings.diagnosis.notes)
    assert "3 grasps only" in notes
    assert "opposite labels" in notes
    assert "1 of 3 grasps cannot be executed" in notes
    assert "'c': " in notes
    assert findings.diagnosis.verdict in ("sufficient", "unexplained")
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["notes"]
    # All that was simulated is kept: a second run simulates nothing and gives the same file.
    files = [tmp_path / "out" / "diagnosis.json", *(tmp_path / "out").rglob("outcomes.jsonl")]
    before = [path.read_bytes() for path in files]
    assert len(before) == 2
    diagnose_grasps(RECIPE, real, tmp_path / "out", workers=1)
    assert [path.read_bytes() for path in files] == before


def test_the_strength_of_an_imprint_grows_and_does_not_follow_the_gain():
    rng = np.random.default_rng(0)
    untouched = np.full((120, 160, 3), 120, np.uint8)
    rows, columns = np.mgrid[:120, :160]

    def pressed(radius_px, gain=1.0):
        bump = 60.0 * np.exp(-((rows - 60) ** 2 + (columns - 80) ** 2) / radius_px**2)
        grey = (120 + bump[..., None]) * gain + rng.normal(0, 1, untouched.shape)
        return np.clip(grey, 0, 255).astype(np.uint8)

    strengths = [imprint_strength(pressed(r), untouched) for r in (5, 10, 20)]
    assert strengths[0] < strengths[1] < strengths[2]
    again = imprint_strength(pressed(10, gain=1.04), untouched)
    assert again == pytest.approx(strengths[1], rel=0.1)
    assert imprint_strength(untouched, untouched) == 0.0
