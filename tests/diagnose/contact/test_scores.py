"""The statistics that the choice rests on: free of noise, right level, enough power."""

import numpy as np
import pytest
from scipy.stats import chi2, ttest_1samp

from tacgen.diagnose.contact import scores
from tacgen.diagnose.contact.channel import ChannelSamples, noise_floor
from tacgen.diagnose.rules import CONTACT as CONTACT

N_TRIALS, N_SAMPLES = 40, 40


def log(rng, force_noise=0.3, volume_noise=0.5, bend=0.0):
    """Ramps up and down, noise in both; a quarter of each trial is without load."""
    shape = np.interp(np.linspace(0, 1, N_SAMPLES), [0.25, 0.6, 1.0], [0.0, 1.0, 0.0])
    force = (rng.uniform(3, 9, N_TRIALS)[:, None] * shape).ravel()
    volume = 4.0 * force + bend * force**2
    return {
        "trial": np.repeat(np.arange(N_TRIALS), N_SAMPLES),
        "time_s": np.arange(N_TRIALS * N_SAMPLES) * 0.05,
        "force_normal_n": force + force_noise * rng.normal(size=force.size),
        "volume_mm3": volume + volume_noise * rng.normal(size=force.size),
    }


def grams_of(columns):
    """Gram matrices of force, force² and volume less k·force."""
    data = ChannelSamples(columns, "normal").thinned()
    force = data.history.force_normal_n[:, None]
    load = data.reduce(force)
    target = data.reduce(data.target)
    k = (load @ target) / (load @ load)
    ones = data.reduce(np.ones_like(force))
    design = np.column_stack([load, data.reduce(force**2), ones, target - k * load])
    return data, scores.unit_grams(data, design), k


def p_value_of(grams, base, group, shuffled, ones):
    return scores.p_values(grams, base, [group], shuffled, ones)[0]


def test_the_compliance_is_not_diluted_by_noise_of_the_force():
    rng = np.random.default_rng(0)
    diluted, free = [], []
    for _ in range(20):
        _, grams, k = grams_of(log(rng, force_noise=1.5))
        diluted.append(k)
        free.append(k + scores.coefficients(grams.sum(axis=0), [0], scores.RIDGE)[0])
    assert np.mean(diluted) < 3.85
    assert np.mean(free) == pytest.approx(4.0, abs=0.03)


def test_a_loss_between_neighbours_holds_structure_and_no_noise():
    rng = np.random.default_rng(1)
    left = [grams_of(log(rng))[1][:, -1, -1].sum() for _ in range(20)]
    data, _, _ = grams_of(log(rng))
    assert abs(np.mean(left)) < 0.02 * data.noise_loss


def test_products_are_of_every_row_with_the_next_of_its_trial():
    """Half of their sum, by trial and both axes; within rows, the ends of a trial count half."""
    rng = np.random.default_rng(20)
    columns = log(rng)
    for axis in "xy":
        columns[f"force_shear_{axis}_n"] = 0.3 * columns["force_normal_n"]
        columns[f"shear_{axis}_mm"] = columns[f"force_shear_{axis}_n"]
    data = ChannelSamples(columns, "shear").thinned()
    design = rng.normal(size=(2 * N_TRIALS * N_SAMPLES, 3))
    rows = design.reshape(N_TRIALS, N_SAMPLES, 2, 3)
    both = np.einsum("tnci,tncj->tij", rows[:, :-1], rows[:, 1:])
    expected = 0.25 * (both + both.transpose(0, 2, 1))
    np.testing.assert_allclose(scores.unit_grams(data, design), expected, atol=1e-10)
    within = np.einsum("tnci,tncj->tnij", rows, rows)
    expected = 0.5 * within.sum(axis=1) - 0.25 * (within[:, 0] + within[:, -1])
    grams = scores.unit_grams(data, design, of_neighbours=False)
    np.testing.assert_allclose(grams, expected, atol=1e-10)


def test_the_noise_floor_is_that_of_volume_and_force_together():
    data, _, _ = grams_of(log(np.random.default_rng(2)))
    assert data.noise == pytest.approx(np.hypot(0.5, 4.0 * 0.3), rel=0.08)


@pytest.mark.slow
def test_shuffles_keep_their_level_and_see_a_bend():
    rng = np.random.default_rng(3)
    shuffled = scores.shuffles(np.arange(N_TRIALS), 499, rng)

    def p_value(bend):
        _, grams, _ = grams_of(log(rng, bend=bend))
        return p_value_of(grams, [0], [1], shuffled, [2])

    null = np.array([p_value(0.0) for _ in range(150)])
    assert 0.0 <= np.mean(null < 0.1) < 0.2
    assert p_value(0.05) == 1 / 500


def test_a_constant_that_is_added_in_every_trial_has_the_p_of_sign_flips():
    """It has no order that permuting trials could change: a permutation sees nothing of it."""
    rng = np.random.default_rng(6)
    p_values = []
    for offset in [0.0] * 40 + [0.4]:
        columns = log(rng, force_noise=0.0)
        columns["volume_mm3"] += offset
        _, grams, _ = grams_of(columns)
        shuffled = scores.shuffles(np.arange(N_TRIALS), 499, rng)
        p_values.append(p_value_of(grams, [0], [2], shuffled, [2]))
    # Of 40 uniform values 2 are below 0.05 in the mean; more than 7 have a chance of 0.1 %.
    assert sum(p < 0.05 for p in p_values[:-1]) <= 7
    assert p_values[-1] == 1 / 500, "0.4 mm³ is ten standard errors"


def test_permutations_keep_their_level_where_trials_differ():
    """Each trial has its own gain; those with more load say more about it, and differ as much."""
    rng = np.random.default_rng(11)
    n_trials, n_logs = 24, 400
    shuffled = scores.shuffles(np.arange(n_trials), 199, rng)
    p_values = []
    for _ in range(n_logs):
        load = rng.uniform(0.5, 9.0, n_trials)  # of a trial, as the root of its information
        condition = rng.normal(size=n_trials)
        left = 0.05 * rng.normal(size=n_trials) * load + 0.01 * rng.normal(size=n_trials)
        columns = np.stack([load, condition * load, np.ones(n_trials), left], axis=1)
        grams = columns[:, :, None] * columns[:, None, :]
        p_values.append(p_value_of(grams, [0], [1], shuffled, [2]))
    # Two standard deviations of 400 draws at 0.1 are 0.03.
    assert np.mean(np.array(p_values) < 0.1) == pytest.approx(0.1, abs=0.03)


def test_permutations_keep_their_level_beside_almost_as_many_numbers_as_trials():
    """Residuals beside six columns of ten trials vary in four ways only; their shuffles in all."""
    rng = np.random.default_rng(17)
    n_trials, p_values = 10, []
    shuffled = scores.shuffles(np.arange(n_trials), 199, rng)
    for _ in range(400):
        conditions = np.column_stack([np.ones(n_trials), rng.normal(size=(n_trials, 6))])
        left = rng.normal(size=n_trials)
        columns = np.column_stack([conditions, np.ones(n_trials), left])
        grams = columns[:, :, None] * columns[:, None, :]
        p_values.append(p_value_of(grams, list(range(6)), [6], shuffled, [7]))
    # Two standard deviations of 400 draws at 0.1 are 0.03.
    assert np.mean(np.array(p_values) < 0.1) == pytest.approx(0.1, abs=0.03)


def test_what_other_columns_take_of_a_shuffle_hides_no_effect():
    """A condition that explains all that ten columns beside it leave; by chance 1 shuffle of 200.

    The same ratio of sums of squares as an F test has, whose p is below 1e-8 in each draw.
    """
    rng = np.random.default_rng(19)
    n_trials, n_base = 14, 10
    shuffled = scores.shuffles(np.arange(n_trials), 199, rng)
    p_values = []
    for _ in range(20):
        load = np.exp(0.7 * rng.normal(size=(n_trials, 1)))
        base = np.column_stack([load, load * rng.normal(size=(n_trials, n_base - 1))])
        condition = load[:, 0] * rng.normal(size=n_trials) + base @ rng.normal(size=n_base)
        left = condition + 1e-4 * rng.normal(size=n_trials)
        left -= base @ np.linalg.lstsq(base, left, rcond=None)[0]
        columns = np.column_stack([base, condition, np.ones(n_trials), left])
        grams = columns[:, :, None] * columns[:, None, :]
        p_values.append(p_value_of(grams, list(range(n_base)), [n_base], shuffled, [n_base + 1]))
    assert max(p_values) <= 0.02


def test_signs_see_effects_that_scatter_about_as_well_as_a_t_test_of_them_whatever_the_loads():
    rng = np.random.default_rng(20)
    n_units, rows, n_draws = 20, 5, 60
    shuffled = scores.shuffles(np.arange(n_units), 999, rng)
    found = np.empty((n_draws, 2))
    for draw in range(n_draws):
        load = np.exp(0.8 * rng.normal(size=(n_units, 1, 1))) * np.linspace(0.2, 1.0, rows)[:, None]
        bent = load * np.linspace(-1.0, 1.0, rows)[:, None] ** 2
        effects = 0.3 + 0.3 * rng.normal(size=n_units)
        left = effects[:, None, None] * bent + 1e-3 * rng.normal(size=load.shape)
        design = np.concatenate([load, bent, np.ones_like(load), left], axis=2)
        grams = np.einsum("urp,urq->upq", design, design)
        p_value = p_value_of(grams, [0], [1], shuffled, [2])
        found[draw] = p_value < 0.01, ttest_1samp(effects, 0.0).pvalue < 0.01
    by_signs, by_t_test = found.mean(axis=0)
    assert by_t_test > 0.8
    assert by_signs > 0.75 * by_t_test


def log_of_parts(rng, n_trials, *, gains, bend=0.0):
    """Gram matrices of six parts a trial, of load, load² and what is left: trials differ by gains.

    The second column, load² in half of the trials, is more of a gain than of a bend.
    """
    load = np.linspace(0.4, 1.0, 24).reshape(1, 6, 4) * rng.uniform(0.5, 1.0, (n_trials, 1, 1))
    bent = load**2 * (np.arange(n_trials) % 2)[:, None, None]
    left = gains * rng.normal(size=(n_trials, 1, 1)) * load + bend * bent
    left = left + 0.01 * rng.normal(size=load.shape)
    design = np.stack([load, bent, np.ones_like(load), left], axis=-1)
    return np.einsum("tpri,tprj->tpij", design, design).reshape(n_trials * 6, 4, 4)


def test_parts_of_trials_keep_their_level_where_the_trials_gains_differ():
    rng = np.random.default_rng(18)
    shuffled = scores.shuffles(np.repeat(np.arange(9), 6), 199, rng)

    def found(**how):
        grams = log_of_parts(rng, 9, **how)
        parts = scores.p_values(grams, [0], [[1]], shuffled, [2], parts_of_trials=True)[0]
        return parts, p_value_of(grams, [0], [1], shuffled, [2])

    null = np.array([found(gains=0.1) for _ in range(300)])
    # Three standard deviations of 300 draws at 0.1 are 0.05; twice the smaller p is cautious.
    assert np.mean(null[:, 0] < 0.1) < 0.15
    assert np.mean(null[:, 1] < 0.1) > 0.4, "signs of parts take a gain for several findings"
    assert found(gains=0.1, bend=0.3)[0] <= 0.01


def test_an_offset_of_both_axes_is_no_difference_between_the_levels_of_a_column():
    """Constants for each level hold an offset; what differs from level to level has an order."""
    rng = np.random.default_rng(15)
    n_trials, n_rows = 32, 20
    shuffled = scores.shuffles(np.arange(n_trials), 199, rng)

    def p_value(difference):
        level = rng.permutation(np.arange(n_trials) % 2)[:, None, None]
        angle = rng.uniform(0.0, 2.0 * np.pi, (n_trials, 1))
        size = rng.uniform(2.0, 8.0, (n_trials, 1)) * np.linspace(0.0, 1.0, n_rows)
        force = np.stack([size * np.cos(angle), size * np.sin(angle)], axis=2)
        axes = np.broadcast_to(np.eye(2), (n_trials, n_rows, 2, 2))
        left = 0.4 + difference * level + 0.3 * rng.normal(size=force.shape)
        columns = [force[..., None], axes * level[..., None], axes * (1 - level)[..., None], axes]
        design = np.concatenate([*columns, left[..., None]], axis=3).reshape(n_trials, -1, 8)
        grams = np.einsum("urp,urq->upq", design, design)
        return p_value_of(grams, [0], [1, 2, 3, 4], shuffled, [5, 6])

    null = np.array([p_value(0.0) for _ in range(150)])
    # Three standard deviations of 150 draws at 0.1 are 0.07.
    assert np.mean(null < 0.1) <= 0.17
    assert p_value(0.4) < 0.01


def p_values_of_forms(rng, shuffled, n_forms):
    """The p of random forms where only the trials' gains differ, some loads being far greater."""
    load = np.exp(rng.normal(size=(shuffled.signs.shape[1], 1, 1)))
    shape = load * np.linspace(0.2, 1.0, 6)[:, None]
    forms = shape * rng.normal(size=(len(load), 6, n_forms))
    left = 0.02 * shape * rng.normal(size=(len(load), 1, 1))
    design = np.concatenate([shape, forms, np.ones_like(shape), left], axis=2)
    grams = np.einsum("urp,urq->upq", design, design)
    groups = [[1 + form] for form in range(n_forms)]
    return scores.p_values(grams, [0], groups, shuffled, [n_forms + 1])


@pytest.mark.parametrize("n_forms", [1, 8])
def test_sign_flips_keep_their_level_where_trials_differ_however_many_forms_there_are(n_forms):
    rng = np.random.default_rng(14)
    shuffled = scores.shuffles(np.arange(20), 199, rng)
    least = [p_values_of_forms(rng, shuffled, n_forms).min() for _ in range(400)]
    # Three standard deviations of 400 draws at 0.1 are 0.045; with what the fit hides left out, one
    # form is at 0.19; with a p of their own, eight forms are at 0.48.
    assert np.mean(np.array(least) <= 0.1) <= 0.145


def test_a_trial_of_one_row_changes_no_p():
    columns = log(np.random.default_rng(13), bend=0.02)
    short = {name: values[:1] + 0.0 for name, values in columns.items()}
    short["trial"], short["time_s"] = np.array([-1.0]), np.array([-5.0])
    with_short = {name: np.append(short[name], values) for name, values in columns.items()}

    def p_values(columns):
        data = ChannelSamples(columns, "normal").thinned()
        force = data.history.force_normal_n[:, None]
        number = data.history.trial_index[:, None] / N_TRIALS
        parts = [force, number * force, np.ones_like(force), data.target - 4.0 * force]
        grams = scores.unit_grams(data, np.column_stack([data.reduce(part) for part in parts]))
        shuffled = scores.shuffles(data.unit_trial, 99, np.random.default_rng(0))
        return scores.p_values(grams, [0], [[1]], shuffled, [2])

    np.testing.assert_allclose(p_values(with_short), p_values(columns))


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.95])
def test_parts_of_a_trial_count_as_one_for_as_long_as_noise_goes_on(memory):
    """The integrated autocorrelation time of an AR(1) process is (1 + ρ) / (1 − ρ)."""
    rng = np.random.default_rng(12)
    columns = log(rng)
    columns["trial"] = np.repeat(np.arange(4), N_TRIALS * N_SAMPLES // 4)
    data = ChannelSamples(columns, "normal").thinned(400)
    noise = np.zeros(data.history.n_samples)
    for i in range(1, noise.size):
        noise[i] = memory * noise[i - 1] + rng.standard_normal()
    # 1 600 rows hold 40 of the longest memory: its estimate is good to a third.
    expected = 2 * (1 + memory) / (1 - memory)
    assert data.memory_rows(noise) == pytest.approx(expected, rel=0.35)


def test_blocks_of_units_share_a_sign_within_their_trial():
    trial, rows = np.repeat([0, 1], [5, 3]), np.array([10, 10, 5, 5, 10, 10, 10, 10])
    blocks = scores.shuffles(trial, 50, np.random.default_rng(1), rows).of_blocks(20.0).signs
    same, different = [(0, 1), (2, 3), (3, 4), (5, 6)], [(1, 2), (4, 5), (6, 7)]
    for one, other, is_same in [(*p, True) for p in same] + [(*p, False) for p in different]:
        assert np.array_equal(blocks[:, one], blocks[:, other]) == is_same


def test_units_of_few_trials_are_parts_in_which_as_much_happens():
    """A ramp in a fifth of the time has the way too: 0.2 to 0.8 of nine units, so seven of them."""
    time_s = np.tile(np.linspace(0.0, 10.0, 401), 4)
    force = np.interp(time_s, [4.0, 5.0, 6.0], [0.0, 10.0, 0.0])
    columns = {
        "trial": np.repeat(np.arange(4), 401),
        "time_s": time_s,
        "force_normal_n": force,
        "volume_mm3": 4.0 * force + 1e-3 * np.random.default_rng(0).standard_normal(time_s.size),
    }
    data = ChannelSamples(columns, "normal").thinned(401)
    is_ramp = np.abs(time_s[data.first] - 5.0) < 1.0
    assert data.n_units == 36
    assert np.unique(data.pair_unit[is_ramp]).size == 4 * 7


def test_cross_validation_of_a_set_equals_refitting_without_each_fold():
    _, grams, _ = grams_of(log(np.random.default_rng(4), bend=0.02))
    folds = np.arange(N_TRIALS) % 5
    quick = scores.cv_losses(grams, folds, [[0, 1]], scores.RIDGE)[0]
    for fold in range(5):
        kept = grams[folds != fold].sum(axis=0)
        weights = np.linalg.solve(kept[:2, :2], kept[:2, -1])
        extended = np.append(-weights, [0.0, 1.0])
        slow = np.einsum("i,uij,j->u", extended, grams[folds == fold], extended)
        np.testing.assert_allclose(quick[folds == fold], slow, rtol=1e-5, atol=1e-6)


def test_a_ridge_is_as_much_more_data_that_the_coefficients_are_0():
    rng = np.random.default_rng(21)
    design = rng.normal(size=(6, 30, 3))
    design[:, :, 1] = design[:, :, 0] + 1e-3 * design[:, :, 1]  # hardly two columns
    grams, ridge = np.einsum("urp,urq->upq", design, design), 1e-3
    losses = scores.cv_losses(grams, np.arange(6), [[0, 1]], ridge)[0]
    for unit in range(6):
        columns, target = (
            np.delete(design, unit, axis=0).reshape(-1, 3)[:, part] for part in ([0, 1], 2)
        )
        rows = np.sqrt(ridge) * np.diag(np.linalg.norm(columns, axis=0))
        stacked = np.vstack([columns, rows])
        weights = np.linalg.lstsq(stacked, np.append(target, [0.0, 0.0]), rcond=None)[0]
        left = design[unit, :, 2] - design[unit, :, :2] @ weights
        assert losses[unit] == pytest.approx(left @ left, rel=1e-6)


def test_groups_of_different_size_are_scored_as_they_are_alone():
    _, grams, _ = grams_of(log(np.random.default_rng(5)))
    folds = np.arange(N_TRIALS) % 4
    both = scores.cv_losses(grams, folds, [[0, 1], [0, 1, 2]], scores.RIDGE)
    np.testing.assert_allclose(both[0], scores.cv_losses(grams, folds, [[0, 1]], scores.RIDGE)[0])
    np.testing.assert_allclose(
        both[1], scores.cv_losses(grams, folds, [[0, 1, 2]], scores.RIDGE)[0]
    )


def test_columns_that_only_noise_tells_apart_cannot_leave_less_than_nothing():
    without = np.array([3.0, 2.0, 1.0])
    losses = np.array([[1.0, 0.5, -0.2], [-60.0, -50.0, 3.0], [np.nan, 1.0, 1.0]])
    kept = scores.believable(losses, without, -0.5)
    np.testing.assert_array_equal(kept, [losses[0], without, without])


def test_chance_takes_a_sum_between_neighbours_below_zero_as_far_as_is_said():
    rng = np.random.default_rng(19)
    data, _, _ = grams_of(log(rng))
    deviation = data.least_loss / -CONTACT.negative_loss_in_sd
    sums = [grams_of(log(rng))[1][:, -1, -1].sum() for _ in range(60)]
    # The noise of a standard deviation of 60 draws is 9 %; that of the force adds to the volume's.
    assert np.std(sums) == pytest.approx(deviation, rel=0.3)


@pytest.mark.parametrize("memory", [0.0, 0.4, 0.6])
def test_the_noise_floor_sees_noise_that_goes_on_and_not_what_a_law_leaves(memory):
    rng = np.random.default_rng(8)
    parts = []
    for _ in range(40):
        white, slow = rng.standard_normal((2, 120))
        for i in range(1, 120):
            slow[i] = memory * slow[i - 1] + np.sqrt(1 - memory**2) * slow[i]
        parts.append(np.sqrt(0.6) * white + np.sqrt(0.4) * slow)
    noise = np.concatenate(parts)[:, None]
    starts = np.arange(0, 4801, 120)
    assert noise_floor(noise, starts) == pytest.approx(1.0, rel=0.06)
    left = noise + 6.0 * np.sin(2 * np.pi * np.arange(4800) / 60)[:, None]
    assert noise_floor(left, starts) < 1.25


@pytest.mark.parametrize(
    ("observed", "p"), [(3.0, 1.0), (3.0 * (1 - 1e-12), 1.0), (2.0, 1.0), (5.0, 1 / 400)]
)
def test_shuffles_that_equal_the_observed_score_but_for_rounding_count_as_reaching_it(observed, p):
    neg_log_p = np.full(400, 3.0)
    neg_log_p[0] = observed
    assert scores.ranked({7: neg_log_p}) == {7: pytest.approx(p)}


def test_a_score_is_ranked_among_the_highest_of_all_candidates():
    """Westfall & Young: of two, what the other reaches in a shuffle counts too."""
    one, other = np.array([3.0, 1.0, 2.0, 1.0]), np.array([0.5, 4.0, 0.1, 0.2])
    assert scores.ranked({0: one, 1: other}) == {0: 0.5, 1: 1.0}


@pytest.mark.parametrize("size", [1, 2, 6])
def test_a_sum_of_normal_scores_has_the_p_of_its_chi_squared_law(size):
    """To a fifth: of 999 shuffles 49 are beyond the twentieth, to one in seven of their excess."""
    rng = np.random.default_rng(22)
    mix = rng.normal(size=(size, size))
    direction = rng.normal(size=size)
    p_values = np.array([0.5, 0.1, 0.01, 1e-3, 1e-4])
    lengths = np.sqrt(chi2.isf(p_values, size)) / np.linalg.norm(direction)
    sums = np.concatenate([lengths[:, None] * direction, rng.normal(size=(995, size))]) @ mix.T
    found = scores.neg_log_p_of(sums, mix @ mix.T)[: p_values.size]
    np.testing.assert_allclose(found, -np.log(p_values), rtol=0.2, atol=0.1)


def test_trials_in_which_neighbours_disagree_have_no_gain_beyond_their_size():
    """Of few samples the products of neighbours may all be negative: they say nothing then."""
    products = np.array([-4.0, -2.0])
    grams = np.repeat(products, 3).reshape(2, 3, 1) * np.ones((2, 3, 3))
    information = scores.trial_information(grams, 0)
    np.testing.assert_array_equal(information, [3.0, 3.0])
    left = scores.without_gains(grams, 0, np.arange(2))
    assert np.isfinite(left).all()
    assert np.abs(left).max() == pytest.approx(4.0 * (1.0 + 4.0 / 3.0) ** 2)
