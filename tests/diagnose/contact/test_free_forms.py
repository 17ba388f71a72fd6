"""Free forms of effects recover shapes that were computed independently, and win only where due."""

import numpy as np
import pytest

from tacgen.contact.effects import LoadHistory, Variant, find_effect
from tacgen.contact.effects.history import REQUIRED
from tacgen.contact.effects.hysteresis import PLAY_WIDTHS
from tacgen.contact.effects.latency import ECHOES
from tacgen.contact.law import ContactLaw, FittedEffect, load_law, respond, save_law
from tacgen.core.records import Estimate
from tacgen.diagnose.contact import scores
from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.model import Model, fit_model, start_term
from tacgen.diagnose.contact.result import shown_parameters
from tacgen.diagnose.contact.search import ContactProblem
from tacgen.diagnose.rules import CONTACT as CONTACT

K_N = 4.0
N_TRIALS, N_SAMPLES = 24, 60


def presses(response, noise, seed, schedule=(0.0, 0.35, 0.65, 0.95, 1.0), peaks_n=(3.0, 9.0)):
    """Ramp, hold, ramp down; ``response(force, time, peak)`` of each press, plus white noise.

    ``schedule``: when the ramp up begins, the hold begins and ends, and the load is gone.
    """
    rng = np.random.default_rng(seed)
    parts = []
    for trial in range(N_TRIALS):
        peak, duration = rng.uniform(*peaks_n), rng.uniform(4.0, 8.0)
        time = np.linspace(0.0, duration, N_SAMPLES)
        knots = duration * np.array(schedule)
        force = np.interp(time, knots, [0.0, peak, peak, 0.0, 0.0])
        volume = K_N * response(force, time, knots, peak) + noise * rng.normal(size=time.size)
        parts.append(np.stack([np.full(N_SAMPLES, trial), trial * 20.0 + time, force, volume]))
    names = ("trial", "time_s", "force_normal_n", "volume_mm3")
    return dict(zip(names, np.concatenate(parts, axis=1), strict=True))


def free_fit(columns, name):
    """The effect's free amounts alone, fitted to a log of the normal channel."""
    data, effect = ChannelSamples(columns, "normal").thinned(), find_effect("normal", name)
    form = effect.corrected(Variant("nothing", (), ()), 0.3)
    return data, fit_model(data, Model(K_N, (start_term(effect, form, data, ()),)))


def prandtl_ishlinskii(weights, widths):
    """Closed form of Σ w (F − play_r[F]) for one press: min(F, r), then less min(fall, 2r)."""

    def response(force, time, knots, peak):
        fallen = np.where(time > knots[2], peak - force, 0.0)
        stops = np.minimum(np.where(time > knots[2], peak, force)[:, None], widths)
        return force + (stops - np.minimum(fallen[:, None], 2 * np.array(widths))) @ weights

    return response


def test_plays_recover_a_prandtl_ishlinskii_spectrum():
    weights = np.array([0.0, 0.0, 0.25, 0.0, 0.15, 0.0, 0.1])
    probe = presses(lambda force, *_: force, 0.0, 1)
    span = ChannelSamples(probe, "normal").thinned().history.normal_span_n
    widths = span * np.array(PLAY_WIDTHS)
    noise = 0.02
    columns = presses(prandtl_ishlinskii(weights, widths), noise, 1)
    data, fit = free_fit(columns, "hysteresis")
    values = fit.model.terms[0].values
    found = np.array([values[f"play_{k}"] for k in range(1, 8)])
    # Neighbouring widths share what noise does not tell apart: their running sums are known.
    np.testing.assert_allclose(np.cumsum(found), np.cumsum(weights), atol=0.08)
    assert np.sqrt(fit.loss / data.target.size) == pytest.approx(noise, rel=0.1)


def prony(amounts, taus):
    """Closed form of Σ a ∫(1 − exp(−(t − s)/τ)) dF(s) for three ramps."""

    def response(force, time, knots, peak):
        result = force.copy()
        turns = [(knots[0], 1.0), (knots[1], -1.0)], [(knots[2], -1.0), (knots[3], 1.0)]
        lengths = knots[1] - knots[0], knots[3] - knots[2]
        for ends, length in zip(turns, lengths, strict=True):
            for begin, sign in ends:
                since = np.maximum(time - begin, 0.0)
                for amount, tau in zip(amounts, taus, strict=True):
                    grown = since + tau * np.expm1(-since / tau)
                    result = result + sign * amount * peak / length * grown
        return result

    return response


def test_a_prony_spectrum_between_the_grid_s_times_is_predicted_on_another_schedule():
    truth = prony([0.1, 0.15, 0.2], [0.25, 1.3, 6.0])
    noise = 0.01
    _, fit = free_fit(presses(truth, noise, 2), "creep")
    other = presses(truth, 0.0, 3, schedule=(0.05, 0.15, 0.5, 0.7, 1.0))
    data = ChannelSamples(other, "normal").thinned()
    linear = data.target - K_N * data.history.load("normal")
    left = data.target - fit.model.law_response(data)
    assert np.sqrt((left**2).mean()) < 0.02 * np.sqrt((linear**2).mean())


def test_a_curve_recovers_a_shape_that_no_power_has():
    def bend(share):
        return 0.2 * np.tanh(share / 0.3) - 0.1 * share**2

    columns = presses(lambda f, *_: f * (1 + bend(f / 9.0)), 0.02, 4, peaks_n=(8.5, 9.0))
    _, fit = free_fit(columns, "stiffening")
    force = np.linspace(0.5, 8.5, 9)
    response = respond(
        LoadHistory({"trial": np.zeros(9), "time_s": np.arange(9.0), "force_normal_n": force}),
        "normal",
        fit.model.compliance,
        [(term.effect, term.values) for term in fit.model.terms],
    )
    # A line from knot to knot leaves at most h²/8 of the curvature: 0.15²/8 · 1.7 of tanh's.
    np.testing.assert_allclose(response[:, 0], K_N * force * (1 + bend(force / 9.0)), rtol=0.006)


def test_a_force_that_leaks_from_shear_by_any_law_is_recovered():
    """V = k (F_n + 0.05 |F_s|^1.4): added, and no multiple of the shear force."""
    rng = np.random.default_rng(11)
    columns = presses(lambda f, *_: f, 0.0, 11)
    shear = columns["force_normal_n"] * rng.uniform(0.1, 0.6, N_TRIALS).repeat(N_SAMPLES)
    angle = rng.uniform(0.0, 2.0 * np.pi, N_TRIALS).repeat(N_SAMPLES)
    columns["force_shear_x_n"] = shear * np.cos(angle)
    columns["force_shear_y_n"] = shear * np.sin(angle)
    leaked = K_N * 0.05 * shear**1.4
    columns["volume_mm3"] += leaked + 0.05 * rng.normal(size=shear.size)
    data, fit = free_fit(columns, "shear_coupling")
    found = fit.model.law_response(data) - fit.model.compliance * data.history.load("normal")
    slope = fit.model.compliance - K_N  # what a compliance takes of it
    expected = leaked - slope * columns["force_normal_n"]
    assert np.sqrt(np.mean((found[:, 0] - expected) ** 2)) < 0.04 * np.sqrt(np.mean(leaked**2))


def test_a_mean_of_samples_is_recovered_as_a_response_to_an_impulse():
    """Half of the present load, and shares of those of one and two samples before."""
    rng = np.random.default_rng(13)
    columns = presses(lambda f, *_: f, 0.0, 13)
    for rows in np.split(np.arange(columns["trial"].size), N_TRIALS):
        columns["time_s"][rows] = columns["time_s"][rows[0]] + 0.1 * np.arange(N_SAMPLES)
        force = 5.0 + np.cumsum(rng.normal(0.0, 0.3, N_SAMPLES))
        one, two = (np.append(np.full(k, force[0]), force[:-k]) for k in (1, 2))
        columns["force_normal_n"][rows] = force
        columns["volume_mm3"][rows] = K_N * (0.5 * force + 0.3 * one + 0.2 * two)
    columns["volume_mm3"] += 0.02 * rng.normal(size=columns["trial"].size)
    _, fit = free_fit(columns, "latency")
    values = fit.model.terms[0].values
    found = [values[echo.name] for echo in ECHOES]
    np.testing.assert_allclose(found, [0.0, 0.0, 0.3, 0.2, 0.0, 0.0], atol=0.01)


@pytest.mark.parametrize(
    ("weights", "seed", "corrected", "share"),
    [([0.4, 0.0, 0.2], 5, True, 0.1), *(([0.0, 0.3, 0.0], seed, False, 1.0) for seed in (5, 6, 8))],
    ids=["two plays", "one play", "one play 6", "one play 8"],
)
def test_a_form_is_corrected_only_where_held_out_trials_gain(weights, seed, corrected, share):
    """Two plays, one narrow and one wide, are no few-parameter form; one play is.

    Before any fit, friction and a spread of plays explain more than one play of a wrong width.
    """
    response = prandtl_ishlinskii(-np.array(weights), [0.3, 1.0, 4.0])
    columns = presses(response, 0.1, seed, schedule=(0.05, 0.4, 0.45, 0.95, 1.0))
    data = ChannelSamples(columns, "normal").thinned()
    found = ContactProblem(data, np.random.default_rng(0)).run()
    assert [one.candidate.name for one in found.chosen] == ["hysteresis"]
    (term,) = found.final.fit.model.terms
    assert term.variant.label.endswith("corrected") == corrected
    assert found.final.loss <= share * found.accepted.loss
    # Chance alone moves this by 0.03; what is left of two plays' corners is no more.
    assert found.final.loss < 0.2 * data.noise_loss


def test_cross_validation_with_a_prior_is_ridge_regression_without_each_fold():
    rng = np.random.default_rng(6)
    columns = presses(lambda f, *_: f * (1 + 0.1 * f), 0.3, 7)
    data = ChannelSamples(columns, "normal").thinned()
    load = data.reduce(data.history.load("normal"))
    x = np.stack([load, rng.normal(size=load.size) + 0.1 * load], axis=1)
    y = data.reduce(data.target)
    design = np.column_stack([x, y])
    precision = np.diag([0.0, 50.0, 0.0])
    within = scores.unit_grams(data, design, of_neighbours=False)
    training = np.concatenate([within, 0.5 * precision[None] ** 2])
    between = scores.unit_grams(data, design)
    losses = scores.cv_losses(between, data.folds(), [[0, 1]], scores.RIDGE, training)[0]
    fold_of_row = data.folds()[data.row_unit]
    for fold in range(int(data.folds().max()) + 1):
        kept = fold_of_row != fold
        rows = np.vstack([x[kept], precision[:2, :2]])
        weights = np.linalg.lstsq(rows, np.append(y[kept], [0.0, 0.0]), rcond=None)[0]
        a, b = data.neighbours(y - x @ weights)
        slow = np.bincount(data.pair_unit, 0.5 * a * b, minlength=data.n_units)[
            data.folds() == fold
        ]
        np.testing.assert_allclose(losses[data.folds() == fold], slow, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", ["hysteresis", "creep", "stiffening"])
def test_a_law_file_holds_the_whole_corrected_form(name, tmp_path):
    """Spans and times that place its functions too: a grasp has others than the log."""
    weights = [0.2, 0.0, 0.1]
    columns = presses(prandtl_ishlinskii(weights, [0.3, 1.0, 4.0]), 0.05, 8)
    _, fit = free_fit(columns, name)
    (term,) = fit.model.terms
    parameters = {key: Estimate(value) for key, value in shown_parameters(term).items()}
    effects = (FittedEffect(name, "normal", parameters),)
    law = ContactLaw("volume_linear", Estimate(fit.model.compliance), effects=effects)
    save_law(law, tmp_path / "contact.yaml")
    grasp = {key: columns[key][: 2 * N_SAMPLES] for key in REQUIRED}
    grasp["force_normal_n"] = 0.4 * grasp["force_normal_n"]
    volume, _ = load_law(tmp_path / "contact.yaml").predict(grasp, simulate=True)
    terms = [(term.effect, term.values)]
    expected = respond(LoadHistory(grasp), "normal", fit.model.compliance, terms)[:, 0]
    np.testing.assert_allclose(volume, np.maximum(expected, 0.0), rtol=1e-12, atol=1e-12)
    linear = fit.model.compliance * grasp["force_normal_n"]
    assert np.abs(volume - linear).max() > 0.01 * linear.max()


@pytest.mark.parametrize("delay_s", [0.0, 0.15])
def test_what_corrections_of_another_form_explain_is_no_effect_of_its_own(delay_s):
    """Creep over decades of time, fitted by one Prony term, leaves what looks like a latency."""
    wide = prony([0.06, 0.06, 0.06, 0.06], [0.15, 0.6, 2.4, 9.6])

    def delayed(force, time, knots, peak):
        before = np.interp(time - delay_s, knots, [0.0, peak, peak, 0.0, 0.0])
        return wide(before, time - delay_s, knots, peak)

    data = ChannelSamples(presses(delayed, 0.02, 10), "normal").thinned()
    selection = ContactProblem(data, np.random.default_rng(0))
    base = selection.fitted((), Model(K_N))
    pool = {one.label: one for one, _ in selection.pool(base)}
    tau = next(label for label in pool if label.startswith("creep: recovering"))
    both = selection.add(base, [pool[tau], pool["latency: delay"]])
    kept = {"creep"} if delay_s == 0.0 else {"creep", "latency"}
    assert selection._without_mismatch(both).names == kept
    rest = selection.without(both, both.members[1])
    assert selection.is_worth(rest, both), "one Prony term alone leaves much"
