"""What must not matter to the law of a press log, or acts on it in a known way."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from tacgen.calibrate.contact.law_fit import fit_contact
from tacgen.diagnose.contact.command import diagnose
from tacgen.diagnose.contact.result import diagnosis_record
from tacgen.presses.press_log import SHEAR_FORCES, SHEAR_MOTIONS, read_press_log
from tests.calibrate.contact.test_law_fit import session
from validation.contact.cases import blank_log, make_case


@dataclass(frozen=True)
class Change:
    """What is done to a log, and the factors on force, volume and marker motion."""

    of_log: Callable[[pd.DataFrame], pd.DataFrame]
    force: float = 1.0
    volume: float = 1.0
    motion: float = 1.0


def scaled(force=1.0, volume=1.0, motion=1.0):
    """Other units; factors that are no powers of two are rounded."""
    factors = {"force_normal_n": force, "volume_mm3": volume}
    factors |= dict.fromkeys(SHEAR_FORCES, force) | dict.fromkeys(SHEAR_MOTIONS, motion)

    def of_log(log):
        return log.assign(**{name: log[name] * by for name, by in factors.items() if name in log})

    return Change(of_log, force, volume, motion)


def renumbered(log):
    """In another order of numbers, and not one after another."""
    numbers = log["trial"].unique()
    other = np.random.default_rng(1).permutation(500)[: len(numbers)]
    return log.assign(trial=log["trial"].map(dict(zip(numbers, other, strict=True))))


def swapped(log):
    """With x for y, of places, forces and motions."""
    axes = [name for name in log if "_x_" in name or name == "x_mm"]
    other = {name: name.replace("x_", "y_", 1) for name in axes}
    return log.rename(columns=other | {y: x for x, y in other.items()})


def with_noise(log):
    """With a column that has nothing to say."""
    return log.assign(humidity=np.random.default_rng(9).normal(50.0, 5.0, len(log)))


CHANGES = {
    "1000 s later": Change(lambda log: log.assign(time_s=log["time_s"] + 1000.0)),
    "renumbered": Change(renumbered),
    "half the force": scaled(force=0.5),
    "in other units": scaled(force=0.7, volume=3.0, motion=10.0),
    "x and y swapped": Change(swapped),
    "columns in another order": Change(lambda log: log[log.columns[::-1]]),
    "a column of noise": Change(with_noise),
}


def read(log, folder):
    """The log as a user's file."""
    log.to_csv(folder / "log.csv", index=False)
    return read_press_log(folder / "log.csv")


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
@pytest.mark.parametrize("free_contact_point", [False, True])
def test_a_calibration_is_of_what_was_measured(tmp_path, change, free_contact_point):
    if free_contact_point and change.volume != 1.0:
        pytest.skip("the volume of a known ball is in mm³")
    # Contact points are searched for.
    rel = 1e-6 if free_contact_point else 1e-9
    log = session(n_trials=24)  # more than there are folds
    plain, other = (
        fit_contact(read(one, tmp_path), free_contact_point=free_contact_point)
        for one in (log, change.of_log(log))
    )
    for channel, found, response in (
        (plain.normal, other.normal, change.volume),
        (plain.shear, other.shear, change.motion),
    ):
        k, held_out = found.pooled, found.held_out
        factor = response / change.force
        assert k.value == pytest.approx(factor * channel.pooled.value, rel=rel)
        assert k.stderr == pytest.approx(factor * channel.pooled.stderr, rel=rel)
        assert held_out.nrmse == pytest.approx(channel.held_out.nrmse, rel=rel)
        assert found.noise == pytest.approx(response * channel.noise, rel=rel)
        assert found.agreement.p_value == pytest.approx(channel.agreement.p_value, rel=1e3 * rel)
        groups = {name: group.value * factor for name, group in channel.groups.items()}
        assert {n: g.value for n, g in found.groups.items()} == pytest.approx(groups, rel=rel)
    assert len(other.warnings) == len(plain.warnings)


ALL = ("1000 s later", "in other units", "x and y swapped", "columns in another order")


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [
        [("normal", "temperature", 1), ("shear", "anisotropy", 0)],
        pytest.param([("normal", "creep", 0), ("shear", "slip", 0)], marks=pytest.mark.exhaustive),
    ],
    ids=["temperature-anisotropy", "creep-slip"],
)
def test_a_diagnosis_is_of_what_was_measured(tmp_path, effects):
    """All changes at once: the same effects, and a law that predicts the changed log as well.

    A column of noise is one more candidate, in fits without the held-out trials too: it changes no
    name.
    """
    rng = np.random.default_rng(3)
    log = pd.DataFrame(make_case(effects, 3.0, rng, blank_log(rng, 16, 24))[0])
    changed = renumbered(log)
    for name in ALL:
        changed = CHANGES[name].of_log(changed)
    found = []
    for one in (log, changed):
        columns = read(one, tmp_path).columns
        diagnosis = diagnose(columns)
        predicted = diagnosis.law.predict(columns)
        # Files are sorted by the trials' numbers.
        in_time = (values[np.argsort(columns["time_s"])] for values in predicted)
        found.append((diagnosis_record(diagnosis)["channels"], *in_time))
    (plain, volume, motion), (other, other_volume, other_motion) = found
    noisy = diagnosis_record(diagnose(read(with_noise(log), tmp_path).columns))["channels"]
    for channel, name, _ in effects:
        for one in (plain[channel], other[channel], noisy[channel]):
            assert (one["verdict"], [e["name"] for e in one["effects"]]) == ("effect_found", [name])
        after = plain[channel]["error_after"]["nrmse"]
        assert other[channel]["error_after"]["nrmse"] == pytest.approx(after, rel=1e-3)
    units = CHANGES["in other units"]
    # Fits end within a share of the parameters' errors.
    np.testing.assert_allclose(other_volume, units.volume * volume, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(other_motion[:, ::-1], units.motion * motion, rtol=2e-3, atol=2e-3)
