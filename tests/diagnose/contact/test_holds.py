"""Relaxation and creep tests: a displacement or a force is held, and nothing is unloaded."""

import numpy as np
import pandas as pd
import pytest

from tacgen.calibrate.contact.align import align, limits_of
from tacgen.core.errors import PressError
from tacgen.diagnose.contact.command import diagnose
from tacgen.presses.geometry import ball_depth_mm
from tacgen.presses.press_log import read_press_log
from tests.messages import refused

LEVELS = (2.0, 4.0, 6.0, 8.0, 10.0)  # mm³, or times 0.2 N
STIFF, LOST, TAU_S = 0.12, 0.12, 15.0  # N/mm³ at once less what is lost, of it, and how fast
RAMP_S, HOLD_S = 1.0, 100.0
BALL_MM = 5.0


def times_s(count: int, *, ramp: bool, by_logarithm: bool) -> np.ndarray:
    """When rows are taken: at rest, while the displacement grows from 0 s on, and in the hold."""
    hold = (
        np.r_[0.0, np.geomspace(HOLD_S / 2000, HOLD_S, count - 1)]
        if by_logarithm
        else np.linspace(0.0, HOLD_S, count)
    )
    before = np.linspace(-1.0, RAMP_S, 20)[:-1] if ramp else np.zeros(0)
    return np.r_[before, RAMP_S + hold]


def log_of(make, levels, *, ramp=True, by_logarithm=False, count=150, noise=0.002) -> pd.DataFrame:
    """A log of one press a level; ``make`` gives force and volume at times since the ramp began."""
    rng, parts, start_s = np.random.default_rng(3), [], 0.0
    for trial, level in enumerate(levels):
        t = times_s(count, ramp=ramp, by_logarithm=by_logarithm)
        force, volume = make(t, level)
        force = force + noise * force.max() * rng.standard_normal(t.size)
        time_s = start_s + t - t[0]
        columns = {"time_s": time_s, "force_normal_n": force, "volume_mm3": volume}
        parts.append(pd.DataFrame(columns).assign(trial=trial))
        start_s = time_s[-1] + 30.0
    return pd.concat(parts, ignore_index=True)


def ramped(t: np.ndarray, tau_s: float) -> tuple[np.ndarray, np.ndarray]:
    """A ramp of 1 s to 1, and what of its growth a Maxwell element still holds."""
    end = np.clip(t, 0.0, RAMP_S)
    held = (np.exp(-(t - end) / tau_s) - np.exp(-np.maximum(t, 0.0) / tau_s)) * tau_s / RAMP_S
    return end / RAMP_S, np.where(t > 0, held, 0.0)


def relaxing(t, volume_mm3, stiff=STIFF, lost=LOST):
    """The standard linear solid whose volume is held: F = E V + E₁ ∫ exp(−(t − s)/τ) dV."""
    course, held = ramped(t, TAU_S)
    return volume_mm3 * (stiff * course + lost * held), volume_mm3 * course


def creeping(t, level):
    """The same solid under a held force: V = k (F + a ∫ (1 − exp(−(t − s)/τ)) dF)."""
    course, held = ramped(t, 2.0 * TAU_S)
    return 0.2 * level * course, 0.2 * level * (course + course - held) / (STIFF + LOST)


def powers(t, volume_mm3):
    """A force that falls as t to the −0.12: of no exponential."""
    return 0.2 * volume_mm3 * np.maximum(t, 0.5) ** -0.12, volume_mm3 * np.clip(t, 0.0, 1.0)


def diagnosed(frame, tmp_path):
    frame.round(7).to_csv(tmp_path / "log.csv", index=False)
    log, _ = align(read_press_log(tmp_path / "log.csv"))
    return log, diagnose(log.columns, session_clock=log.session_clock).channels["normal"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("levels", "ramp", "by_logarithm"),
    [
        ((6.0,), True, False), ((6.0,), False, True),
        ((6.0, 6.0, 6.0), False, False), ((6.0, 6.0, 6.0), True, True),
        (LEVELS, True, False), (LEVELS, False, True),
    ],
)  # fmt: skip
def test_relaxation_at_a_held_displacement_is_creep(levels, ramp, by_logarithm, tmp_path):
    frame = log_of(relaxing, levels, ramp=ramp, by_logarithm=by_logarithm)
    log, found = diagnosed(frame, tmp_path)
    assert not log.dropped
    assert found.effect_names == ("creep",)
    assert found.verdict == "effect_found"
    assert "creep (the force relaxes at a held displacement)" in found.sentence
    # E₁ / E more, τ (E + E₁) / E slower: what is lost of a held volume is gained at a held force.
    # Where the log begins after the ramp, what relaxed within it is not known: 1/30 of the loss.
    (term,) = found.final.model.terms
    within = 0.02 if ramp else 0.05
    assert term.values["amount"] == pytest.approx(LOST / STIFF, rel=within)
    assert term.values["tau_s"] == pytest.approx(TAU_S * (1.0 + LOST / STIFF), rel=within)
    assert found.compliance.value == pytest.approx(1.0 / (STIFF + LOST), rel=within)
    if len(levels) > 1:
        assert found.after.rmse < 0.02 * found.before.rmse


@pytest.mark.parametrize(
    ("levels", "ramp", "by_logarithm"),
    [((6.0,), True, False), ((6.0,), False, True), (LEVELS, True, True), (LEVELS, False, False)],
)
def test_an_elastic_gel_that_is_held_has_no_effect(levels, ramp, by_logarithm, tmp_path):
    def elastic(t, volume_mm3):
        return relaxing(t, volume_mm3, lost=0.0)

    frame = log_of(elastic, levels, ramp=ramp, by_logarithm=by_logarithm)
    _, found = diagnosed(frame, tmp_path)
    assert (found.verdict, found.effect_names) == ("sufficient", ())
    assert found.compliance.value == pytest.approx(1.0 / STIFF, rel=0.002)


@pytest.mark.parametrize(
    ("levels", "by_logarithm", "noise"),
    [((6.0,), True, 0.0), ((6.0,), False, 0.002), (LEVELS, True, 0.002), (LEVELS, False, 0.0)],
)
def test_creep_at_a_held_force_is_creep(levels, by_logarithm, noise, tmp_path):
    # A dead weight's force is logged without noise: the same in every row.
    frame = log_of(creeping, levels, ramp=noise > 0, by_logarithm=by_logarithm, noise=noise)
    if not noise:
        frame["force_normal_n"] = frame["trial"].map(lambda k: 0.2 * levels[k])
        volume = frame["volume_mm3"]
        frame["volume_mm3"] += 0.003 * np.random.default_rng(4).standard_normal(len(volume))
    log, found = diagnosed(frame, tmp_path)
    assert not log.dropped
    assert ("the force never changes" in "".join(log.warnings)) == (noise == 0.0)
    assert found.effect_names == ("creep",)
    (term,) = found.final.model.terms
    assert term.values["tau_s"] == pytest.approx(2.0 * TAU_S, rel=0.03)
    assert found.final.model.compliance == pytest.approx(1.0 / (STIFF + LOST), rel=0.04)


@pytest.mark.slow
@pytest.mark.parametrize(("levels", "by_logarithm"), [((6.0,), True), (LEVELS, False)])
def test_relaxation_that_no_exponential_is_is_still_no_hysteresis(levels, by_logarithm, tmp_path):
    _, found = diagnosed(log_of(powers, levels, ramp=False, by_logarithm=by_logarithm), tmp_path)
    assert found.effect_names[0] == "creep"
    assert not {"hysteresis", "saturation"} & set(found.effect_names)


@pytest.mark.slow
def test_relaxation_as_a_power_of_time_is_foretold_60_times_as_long():
    """Of E (1 + 1.2 t^−0.25): two exponentials, fitted to the same, are 24 % off at the end."""

    def log(last_s, noise=0.0):
        t = np.unique(np.r_[np.linspace(0.0, 1.0, 21), 1.0 + np.geomspace(0.02, last_s, 120)])
        held = np.clip(t, 0.0, 1.0)
        since, after = (np.clip(t[:, None] - one, 0.0, None) for one in (t[:-1], t[1:]))
        whole = since - after + 1.2 * (since**0.75 - after**0.75) / 0.75
        force = whole @ (np.diff(held) / np.diff(t))
        force = force * (1.0 + noise * np.random.default_rng(0).standard_normal(t.size))
        trial = np.zeros(t.size, dtype=np.int64)
        return {"trial": trial, "time_s": t, "force_normal_n": force, "volume_mm3": held}

    law, later = diagnose(log(30.0, noise=0.002)).law, log(1800.0)
    volume, _ = law.predict(later)
    assert np.abs(volume - later["volume_mm3"])[21:].max() < 0.03


def test_holds_on_the_way_up_and_a_way_back_are_creep_too(tmp_path):
    def unloaded(t, volume_mm3):
        """Load and hold, and a second ramp down to none at 60 s."""
        force, volume = relaxing(t, volume_mm3)
        less, lower = relaxing(t - 60.0, -volume_mm3)
        return force + less, volume + lower

    _, found = diagnosed(log_of(unloaded, LEVELS), tmp_path)
    assert found.effect_names == ("creep",)
    assert "relaxes" not in found.sentence


@pytest.mark.parametrize("change", ["depth", "grams", "minutes", "no trial", "sagging force"])
def test_holds_are_read_in_every_unit_and_clock(change, tmp_path):
    frame = log_of(relaxing, LEVELS, ramp=False, by_logarithm=change != "minutes")
    if change in ("depth", "no trial"):
        depth = ball_depth_mm(frame.pop("volume_mm3").to_numpy(), BALL_MM)
        frame = frame.assign(depth_mm=depth, radius_mm=BALL_MM)
    if change == "no trial":
        frame = frame.drop(columns="trial")
    if change == "grams":
        frame["Fz [g]"] = 101.97162 * frame.pop("force_normal_n")
    if change == "minutes":
        frame["t [min]"] = frame.pop("time_s") / 60.0
    if change == "sagging force":  # the machine's frame springs back as the force falls
        frame["volume_mm3"] -= 0.3 * frame["force_normal_n"]
    log, found = diagnosed(frame, tmp_path)
    assert len(log.trials) == len(LEVELS)
    assert not [note for note in log.warnings if "clock jumps" in note or "unit" in note]
    assert found.effect_names == ("creep",)
    less = 0.3 if change == "sagging force" else 0.0
    assert found.compliance.value == pytest.approx(1.0 / (STIFF + LOST) - less, rel=0.05)
    assert not {"hold"} & {limit.subject for limit in limits_of(log)}
    assert "unloading" in {limit.subject for limit in limits_of(log)}


def test_a_gauge_that_is_stuck_in_a_press_is_no_held_load(tmp_path):
    frame = log_of(relaxing, LEVELS)
    way = np.sin(np.linspace(0.0, np.pi, (frame["trial"] == 2).sum()))
    frame.loc[frame["trial"] == 2, "force_normal_n"] = 1.0
    frame.loc[frame["trial"] == 2, "volume_mm3"] = 6.0 * way
    frame.to_csv(tmp_path / "log.csv", index=False)
    log = read_press_log(tmp_path / "log.csv")
    assert [one.trial for one in log.dropped] == [2]
    assert "check the gauge" in str(log.dropped[0])


def test_a_wrong_unit_of_holds_is_still_refused(tmp_path):
    frame = log_of(relaxing, LEVELS, ramp=False)
    frame.assign(force_normal_n=1e3 * frame["force_normal_n"]).to_csv(tmp_path / "log.csv")
    with refused(PressError):
        read_press_log(tmp_path / "log.csv")
