"""The virtual rig: what it writes is what its recipe says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tacgen.calibrate.contact.slope_fit import fit_slope
from tacgen.cli import app
from tacgen.contact.effects import Where, all_effects
from tacgen.contact.law import load_law
from tacgen.core.errors import RecipeError
from tacgen.core.resources import packaged
from tacgen.core.sensors import load_sensor
from tacgen.presses.press_log import read_press_log
from tacgen.rig import RigRecipe, load_rig_recipe, run_rig, simulate_session
from tacgen.rig.rig_recipe import RigEffect
from tests.messages import refused

RECIPES = sorted(packaged("recipes").glob("rig*.yaml"))
SHEAR_FORCES = ["force_shear_x_n", "force_shear_y_n"]
SHEAR_MOTIONS = ["shear_x_mm", "shear_y_mm"]


def recipe(**changes) -> RigRecipe:
    return load_rig_recipe("rig").model_copy(update=changes)


def written(text: str, folder: Path) -> Path:
    path = folder / "my_rig.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("path", RECIPES, ids=lambda path: path.stem)
def test_every_shipped_recipe_presses(path):
    given = load_rig_recipe(path)
    log = simulate_session(given).log
    assert log["trial"].nunique() == given.schedule.presses
    assert set(log["indenter"]) == {indenter.name for indenter in given.indenters}
    assert np.isfinite(log.select_dtypes("number").to_numpy()).all()


def test_a_clean_session_is_the_law_and_its_noise():
    given = recipe()
    session = simulate_session(given)
    log, true = session.log, session.true_columns
    np.testing.assert_allclose(session.truth.volume_mm3, 5.135 * true["force_normal_n"])
    noise = given.noise
    n = len(log)
    tolerance = 4.0 / np.sqrt(2 * n)
    for column, sd in (("force_normal_n", noise.force_n), ("force_shear_x_n", noise.force_n)):
        assert np.std(log[column] - true[column]) == pytest.approx(sd, rel=tolerance)
    assert np.std(log["volume_mm3"] - session.truth.volume_mm3) == pytest.approx(
        noise.volume_mm3, rel=tolerance
    )
    off = log[SHEAR_MOTIONS].to_numpy() - session.truth.shear_mm
    assert np.sqrt((off**2).sum(axis=1).mean()) == pytest.approx(noise.marker_sum_mm, rel=tolerance)


def test_a_press_loads_holds_shears_and_unloads():
    session = simulate_session(recipe())
    true = session.true_columns
    first = true["trial"] == 0
    force = true["force_normal_n"][first]
    shear = np.hypot(true["force_shear_x_n"], true["force_shear_y_n"])[first]
    peak = int(np.argmax(shear))
    assert force[0] == 0.0
    assert force[-1] < 0.1 * force.max()
    assert force[peak] == pytest.approx(force.max()), "it shears while the load is held"
    assert (np.diff(force)[: np.argmax(force)] >= 0).all()
    assert 0.1 <= shear.max() / force.max() <= 0.3


def test_the_clock_runs_on_and_the_log_is_read_without_complaint(tmp_path):
    run_rig(recipe(), tmp_path)
    log = read_press_log(tmp_path / "press_log.csv")
    assert (log.dropped, log.warnings, log.session_clock) == ((), (), True)


def test_the_same_recipe_gives_the_same_bytes(tmp_path):
    for folder in ("a", "b"):
        run_rig(recipe(), tmp_path / folder)
    run_rig(recipe(seed=1), tmp_path / "c")
    logs = [(tmp_path / folder / "press_log.csv").read_bytes() for folder in "abc"]
    assert logs[0] == logs[1] != logs[2]


def test_a_press_does_not_depend_on_how_many_follow():
    long = recipe()
    short = long.model_copy(update={"schedule": long.schedule.model_copy(update={"presses": 6})})
    whole, part = simulate_session(long).log, simulate_session(short).log
    pd.testing.assert_frame_equal(whole[whole["trial"] < 6], part)


@pytest.mark.parametrize("effect", all_effects(), ids=lambda e: f"{e.channel}-{e.name}")
def test_every_effect_reaches_the_strength_asked_for(effect):
    where = Where("trial", above=10) if effect.is_local else None
    one = RigEffect(name=effect.name, channel=effect.channel, strength=2.0, where=where)
    given = recipe(effects=(one,))
    session = simulate_session(given)
    true = session.true_columns
    if effect.channel == "normal":
        load, response = true["force_normal_n"][:, None], session.truth.volume_mm3[:, None]
        noise = given.noise.volume_mm3
    else:
        load = np.column_stack([true[name] for name in SHEAR_FORCES])
        response, noise = session.truth.shear_mm, given.noise.marker_sum_mm
    k = (load * response).sum() / (load**2).sum()
    left_over = np.sqrt(((response - k * load) ** 2).sum(axis=1).mean())
    assert left_over / noise == pytest.approx(2.0, rel=1e-3)


def test_the_truth_file_predicts_the_session(tmp_path):
    given = load_rig_recipe("rig_two_effects")
    run_rig(given, tmp_path)
    law = load_law(tmp_path / "truth.yaml")
    assert [effect.name for effect in law.effects] == ["stiffening", "temperature", "slip"]
    assert law.marker_pitch_mm == 1.5
    log = pd.read_csv(tmp_path / "press_log.csv")
    volume, _ = law.predict(log)
    # Gauge noise of 0.01 N counts 5 mm³/N.
    assert np.std(log["volume_mm3"] - volume) == pytest.approx(0.207, rel=0.05)


@pytest.mark.slow
def test_compliances_are_inside_their_intervals_as_often_as_said():
    """200 sessions; 95 % within 3.5 standard deviations of the binomial is 89.6 % or more."""
    inside = {"k_n": 0, "k_s": 0}
    for seed in range(200):
        log = simulate_session(recipe(seed=seed)).log
        trial = log["trial"].to_numpy()
        for name, load, response, true in (
            ("k_n", ["force_normal_n"], ["volume_mm3"], 5.135),
            ("k_s", SHEAR_FORCES, SHEAR_MOTIONS, 0.8),
        ):
            fit = fit_slope(log[load].to_numpy(), log[response].to_numpy(), trial)
            inside[name] += fit.interval[0] < true < fit.interval[1]
    assert inside["k_n"] >= 180
    assert inside["k_s"] >= 180


def test_everything_wrong_with_a_recipe_is_said_at_once(tmp_path):
    path = written(
        "extends: rig\n"
        "colour: red\n"
        "schedule: {presses: 0, force_n: [9.0, 2.0]}\n"
        "indenters:\n  - {name: a, radius_mm: -1}\n",
        tmp_path,
    )
    with refused(RecipeError):
        load_rig_recipe(path)


@pytest.mark.parametrize(
    "effects",
    [
        "[{name: creeep, strength: 1}]",
        "[{name: creep, parameters: {tau: 1}}]",
        "[{name: creep}]",
        "[creep, creep]",
        "[{name: slip, strength: 1}]",
    ],
)
def test_effects_that_cannot_be(tmp_path, effects):
    with refused(RecipeError):
        load_rig_recipe(written(f"extends: rig\neffects: {effects}\n", tmp_path))


def test_an_effect_that_the_schedule_cannot_show(tmp_path):
    path = written(
        "extends: rig\nindenters: [{name: a, radius_mm: 2.0}]\n"
        "effects: [{name: geometry, strength: 3}]\n",
        tmp_path,
    )
    with refused(RecipeError):
        simulate_session(load_rig_recipe(path))


def test_the_command_writes_what_it_says(tmp_path):
    result = CliRunner().invoke(app, ["rig", "rig_creep", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert result.stdout.split() == [str(tmp_path / "truth.yaml"), str(tmp_path / "press_log.csv")]


def test_another_seed_is_another_session(tmp_path):
    for name, options in (("a", []), ("b", ["--seed", "7"]), ("c", ["--seed", "7"])):
        result = CliRunner().invoke(app, ["rig", "rig", "--out", str(tmp_path / name), *options])
        assert result.exit_code == 0, result.output
    logs = [(tmp_path / name / "press_log.csv").read_bytes() for name in "abc"]
    assert logs[0] != logs[1] == logs[2]


def test_marker_tracks_sum_to_the_shear_force_and_are_the_same_twice(tmp_path):
    given = load_rig_recipe("rig_markers")
    schedule = given.schedule.model_copy(update={"presses": 2})
    markers = given.markers.model_copy(
        update={"noise_mm": 0.0, "grid_turn_deg": 0.0, "rate_hz": 2.0}
    )
    changed = given.model_copy(update={"schedule": schedule, "markers": markers})
    written = run_rig(changed, tmp_path / "a")
    assert [path.name for path in written] == ["truth.yaml", "markers.csv", "press_log.csv"]
    run_rig(changed, tmp_path / "b")
    first, again = ((tmp_path / one / "markers.csv").read_bytes() for one in "ab")
    assert first == again
    tracks = pd.read_csv(tmp_path / "a" / "markers.csv")
    log = pd.read_csv(tmp_path / "a" / "press_log.csv")
    scale = load_sensor(given.sensor, needs_table=False).mm_per_px
    for press, own in tracks.groupby("press"):
        places = own.pivot(index="frame", columns="marker", values=["x_px", "y_px"]).to_numpy()
        motion = (places - places[0]).reshape(len(places), 2, -1).sum(axis=2) * scale
        samples = log[log["trial"] == press].iloc[own["frame"].unique()]
        force = samples[SHEAR_FORCES].to_numpy()
        top = np.hypot(*force.T).argmax()
        normal = samples["force_normal_n"].to_numpy()
        held = np.flatnonzero((normal > 0.95 * normal.max()) & (np.hypot(*force.T) < 0.05))[0]
        # However it slips, the sum is k_s F, beside what the indentation moves.
        wanted = given.law.k_s_mm_per_n * force[top]
        np.testing.assert_allclose(
            motion[top] - motion[held], wanted, atol=0.05 * np.hypot(*wanted)
        )
