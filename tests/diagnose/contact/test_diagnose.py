"""The loop on logs whose truth is known, by formulas other than those that are fitted."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.contact.law import load_law
from tacgen.core import processes
from tacgen.core.errors import PressError
from tacgen.diagnose.contact.command import SEED, diagnose
from tacgen.diagnose.contact.heldout import test_trials as trials_to_hold_out
from tacgen.diagnose.contact.result import diagnosis_record
from tacgen.diagnose.rules import CONTACT
from tests.contact.effects.test_registry import press_columns
from tests.messages import refused
from validation.contact.cases import blank_log, make_case


def case(effects, strength=1.5, seed=3, n_trials=48, n_samples=60):
    rng = np.random.default_rng(seed)
    return make_case(effects, strength, rng, blank_log(rng, n_trials, n_samples))


def few_columns(columns, *names):
    """The contract's required columns and ``names``: quicker, where a test needs no more."""
    kept = ("trial", "time_s", "force_normal_n", "volume_mm3", *names)
    return {name: columns[name] for name in kept}


def names(channel):
    return [effect["name"] for effect in channel["effects"]]


@pytest.mark.slow
def test_a_clean_log_is_sufficient_in_both_channels():
    columns, noise = case([])
    diagnosis = diagnose(columns)
    record = diagnosis_record(diagnosis)
    for channel in ("normal", "shear"):
        found = record["channels"][channel]
        assert " is sufficient: nothing that was looked at " in diagnosis.channels[channel].sentence
        assert (found["verdict"], found["effects"], found["unexplained"]) == ("sufficient", [], [])
        assert found["noise_floor"]["rmse"] == pytest.approx(noise[channel], rel=0.1)
        assert found["error_after"]["rmse"] < 1.1 * noise[channel]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "columns"),
    [
        (("normal", "creep", 0), ()),
        pytest.param(("normal", "zero_offset", 1), (), marks=pytest.mark.exhaustive),
        pytest.param(("normal", "latency", 0), (), marks=pytest.mark.exhaustive),
        (("normal", "hysteresis", 1), ()),
        pytest.param(("normal", "drift", 1), (), marks=pytest.mark.exhaustive),
        pytest.param(("normal", "conditioning", 0), (), marks=pytest.mark.exhaustive),
        (("normal", "temperature", 1), ("temperature_c",)),
        (("normal", "geometry", 1), ("radius_mm", "indenter")),
    ],
)
def test_one_effect_is_named_and_brings_the_error_down_to_the_noise(effect, columns):
    made, noise = case([effect], strength=2.0)
    found = diagnosis_record(diagnose(few_columns(made, *columns)))["channels"]["normal"]
    assert (found["verdict"], names(found)) == ("effect_found", [effect[1]])
    few_show_it = effect[1] == "conditioning"  # one of the first four presses is held out
    assert found["error_before"]["rmse"] > (1.2 if few_show_it else 1.5) * noise["normal"]
    assert found["error_after"]["rmse"] < 1.12 * noise["normal"]
    assert found["gain_interval_95"][0] > (0.05 if few_show_it else 0.2)
    assert found["trials"] == {"fit": 36, "test": 12}


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.parametrize("is_of_gauge", [True, False])
def test_an_offset_beside_slip_is_that_of_the_gauge_or_of_the_picture(is_of_gauge):
    """Shear up to the friction limit of 0.4; the offset is before that limit, or after it."""
    rng, n_trials, n_samples = np.random.default_rng(3), 40, 40
    trial = np.repeat(np.arange(n_trials), n_samples)
    phase = np.tile(np.linspace(0.0, 1.0, n_samples), n_trials)
    force_n = rng.uniform(3.0, 8.0, n_trials)[trial] * np.minimum(4.0 * phase, 1.0)
    angle = rng.uniform(-np.pi, np.pi, n_trials)[trial]
    pull_n = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pull_n *= (rng.uniform(0.1, 0.6, n_trials)[trial] * force_n * np.sin(np.pi * phase))[:, None]
    offset_n = np.array([0.3, -0.2])

    def limited(load_n):
        size_n = np.linalg.norm(load_n, axis=1)
        return load_n * np.minimum(1.0, 0.4 * force_n / np.maximum(size_n, 1e-9))[:, None]

    moved_n = limited(pull_n + offset_n) if is_of_gauge else limited(pull_n) + offset_n
    motion_mm = 0.05 * moved_n + 0.002 * rng.standard_normal(moved_n.shape)
    columns = {
        "trial": trial,
        "time_s": 5.0 * phase + 20.0 * trial,
        "force_normal_n": force_n,
        "volume_mm3": 4.0 * force_n + 0.2 * rng.standard_normal(trial.size),
        "force_shear_x_n": pull_n[:, 0],
        "force_shear_y_n": pull_n[:, 1],
        "shear_x_mm": motion_mm[:, 0],
        "shear_y_mm": motion_mm[:, 1],
    }
    found = diagnosis_record(diagnose(columns))["channels"]["shear"]
    assert sorted(names(found)) == ["slip", "zero_offset"]
    assert found["error_after"]["rmse"] < 1.05 * 0.002
    said = {one["name"]: one["parameters"] for one in found["effects"]}
    said, limit = said["zero_offset"], said["slip"]
    assert limit["gross_mu"]["value"] == pytest.approx(0.4, abs=4 * limit["gross_mu"]["stderr"])
    assert limit["sharpness"]["stderr"] == 0.0, "of a sharp limit, any sharpness will do"
    of_picture = {f"motion_{axis}_mm": 0.05 * offset_n[i] for i, axis in enumerate("xy")}
    of_gauge = {f"force_{axis}_n": offset_n[i] for i, axis in enumerate("xy")}
    for name, value in (of_gauge if is_of_gauge else of_picture).items():
        assert said[name]["value"] == pytest.approx(value, abs=4 * said[name]["stderr"])
    if is_of_gauge:
        assert not set(of_picture) & set(said)


@pytest.mark.slow
@pytest.mark.parametrize(("covariate", "form"), [("operator", 0), ("time_s", 0)])
def test_what_no_effect_explains_is_named_by_its_covariate(covariate, form):
    made, _ = case([("outside", covariate, form)], strength=2.0)
    columns = few_columns(made, "operator", "x_mm", "y_mm")
    found = diagnosis_record(diagnose(columns))["channels"]["normal"]
    assert (found["verdict"], names(found)) == ("unexplained", [])
    assert [entry["covariate"] for entry in found["unexplained"]] == [covariate]


@pytest.mark.slow
def test_the_extended_law_predicts_trials_that_nothing_saw(tmp_path):
    made, noise = case([("normal", "creep", 2)], strength=3.0, n_trials=60)
    frame = pd.DataFrame(few_columns(made))
    seen = frame[frame["trial"] < 40]
    seen.to_csv(tmp_path / "log.csv", index=False)
    result = CliRunner().invoke(
        app, ["diagnose", "contact", str(tmp_path / "log.csv"), "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == 0, result.output
    record = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    promised = record["channels"]["normal"]["error_after"]["rmse"]
    law = load_law(tmp_path / "out" / "contact.yaml")
    later = frame[frame["trial"] >= 40]
    left = later["volume_mm3"] - law.predict(later)[0]
    assert np.sqrt((left**2).mean()) < 1.1 * promised
    assert promised < 1.1 * noise["normal"]
    assert "<svg" not in (tmp_path / "out" / "report.html").read_text()[:200]
    assert "creep" in result.output


@pytest.mark.exhaustive
@pytest.mark.slow
def test_parameters_of_a_linear_law_are_covered_by_their_errors():
    inside = 0
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        truth = blank_log(rng, 30, 40)
        k_n = float(truth.volume_mm3.max() / truth.force_n.max())
        columns, _ = make_case([], 0.0, rng, truth)
        found = diagnose(few_columns(columns)).channels["normal"]
        inside += abs(found.final.model.compliance - k_n) < 2.2 * found.final_errors.compliance
    assert inside >= 10


def test_errors_are_of_a_law_that_is_chosen_without_the_held_out_trials():
    """The gel stiffens in the presses that are fitted, and softens as much in those held out."""
    columns = few_columns(press_columns(32, 24, 0) | {"volume_mm3": np.zeros(768)})
    held_out = trials_to_hold_out(columns, np.random.default_rng(SEED), CONTACT)
    bend = np.where(np.isin(columns["trial"], held_out), 0.02, -0.02) * columns["force_normal_n"]
    noise = 0.05 * np.random.default_rng(0).normal(size=bend.size)
    columns["volume_mm3"] = 4.0 * columns["force_normal_n"] * (1 + bend) + noise
    diagnosis = diagnose(columns)
    found = diagnosis.channels["normal"]
    assert (found.effect_names, found.scored_effects) == ((), ("stiffening",))
    assert found.after.rmse > found.before.rmse
    assert any("held-out trials do not confirm stiffening" in note for note in diagnosis.notes)
    assert found.verdict == "unexplained"
    other = diagnose(few_columns(case([("normal", "creep", 0)], strength=2.0)[0])).channels[
        "normal"
    ]
    assert "lacks creep: with it, the error" in other.sentence
    assert "lacks creep: the same search without the held-out trials finds nothing; there" in (
        replace(other, scored_effects=()).sentence
    )


def test_of_two_trials_one_is_held_out_and_they_are_reported_as_few():
    columns, _ = case([], n_trials=40)
    two = {name: values[columns["trial"] < 2] for name, values in few_columns(columns).items()}
    diagnosis = diagnose(two)
    assert any("2 trials are few" in note for note in diagnosis.notes)
    found = diagnosis.channels["normal"]
    assert (found.n_fit, found.n_test, found.verdict) == (1, 1, "sufficient")


def test_columns_that_cannot_be_compared_are_said():
    columns, _ = case([])
    n = columns["trial"].size
    log = few_columns(columns) | {
        "shift": np.full(n, "day"),
        "note": np.arange(n).astype(str),
        "clock": columns["time_s"].copy(),
    }
    notes = "\n".join(diagnose(log).notes)
    assert "column 'shift' is constant" in notes
    assert "column 'note' has" in notes
    assert "'time_s' and 'clock' are equal" in notes
    assert "shear channel: not diagnosed" in notes


@pytest.mark.slow
def test_rows_without_shear_do_not_stop_the_shear_channel():
    columns, _ = case([])
    gone = columns["trial"] < 10
    for name in ("shear_x_mm", "shear_y_mm", "force_shear_x_n", "force_shear_y_n"):
        columns[name] = np.where(gone, np.nan, columns[name])
    diagnosis = diagnose(columns)
    assert diagnosis.channels["shear"].data.history.n_trials == 38
    assert any("rows without a finite value" in note for note in diagnosis.notes)


def test_forces_of_the_wrong_sign_are_said_and_not_fitted():
    columns, _ = case([], n_trials=10, n_samples=40)
    turned = few_columns(columns) | {"volume_mm3": -columns["volume_mm3"]}
    with refused(PressError):
        diagnose(turned)
    against = columns | {f"shear_{axis}_mm": -columns[f"shear_{axis}_mm"] for axis in "xy"}
    diagnosis = diagnose(against)
    assert list(diagnosis.channels) == ["normal"]
    assert any("shear channel: not diagnosed" in note for note in diagnosis.notes)


def unloaded(columns, noise, trials, seed):
    """``columns`` with nothing but noise in the shear channel of some trials."""
    rng, gone = np.random.default_rng(seed), np.isin(columns["trial"], trials)
    columns = dict(columns)
    for axis in "xy":
        for name, size in ((f"force_shear_{axis}_n", 1e-4), (f"shear_{axis}_mm", noise["shear"])):
            columns[name] = np.where(gone, size * rng.normal(size=gone.size), columns[name])
    return columns


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.exhaustive) for seed in (2, 3))]
)
def test_a_trial_without_load_cannot_tell_the_law_of_another(seed):
    columns, noise = case([], n_trials=10, n_samples=40)
    two = {name: values[columns["trial"] < 2] for name, values in columns.items()}
    diagnosis = diagnose(unloaded(two, noise, [1], seed))
    # Trial 0 has all the load: only trial 1 can be held out, and of it nothing is left but noise.
    found = diagnosis.channels["shear"]
    assert found.verdict == "sufficient"
    assert found.after.squares.size == 1
    assert found.after.rmse < 2 * noise["shear"]


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_force_that_is_all_noise_has_no_law():
    columns, noise = case([], n_trials=10, n_samples=40)
    found = [diagnose(unloaded(columns, noise, np.arange(10), seed)) for seed in range(4)]
    said = [note for one in found for note in one.notes if note.startswith("shear channel: not")]
    assert all(list(one.channels) == ["normal"] for one in found)
    assert len(said) == 4
    assert any(note.endswith("its force does not stand out from noise") for note in said)


def test_where_no_trial_can_be_held_out_that_is_said():
    columns, _ = case([], n_trials=10, n_samples=40)
    diagnosis = diagnose(few_columns(columns), rules=replace(CONTACT, max_draws=0))
    found = diagnosis.channels["normal"]
    assert (found.how, found.n_test) == ("none could be: only noise is left without them", 0)
    assert any("hardly any trial has load" in note for note in diagnosis.notes)


def test_an_error_far_above_the_noise_is_unexplained_where_no_column_explains_it():
    """Seven trials with a gain of their own each, by 5 %."""
    columns, _ = case([], n_trials=7, seed=3)
    log = few_columns(columns)
    gain = 1.0 + 0.05 * np.random.default_rng([3, 7]).normal(size=7)
    log["volume_mm3"] = log["volume_mm3"] * gain[log["trial"]]
    found = diagnose(log).channels["normal"]
    assert found.verdict == "unexplained"
    (left,) = found.unexplained
    # A gain of each explains all but the noise, which is more than two floors below.
    assert left.covariate == "press"
    assert left.gain > 0.75
    assert "follows each press (a gain of its own)" in found.sentence


def test_a_zero_of_each_press_is_told_from_a_gain():
    columns, _ = case([], n_trials=7, seed=3)
    log = few_columns(columns)
    zero = 0.05 * log["volume_mm3"].max() * np.random.default_rng([3, 7]).normal(size=7)
    log["volume_mm3"] = log["volume_mm3"] + zero[log["trial"]]
    diagnosis = diagnose(log)
    found = diagnosis.channels["normal"]
    assert [one.covariate for one in found.unexplained] == ["press"]
    assert "follows each press (a zero of its own)" in found.sentence
    (said,) = diagnosis_record(diagnosis)["channels"]["normal"]["unexplained"]
    assert [one.split(",")[0] for one in said["separating_measurements"]] == [
        "record a second of rest before each press"
    ]


def test_a_gain_of_each_press_is_seen_in_presses_of_six_samples():
    rng = np.random.default_rng(0)
    gain, force = np.repeat(rng.uniform(3.0, 6.0, 20), 6), np.tile(np.linspace(0.0, 5.0, 6), 20)
    log = {
        "trial": np.repeat(np.arange(20), 6),
        "time_s": 0.1 * np.arange(120),
        "force_normal_n": force,
        "volume_mm3": gain * force + 0.01 * rng.standard_normal(120),
    }
    (left,) = diagnose(log).channels["normal"].unexplained
    assert left.covariate == "press"
    assert left.gain > 0.9


def test_samples_that_stick_out_spoil_neither_the_fit_nor_the_errors():
    columns, noise = case([])
    log = few_columns(columns)
    struck = np.random.default_rng(5).choice(log["trial"].size, 60, replace=False)
    log["volume_mm3"] = log["volume_mm3"].copy()
    log["volume_mm3"][struck] += 40.0 * noise["normal"]
    diagnosis = diagnose(log)
    found = diagnosis.channels["normal"]
    assert found.verdict == "sufficient"
    assert found.after.rmse < 1.1 * noise["normal"]
    assert any("stick out" in note for note in diagnosis.notes)


@pytest.mark.parametrize("n_trials", [16, 3])
def test_one_core_and_several_find_the_same(monkeypatch, n_trials):
    effects = [("normal", "stiffening", 0), ("shear", "anisotropy", 0)]
    made, _ = case(effects, 3.0, n_trials=n_trials, n_samples=30)
    records = []
    for cores in (1, 3):
        monkeypatch.setattr(processes, "available_cores", lambda cores=cores: cores)
        records.append(diagnosis_record(diagnose(made)))
    assert json.dumps(records[0]) == json.dumps(records[1])
    found = [names(one) for one in records[0]["channels"].values()]
    assert found == [["stiffening"], ["anisotropy"] if n_trials > 3 else []]


def test_memory_that_outlasts_the_pauses_is_creep_and_held_out_presses_are_predicted_with_it():
    rng = np.random.default_rng(12)
    parts, n, tau_s, step_s = [], 40, 5.0, 1e-3
    for trial, (peak, pause_s) in enumerate(rng.uniform([3.0, 0.5], [9.0, 3.0], (24, 2))):
        start = parts[-1]["time_s"].iloc[-1] + pause_s if parts else 0.0
        phase = np.linspace(0.0, 4.0, n)
        force = np.interp(phase, [0.0, 0.8, 3.0, 4.0], [0.0, peak, peak, 0.0])
        parts.append(
            pd.DataFrame({"trial": trial, "time_s": start + phase, "force_normal_n": force})
        )
    frame = pd.concat(parts, ignore_index=True)
    time = np.arange(0.0, frame["time_s"].iloc[-1] + step_s, step_s)
    force = np.interp(time, frame["time_s"], frame["force_normal_n"])
    memory = np.zeros(time.size)
    for k in range(1, time.size):  # Euler steps, without regard for presses
        memory[k] = memory[k - 1] + step_s / tau_s * (force[k - 1] - memory[k - 1])
    clean = frame["force_normal_n"] + 0.2 * np.interp(frame["time_s"], time, memory)
    frame["volume_mm3"] = 5.0 * clean + rng.normal(0.0, 0.2, len(frame))
    diagnosis = diagnose({name: frame[name].to_numpy() for name in frame})
    found = diagnosis_record(diagnosis)["channels"]["normal"]
    assert names(found) == ["creep"]
    values = {p: one["value"] for p, one in found["effects"][0]["parameters"].items()}
    assert values["carried"] == 1.0
    assert values["tau_s"] == pytest.approx(tau_s, rel=0.1)
    assert found["error_after"]["rmse"] == pytest.approx(0.2, rel=0.06)
    volume, _ = diagnosis.law.predict(frame)
    assert np.sqrt(np.mean((volume - 5.0 * clean) ** 2)) < 0.03


@pytest.mark.parametrize(
    "spoiled",
    [
        lambda volume, force: np.minimum(volume, 41.0),
        lambda volume, force: np.where(force.max() == 6.0, 0.9 * volume, volume),
        lambda volume, force: np.where(force.max() == 10.0, 0.9 * volume, volume),
    ],
    ids=["limit", "an ordinary press is off", "the hardest press is off"],
)
def test_what_one_press_shows_is_no_effect_but_said(spoiled):
    """Nothing repeats it: a limit that it reaches may be a fixture that gave way."""
    rng = np.random.default_rng(4)
    peaks = np.append(rng.uniform(3.0, 8.0, 38), [6.0, 10.0])[rng.permutation(40)]
    force = peaks[:, None] * np.interp(
        np.linspace(0.0, 3.0, 60), [0.0, 1.0, 2.0, 3.0], [0, 1, 1, 0]
    )
    clean = np.stack([spoiled(5.0 * press, press) for press in force])
    log = {
        "trial": np.repeat(np.arange(40), 60),
        "time_s": (4.0 * np.arange(40)[:, None] + np.linspace(0.0, 3.0, 60)).ravel(),
        "force_normal_n": force.ravel(),
        "volume_mm3": (clean + rng.normal(0.0, 0.3, clean.shape)).ravel(),
    }
    diagnosis = diagnose(log)
    found = diagnosis_record(diagnosis)["channels"]["normal"]
    assert names(found) == []
    is_left = "normal channel: most of the law's residual is in trial"
    assert len([note for note in diagnosis.notes if note.startswith(is_left)]) == 1


def test_smoothing_by_software_is_fitted_to_samples_not_to_their_means():
    """V of q += (1 − exp(−Δt/τ))(F − q), of 100 to 400 samples a trial: the law is as exact."""
    rng, noise, k_n, tau_s = np.random.default_rng(4), 0.05, 4.0, 0.03
    parts, exact = [], []
    for trial in range(20):
        n_samples, peak = (100, 300, 400)[trial % 3], rng.uniform(4.0, 9.0)
        time = np.linspace(0.0, 4.0, n_samples)
        force = np.interp(time, [0.0, 1.0, 2.0, 2.5, 4.0], [0.0, peak, peak, 0.0, 0.0])
        kept = np.exp(-time[1] / tau_s)
        exact.append(k_n * lfilter([1 - kept], [1, -kept], force))
        number, volume = np.full(n_samples, trial), exact[-1] + noise * rng.normal(size=n_samples)
        parts.append(np.stack([number, trial * 20.0 + time, force, volume]))
    keys = ("trial", "time_s", "force_normal_n", "volume_mm3")
    columns = dict(zip(keys, np.concatenate(parts, axis=1), strict=True))
    found = diagnose({**columns, "trial": columns["trial"].astype(int)})
    assert names(diagnosis_record(found)["channels"]["normal"]) == ["latency"]
    error = found.law.predict(columns)[0] - np.concatenate(exact)
    assert np.sqrt(np.mean(error**2)) < 0.2 * noise
