"""Cross-validation and sign-flip tests of linearised candidates, from sums over units alone.

Everything here works on Gram matrices (U, P, P) of a design's columns, one for each unit (a
trial), whose last column is the residual: no sample is touched again, so that hundreds of
candidates and pairs cost milliseconds. The products are of neighbouring rows (`channel`), so that
a loss is the remaining structure, without the noise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc

from tacgen.core.arrays import BoolArray, FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.model import Fit
from tacgen.diagnose.contact.rules import SelectionRules

RIDGE = 1e-8  # of the diagonal: enough to solve with columns that are equal but for noise
TAIL_SHARE = 0.05  # of the shuffles, the largest: an exponential tail is fitted to them
_OWN_SHARES = np.array([0.0, *np.logspace(-2, 3, 11)])
"""Variance of trials' own effects, in parts of the samples' noise at the mean information."""


def unit_grams(data: ChannelData, columns: FloatArray, *, of_neighbours: bool = True) -> FloatArray:
    """Sums over each unit of products of ``columns`` (R, P) of neighbouring rows: (U, P, P).

    Symmetrised; in the mean free of noise, and so not positive definite where a column is noise.
    Otherwise of products within each row. Both are half of a sum over all rows.
    """
    size = columns.shape[1]
    step = data.n_outputs
    bounds = np.searchsorted(data.pair_unit, np.arange(data.n_units + 1))
    grams = np.empty((data.n_units, size, size))
    for gram, (i, j) in zip(grams, pairwise(bounds), strict=True):
        start, stop = step * data.first[i], step * (data.first[j - 1] + 1)
        a, b = columns[start:stop], columns[start + step : stop + step]
        if of_neighbours:
            products = a.T @ b
            gram[:] = 0.25 * (products + products.T)
        else:
            gram[:] = 0.25 * (a.T @ a + b.T @ b)
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
    ridge: float,
    training: FloatArray | None = None,
) -> FloatArray:
    """Held-out sum of squares of every unit, for every set of columns: (S, U).

    ``sets`` hold column numbers; the last column is the target. Coefficients are fitted to
    ``training`` (≥ U, P, P), whose first U are the units, by default to ``grams`` too; ``ridge``
    of the diagonal holds them near 0. A set of columns that are all but the same can overflow;
    ``believable`` refuses it.
    """
    losses = np.empty((len(sets), grams.shape[0]))
    training = grams if training is None else training
    total = training.sum(axis=0)
    for rows, index in _of_one_length(sets):
        for fold in range(int(folds.max()) + 1):
            out = np.flatnonzero(folds == fold)
            held = grams[out]
            weights = _solve(total - training[out].sum(axis=0), index, ridge)
            block = held[:, index[:, :, None], index[:, None, :]]
            with np.errstate(over="ignore", invalid="ignore"):
                onto = (block @ weights[None, :, :, None])[..., 0]
                change = ((onto - 2.0 * held[:, index, -1]) * weights).sum(axis=-1)
            losses[np.ix_(rows, out)] = held[:, -1, -1] + change.T
    return losses


def training_losses(total: FloatArray, sets: Sequence[Sequence[int]], ridge: float) -> FloatArray:
    """Sum of squares left by each set of columns on all units: (S,)."""
    losses = np.empty(len(sets))
    for rows, index in _of_one_length(sets):
        weights = _solve(total, index, ridge)
        losses[rows] = total[-1, -1] - np.einsum("si,si->s", weights, total[index, -1])
    return losses


def _of_one_length(
    sets: Sequence[Sequence[int]],
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Numbers of the sets of each length, and these sets as one array."""
    for size in {len(one) for one in sets}:
        rows = np.array([i for i, one in enumerate(sets) if len(one) == size], dtype=np.int64)
        yield rows, np.asarray([sets[i] for i in rows], dtype=np.int64)


def believable(losses: FloatArray, without: FloatArray, least: float) -> FloatArray:
    """``losses`` (S, U) of units; a set whose sum cannot be takes the losses ``without`` (U,) it.

    Products of neighbouring rows are not positive definite, so that columns that are nearly the
    same, or that have a memory of the force's noise, can seem to leave less than chance could:
    than ``least``, or than ``without`` them.
    """
    with np.errstate(invalid="ignore"):
        impossible: BoolArray = ~(losses.sum(axis=1) >= min(float(without.sum()), least))
    result: FloatArray = np.where(impossible[:, None], without, losses)
    return result


def coefficients(total: FloatArray, columns: Sequence[int], ridge: float) -> FloatArray:
    """Least-squares coefficients of ``columns`` for the target."""
    return np.asarray(_solve(total, np.asarray([columns], dtype=np.int64), ridge)[0])


def _solve(gram: FloatArray, index: NDArray[np.int64], ridge: float) -> FloatArray:
    """Coefficients (S, P) by the normal equations."""
    block = gram[index[:, :, None], index[:, None, :]]
    own = np.abs(np.diagonal(block, axis1=1, axis2=2))
    size = np.sqrt(np.maximum(own, 1e-12 * own.max(axis=1, keepdims=True)) + 1e-290)
    scaled = block / (size[:, :, None] * size[:, None, :])
    scaled = scaled + ridge * np.eye(index.shape[1])
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


@dataclass(frozen=True)
class PValues:
    """The p of every group of columns, each (groups,), before any correction for the choice.

    ``flipped`` is by signs of units, ``permuted`` by the order of the trials. Groups that are
    ``of_trials`` have one value a trial, and only the second test; the others only the first,
    unless they ``have_both``.
    """

    flipped: FloatArray
    permuted: FloatArray
    of_trials: BoolArray
    have_both: bool

    def corrected(self, n_flipped: int, n_permuted: int) -> FloatArray:
        """The p (groups,) for a choice from so many, by each test, and for that between the two."""
        flipped, permuted = self.flipped * n_flipped, self.permuted * n_permuted
        others = 2.0 * np.minimum(flipped, permuted) if self.have_both else flipped
        return np.asarray(np.minimum(np.where(self.of_trials, permuted, others), 1.0))


def shuffle_p_values(
    grams: FloatArray,
    base: Sequence[int],
    groups: Sequence[Sequence[int]],
    shuffled: Shuffles,
    ones: Sequence[int],
    rules: SelectionRules,
    names: Sequence[str] | None = None,
    *,
    parts_of_trials: bool = False,
) -> PValues:
    """The p of the score of every group of columns by its own shuffles.

    Of groups with the same of ``names``, each p is the chance that any of them scores as high.

    The score of a unit is the product of the group's columns, made orthogonal to the base, and the
    residual. Two kinds of null are used. Where the columns are, within each trial, a constant times
    the response (or a constant), what counts is one number a trial, and those numbers are permuted.
    Otherwise each unit's score is given a random sign, which holds whatever the correlations within
    the unit. Where units are ``parts_of_trials``, whose gains may differ, the signs are of what is
    left beside a gain for each trial, and the gains are permuted too. ``base[0]`` is the column of
    the compliance, ``ones`` those of a constant along each axis.
    """
    test = _Test(grams, base, shuffled, rules)
    within = test
    if parts_of_trials:
        grams = without_gains(grams, base[0], shuffled.trial, rules)
        within = _Test(grams, base, shuffled, rules)
    shapes = [test.shapes(group, ([base[0]], ones)) for group in groups]
    gains = [shape or ([base[0]] if parts_of_trials else ()) for shape in shapes]
    flips = {i: within.flipped(groups[i]) for i, shape in enumerate(shapes) if not shape}
    orders = {i: test.permuted(groups[i], gain) for i, gain in enumerate(gains) if gain}
    kinds = [(names[i] if names else i, bool(shape)) for i, shape in enumerate(shapes)]
    return PValues(
        _p_of_each(flips, kinds, rules, permuted=False),
        _p_of_each(orders, kinds, rules, permuted=True),
        np.array([bool(shape) for shape in shapes]),
        parts_of_trials,
    )


def _p_of_each(
    neg_log_p: Mapping[int, FloatArray],
    kinds: Sequence[tuple[str | int, bool]],
    rules: SelectionRules,
    *,
    permuted: bool,
) -> FloatArray:
    """The p of each of a list, by number; of one kind, that any scores as high. 1 of the others."""
    p_values = np.ones(len(kinds))
    for kind in set(kinds):
        same = [number for number in neg_log_p if kinds[number] == kind]
        if same:
            highest = np.max([neg_log_p[number] for number in same], axis=0)
        for number in same:
            highest[0] = neg_log_p[number][0]
            p_values[number] = p_of_shuffles(highest, rules, permuted=permuted)
    return p_values


def without_gains(
    grams: FloatArray, response: int, trial: NDArray[np.int64], rules: SelectionRules
) -> FloatArray:
    """``grams`` (U, P, P) of columns less, in each ``trial`` (U,), their share of the response.

    Nothing is left of a column that is hardly more than that: what it would fit is decided by
    the trials' gains.
    """
    starts = np.searchsorted(trial, np.arange(int(trial[-1]) + 1))
    whole = np.add.reduceat(grams, starts, axis=0)
    gains = (whole[:, response] / trial_information(whole, response)[:, None])[trial]
    cross = gains[:, :, None] * grams[:, response][:, None, :]
    both = gains[:, :, None] * gains[:, None, :] * grams[:, response, response][:, None, None]
    left = grams - cross - np.swapaxes(cross, 1, 2) + both
    own, own_left = (np.diag(one.sum(axis=0)) for one in (grams, left))
    gone = own_left[:-1] <= (1.0 - rules.one_number_a_trial_share) * own[:-1]
    left[:, :-1][:, gone] = left[:, :, :-1][:, :, gone] = 0.0
    return left


class _Test:
    """Scores of columns beside a base, and the −log p (F + 1,) of each shuffle of them."""

    def __init__(
        self,
        grams: FloatArray,
        base: Sequence[int],
        shuffled: Shuffles,
        rules: SelectionRules,
    ) -> None:
        self._grams, self._base, self._shuffled, self._rules = grams, list(base), shuffled, rules
        total = grams.sum(axis=0)
        self._with_base = grams[:, self._base]
        weights = coefficients(total, base, RIDGE)
        self._left = grams[:, :, -1] - grams[:, :, self._base] @ weights
        self._of_base = total[np.ix_(self._base, self._base)]
        self._inverse = _inverse_without_noise(self._of_base)
        share = self._left[:, self._base] @ self._inverse
        self._absorbed = (self._with_base * share[:, :, None]).sum(axis=1)
        self._onto_base = np.linalg.lstsq(self._of_base, total[self._base], rcond=1e-10)[0]
        bounds = np.searchsorted(shuffled.trial, np.arange(shuffled.orders.shape[1]))
        self._trial_grams = np.add.reduceat(grams, bounds, axis=0)
        self._trial_left = np.add.reduceat(self._left, bounds, axis=0)
        self._known: dict[tuple[int, tuple[int, ...]], tuple[FloatArray, FloatArray, FloatArray]]
        self._known = {}

    def shapes(self, columns: Sequence[int], among: Sequence[Sequence[int]]) -> Sequence[int]:
        """Which of the shapes ``among`` (numbers of columns) the columns are in each trial."""
        return _shapes_within_trials(self._trial_grams, among, list(columns), self._rules)

    def flipped(self, columns: Sequence[int]) -> FloatArray:
        """By a sign for each unit: the larger −log p of scores as they are and weighted.

        The weights (`score_weights`) do not depend on signs. Where effects differ from unit to
        unit, or are far above the noise, no unit outweighs the others.
        """
        base, columns = self._base, list(columns)
        onto = self._onto_base[:, columns]
        beside = self._with_base[:, :, columns] - self._with_base[:, :, base] @ onto
        own = np.stack([self._grams[:, one, one] for one in columns], axis=1)
        own = own - (onto * (self._with_base[:, :, columns] + beside)).sum(axis=1)
        parts = self._left, self._absorbed
        plain = [part[:, columns] - part[:, base] @ onto for part in parts]
        weights = np.stack(
            [score_weights(*one) for one in zip(plain[0].T, own.T, strict=True)], axis=1
        )
        again = np.linalg.lstsq(
            self._of_base, (weights[:, None] * beside).sum(axis=0), rcond=1e-10
        )[0]
        weighted = [
            weights * score - part[:, base] @ again
            for score, part in zip(plain, parts, strict=True)
        ]
        return np.maximum(self._of_signs(*plain), self._of_signs(*weighted))

    def _of_signs(self, scores: FloatArray, absorbed: FloatArray) -> FloatArray:
        """The −log p of scores (U, M), of which the fit of the base ``absorbed`` a part (U, M).

        The residual r of a unit with a share H of all that says something of the base has a
        variance lower by 1 − H; r + H r / 2 has the full one, to first order in H.
        Source: Bell & McCaffrey 2002, Survey Methodology 28: (1 − H)^(−1/2) r.
        """
        scale = np.sqrt((scores**2).sum(axis=0)) + 1e-300
        scores, absorbed = scores / scale, absorbed / scale
        growth = max(1.0, float(((scores + 0.5 * absorbed) ** 2).sum(axis=0).mean()))
        sums = self._shuffled.signs @ scores
        sums[0] /= np.sqrt(growth)
        return self._neg_log_p(sums, scores.T @ scores)

    def permuted(self, columns: Sequence[int], shapes: Sequence[int]) -> FloatArray:
        """By the order of the trials' numbers: how much of each of ``shapes`` is in them."""
        covariance, sums = np.zeros((len(columns), len(columns))), np.zeros(1)
        for shape in shapes:
            shuffles, alike, deviation = self._shuffles(shape, tuple(shapes))
            across = orthogonal(self._beside(shape)[:, list(columns)] / deviation, alike)
            covariance = covariance + across.T @ across
            sums = sums + shuffles @ across
        return self._neg_log_p(sums, covariance)

    def _beside(self, shape: int) -> FloatArray:
        grams = self._trial_grams
        return np.asarray(grams[:, shape] - grams[:, shape, self._base] @ self._onto_base)

    def _shuffles(
        self, shape: int, shapes: tuple[int, ...]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Shuffles (F + 1, T) of the numbers of ``shape``, what all trials share, their deviation.

        What the base, fitted to a shuffle, takes from it is taken from it.
        Source: Freedman & Lane 1983, J. Business & Economic Statistics 1: residuals permuted.
        """
        if (shape, shapes) not in self._known:
            grams, numbers = self._trial_grams, self._trial_left[:, shape]
            information = trial_information(grams, shape)
            deviation = score_deviation(numbers, information)[:, None]
            # What is the same in all trials has no order: nor has a constant beside the base.
            alike = information[:, None] / deviation
            if shape not in self._base:
                alike = np.column_stack([alike, self._beside(shape)[:, shapes] / deviation])
            shuffles = (numbers / deviation[:, 0])[self._shuffled.orders]
            with_base = grams[:, shape, self._base]
            gains = shuffles * (deviation[:, 0] / information)
            shuffles -= gains @ with_base @ self._inverse @ (with_base / deviation).T
            shuffles /= _size_beside(shuffles, alike)[:, None]
            self._known[shape, shapes] = shuffles, alike, deviation
        return self._known[shape, shapes]

    def _neg_log_p(self, sums: FloatArray, covariance: FloatArray) -> FloatArray:
        size = np.sqrt(np.diag(covariance)) + 1e-150
        scaled = covariance / np.outer(size, size) + 1e-6 * np.eye(size.size)
        sums = sums / size
        quadratic = ((sums @ np.linalg.inv(scaled)) * sums).sum(axis=1)
        return neg_log_p_of(np.maximum(quadratic, 0.0), size.size, self._rules)


def _size_beside(rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Root mean square (F,) of ``rows`` (F, T) less their share along ``columns`` (T, K)."""
    size = np.linalg.norm(columns, axis=0)
    u, singular, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    basis = u[:, singular > 1e-6 * singular[0]]
    square, own = (rows**2).sum(axis=1), ((rows @ basis) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(square - own, 1e-12 * square) / rows.shape[1]) + 1e-300)


def _inverse_without_noise(gram: FloatArray) -> FloatArray:
    """Inverse (P, P) without directions of the columns that hardly differ but for noise."""
    size = np.sqrt(np.abs(np.diag(gram))) + 1e-150
    scale = np.outer(size, size)
    return np.asarray(np.linalg.pinv(gram / scale, rcond=1e-3, hermitian=True) / scale)


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


def score_deviation(scores: FloatArray, information: FloatArray) -> FloatArray:
    """Standard deviation (T,) of trials' or units' scores: noise of the samples, and their own.

    The first adds a variance in proportion to the information, the second to its square. What is
    divided by it can be permuted, though trials with more load or samples say more. The second's
    share is the likeliest for normal scores; the scale is left out.
    """
    variance = information * (1.0 + _OWN_SHARES[:, None] * information / information.mean())
    scale = (scores**2 / variance).mean(axis=1)
    likelihood = -scores.size * np.log(scale + 1e-290) - np.log(variance).sum(axis=1)
    return np.asarray(np.sqrt(variance[np.argmax(likelihood)]))


def score_weights(scores: FloatArray, information: FloatArray) -> FloatArray:
    """Information over variance (T,), by which scores with a part of their own are weighted."""
    information = _floored(information)
    return np.asarray(information / score_deviation(scores, information) ** 2)


def orthogonal(columns: FloatArray, to: FloatArray) -> FloatArray:
    """``columns`` (T, M) less their share along ``to`` (T, K); 0 where nothing else is in one."""
    across = columns - to @ np.linalg.lstsq(to, columns, rcond=1e-10)[0]
    is_more = np.linalg.norm(across, axis=0) > 1e-6 * np.linalg.norm(columns, axis=0)
    return np.asarray(across * is_more)


def trial_information(grams: FloatArray, shape: int) -> FloatArray:
    """Sum of squares of a column in each trial, with a floor for those that hardly have any."""
    return _floored(grams[:, shape, shape])


def _floored(information: FloatArray) -> FloatArray:
    """``information`` (T,), at least a hundredth of its mean; where that is noise, its size."""
    mean, size = float(information.mean()), float(np.abs(information).mean())
    return np.maximum(information, 0.01 * mean if mean > 0.0 else max(size, 1e-290))


def neg_log_p_of(quadratic: FloatArray, size: int, rules: SelectionRules) -> FloatArray:
    """−log p (F + 1,) of each of the ``quadratic`` forms of ``size`` scores among the shuffles.

    By rank up to the largest twentieth of the shuffles, beyond by an exponential tail that is
    fitted to that twentieth: −log p of a χ² law is a scale where that is the tail.
    """
    count, null = quadratic.size - 1, quadratic[1:]
    top = max(5, int(TAIL_SHARE * count))
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
    top = max(5, int(TAIL_SHARE * null.size))
    threshold, *tail = np.sort(np.partition(null, -top - 1)[-top - 1 :])
    reached = int((null >= observed - 1e-9).sum())
    by_rank = (1.0 + reached) / (1.0 + null.size)
    excess = float(np.mean(tail)) - float(threshold)
    if observed <= threshold or excess < 1e-9 or (permuted and reached):
        return float(by_rank)
    return float(min(by_rank, top / null.size * np.exp(-(observed - threshold) / excess)))
