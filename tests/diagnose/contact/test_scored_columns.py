"""A law is scored with the columns that it was fitted beside; a useless one spoils nothing."""

import numpy as np
import pytest

from tacgen.calibrate.contact.align import align
from tacgen.diagnose.contact.command import _Channel, diagnose
from tacgen.diagnose.contact.search import Attribution, ContactProblem
from tacgen.diagnose.rules import CONTACT
from tacgen.presses.press_log import read_press_log
from tests.diagnose.contact.test_standard_errors import ROWS, creeping_presses


@pytest.mark.parametrize("is_useful", [True, False])
def test_a_column_counts_where_the_law_was_fitted_beside_it(is_useful):
    columns = creeping_presses(20, np.random.default_rng(2), gain=0.0)
    room = np.repeat(np.random.default_rng(3).uniform(-1.0, 1.0, 20), ROWS)
    columns["room"] = room
    if is_useful:
        columns["volume_mm3"] = columns["volume_mm3"] * (1.0 + 0.2 * room)
    channel = _Channel(columns, "normal", True, CONTACT, 0.0)
    fitted, test = channel.split
    problem = ContactProblem(fitted.thinned(), np.random.default_rng(4))
    base = problem.fitted((), problem.linear)
    pool = [one for one, _ in problem.pool(base)]
    creep = next(one for one in pool if one.label.startswith("creep: recovering, tau"))
    column = next(one for one in pool if one.label == "room (gain, degree 1)")

    def errors(*members):
        found = problem.add(base, members)
        return channel._test_errors(fitted, test, Attribution(base, found, found))

    before, after = errors(creep, column)
    without = errors(creep)[1]
    assert before.rmse > 3.0 * after.rmse
    if is_useful:
        assert after.rmse == pytest.approx(0.05, rel=0.1)  # the noise
        assert without.rmse > 3.0 * after.rmse
    else:
        assert after.rmse == pytest.approx(without.rmse, rel=0.01)
    assert errors(column)[1].rmse == errors(column)[0].rmse, "of a column alone there is no law"


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_column_does_not_spoil_the_score_of_a_measured_log(measured_data):
    log, _ = align(read_press_log(measured_data / "real_logs" / "vhb_load_unload.csv"))
    rest = {name: values for name, values in log.columns.items() if name != "strain_rate"}
    found = [diagnose(one).channels["normal"].after.rmse for one in (log.columns, rest)]
    assert found[0] < 1.1 * found[1] < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("session", ["a", "c"])
def test_a_measured_pads_tilt_is_found_and_lowers_the_error_held_out(session, measured_data):
    """With two thirds of the error gone; the law was chosen without the trials held out."""
    log, _ = align(read_press_log(measured_data / "real_logs" / f"hydrogel_{session}.csv"))
    found = diagnose(log.columns).channels["normal"]
    assert set(found.effect_names) == set(found.scored_effects) == {"stiffening", "tilt"}
    assert found.after.rmse < 0.45 * found.before.rmse
