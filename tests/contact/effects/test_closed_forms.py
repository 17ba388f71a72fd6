"""Each effect against the closed form that its source gives."""

import numpy as np
import pytest
from scipy.special import erfcx

from tacgen.contact.effects import LoadHistory, Where, find_effect
from tacgen.contact.effects.base import power_shape
from tacgen.contact.effects.kernels import delayed
from tacgen.contact.law import respond


def history_of(force, time=None, **more):
    force = np.asarray(force, dtype=float)
    time = np.arange(force.size) * 0.1 if time is None else np.asarray(time, dtype=float)
    return LoadHistory(
        {"trial": np.zeros(force.size, int), "time_s": time, "force_normal_n": force, **more}
    )


def volume(history, name, channel="normal", **parameters):
    effect = find_effect(channel, name)
    complete = effect.complete(effect.references(history) | parameters)
    return respond(history, channel, 2.0, [(effect, complete)])


def test_creep_under_a_constant_load_is_the_prony_series():
    time = np.linspace(0.0, 20.0, 57) ** 1.1
    history = history_of(np.full(57, 3.0), time)
    creeping = volume(history, "creep", amount=0.2, tau_s=1.5, amount_2=0.1, tau_2_s=9.0)
    grown = 0.2 * (1 - np.exp(-time / 1.5)) + 0.1 * (1 - np.exp(-time / 9.0))
    np.testing.assert_allclose(creeping[:, 0], 6.0 * (1 + grown), rtol=1e-12)


def test_creep_under_a_ramp_is_the_convolution_integral():
    time = np.linspace(0.0, 5.0, 11)
    history = history_of(2.0 * time, time)
    creeping = volume(history, "creep", amount=0.3, tau_s=0.7)[:, 0]
    integral = 2.0 * (time - 0.7 * (1 - np.exp(-time / 0.7)))
    np.testing.assert_allclose(creeping, 2.0 * (2.0 * time + 0.3 * integral), rtol=1e-12)


@pytest.mark.parametrize("channel", ["normal", "shear"])
def test_creep_as_it_is_fitted_never_goes_back_under_a_held_load(channel):
    """Terms of both signs and nearly one τ would be a delay instead."""
    history = history_of(np.ones(60), np.linspace(0.0, 12.0, 60))
    effect, rng = find_effect(channel, "creep"), np.random.default_rng(0)
    values = effect.complete(effect.references(history))
    free = {name for form in effect.variants(history, values) for name in form.free}
    assert {"amount", "amount_2"} <= free
    for _ in range(20):
        ends = {name: effect.parameter(name).bounds_on(history, values) for name in free}
        drawn = {name: rng.uniform(low, high) for name, (low, high) in ends.items()}
        crept = effect.apply(np.ones((60, 1)), history, values | drawn)
        assert np.all(np.diff(crept[:, 0]) >= -1e-12)


def test_creep_as_a_power_of_time_is_the_springpot_and_ends_as_mittag_leffler_has_it():
    time = np.r_[0.0, np.geomspace(0.2, 100.0, 120)]
    history = history_of(np.full(121, 3.0), time)
    given = {"shortest_s": 0.01, "longest_s": 100.0, "power_amount": 0.4}
    for power, ends_s, shape in (
        (0.2, 1e7, time**0.2),
        (0.5, 2.0, 1.0 - erfcx(np.sqrt(time / 2.0))),
    ):
        crept = volume(history, "creep", **given, power=power, ends_s=ends_s)[:, 0] / 6.0 - 1.0
        assert crept[-1] == pytest.approx(0.4, rel=1e-9)
        # What yields within the shortest time is as if at once: the compliance holds it.
        since, wanted = ((one - one[1])[1:] / (one[-1] - one[1]) for one in (crept, shape))
        np.testing.assert_allclose(since, wanted, atol=0.02)


def test_a_tilt_counts_whichever_way_it_is_or_by_its_side():
    tilt_x, tilt_y = np.array([0.0, 3.0, -3.0, 0.0]), np.array([0.0, 4.0, -4.0, 10.0])
    history = history_of(np.full(4, 3.0), tilt_x=tilt_x, tilt_y=tilt_y)
    found = volume(history, "tilt", amount=0.4, square=0.2)[:, 0]
    np.testing.assert_allclose(found, 6.0 * np.array([1.0, 1.25, 1.25, 1.6]), rtol=1e-12)
    aside = volume(history, "tilt", x=0.1, y=-0.2)[:, 0]
    np.testing.assert_allclose(aside, 6.0 * np.array([1.0, 0.95, 1.05, 0.8]), rtol=1e-12)


def test_creep_is_superposed_and_recovers_after_unloading():
    time = np.linspace(0.0, 40.0, 4001)
    pulse = ((time >= 5.0) & (time < 15.0)).astype(float)
    creeping = volume(history_of(pulse, time), "creep", amount=0.5, tau_s=3.0)[:, 0]
    late = time > 15.1
    expected = 2.0 * 0.5 * (np.exp(-(time - 15.0) / 3.0) - np.exp(-(time - 5.0) / 3.0))
    np.testing.assert_allclose(creeping[late], expected[late], atol=0.005)


@pytest.mark.parametrize("since_press", [0.0, 1.0])
def test_creep_of_a_shear_that_begins_later_is_timed_from_it_or_from_the_press(since_press):
    time = np.linspace(0.0, 6.0, 61)
    pull = np.where(time >= 2.0, 1.5, 0.0)
    history = history_of(np.full(61, 5.0), time, force_shear_x_n=pull, force_shear_y_n=0 * pull)
    given = {"amount": 0.3, "tau_s": 1.7, "recovery": 0.0, "since_press": since_press}
    found = volume(history, "creep", "shear", **given)[:, 0]
    since = time - (0.0 if since_press else 2.0)
    expected = 2.0 * pull * (1.0 + 0.3 * (1.0 - np.exp(-since / 1.7)))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def presses(*parts, pause_s):
    """Columns of presses of these forces, 0.1 s from sample to sample, so far apart."""
    counts = [len(part) for part in parts]
    starts = np.cumsum([0.0, *((n - 1) * 0.1 + pause_s for n in counts[:-1])])
    times = [start + 0.1 * np.arange(n) for start, n in zip(starts, counts, strict=True)]
    return {
        "trial": np.repeat(np.arange(len(parts)), counts),
        "time_s": np.concatenate(times),
        "force_normal_n": np.concatenate(parts).astype(float),
    }


def test_carried_memory_of_a_load_that_was_held_decays_through_pause_and_press():
    columns = presses(np.full(21, 4.0), np.full(11, 3.0), np.full(6, 1.0), pause_s=1.5)
    found = volume(LoadHistory(columns), "creep", amount=0.4, tau_s=0.8, carried=1.0)[:, 0]
    time = columns["time_s"]
    expected, state = [], 0.0
    for trial, force in ((0, 4.0), (1, 3.0), (2, 1.0)):
        own = time[columns["trial"] == trial]
        grown = force + (state - force) * np.exp(-(own - own[0]) / 0.8)
        expected += list(2.0 * (force + 0.4 * grown))
        state = grown[-1] * np.exp(-1.5 / 0.8)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_a_part_of_a_log_carries_what_the_whole_left():
    columns = presses(*np.random.default_rng(9).uniform(0.0, 5.0, (5, 20)), pause_s=0.4)
    # As the trials' numbers tell nothing of their order in time.
    columns["trial"] = np.array([3, 1, 4, 0, 2])[columns["trial"]]
    whole = LoadHistory(columns)
    kept = np.isin(columns["trial"], [0, 2, 3])
    part = LoadHistory({name: values[kept] for name, values in columns.items()}, whole)
    given = {"amount": 0.5, "tau_s": 0.9, "carried": 1.0}
    of_whole = whole.unsorted(volume(whole, "creep", **given))
    of_part = part.unsorted(volume(part, "creep", **given))
    np.testing.assert_allclose(of_part, of_whole[kept], rtol=1e-12)


def test_nothing_is_carried_where_the_clock_starts_anew_with_every_press():
    columns = presses(np.full(9, 4.0), np.full(9, 4.0), pause_s=0.5)
    columns["time_s"] = np.tile(columns["time_s"][:9], 2)
    history = LoadHistory(columns)
    given = {"amount": 0.4, "tau_s": 0.9}
    carried = volume(history, "creep", **given, carried=1.0)
    np.testing.assert_array_equal(carried, volume(history, "creep", **given))
    assert history.pause_s == np.inf


def test_latency_shifts_a_ramp_by_its_delay():
    time = np.linspace(0.0, 4.0, 41)
    late = volume(history_of(3.0 * time, time), "latency", delay_s=0.25)[:, 0]
    np.testing.assert_allclose(late[5:], 6.0 * (time[5:] - 0.25), rtol=1e-9)
    early = volume(history_of(3.0 * time, time), "latency", delay_s=-0.25)[:, 0]
    np.testing.assert_allclose(early[:-5], 6.0 * (time[:-5] + 0.25), rtol=1e-9)


def test_a_delay_interpolates_each_trial_by_itself_and_holds_its_ends():
    rng = np.random.default_rng(5)
    counts = [1, 7, 40, 12]
    starts = np.concatenate([[0], np.cumsum(counts)])
    # Two decimals: some samples of a trial have the same time, as coarse clocks give.
    times = [np.sort(np.round(rng.uniform(0.0, 0.5, count), 2)) for count in counts]
    values = [rng.normal(size=count) for count in counts]
    for delay_s in (-0.2, -0.01, 0.0, 0.004, 0.03, 2.0):
        found = delayed(np.concatenate(values), np.concatenate(times), starts, delay_s)
        wanted = [np.interp(t - delay_s, t, v) for t, v in zip(times, values, strict=True)]
        np.testing.assert_allclose(found, np.concatenate(wanted), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("operator", ["play", "low_pass", "dahl"])
def test_what_is_kept_of_a_load_is_not_taken_for_another(operator):
    rng = np.random.default_rng(6)
    one, other = np.cumsum(rng.normal(size=(2, 50, 1)), axis=1)
    history = history_of(np.ones(50))
    kept = getattr(history, operator)
    first, again = kept(one, 0.5), kept(one, 0.5)
    assert again is first
    for load, number in ((other, 0.5), (one, 0.7), (one.copy(), 0.5)):
        fresh = getattr(history_of(np.ones(50)), operator)(load, number)
        np.testing.assert_array_equal(kept(load, number), fresh)


def test_a_hysteresis_within_its_bounds_takes_work_from_every_cycle():
    """∮ F dV is above 0 where the volume follows the force, and below where it is ahead."""
    one = np.linspace(0.0, 6.0, 200)
    force_n = np.concatenate([one, one[::-1]])
    history, effect = history_of(force_n), find_effect("normal", "hysteresis")
    references = effect.references(history)
    seen = set()
    for form in effect.variants(history, references):
        for name in (name for probe in form.probes for name in probe):
            values = effect.complete(references | form.shapes)
            low, high = effect.parameter(name).bounds_on(history, values)
            assert low == 0.0 or high == 0.0
            for size in (0.2, -0.2):
                response = volume(history, "hysteresis", **{**values, name: size})[:, 0]
                work = 0.5 * (force_n[1:] + force_n[:-1]) @ np.diff(response)
                assert (work > 0) == (low <= size <= high), (form.label, name, size)
            seen.add(name)
    assert seen == {"residual", "loop", "jump", "play", "spread", "friction", "rubbing"}


def test_smoothed_samples_of_a_step_approach_it_by_a_geometric_series():
    time = np.cumsum([0.0, 0.1, 0.1, 0.3, 0.05])
    step = volume(history_of([0.0, 5.0, 5.0, 5.0, 5.0], time), "latency", smoothing_s=0.2)[:, 0]
    np.testing.assert_allclose(step, 10.0 * (1.0 - np.exp(-time / 0.2)), rtol=1e-12)


def test_bumps_of_a_place_add_up_to_a_sum_of_gaussians():
    x, y = np.array([0.0, 2.0, -4.0, 1.0]), np.array([0.0, 1.0, 3.0, -4.0])
    history = history_of(np.full(4, 3.0), x_mm=x, y_mm=y)
    found = volume(history, "position", bump_1=0.1, bump_18=-0.2)[:, 0]

    def bump(u, v):
        return np.exp(-((x / 4.0 - u) ** 2 + (y / 4.0 - v) ** 2) / (2 * 0.5**2))

    expected = 6.0 * (1.0 + 0.1 * bump(-1.0, -1.0) - 0.2 * bump(0.5, 0.0))
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_stiffening_is_one_at_its_reference_and_logarithmic_at_exponent_zero():
    force = np.linspace(0.5, 8.0, 20)
    bent = volume(history_of(force), "stiffening", amount=-0.2, exponent=0.0, reference_n=4.0)
    np.testing.assert_allclose(bent[:, 0], 2.0 * force * (1 - 0.2 * np.log(force / 4.0)))
    assert power_shape(np.array([2.0]), 1e-4)[0] == pytest.approx(np.log(2.0), rel=1e-4)


def test_residual_hysteresis_leaves_a_share_of_the_peak_behind():
    force = np.concatenate([np.linspace(0, 5, 50), np.linspace(5, 0, 50), np.zeros(20)])
    left = volume(history_of(force), "hysteresis", residual=0.1)[:, 0]
    np.testing.assert_allclose(left[:49], 2.0 * force[:49], atol=0.06)
    assert left[-1] == pytest.approx(2.0 * 0.1 * 5.0, rel=1e-2)


def test_a_hysteresis_loop_closes_at_both_ends():
    force = np.concatenate([np.linspace(0, 5, 80), np.linspace(5, 0, 80)])
    loop = volume(history_of(force), "hysteresis", loop=0.2)[:, 0] - 2.0 * force
    assert abs(loop[80]) < 0.05
    assert loop[-1] == pytest.approx(0.0, abs=1e-9)
    assert loop.max() == pytest.approx(2.0 * 0.2 * 5.0 / 4.0, rel=0.02)


def test_what_a_gel_keeps_of_its_peak_is_forgotten_or_not_when_it_is_let_go():
    """Two presses in a trial, the second half as high: of which peak does its way back know?"""
    up, down = np.linspace(0, 8, 81), np.linspace(8, 0, 81)
    force = np.concatenate([up, down, up / 2, down / 2])
    history = history_of(force)
    second = slice(324 - 60, 324 - 20)
    kept = dict.fromkeys([f"kept_{k}" for k in range(1, 7)], 0.1)
    kept = volume(history, "hysteresis", **kept)[:, 0] - 2.0 * force
    np.testing.assert_allclose(kept[second], 2.0 * 0.1 * 8.0)
    let_go = dict.fromkeys([f"return_{k}" for k in range(1, 6)], 0.1)
    let_go = volume(history, "hysteresis", **let_go)[:, 0] - 2.0 * force
    np.testing.assert_allclose(let_go[second], 2.0 * 0.1 * 4.0)


def test_play_lags_by_its_width_each_way():
    force = np.concatenate([np.linspace(0, 5, 80), np.linspace(5, 0, 80)])
    lag = volume(history_of(force), "hysteresis", play=-1.0, width_n=0.5)[:, 0] - 2.0 * force
    assert lag[79] == pytest.approx(-1.0)
    assert lag[-1] == pytest.approx(1.0)


def sheared(path):
    """The history of a shear force that follows a path (N, 2)."""
    x, y = path.T
    return history_of(np.full(x.size, 5.0), force_shear_x_n=x, force_shear_y_n=y)


def friction_along(path, name, **parameters):
    """What hysteresis of the vector adds (N, 2) to the load, for an amount of −1."""
    history = sheared(path)
    given = {"width_n": 0.6, name: -1.0, "isotropic": 1.0, **parameters}
    return 0.5 * volume(history, "hysteresis", "shear", **given) - path


def circle(radius, turns=6, per_turn=2000):
    angle = np.linspace(0.0, 2 * np.pi * turns, turns * per_turn)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("name", ["play", "spread", "friction", "rubbing"])
def test_along_one_line_friction_of_the_vector_is_that_of_an_axis(name):
    course = np.concatenate([np.linspace(0, 2, 30), np.linspace(2, -1, 40), np.linspace(-1, 1, 20)])
    for angle in (0.0, 0.7):
        axis = np.array([np.cos(angle), np.sin(angle)])
        of_vector = friction_along(course[:, None] * axis, name)
        of_axis = friction_along(course[:, None] * np.array([1.0, 0.0]), name, isotropic=0.0)
        np.testing.assert_allclose(of_vector, of_axis[:, :1] * axis, atol=1e-12)


def test_a_play_that_is_dragged_round_a_circle_stays_on_a_smaller_one():
    """A weight on a string of length w behind one who walks in a circle: r² = R² − w²."""
    path = circle(2.0)
    dragged = path + friction_along(path, "play")  # the load less its way ahead of the play
    np.testing.assert_allclose(
        np.linalg.norm(dragged[-2000:], axis=1), np.sqrt(2.0**2 - 0.6**2), rtol=2e-3
    )


def test_dahl_friction_round_a_circle_has_the_size_of_its_steady_state():
    """dz/ds = t − z/c with a direction t that turns by 1/R: |z| = c / √(1 + c²/R²)."""
    added = friction_along(circle(2.0), "friction")
    size = np.linalg.norm(added[-2000:], axis=1)
    np.testing.assert_allclose(size, 0.6 / np.sqrt(1.0 + 0.6**2 / 2.0**2), rtol=2e-3)


def test_rubbing_in_proportion_to_the_load_leaves_a_wedge():
    """Far from a turn V = k F (1 ∓ r): less on the way in, more on the way back."""
    one = np.linspace(0.0, 6.0, 400)
    history = history_of(np.concatenate([one, one[::-1]]))
    given = {"rubbing": -0.1, "width_n": 0.02}
    found = volume(history, "hysteresis", **given)[:, 0]
    middle = slice(100, 300)
    np.testing.assert_allclose(found[:400][middle], 2.0 * 0.9 * one[middle], rtol=1e-9)
    np.testing.assert_allclose(found[400:][::-1][middle], 2.0 * 1.1 * one[middle], rtol=1e-9)


def test_a_sharp_saturation_is_a_limit_and_a_soft_one_stays_below():
    history = history_of(np.linspace(0, 10, 30))
    hard = volume(history, "saturation", limit_mm3=12.0, sharpness=60.0)[:, 0]
    np.testing.assert_allclose(hard, np.minimum(2.0 * np.linspace(0, 10, 30), 12.0), atol=0.15)
    assert (volume(history, "saturation", limit_mm3=12.0, sharpness=2.0)[:, 0] < 12.0).all()


def test_mindlin_slip_follows_the_published_law():
    shear = np.linspace(0.0, 1.9, 30)
    history = history_of(np.full(30, 4.0), force_shear_x_n=shear, force_shear_y_n=np.zeros(30))
    moved = volume(history, "slip", "shear", mindlin=1.0, mu=0.5)[:, 0]
    published = 2.0 * 2.0 * 1.5 * (1 - (1 - history.shear_size_n / 2.0) ** (2 / 3))
    np.testing.assert_allclose(moved, published, rtol=1e-4)


def test_gross_slip_holds_no_more_than_friction_at_a_peak_and_after_creep():
    """k_s = 2 mm/N and μ = 0.5, of a ramp of the shear force up and down and of a hold."""
    ramp = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0])
    pressed = np.array([0.0, 2.0, 4.0, 5.0, 4.0, 2.0, 0.0])
    history = history_of(pressed, force_shear_x_n=ramp, force_shear_y_n=np.zeros(7))
    moved = volume(history, "slip", "shear", gross_mu=0.5)[:, 0]
    np.testing.assert_allclose(moved, 2.0 * np.minimum(ramp, 0.5 * pressed), rtol=0.003, atol=1e-9)

    held = history_of(
        np.full(40, 5.0), force_shear_x_n=np.full(40, 2.0), force_shear_y_n=np.zeros(40)
    )
    creep = find_effect("shear", "creep"), {"amount": 0.5, "tau_s": 2.0}
    slip = find_effect("shear", "slip"), {"gross_mu": 0.5}
    both = [
        (effect, effect.complete(effect.references(held) | given))
        for effect, given in (slip, creep)
    ]
    moved = respond(held, "shear", 2.0, both)[:, 0]
    crept = respond(held, "shear", 2.0, both[1:])[:, 0]
    assert crept[-1] > 5.5
    np.testing.assert_allclose(moved, np.minimum(crept, 5.0), rtol=0.003)


def test_an_offset_of_the_gauge_is_limited_with_the_load_and_one_of_the_picture_is_not():
    """k_n = 2 mm³/N and a sharp limit of 8 mm³."""
    history = history_of([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    limit = find_effect("normal", "saturation"), {"limit_mm3": 8.0, "sharpness": 300.0}
    offset = find_effect("normal", "zero_offset")
    for given, expected in (
        ({"force_n": 0.5}, [1.0, 3.0, 5.0, 7.0, 8.0, 8.0, 8.0]),
        ({"volume_mm3": 1.0}, [1.0, 3.0, 5.0, 7.0, 9.0, 9.0, 9.0]),
        ({"force_n": -0.5, "volume_mm3": 1.0}, [0.0, 2.0, 4.0, 6.0, 8.0, 9.0, 9.0]),
    ):
        both = [(e, e.complete(e.references(history) | p)) for e, p in (limit, (offset, given))]
        # At the limit itself a sharpness of 300 leaves 2^(-1/300) of the load.
        np.testing.assert_allclose(
            respond(history, "normal", 2.0, both)[:, 0], expected, rtol=0.0025, atol=1e-9
        )
    part = offset.only(Where("trial", above=3.0)), offset.complete({"volume_mm3": 1.0})
    np.testing.assert_allclose(
        respond(history, "normal", 2.0, [part]), 2.0 * history.load("normal")
    )


def test_anisotropy_stretches_one_axis_and_shrinks_the_other():
    history = history_of(
        np.full(4, 5.0), force_shear_x_n=np.ones(4), force_shear_y_n=np.full(4, 2.0)
    )
    moved = volume(history, "anisotropy", "shear", along_x=0.1)
    np.testing.assert_allclose(moved[0], [2.2, 3.6])
    turned = volume(history, "anisotropy", "shear", rotation_rad=np.pi / 2)
    np.testing.assert_allclose(turned[0], [-4.0, 2.0], atol=1e-12)


def test_the_first_press_shows_all_of_conditioning_and_a_late_one_none():
    history = LoadHistory(
        {"trial": np.arange(40), "time_s": np.arange(40) * 9.0, "force_normal_n": np.full(40, 2.0)}
    )
    worn = volume(history, "conditioning", amount=-0.3, trials=2.0)[:, 0]
    assert worn[0] == pytest.approx(4.0 * 0.7)
    assert worn[2] == pytest.approx(4.0 * (1 - 0.3 * np.exp(-1.0)))
    assert worn[-1] == pytest.approx(4.0, rel=1e-6)


@pytest.mark.parametrize("power", [1.0, 2.5, 4.0])
def test_of_a_conditioning_no_more_than_a_tenth_is_left_after_half_of_the_session(power):
    history = LoadHistory(
        {"trial": np.arange(40), "time_s": np.arange(40) * 9.0, "force_normal_n": np.full(40, 2.0)}
    )
    trials = find_effect("normal", "conditioning").parameter("trials")
    _, longest = trials.bounds_on(history, {"power": power})
    worn = volume(history, "conditioning", amount=1.0, trials=longest, power=power)[:, 0]
    assert worn[20] == pytest.approx(4.0 * (1.0 + 0.1), rel=1e-9)


def test_a_step_of_temperature_is_half_done_at_its_place_and_over_far_from_it():
    celsius = np.array([10.0, 24.0, 25.0, 40.0])
    history = history_of(np.full(4, 3.0), temperature_c=celsius)
    given = {"reference_c": 22.0, "step": 0.2, "step_at_c": 2.0, "step_width_c": 1.0}
    found = volume(history, "temperature", **given)[:, 0]
    expected = 6.0 * np.array([0.8, 1.0, 1.0 + 0.2 * np.tanh(1.0), 1.2])
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_gain_that_settles_approaches_its_end_exponentially():
    time = np.linspace(0.0, 100.0, 11)
    found = volume(history_of(np.full(11, 3.0), time), "drift", settling=-0.3, over=0.25)[:, 0]
    np.testing.assert_allclose(found, 6.0 * (1.0 - 0.3 * (1.0 - np.exp(-time / 25.0))), rtol=1e-12)
