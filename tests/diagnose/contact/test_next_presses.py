"""Presses to make next: the separation is its formula, and the proposals tell what is asked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import RecipeError
from tacgen.diagnose.contact.command import diagnose
from tacgen.diagnose.contact.next_presses import _Explanation, _separations, propose_presses
from tacgen.rig import RigRecipe, load_rig_recipe, simulate_session
from tacgen.rig.schedule import draw_press, press_course
from tests.messages import refused

WIDE = {"hold_s": (0.1, 12.0), "load_s": (0.3, 3.0), "force_n": (1.0, 12.0)}


def rig(effects: list[dict], **schedule) -> RigRecipe:
    given = load_rig_recipe("rig").model_dump()
    given["schedule"] |= schedule
    return RigRecipe.model_validate({**given, "effects": effects})


def columns(recipe: RigRecipe) -> dict[str, np.ndarray]:
    return {name: values.to_numpy() for name, values in simulate_session(recipe).log.items()}


def test_the_separation_is_that_of_its_definition():
    rng = np.random.default_rng(0)
    n_log, n_rows, n_presses = 40, 7, 3
    one, other = (
        _Explanation(
            name,
            rng.normal(size=(n_presses, n_rows)),
            rng.normal(size=(n_presses, n_rows, n_parameters)),
            [rng.normal(size=(n_log, n_parameters))],
        )
        for name, n_parameters in (("one", 3), ("other", 2))
    )
    for k, found in enumerate(_separations(one, other)):
        log_i, log_j = one.seen[0], other.seen[0]
        covariance_i = np.linalg.inv(log_i.T @ log_i + np.eye(3))
        covariance_j = np.linalg.inv(log_j.T @ log_j + np.eye(2))
        j_new = other.at_presses[k]
        inverse = np.linalg.inv(np.eye(n_rows) + j_new @ covariance_j @ j_new.T)
        change = one.at_presses[k] - j_new @ covariance_j @ log_j.T @ log_i
        r = one.prediction[k] - other.prediction[k]
        expected = r @ inverse @ r + np.trace(inverse @ change @ covariance_i @ change.T)
        assert found == pytest.approx(expected, rel=1e-9)


def test_a_press_that_both_laws_predict_alike_separates_nothing():
    rng = np.random.default_rng(1)
    shared = rng.normal(size=(2, 5, 1))
    log = rng.normal(size=(30, 1))
    laws = [_Explanation(name, np.ones((2, 5)), shared, [1e6 * log]) for name in ("a", "b")]
    np.testing.assert_allclose(_separations(*laws), 0.0, atol=1e-9)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_creep_is_separated_by_longer_holds_than_the_log_has():
    # Holds of a quarter of a second hardly show a creep of some seconds.
    log = columns(
        rig([{"name": "creep", "parameters": {"amount": 0.06, "tau_s": 3.0}}],
            presses=16, hold_s=0.25, shear_s=0.5)
    )  # fmt: skip
    pool = rig([], **WIDE)
    drawn = [draw_press(pool, number) for number in range(60)]
    courses = [press_course(pool, press, k, 0.0) for k, press in enumerate(drawn)]
    proposed = propose_presses(diagnose(log), courses, 12)
    assert len({one.index for one in proposed}) == 12
    about_creep = [drawn[one.index].hold_s for one in proposed if "creep" in str(one.between)]
    assert about_creep
    assert np.median(about_creep) > 2 * np.median([press.hold_s for press in drawn])


@pytest.mark.slow
def test_a_session_follows_the_presses_of_a_file(tmp_path: Path):
    (tmp_path / "rig.yaml").write_text(
        "extends: rig\nschedule: {presses: 8, hold_s: [0.2, 5.0]}\n"
        "effects: [{name: creep, strength: 1.0}]\n"
    )
    runner, out = CliRunner(), tmp_path / "out"
    done = runner.invoke(app, ["rig", str(tmp_path / "rig.yaml"), "--out", str(tmp_path / "first")])
    assert done.exit_code == 0, done.output
    log = tmp_path / "first" / "press_log.csv"
    given = [
        "diagnose",
        "contact",
        str(log),
        "--out",
        str(out),
        "--rig",
        str(tmp_path / "rig.yaml"),
    ]
    done = runner.invoke(app, [*given, "--next-presses", "5"])
    assert done.exit_code == 0, done.output
    proposed = pd.read_csv(out / "next_presses.csv")
    assert len(proposed) == 5

    (tmp_path / "more.yaml").write_text(
        "extends: ./rig.yaml\nschedule: {follow: out/next_presses.csv}\n"
        "effects: [{name: creep, parameters: {amount: 0.05, tau_s: 3.0}}]\n"
    )
    whole = simulate_session(load_rig_recipe(tmp_path / "more.yaml")).true_columns
    first = simulate_session(load_rig_recipe(tmp_path / "rig.yaml")).true_columns
    n = len(first["time_s"])
    np.testing.assert_array_equal(whole["force_normal_n"][:n], first["force_normal_n"])
    for number, press in enumerate(proposed.itertuples(), start=8):
        rows = whole["trial"] == number
        assert set(whole["indenter"][rows]) == {press.indenter}
        assert whole["force_normal_n"][rows].max() == pytest.approx(press.force_n, rel=0.1)
        held = whole["force_normal_n"][rows] > 0.999 * press.force_n
        assert held.sum() / 20 == pytest.approx(
            press.hold_s + press.shear_out_s + press.shear_back_s, abs=0.11
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(columns="hold_s"), "lacks the columns hold_s"),
        (lambda t: t.assign(force_n=-1.0), "row 2: force_n"),
        (lambda t: pd.concat([t, t.assign(hold_s="")]), "row 3: hold_s = ''"),
        (lambda t: t.assign(load_s="soon"), "row 2: load_s = 'soon'"),
        (lambda t: t.assign(indenter="fist"), "row 2: indenter 'fist' is none of the recipe's"),
    ],
)
def test_a_file_of_presses_that_cannot_be_made_is_refused(tmp_path: Path, change, message: str):
    recipe = load_rig_recipe("rig")
    presses = pd.DataFrame([{**_as_dict(draw_press(recipe, 0))}])
    change(presses).to_csv(tmp_path / "presses.csv", index=False)
    (tmp_path / "rig.yaml").write_text("extends: rig\nschedule: {follow: presses.csv}\n")
    done = CliRunner().invoke(
        app, ["rig", str(tmp_path / "rig.yaml"), "--out", str(tmp_path / "out")]
    )
    assert done.exit_code != 0
    assert message in str(done.exception) + done.output
    assert not (tmp_path / "out" / "press_log.csv").exists()


@pytest.mark.parametrize(
    "schedule",
    [
        "load_s: [2, 1]",
        "hold_s: -1",
        "load_s: 0",
        "follow: ''",
    ],
)
def test_a_duration_that_cannot_be_is_one_message(tmp_path: Path, schedule: str):
    (tmp_path / "rig.yaml").write_text(f"extends: rig\nschedule: {{{schedule}}}\n")
    with refused(RecipeError):
        load_rig_recipe(tmp_path / "rig.yaml")


def _as_dict(press) -> dict:
    return {name: getattr(press, name) for name in type(press).__dataclass_fields__}


def test_one_explanation_alone_leaves_nothing_to_separate(monkeypatch):
    from tacgen.diagnose.contact import next_presses

    log = columns(rig([], presses=8))
    explanations = next_presses._explanations
    monkeypatch.setattr(next_presses, "_explanations", lambda *given: explanations(*given)[:1])
    course = press_course(rig([]), draw_press(rig([]), 0), 0, 0.0)
    assert propose_presses(diagnose(log), [course], 3) == []
