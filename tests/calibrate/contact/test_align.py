"""One road from depths, volumes or both to the law: the same presses give the same answer."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tacgen.calibrate.contact.align import align, shift_beside_effects
from tacgen.calibrate.contact.command import LogSource, calibrate_contact
from tacgen.calibrate.contact.law_fit import fit_contact
from tacgen.cli import app
from tacgen.contact.law import load_law
from tacgen.core.errors import PressError
from tacgen.diagnose.contact.command import diagnose_log
from tacgen.presses.geometry import ball_depth_mm, ball_volume_mm3
from tacgen.presses.lab_table import LogFormat, read_log_table
from tacgen.presses.press_log import press_log_of
from tacgen.rig import RigRecipe, load_rig_recipe, simulate_session
from tests.messages import refused

K_N, K_S = 5.135, 0.8


def curves(radius_mm, k_n, deepest_mm, *, late_mm=0.0, n_curves=1, seed=0) -> pd.DataFrame:
    """Curves of one ball with noise of 0.3 % of the largest force."""
    rng, parts = np.random.default_rng(seed), []
    for trial in range(n_curves):
        depth = np.linspace(0.0, deepest_mm, 40)
        force = ball_volume_mm3(depth - late_mm, radius_mm) / k_n
        force += 0.003 * force.max() * rng.standard_normal(40)
        parts.append(pd.DataFrame({"trial": trial, "force_normal_n": force, "depth_mm": depth}))
    return pd.concat(parts, ignore_index=True)


def read(frame: pd.DataFrame, folder: Path):
    frame.to_csv(folder / "log.csv", index=False)
    return press_log_of(read_log_table(folder / "log.csv", LogFormat()))


def session(seed: int, effects=()) -> tuple[pd.DataFrame, np.ndarray]:
    """A session of the rig with one or two balls, and the true depths (N,)."""
    given = load_rig_recipe("rig").model_dump() | {"seed": seed, "effects": list(effects)}
    given["schedule"]["force_n"] = (0.6, 4.0)
    radii = (4.0,) if seed % 2 else (3.0, 5.0)
    given["indenters"] = [{"name": f"ball_{r:g}", "radius_mm": r} for r in radii]
    made = simulate_session(RigRecipe.model_validate(given))
    log = made.log.round(6)
    return log, ball_depth_mm(made.truth.volume_mm3, log["radius_mm"])


def in_form(form: str, seed: int, effects=()) -> pd.DataFrame:
    """A session's depths as a rig may record them, in place of its volumes."""
    log, true_mm = session(seed, effects)
    noise = 0.005 * np.random.default_rng([seed, 7]).standard_normal(len(log))
    own_zero = 0.03 * np.random.default_rng([seed, 8]).standard_normal(log["trial"].nunique())
    depth = {
        "of the volumes": ball_depth_mm(log["volume_mm3"], log["radius_mm"]),
        "exact": true_mm,
        "noise": true_mm + noise,
        "zero off": true_mm + 0.05 + noise,
        "counted late": np.maximum(true_mm - 0.04, 0.0),
        "each its own": np.where(true_mm > 0, true_mm, -0.3) + own_zero[log["trial"]],
    }[form]
    return log.assign(depth_mm=depth).drop(columns="volume_mm3").round(6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "seed"),
    [
        ("exact", 40),
        ("zero off", 41),
        pytest.param("of the volumes", 41, marks=pytest.mark.exhaustive),
        pytest.param("noise", 40, marks=pytest.mark.exhaustive),
        pytest.param("counted late", 41, marks=pytest.mark.exhaustive),
        pytest.param("each its own", 40, marks=pytest.mark.exhaustive),
    ],
)
def test_the_same_presses_give_one_law_whatever_they_come_with(tmp_path, form, seed):
    """k_s to the last digit, k_n within its error, and no effect by either command."""
    log, _ = session(seed)
    log.to_csv(tmp_path / "volumes.csv", index=False)
    by_volume = calibrate_contact(LogSource(tmp_path / "volumes.csv"), tmp_path / "v.yaml").law
    in_form(form, seed).to_csv(tmp_path / "depths.csv", index=False)
    law = calibrate_contact(LogSource(tmp_path / "depths.csv"), tmp_path / "d.yaml").law
    assert law.k_s_mm_per_n == by_volume.k_s_mm_per_n
    assert law.k_s_mm_per_n.value == pytest.approx(K_S, rel=0.02)
    assert abs(law.k_n_mm3_per_n.value - K_N) < 3.5 * law.k_n_mm3_per_n.stderr < 0.025 * K_N
    diagnosis = diagnose_log(LogSource(tmp_path / "depths.csv"), tmp_path / "diagnosis")
    found = {name: one.verdict for name, one in diagnosis.channels.items()}
    assert found == {"normal": "sufficient", "shear": "sufficient"}
    assert diagnosis.law.k_n_mm3_per_n == law.k_n_mm3_per_n


def effect(name: str) -> dict[str, object]:
    return {"name": name, "channel": "normal", "strength": 4.0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("form", "name"),
    [
        pytest.param("noise", "hysteresis", marks=pytest.mark.exhaustive),
        ("counted late", "creep"),
        ("zero off", "stiffening"),
    ],
)
def test_an_effect_is_found_by_depths_too(tmp_path, form, name):
    in_form(form, 44, [effect(name)]).to_csv(tmp_path / "log.csv", index=False)
    found = diagnose_log(LogSource(tmp_path / "log.csv"), tmp_path / "diagnosis")
    assert found.channels["normal"].effect_names == (name,)
    # A fast creep is partly taken for compliance.
    assert found.law.k_n_mm3_per_n.value == pytest.approx(K_N, rel=0.03)


@pytest.mark.parametrize(
    ("names", "form", "shift_mm"),
    [
        ((), "zero off", None),
        (("creep",), "noise", 0.0),
        (("creep",), "zero off", -0.05),
        (("creep",), "counted late", 0.04),
        (("hysteresis",), "zero off", -0.05),
        (("stiffening",), "noise", 0.0),
        (("stiffening",), "zero off", -0.05),
        (("creep", "stiffening"), "zero off", -0.05),
    ],
)
def test_a_zero_is_told_from_what_the_gel_does(tmp_path, names, form, shift_mm):
    """One shift of all depths beside effects, to 3 µm; without any, of each press by itself."""
    log = read(in_form(form, 46, [effect(name) for name in names]), tmp_path)
    found = shift_beside_effects(align(log, free_contact_point=False)[0], log.trials.tolist())
    if shift_mm is None:
        assert found is None
    else:
        assert found[0] == pytest.approx(shift_mm, abs=0.003)
        assert 0.0005 < found[1] < 0.003


@pytest.mark.slow
def test_presses_with_depths_beside_presses_with_volumes(tmp_path):
    log, true_mm = session(43)
    even = log["trial"] % 2 == 0
    mixed = log.assign(depth_mm=np.where(even, true_mm, np.nan))
    mixed["volume_mm3"] = log["volume_mm3"].where(~even)
    read_mixed = read(mixed, tmp_path)
    assert len(read_mixed.trials) == log["trial"].nunique()
    assert any("no volume_mm3 in 12 presses" in text for text in read_mixed.warnings)
    expected = np.where(even, ball_volume_mm3(true_mm, log["radius_mm"]), log["volume_mm3"])
    np.testing.assert_allclose(read_mixed["volume_mm3"], expected)
    law = calibrate_contact(LogSource(tmp_path / "log.csv"), tmp_path / "law.yaml").law
    assert abs(law.k_n_mm3_per_n.value - K_N) < 3.5 * law.k_n_mm3_per_n.stderr < 0.025 * K_N


def test_a_measured_volume_is_not_replaced_by_that_of_a_depth_beside_it(tmp_path):
    log, true_mm = session(43)
    log["depth_mm"] = 1.3 * true_mm + 0.1
    aligned, points = align(read(log, tmp_path))
    assert points == ()
    np.testing.assert_array_equal(aligned["volume_mm3"], log["volume_mm3"])


@pytest.mark.slow
def test_an_unknown_ball_is_found_where_the_curve_bends(tmp_path):
    """Deep enough that the cap is no parabola: radius and k_n part."""
    log = read(curves(2.0, 4.0, 2.5, late_mm=0.1, n_curves=2), tmp_path)
    aligned, points = align(log)
    assert aligned["radius_mm"][0] == pytest.approx(2.0, rel=0.05)
    assert [point.depth_mm for point in points] == pytest.approx([-0.1, -0.1], abs=0.02)
    assert any("whose radius was fitted" in text for text in aligned.warnings)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_k_n_of_an_unknown_ball_is_off_by_what_its_error_says(tmp_path):
    """The radius is most of it. Bounds: 0.1 and 99.9 % of a χ² of 12, three errors of a mean."""
    offs = []
    for seed in range(30, 42):
        log = read(curves(2.0, 4.0, 2.5, late_mm=0.1, n_curves=2, seed=seed), tmp_path)
        k_n = fit_contact(log).law.k_n_mm3_per_n
        assert k_n.stderr < 0.25
        offs.append((k_n.value - 4.0) / k_n.stderr)
    assert 2.2 < np.square(offs).sum() < 32.9
    assert abs(np.mean(offs)) < 3.0 / np.sqrt(len(offs))


@pytest.mark.slow
def test_shallow_curves_that_cannot_tell_the_radius_are_refused(tmp_path):
    """V ≈ π R d² for d ≪ R: only R / k_n is known."""
    with refused(PressError):
        align(read(curves(5.0, 4.0, 0.3, n_curves=3), tmp_path))


@pytest.mark.parametrize(
    "depth_mm",
    [
        [0.1, None],
        [0.1, 0.2],
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, depth_mm):
    frame = pd.DataFrame({"curve": "a", "force_normal_n": [1.0, 2.0], "depth_mm": depth_mm})
    with refused(PressError):
        align(read(frame, tmp_path))


@pytest.mark.exhaustive
@pytest.mark.slow
def test_the_interval_of_one_curve_of_a_known_ball_holds_its_k_n(tmp_path):
    """95 % of 20 draws: three standard errors are 15 %."""
    held = []
    for seed in range(20):
        frame = curves(4.0, 5.0, 1.5, late_mm=0.2, seed=seed).assign(radius_mm=4.0)
        frame.to_csv(tmp_path / "log.csv", index=False)
        k_n = calibrate_contact(
            LogSource(tmp_path / "log.csv"), tmp_path / "law.yaml"
        ).law.k_n_mm3_per_n
        held.append(abs(k_n.value - 5.0) < 1.96 * k_n.stderr)
        assert k_n.stderr < 0.2
    assert np.mean(held) >= 0.8


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["force_depth_curves/force_depth", "asmi_ball_indentation/press_log"]
)
def test_measured_curves_have_one_answer(measured_data, tmp_path, name):
    path = measured_data / f"{name}.csv"
    law, out = tmp_path / "contact.yaml", tmp_path / "diagnosis"
    page = tmp_path / "report"
    words = ["calibrate", "contact", str(path), "--out", str(law), "--json", "--report", str(page)]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "data:image/png" in (page / "index.html").read_text()
    own = json.loads(result.stdout)["channels"]["normal"]["k_n"]
    assert own["value"] == pytest.approx(load_law(law).k_n_mm3_per_n.value, rel=1e-6)
    result = CliRunner().invoke(
        app, ["diagnose", "contact", str(path), "--out", str(out), "--json"]
    )
    assert result.exit_code == 0, result.output
    before = json.loads(result.stdout)["channels"]["normal"]["compliance"]["before"]
    assert before["value"] == pytest.approx(own["value"], rel=0.02)
    assert before["stderr"] == pytest.approx(own["stderr"], rel=0.1)


@pytest.mark.slow
def test_both_commands_print_the_same_figures_of_one_file(tmp_path):
    """k_n and k_s with their errors: terminal, JSON, law and page; errors of one axis in both."""
    log, _ = session(42)
    log.to_csv(tmp_path / "log.csv", index=False)
    file, law, out = (str(tmp_path / name) for name in ("log.csv", "law.yaml", "diagnosis"))
    found = [
        json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)["channels"]
        for words in (
            ["calibrate", "contact", file, "--out", law],
            ["diagnose", "contact", file, "--out", out],
        )
    ]
    laws = load_law(Path(law)), load_law(Path(out) / "contact.yaml")
    for channel, symbol in (("normal", "k_n"), ("shear", "k_s")):
        calibrated, diagnosed = (one[channel] for one in found)
        for name in ("value", "stderr"):
            same = pytest.approx(calibrated[symbol][name], rel=1e-9)
            assert diagnosed["compliance"]["before"][name] == same
            assert diagnosed["compliance"]["after"][name] == same
        key = "k_n_mm3_per_n" if channel == "normal" else "k_s_mm_per_n"
        assert getattr(laws[0], key) == getattr(laws[1], key)
        # A quarter of the presses against each in turn: white noise, some 500 samples.
        for name in ("rmse", "nrmse"):
            own = pytest.approx(calibrated["held_out"][name], rel=0.15)
            assert diagnosed["error_before"][name] == own


def approached(approach_mm: float, power: float, n_presses: int) -> pd.DataFrame:
    """Presses to 1 mm in steps of 10 µm whose depth counts from where the stage set out.

    With a ``power`` of 2 V = k_n F holds, with 1.5 Hertz's law.
    """
    rng, parts = np.random.default_rng(2), []
    for trial in range(n_presses):
        way = np.arange(-approach_mm * (1.0 + 0.1 * trial), 1.0, 0.01)
        depth = np.maximum(way, 0.0)
        force = ball_volume_mm3(depth, 2.5) / 0.28 if power == 2 else 10.0 * depth**power
        force = force + 0.003 * rng.standard_normal(way.size)
        time_s = 1000.0 * trial + 0.1 * np.arange(way.size)
        columns = {"time_s": time_s, "force_normal_n": force, "depth_mm": way - way[0]}
        parts.append(pd.DataFrame(columns).assign(trial=trial, radius_mm=2.5))
    return pd.concat(parts, ignore_index=True)


@pytest.mark.parametrize("n_presses", [1, 4])
@pytest.mark.parametrize("approach_mm", [0.0, 0.3, 3.0, 30.0])
def test_rows_before_contact_do_not_weigh_in(tmp_path, approach_mm, n_presses):
    found = fit_contact(read(approached(approach_mm, 2, n_presses), tmp_path)).normal.pooled
    assert found.value == pytest.approx(0.28, rel=1e-3)
    assert abs(found.value - 0.28) < 4.0 * found.stderr


def test_a_long_approach_changes_no_law_of_another_power(tmp_path):
    fits = [fit_contact(read(approached(mm, 1.5, 4), tmp_path)).normal for mm in (0.3, 3.0, 30.0)]
    values = [fit.pooled.value for fit in fits]
    assert values == pytest.approx([values[0]] * 3, rel=0.02)


def test_a_measured_approach_changes_no_law(measured_data, tmp_path):
    """Steel ball on three soft samples, depth counted from where the stage set out."""
    log = pd.read_csv(measured_data / "asmi_ball_indentation" / "press_log.csv")
    way = log.groupby("trial")["z_mm"].transform("first") - log["z_mm"]
    touching = log["depth_mm"] > 0
    contact = (way - log["depth_mm"])[touching].groupby(log["trial"]).min()
    before = log["trial"].map(contact) - way
    log = log.assign(depth_mm=way, radius_mm=2.5).drop(columns="volume_mm3")
    values = [fit_contact(read(log[before <= mm], tmp_path)).normal.pooled.value for mm in (1, 99)]
    assert values == pytest.approx([0.285, 0.285], abs=0.01)
