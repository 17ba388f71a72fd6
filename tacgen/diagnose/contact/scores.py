"""Cross-validation and the sign-flip test of linearised candidates, from sums over units alone.

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

from tacgen.core.types import BoolArray, FloatArray
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.model import Fit

RIDGE = 1e-8  # of the diagonal: enough to solve with columns that are equal but for noise
TAIL_SHARE = 0.05  # of the shuffles, the largest: an exponential tail is fitted to them
ONE_NUMBER_SHARE = 0.97  # of a column that follows the response in every trial: permuted
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

    ``trial`` (U,) is the trial of each unit, ``first_row`` (U,) where in it the unit begins.
    """

    signs: FloatArray
    orders: NDArray[np.int64]
    trial: NDArray[np.int64]
    first_row: NDArray[np.int64]

    def of_blocks(self, n_rows: float) -> "Shuffles":
        """The same, but with one sign for units of a trial that begin in the same ``n_rows``."""
        if n_rows <= 0:
            return self
        place = np.column_stack([self.trial, self.first_row // n_rows])
        _, first, block = np.unique(place, axis=0, return_index=True, return_inverse=True)
        return replace(self, signs=self.signs[:, first[block.ravel()]])


def shuffles(
    trial: NDArray[np.int64],
    count: int,
    rng: np.random.Generator,
    rows: NDArray[np.int64] | None = None,
) -> Shuffles:
    """``count`` random sign flips of units, of ascending trials (U,), and orders of trials.

    ``rows`` (U,) is how many rows each unit has, one if it is not given.
    """
    trial = np.unique(trial, return_inverse=True)[1]  # without those of one row, which have no unit
    n_trials = int(trial[-1]) + 1
    orders = rng.permuted(np.tile(np.arange(n_trials), (count + 1, 1)), axis=1)
    orders[0] = np.arange(n_trials)
    rows = np.ones(trial.size, dtype=np.int64) if rows is None else rows
    begins = np.cumsum(rows) - rows
    first_row = begins - begins[np.searchsorted(trial, trial)]
    return Shuffles(sign_flips(trial.size, count, rng), orders, trial, first_row)


def sign_flips(size: int, count: int, rng: np.random.Generator) -> FloatArray:
    """Random signs (count + 1, size), none flipped in the first row."""
    signs = rng.choice([-1.0, 1.0], size=(count + 1, size))
    signs[0] = 1.0
    return signs


def p_values(
    grams: FloatArray,
    base: Sequence[int],
    groups: Sequence[Sequence[int]],
    shuffled: Shuffles,
    ones: Sequence[int],
    *,
    parts_of_trials: bool = False,
) -> FloatArray:
    """The chance (groups,) that any group of columns, shuffled, scores as high as each does.

    The score of a unit is the product of the group's columns, made orthogonal to the base, and the
    residual. Where the columns are, within each trial, a constant times the response (or a
    constant), what counts is one number a trial, and those numbers are permuted. Otherwise each
    unit's score is given a random sign, which holds whatever the correlations within the unit.
    Where units are ``parts_of_trials``, whose gains may differ, the signs are of what is left
    beside a gain for each trial. ``base[0]`` is the column of the
    compliance, ``ones`` those of a constant along each axis.
    Source: Westfall & Young 1993, Resampling-Based Multiple Testing: the highest of all scores.
    """
    test = within = _Test(grams, base, shuffled)
    if parts_of_trials:
        within = _Test(without_gains(grams, base[0], shuffled.trial), base, shuffled)
    flips, orders = dict[int, FloatArray](), dict[int, FloatArray]()
    for number, group in enumerate(groups):
        if shape := test.shape(group, ([base[0]], ones)):
            orders[number] = test.permuted(group, shape)
        else:
            flips[number] = within.flipped(group)
    found = ranked(flips) | ranked(orders)
    return np.array([found[number] for number in range(len(groups))])


def ranked(neg_log_p: Mapping[int, FloatArray]) -> dict[int, float]:
    """The p of the first of each (F + 1,), by number, among the highest of all under a shuffle."""
    highest = np.max([*neg_log_p.values()], axis=0)[1:] if neg_log_p else np.zeros(0)
    return {
        number: float((1.0 + (highest >= one[0] * (1.0 - 1e-9) - 1e-9).sum()) / one.size)
        for number, one in neg_log_p.items()
    }


def without_gains(grams: FloatArray, response: int, trial: NDArray[np.int64]) -> FloatArray:
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
    gone = own_left[:-1] <= (1.0 - ONE_NUMBER_SHARE) * own[:-1]
    left[:, :-1][:, gone] = left[:, :, :-1][:, :, gone] = 0.0
    return left


class _Test:
    """Scores of columns beside a base, and the −log p (F + 1,) of each shuffle of them."""

    def __init__(self, grams: FloatArray, base: Sequence[int], shuffled: Shuffles) -> None:
        self._grams, self._base, self._shuffled = grams, list(base), shuffled
        total = grams.sum(axis=0)
        self._with_base = grams[:, self._base]
        self._left = grams[:, :, -1] - grams[:, :, self._base] @ coefficients(total, base, RIDGE)
        self._of_base = total[np.ix_(self._base, self._base)]
        self._inverse = _inverse_without_noise(self._of_base)
        share = self._left[:, self._base] @ self._inverse
        self._absorbed = (self._with_base * share[:, :, None]).sum(axis=1)
        self._onto_base = np.linalg.lstsq(self._of_base, total[self._base], rcond=1e-10)[0]
        bounds = np.searchsorted(shuffled.trial, np.arange(shuffled.orders.shape[1]))
        self._trial_grams = np.add.reduceat(grams, bounds, axis=0)
        self._trial_left = np.add.reduceat(self._left, bounds, axis=0)
        self._known = dict[tuple[int, int], tuple[FloatArray, FloatArray, FloatArray]]()

    def flipped(self, group: Sequence[int]) -> FloatArray:
        """By a sign for each unit, the scores weighted.

        The weights are such that no unit outweighs the others where effects differ from unit to
        unit, or are far above the noise; they do not depend on signs. The residual r of a unit with
        a share H of all that says something of the base has a variance lower by 1 − H; r + H r / 2
        has the full one, to first order in H.
        Source: Bell & McCaffrey 2002, Survey Methodology 28: (1 − H)^(−1/2) r.
        """
        base, columns = self._base, list(group)
        onto = self._onto_base[:, columns]
        beside = self._with_base[:, :, columns] - self._with_base[:, :, base] @ onto
        own = np.stack([self._grams[:, one, one] for one in columns], axis=1)
        own = own - (onto * (self._with_base[:, :, columns] + beside)).sum(axis=1)
        plain = [part[:, columns] - part[:, base] @ onto for part in (self._left, self._absorbed)]
        both = zip(plain[0].T, own.T, strict=True)
        weights = np.stack([score_weights(*one) for one in both], axis=1)
        again = np.linalg.lstsq(self._of_base, (weights[:, None] * beside).sum(axis=0), rcond=1e-10)
        scores = weights * plain[0] - self._left[:, base] @ again[0]
        absorbed = weights * plain[1] - self._absorbed[:, base] @ again[0]
        size = np.sqrt((scores**2).sum(axis=0)) + 1e-300
        scores, absorbed = scores / size, absorbed / size
        growth = max(1.0, float(((scores + 0.5 * absorbed) ** 2).sum(axis=0).mean()))
        sums = self._shuffled.signs @ scores
        sums[0] /= np.sqrt(growth)
        return neg_log_p_of(sums, scores.T @ scores)

    def permuted(self, group: Sequence[int], shapes: Sequence[int]) -> FloatArray:
        """By the order of the trials' numbers: how much of each of ``shapes`` is in them."""
        covariance, sums = np.zeros((len(group), len(group))), np.zeros(1)
        for shape in shapes:
            shuffles, alike, deviation = self._shuffles(shape, shapes)
            across = orthogonal(self._beside(shape)[:, list(group)] / deviation, alike)
            covariance = covariance + across.T @ across
            sums = sums + shuffles @ across
        return neg_log_p_of(sums, covariance)

    def shape(self, group: Sequence[int], among: Sequence[Sequence[int]]) -> Sequence[int]:
        """Which of ``among`` (numbers of columns) the group is within each trial, if any.

        None where the factor is the same in all trials, as a constant offset's: it has no order
        that could be permuted.
        """
        grams, columns = self._trial_grams, list(group)
        own = grams[:, columns, columns].sum()
        for shape in among:
            information = np.stack([trial_information(grams, one) for one in shape], axis=1)
            products = grams[:, list(shape)][:, :, columns]
            explained = (products**2 / information[:, :, None]).sum()
            if explained > ONE_NUMBER_SHARE * own:
                common = (products.sum(axis=0) ** 2 / information.sum(axis=0)[:, None]).sum()
                return shape if common < ONE_NUMBER_SHARE * explained else ()
        return ()

    def _beside(self, shape: int) -> FloatArray:
        grams = self._trial_grams
        return np.asarray(grams[:, shape] - grams[:, shape, self._base] @ self._onto_base)

    def _shuffles(
        self, shape: int, shapes: Sequence[int]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Shuffles (F + 1, T) of the numbers of ``shape``, what all trials share, their deviation.

        What the base, fitted to a shuffle, takes from it is taken from it.
        Source: Freedman & Lane 1983, J. Business & Economic Statistics 1: residuals permuted.
        """
        key = shape, len(shapes)
        if key not in self._known:
            grams, numbers = self._trial_grams, self._trial_left[:, shape]
            information = trial_information(grams, shape)
            deviation = score_deviation(numbers, information)[:, None]
            # What is the same in all trials has no order: nor has a constant beside the base.
            alike = information[:, None] / deviation
            if shape not in self._base:
                alike = np.column_stack([alike, self._beside(shape)[:, list(shapes)] / deviation])
            shuffles = (numbers / deviation[:, 0])[self._shuffled.orders]
            with_base = grams[:, shape, self._base]
            gains = shuffles * (deviation[:, 0] / information)
            shuffles -= gains @ with_base @ self._inverse @ (with_base / deviation).T
            size = np.linalg.norm(orthogonal(shuffles.T, alike), axis=0)
            least = 1e-6 * np.linalg.norm(shuffles, axis=1) + 1e-300
            shuffles *= np.sqrt(shuffles.shape[1]) / np.maximum(size, least)[:, None]
            self._known[key] = shuffles, alike, deviation
        return self._known[key]


def _inverse_without_noise(gram: FloatArray) -> FloatArray:
    """Inverse (P, P) without directions of the columns that hardly differ but for noise."""
    size = np.sqrt(np.abs(np.diag(gram))) + 1e-150
    scale = np.outer(size, size)
    return np.asarray(np.linalg.pinv(gram / scale, rcond=1e-3, hermitian=True) / scale)


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
    information = floored(information)
    return np.asarray(information / score_deviation(scores, information) ** 2)


def orthogonal(columns: FloatArray, to: FloatArray) -> FloatArray:
    """``columns`` (T, M) less their share along ``to`` (T, K); 0 where nothing else is in one."""
    across = columns - to @ np.linalg.lstsq(to, columns, rcond=1e-10)[0]
    is_more = np.linalg.norm(across, axis=0) > 1e-6 * np.linalg.norm(columns, axis=0)
    return np.asarray(across * is_more)


def trial_information(grams: FloatArray, shape: int) -> FloatArray:
    """Sum of squares of a column in each trial, with a floor for those that hardly have any."""
    return floored(grams[:, shape, shape])


def floored(information: FloatArray) -> FloatArray:
    """``information`` (T,), at least a hundredth of its mean; where that is noise, its size."""
    mean, size = float(information.mean()), float(np.abs(information).mean())
    return np.maximum(information, 0.01 * mean if mean > 0.0 else max(size, 1e-290))


def neg_log_p_of(sums: FloatArray, covariance: FloatArray) -> FloatArray:
    """−log p (F + 1,) among the shuffles of sums (F + 1, M) of scores with that covariance (M, M).

    Of their quadratic form: by rank up to the largest twentieth of the shuffles, beyond by an
    exponential tail, as a χ² law has it, that is fitted to that twentieth.
    """
    size = np.sqrt(np.diag(covariance)) + 1e-150
    inverse = np.linalg.inv(covariance / np.outer(size, size) + 1e-6 * np.eye(size.size))
    quadratic = ((sums / size @ inverse) * (sums / size)).sum(axis=1)
    null, count = np.sort(quadratic[1:]), quadratic.size - 1
    top = max(5, int(TAIL_SHARE * count))
    reached = count - np.searchsorted(null, quadratic * (1.0 - 1e-9))  # equal ones count as reached
    threshold = null[-top - 1]
    excess = max(float(null[-top:].mean()) - threshold, 1e-9)
    beyond = np.log(count / top) + (quadratic - threshold) / excess
    by_rank = np.log(count / np.maximum(reached, 1))
    return np.asarray(np.where(quadratic > threshold, beyond, by_rank))
