"""Cross-validation and sign-flip tests of linearised candidates, from sums over units alone.

Everything here works on Gram matrices (U, P, P) of a design's columns, one for each unit (a
trial), whose last column is the residual: no sample is touched again, so that hundreds of
candidates and pairs cost milliseconds. The products are between the two halves of the data
(`channel`), so that a loss is what is left of structure, without the noise.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from tacgen.core.arrays import BoolArray, FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.model import Fit
from tacgen.diagnose.contact.rules import SelectionRules


def unit_grams(
    data: ChannelData, columns: FloatArray, *, between_halves: bool = True
) -> FloatArray:
    """Sums over each unit of products of ``columns`` (R, P) between the halves: (U, P, P).

    Symmetrised; in the mean free of noise, and so not positive definite where a column is noise.
    Otherwise of products within the halves, on the same scale.
    """
    size = columns.shape[1]
    shaped = columns.reshape(-1, data.n_outputs, size)
    bounds = np.searchsorted(data.pair_unit, np.arange(data.n_units + 1))
    grams = np.empty((data.n_units, size, size))
    for gram, (i, j) in zip(grams, pairwise(bounds), strict=True):
        a, b = (shaped[rows[i:j]].reshape(-1, size) for rows in data.pairs)
        if between_halves:
            products = a.T @ b
            gram[:] = 0.5 * (products + products.T)
        else:
            gram[:] = 0.5 * (a.T @ a + b.T @ b)
    return grams


def fit_grams(
    data: ChannelData, fit: Fit, blocks: Sequence[FloatArray]
) -> tuple[FloatArray, list[list[int]], list[int]]:
    """Gram matrices of a fit's columns and of further ``blocks`` (R, M), and the numbers of both.

    The numbers of each block's columns come first, then those of the fit's own.
    """
    stops = np.cumsum([block.shape[1] for block in (fit.jacobian, *blocks)])
    base, *groups = (list(range(i, j)) for i, j in pairwise([0, *map(int, stops)]))
    return unit_grams(data, np.column_stack([fit.jacobian, *blocks, fit.residual])), groups, base


def cv_losses(
    grams: FloatArray,
    folds: NDArray[np.int64],
    sets: Sequence[Sequence[int]],
    rules: SelectionRules,
    training: FloatArray | None = None,
) -> FloatArray:
    """Held-out sum of squares of every unit, for every set of columns: (S, U).

    ``sets`` hold column numbers; the last column is the target. Coefficients are fitted to
    ``training`` (≥ U, P, P), whose first U are the units, by default to ``grams`` too. A set of
    columns that are all but the same can overflow; ``believable`` refuses it.
    """
    losses = np.empty((len(sets), grams.shape[0]))
    training = grams if training is None else training
    total = training.sum(axis=0)
    for rows, index in _of_one_length(sets):
        for fold in range(int(folds.max()) + 1):
            out = np.flatnonzero(folds == fold)
            held = grams[out]
            weights = _solve(total - training[out].sum(axis=0), index, rules)
            block = held[:, index[:, :, None], index[:, None, :]]
            with np.errstate(over="ignore", invalid="ignore"):
                onto = (block @ weights[None, :, :, None])[..., 0]
                change = ((onto - 2.0 * held[:, index, -1]) * weights).sum(axis=-1)
            losses[np.ix_(rows, out)] = held[:, -1, -1] + change.T
    return losses


def training_losses(
    total: FloatArray, sets: Sequence[Sequence[int]], rules: SelectionRules
) -> FloatArray:
    """Sum of squares left by each set of columns on all units: (S,)."""
    losses = np.empty(len(sets))
    for rows, index in _of_one_length(sets):
        weights = _solve(total, index, rules)
        losses[rows] = total[-1, -1] - np.einsum("si,si->s", weights, total[index, -1])
    return losses


def _of_one_length(
    sets: Sequence[Sequence[int]],
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Numbers of the sets of each length, and these sets as one array."""
    for size in {len(one) for one in sets}:
        rows = np.array([i for i, one in enumerate(sets) if len(one) == size], dtype=np.int64)
        yield rows, np.asarray([sets[i] for i in rows], dtype=np.int64)


def believable(
    losses: FloatArray, without: FloatArray, noise_loss: float, rules: SelectionRules
) -> FloatArray:
    """``losses`` (S, U) of units; a set whose sum cannot be takes the losses ``without`` (U,) it.

    Products between the halves are not positive definite, so that a set of columns that are
    nearly the same can seem to leave less than nothing.
    """
    least = min(float(without.sum()), 0.0) - rules.negative_loss_tolerance * noise_loss
    impossible: BoolArray = ~(losses.sum(axis=1) >= least)
    result: FloatArray = np.where(impossible[:, None], without, losses)
    return result


def coefficients(total: FloatArray, columns: Sequence[int], rules: SelectionRules) -> FloatArray:
    """Least-squares coefficients of ``columns`` for the target."""
    return np.asarray(_solve(total, np.asarray([columns], dtype=np.int64), rules)[0])


def _solve(gram: FloatArray, index: NDArray[np.int64], rules: SelectionRules) -> FloatArray:
    """Coefficients (S, P) by the normal equations."""
    block = gram[index[:, :, None], index[:, None, :]]
    own = np.abs(np.diagonal(block, axis1=1, axis2=2))
    size = np.sqrt(np.maximum(own, 1e-12 * own.max(axis=1, keepdims=True)) + 1e-290)
    scaled = block / (size[:, :, None] * size[:, None, :])
    scaled = scaled + rules.ridge * np.eye(index.shape[1])
    right = gram[index, -1] / size
    return np.asarray(np.linalg.solve(scaled, right[:, :, None])[:, :, 0] / size)


@dataclass(frozen=True)
class Shuffles:
    """Sign flips of the units (F + 1, U), permutations of the trials (F + 1, T); row 0 is neither.

    ``trial`` (U,) is the trial of each unit.
    """

    signs: FloatArray
    orders: NDArray[np.int64]
    trial: NDArray[np.int64]

    @property
    def of_trials(self) -> "Shuffles":
        """The same, but with one sign for all units of a trial."""
        return self.of_blocks(self.trial.size)

    def of_blocks(self, n_units: int) -> "Shuffles":
        """The same, but with one sign for so many neighbouring units of a trial."""
        first = np.searchsorted(self.trial, self.trial)
        block = first + (np.arange(self.trial.size) - first) // n_units * n_units
        return replace(self, signs=self.signs[:, block])


def shuffles(trial: NDArray[np.int64], count: int, rng: np.random.Generator) -> Shuffles:
    """``count`` random sign flips of units, of ascending trials (U,), and orders of trials."""
    trial = np.unique(trial, return_inverse=True)[1]  # without those of one row, which have no unit
    n_trials = int(trial[-1]) + 1
    signs = rng.choice([-1.0, 1.0], size=(count + 1, trial.size))
    orders = rng.permuted(np.tile(np.arange(n_trials), (count + 1, 1)), axis=1)
    signs[0], orders[0] = 1.0, np.arange(n_trials)
    return Shuffles(signs, orders, trial)


def shuffle_p_values(
    grams: FloatArray,
    base: Sequence[int],
    groups: Sequence[Sequence[int]],
    shuffled: Shuffles,
    ones: Sequence[int],
    rules: SelectionRules,
    names: Sequence[str] | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Return the p of the score of every group of columns by its own shuffles: (groups,).

    And which groups are of trials: they have one value a trial, and trials were permuted. Of
    groups with the same of ``names``, each p is the chance that any of them scores as high.

    The score of a unit is the product of the group's columns, made orthogonal to the base, and the
    residual. Two kinds of null are used. Where the columns are, within each trial, a constant times
    the response (or a constant), what counts is one number a trial, and those numbers are permuted.
    Otherwise each unit's score is given a random sign, which holds whatever the correlations within
    the unit. ``base[0]`` is the column of the compliance, ``ones`` those of a constant along each
    axis.
    """
    total = grams.sum(axis=0)
    base = list(base)
    left = grams[:, :, -1] - grams[:, :, base] @ coefficients(total, base, rules)
    absorbed = _leverage_products(grams, left, base)
    bounds = np.searchsorted(shuffled.trial, np.arange(shuffled.orders.shape[1]))
    trial_grams, trial_left = (np.add.reduceat(sums, bounds, axis=0) for sums in (grams, left))
    neg_log_p = np.empty((len(groups), shuffled.signs.shape[0]))
    of_trials = np.zeros(len(groups), dtype=bool)
    onto_base = np.linalg.lstsq(total[np.ix_(base, base)], total[base], rcond=1e-10)[0]
    for number, group in enumerate(groups):
        columns = list(group)
        projection = onto_base[:, columns]
        shapes = _shapes_within_trials(trial_grams, ([base[0]], ones), columns, rules)
        of_trials[number] = bool(shapes)
        if not shapes:
            scores, more = (
                part[:, columns] - part[:, base] @ projection for part in (left, absorbed)
            )
            scale = np.sqrt((scores**2).sum(axis=0)) + 1e-300
            scores, more = scores / scale, more / scale
            growth = max(1.0, float(((scores + 0.5 * more) ** 2).sum(axis=0).mean()))
            covariance = scores.T @ scores
            sums = shuffled.signs @ scores
            sums[0] /= np.sqrt(growth)
        else:
            covariance, sums = np.zeros((len(columns), len(columns))), np.zeros(1)
            for shape in shapes:
                information = trial_information(trial_grams, shape)
                deviation = trial_deviation(trial_left[:, shape], information)[:, None]
                beside = trial_grams[:, shape] - trial_grams[:, shape, base] @ onto_base
                # What is the same in all trials has no order: nor has a constant beside the base.
                alike = information[:, None]
                if shape not in base:
                    alike = np.column_stack([alike, beside[:, list(shapes)]])
                alike = alike / deviation
                per_trial = orthogonal(trial_left[:, [shape]] / deviation, alike)[:, 0]
                per_trial = per_trial / (per_trial.std() + 1e-300)
                across = orthogonal(beside[:, columns] / deviation, alike)
                covariance = covariance + across.T @ across
                sums = sums + per_trial[shuffled.orders] @ across
        size = np.sqrt(np.diag(covariance)) + 1e-150
        scaled = covariance / np.outer(size, size) + 1e-6 * np.eye(len(columns))
        sums = sums / size
        quadratic = ((sums @ np.linalg.inv(scaled)) * sums).sum(axis=1)
        neg_log_p[number] = neg_log_p_of(np.maximum(quadratic, 0.0), len(columns), rules)
    same: dict[tuple[str, bool], list[int]] = {}
    for number, whole in enumerate(of_trials):
        name = names[number] if names is not None else str(number)
        same.setdefault((name, bool(whole)), []).append(number)
    p_values = np.empty(len(groups))
    for (_, whole), numbers in same.items():
        highest = neg_log_p[numbers].max(axis=0)
        for number in numbers:
            highest[0] = neg_log_p[number, 0]
            p_values[number] = p_of_shuffles(highest, rules, permuted=whole)
    return p_values, of_trials


def _leverage_products(grams: FloatArray, left: FloatArray, base: Sequence[int]) -> FloatArray:
    """Products (U, P) of the columns with what the fit of ``base`` absorbs of each unit's residual.

    The residual r of a unit with a share H of all that says something of the base has a variance
    lower by 1 − H; r + H r / 2 has the full one, to first order in H. Here the products are with
    H r, without directions of the base that hardly differ but for noise.
    Source: Bell & McCaffrey 2002, Survey Methodology 28: (1 − H)^(−1/2) r.
    """
    total = grams.sum(axis=0)[np.ix_(base, base)]
    size = np.sqrt(np.abs(np.diag(total))) + 1e-150
    inverse = np.linalg.pinv(total / np.outer(size, size), rcond=1e-3, hermitian=True)
    share = left[:, base] @ (inverse / np.outer(size, size))
    return np.asarray((grams[:, :, base] @ share[:, :, None])[:, :, 0])


def _shapes_within_trials(
    grams: FloatArray,
    shapes: Sequence[Sequence[int]],
    columns: Sequence[int],
    rules: SelectionRules,
) -> Sequence[int]:
    """Which of the ``shapes`` (sums of columns) all of ``columns`` are within each trial, if any.

    None where the factor is the same in all trials, as a constant offset's: it has no order that
    could be permuted.
    """
    own = grams[:, columns, columns].sum()
    for shape in shapes:
        information = np.stack([trial_information(grams, one) for one in shape], axis=1)
        products = grams[:, shape][:, :, columns]
        explained = (products**2 / information[:, :, None]).sum()
        if explained > rules.one_number_a_trial_share * own:
            common = (products.sum(axis=0) ** 2 / information.sum(axis=0)[:, None]).sum()
            return shape if common < rules.one_number_a_trial_share * explained else ()
    return ()


def trial_deviation(scores: FloatArray, information: FloatArray) -> FloatArray:
    """Standard deviation (T,) of trials' scores: noise of the samples, and trials that differ.

    The first adds a variance in proportion to the information, the second to its square. What is
    divided by it can be permuted, though trials with more load or samples say more. The second's
    share is the likeliest for normal scores; the scale is left out.
    """
    shares = np.array([0.0, *np.logspace(-2, 3, 11)])[:, None]
    variance = information * (1.0 + shares * information / information.mean())
    scale = (scores**2 / variance).mean(axis=1)
    likelihood = -scores.size * np.log(scale + 1e-290) - np.log(variance).sum(axis=1)
    return np.asarray(np.sqrt(variance[np.argmax(likelihood)]))


def orthogonal(columns: FloatArray, to: FloatArray) -> FloatArray:
    """``columns`` (T, M) less their share along ``to`` (T, K); 0 where nothing else is in one."""
    across = columns - to @ np.linalg.lstsq(to, columns, rcond=1e-10)[0]
    is_more = np.linalg.norm(across, axis=0) > 1e-6 * np.linalg.norm(columns, axis=0)
    return np.asarray(across * is_more)


def trial_information(grams: FloatArray, shape: int) -> FloatArray:
    """Sum of squares of a column in each trial, with a floor for those that hardly have any."""
    own = grams[:, shape, shape]
    return np.maximum(own, 0.01 * max(float(own.mean()), 1e-290))


def neg_log_p_of(quadratic: FloatArray, size: int, rules: SelectionRules) -> FloatArray:
    """−log p (F + 1,) of each of the ``quadratic`` forms of ``size`` scores among the shuffles.

    By rank up to the largest twentieth of the shuffles, beyond by an exponential tail that is
    fitted to that twentieth: −log p of a χ² law is a scale where that is the tail.
    """
    count, null = quadratic.size - 1, quadratic[1:]
    top = max(5, int(rules.shuffle_tail_share * count))
    ranked = np.sort(null)
    least = quadratic * (1.0 - 1e-9)  # equal ones count as reached
    result = np.log(count / np.maximum(count - np.searchsorted(ranked, least), 1))
    far = least > ranked[-top - 1]
    tail = -np.log(np.maximum(gammaincc(0.5 * size, 0.5 * quadratic[far]), 1e-300))
    threshold = -np.log(max(gammaincc(0.5 * size, 0.5 * ranked[-top - 1]), 1e-300))
    excess = float(np.mean(tail[int(far[0]) :])) - threshold + 1e-12 if far[1:].any() else 1.0
    result[far] = np.log(count / top) + (tail - threshold) / excess
    return np.asarray(result)


def p_of_shuffles(neg_log_p: FloatArray, rules: SelectionRules, *, permuted: bool) -> float:
    """Return the p of the first of the ``neg_log_p`` (F + 1,), of which the others are shuffles.

    Where ranks end, the exponential tail of the largest twentieth goes on. Of ``permuted`` trials,
    which have many orders, it goes on only from what no shuffle reaches.
    """
    observed, null = neg_log_p[0], neg_log_p[1:]
    top = max(5, int(rules.shuffle_tail_share * null.size))
    threshold, *tail = np.sort(np.partition(null, -top - 1)[-top - 1 :])
    reached = int((null >= observed - 1e-9).sum())
    by_rank = (1.0 + reached) / (1.0 + null.size)
    excess = float(np.mean(tail)) - float(threshold)
    if observed <= threshold or excess < 1e-9 or (permuted and reached):
        return float(by_rank)
    return float(min(by_rank, top / null.size * np.exp(-(observed - threshold) / excess)))
