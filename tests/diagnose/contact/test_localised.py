"""Effects that act in one part of a log: where they act, how they are found, what a law says."""

import html
import json

import numpy as np
import pytest

from tacgen.calibrate.contact.command import LogSource
from tacgen.contact.effects import LoadHistory, Where, all_effects, find_effect
from tacgen.contact.law import ContactLaw, FittedEffect, load_law, respond, save_law
from tacgen.core.errors import ContactError
from tacgen.core.records import Estimate
from tacgen.diagnose.contact import localised, scores
from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.command import diagnose, diagnose_log
from tacgen.diagnose.contact.model import Model, fit_model
from tacgen.rig import load_rig_recipe, simulate_session
from tacgen.rig.rig_recipe import RigEffect
from tests.contact.effects.test_registry import K, press_columns, switched_on
from tests.messages import refused

BALLS = ("ball_4mm", "ball_6mm", "flat")


def log(seed=0, *, n_trials=36, n_samples=40):
    """Presses at random places with three indenters; ``volume_mm3`` is that of V = k F."""
    rng = np.random.default_rng(seed)
    columns = press_columns(n_trials, n_samples, seed)
    columns["indenter"] = np.repeat(rng.choice(BALLS, n_trials), n_samples)
    del columns["radius_mm"]
    return columns | {"volume_mm3": K * columns["force_normal_n"]}


def estimates(values):
    return {name: Estimate(value) for name, value in values.items()}


@pytest.mark.parametrize("effect", all_effects(), ids=lambda e: f"{e.channel}-{e.name}")
def test_outside_of_its_part_an_effect_changes_nothing_and_inside_it_is_itself(effect):
    history = LoadHistory(press_columns())
    acting = [(effect, switched_on(effect, history))]
    inside = history.column("x_mm") > 1.0
    plain, everywhere = (respond(history, effect.channel, K, one) for one in ([], acting))
    local = [(effect.only(Where("x_mm", above=1.0)), acting[0][1])]
    expected = np.where(inside[:, None], everywhere, plain)
    np.testing.assert_allclose(respond(history, effect.channel, K, local), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("where", "words", "trials"),
    [
        (Where("trial", above=4), "in trials after 4", [5, 6, 7]),
        (Where("trial", up_to=1), "in trials up to 1", [0, 1]),
        (Where("x_mm", above=2.25), "at x > 2.25 mm", [3, 4, 5, 6, 7]),
        (Where("radius_mm", 1.5, 2.5), "at radius > 1.5 and ≤ 2.5 mm", [0, 1]),
        (Where("trial", 1, 3), "in trials after 1 and up to 3", [2, 3]),
        (Where("indenter", equals="flat"), "with the indenter flat", [6, 7]),
    ],
)
def test_a_part_holds_trials_and_is_said_in_words(where, words, trials):
    n = np.arange(8)
    columns = {
        "trial": n,
        "time_s": 1.0 * n,
        "force_normal_n": 1.0 * n,
        "x_mm": np.where(n == 0, np.nan, n),
        "radius_mm": np.where(n < 2, 2.0, 3.0),
        "indenter": np.where(n < 6, "ball", "flat"),
    }
    assert str(where) == words
    np.testing.assert_array_equal(np.flatnonzero(where.holds(LoadHistory(columns))), trials)


def law_with(name, where, **values):
    effect = FittedEffect(name, "normal", estimates(values), where)
    return ContactLaw("volume_linear", Estimate(K), effects=(effect,))


def test_a_law_file_holds_the_part(tmp_path):
    where = Where("x_mm", above=1.5)
    save_law(law_with("compliance_change", where, amount=0.2), tmp_path / "contact.yaml")
    assert load_law(tmp_path / "contact.yaml").effects[0].where == where
    press = {"trial": [0, 1], "time_s": [0.0, 1.0], "force_normal_n": [1.0, 1.0]}
    law = load_law(tmp_path / "contact.yaml")
    volume, _ = law.predict(press | {"x_mm": [1.0, 2.0]}, simulate=True)
    np.testing.assert_allclose(volume, [K, 1.2 * K])
    np.testing.assert_allclose(law.predict(press, simulate=True)[0], K)
    with refused(ContactError):
        law.predict(press)


@pytest.mark.parametrize(
    "where",
    [
        {"column": "x_mm"},
        {"column": "x_mm", "equals": "ball"},
        {"column": "x_mm", "above": 2, "up_to": 1},
        {"column": "x_mm", "up_to": float("nan")},
        {"column": "indenter", "above": 2},
        {"column": "indenter", "equals": "ball", "above": 2},
    ],
)
def test_what_is_no_part_of_a_log_is_refused(where):
    with refused(ValueError):
        Where(**where)


@pytest.mark.parametrize(
    ("where", "in_log", "in_simulation"),
    [
        (Where("trial", above=4), [1.0, 1.2], [1.2, 1.2]),
        (Where("trial", up_to=4), [1.2, 1.0], [1.0, 1.0]),
    ],
)
def test_a_simulation_comes_after_the_session(where, in_log, in_simulation):
    law = law_with("compliance_change", where, amount=0.2)
    press = {"trial": [4, 5], "time_s": [0.0, 1.0], "force_normal_n": [1.0, 1.0]}
    np.testing.assert_allclose(law.predict(press)[0] / K, in_log)
    np.testing.assert_allclose(law.predict(press, simulate=True)[0] / K, in_simulation)


NOISE = 0.3  # mm³; the effects below are about 1.5 times as strong


@pytest.mark.parametrize(
    ("name", "values", "where", "note"),
    [
        ("zero_offset", {"force_n": 0.25}, Where("x_mm", above=0.5), ""),
        ("compliance_change", {"amount": 0.05}, Where("trial", above=20), "acts on all of them"),
        pytest.param(
            "stiffening",
            {"amount": -0.15, "exponent": 1.0, "reference_n": 5.0},
            Where("indenter", equals="flat"),
            "have no column indenter",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_local_effect_is_named_with_its_part(name, values, where, note):
    columns, rng = log(3), np.random.default_rng(3)
    truth = law_with(name, where, **values)
    columns["volume_mm3"] = truth.predict(columns)[0] + NOISE * rng.normal(size=1440)
    diagnosis = diagnose(columns)
    found = diagnosis.channels["normal"]
    (effect,) = diagnosis.law.effects
    assert effect.name == name
    held, true = (one.holds(LoadHistory(columns)) for one in (effect.where, where))
    assert (held == true).mean() > 0.95
    assert f"(only {effect.where})" in found.sentence
    assert found.after.rmse < 1.1 * NOISE < 0.8 * found.before.rmse
    said = [line for line in diagnosis.notes if "acts only" in line]
    assert note in said[0] if note else not said  # a gauge's zero is in no simulation anyway
    for key, value in values.items():
        if key not in ("exponent", "reference_n") and name != "stiffening":
            estimate = effect.parameters[key]
            assert estimate.value == pytest.approx(value, abs=4 * estimate.stderr)


def test_a_p_of_a_part_keeps_its_level_and_sees_a_part():
    where, effect = Where("x_mm", above=0.5), find_effect("normal", "zero_offset")
    p_values = []
    for seed in range(60):
        columns, rng = log(seed, n_trials=24, n_samples=20), np.random.default_rng(seed)
        # The offset acts everywhere: there is nothing local in it.
        for given in (0.3, 0.3 * (columns["x_mm"] > 0.5)) if seed == 0 else (0.3,):
            noise = NOISE * rng.normal(size=480)
            force_n = columns["force_normal_n"] + given
            data = ChannelSamples(columns | {"volume_mm3": K * force_n + noise}, "normal").thinned()
            p = localised.local_p_value(
                data,
                fit_model(data, Model(K)),
                effect.only(where),
                f"zero_offset: constant, only {where}",
                localised.parts_of(data),
                scores.sign_flips(24, 999, rng),
            )
            p_values.append(p)
    _, local, *_ = p_values
    del p_values[1]
    assert local < 0.003
    # Of 60 uniform p, 1 to 14 below 0.1 (Binomial(60, 0.1) is outside with 0.25 %), and 18 to 42
    # below a half (three standard deviations of Binomial(60, 0.5)).
    assert 1 <= np.sum(np.array(p_values) <= 0.1) <= 14
    assert 18 <= np.sum(np.array(p_values) <= 0.5) <= 42


@pytest.mark.parametrize("spoiled", [False, True])
def test_parts_are_bounded_between_trials_and_have_enough_on_both_sides(spoiled):
    """Also where places vary within a press, and some presses have no place or no indenter."""
    columns, n_trials = log(n_trials=24), 24
    if spoiled:
        rng = np.random.default_rng(3)
        columns["x_mm"] = columns["x_mm"] + rng.normal(0, 0.3, len(columns["x_mm"]))
        columns["x_mm"][columns["trial"] < 6] = np.nan
        columns["indenter"] = np.where(columns["trial"] % 3 == 0, "", columns["indenter"])
    data = ChannelSamples(columns, "normal").thinned()
    parts = localised.parts_of(data)
    least = data.rules.min_trials_of_part
    assert {part.where.column for part in parts} >= {"trial", "x_mm", "y_mm", "indenter"}
    for part in parts:
        assert least <= part.trials.sum() <= n_trials - least
        rows = part.where.holds(data.history)
        np.testing.assert_array_equal(rows, part.trials[data.history.trial_index])


@pytest.mark.slow
def test_a_rig_s_local_effect_is_found_written_and_shown(tmp_path):
    where = Where("trial", above=11)
    given = RigEffect(name="creep", strength=3.0, where=where)
    session = simulate_session(load_rig_recipe("rig").model_copy(update={"effects": (given,)}))
    session.log.to_csv(tmp_path / "log.csv", index=False)
    diagnose_log(LogSource(tmp_path / "log.csv"), tmp_path)
    (effect,) = load_law(tmp_path / "contact.yaml").effects
    assert (effect.name, effect.where.column) == ("creep", "trial")
    assert effect.where.above == pytest.approx(11, abs=1)
    record = json.loads((tmp_path / "diagnosis.json").read_text())["channels"]["normal"]
    assert record["effects"][0]["where"] == effect.where.given
    assert f", only {effect.where}" in record["effects"][0]["form"]
    assert f"only {effect.where}" in html.unescape((tmp_path / "report.html").read_text())
