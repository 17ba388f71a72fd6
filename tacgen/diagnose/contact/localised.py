"""Effects that act in one part of a log only: a region of the gel, a stretch, or an indenter.

Every condition is one of whole trials, so that sums over trials say what an effect that acts in
any part of them explains, and no sample is touched again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tacgen.contact.effects import Effect, Where, all_effects, find_effect
from tacgen.contact.effects.where import WhereColumn
from tacgen.core.types import BoolArray, FloatArray
from tacgen.diagnose.contact import scores
from tacgen.diagnose.contact.candidates import Candidate, effect_candidates
from tacgen.diagnose.contact.channel import ChannelData
from tacgen.diagnose.contact.model import Fit

BORDERED: tuple[WhereColumn, ...] = ("trial", "x_mm", "y_mm")
EVERYWHERE = Where("trial", above=-1e300)


@dataclass(frozen=True)
class Part:
    """A part of a log: its condition, and which trials (T,) it holds."""

    where: Where
    trials: BoolArray

    @property
    def identifies(self) -> bool:
        """Whether a change of compliance is stated as that of this part, not of the rest.

        It is by the later stretch of the session, and the smaller part of the trials.
        """
        if self.where.is_stretch:
            return not self.where.is_over
        return bool(self.trials.mean() <= 0.5)


def parts_of(data: ChannelData) -> list[Part]:
    """Every part that the log's columns can bound, with enough trials in it and outside of it."""
    history, least = data.history, data.rules.min_trials_of_part
    parts = []
    for column in BORDERED:
        if history.has(column):
            values = history.means_of_trials(column)
            for one, other in pairwise(np.unique(values[np.isfinite(values)])):
                middle = 0.5 * (one + other)
                limit = float(np.floor(middle) if column == "trial" else round(middle, 4))
                above = values > limit
                parts += [Part(Where(column, above=limit), above)]
                parts += [Part(Where(column, up_to=limit), ~above & np.isfinite(values))]
    if history.has("indenter"):
        names = history.text("indenter")[history.starts[:-1]]
        parts += [Part(Where("indenter", equals=str(n)), names == n) for n in np.unique(names) if n]
    if history.has("radius_mm"):
        radius = history.means_of_trials("radius_mm")
        sizes = np.unique(radius[np.isfinite(radius)].round(4))
        edges = [-np.inf, *(0.5 * (sizes[1:] + sizes[:-1])), np.inf]
        for low, high in pairwise(edges) if sizes.size > 1 else ():
            held = (radius > low) & (radius <= high)
            # An indenter's name already identifies them, unless it has none or shares its radius.
            if not any(np.array_equal(held, p.trials) for p in parts if p.where.equals):
                parts.append(Part(Where("radius_mm", float(low), float(high)), held))
    return [p for p in parts if least <= p.trials.sum() <= p.trials.size - least]


def local_effects(data: ChannelData, effects: Sequence[Effect]) -> list[Effect]:
    """Those of the channel's ``effects`` that may act in a part, and those that only can."""
    only = [e for e in all_effects() if e.is_local and e.channel == data.channel]
    return [*(e for e in effects if not e.is_of_trials), *only]


class _Screen:
    """Linear forms of effects beside a fit, each in any part of the log, by sums over trials."""

    def __init__(self, data: ChannelData, fit: Fit, effects: Sequence[Effect]) -> None:
        self._data, self._rules = data, data.rules
        found = effect_candidates(data, fit.model, [e.only(EVERYWHERE) for e in effects])
        self.forms = [one for one in found if one.columns.shape[1] <= self._rules.max_local_columns]
        columns = [one.columns for one in self.forms]
        self._grams, self._groups, self._base = scores.fit_grams(data, fit, columns)
        self._least = min(fit.loss, data.least_loss)
        n_parameters = np.array([one.n_parameters for one in self.forms])
        self._price = self._rules.parameter_price * data.noise_loss * n_parameters

    def losses(self, parts: Sequence[Part], forms: Sequence[int]) -> FloatArray:
        """Sums of squares (P, S) that forms in parts leave on all trials, and their prices."""
        grams, own = self._of(forms)
        inside = np.stack([self._inside(part) for part in parts])
        sums = (inside @ grams.reshape(len(grams), -1)).reshape(-1, *grams.shape[1:])
        totals = np.where(own, sums, grams.sum(axis=0))
        n_base = len(self._base)
        stops = np.cumsum([n_base, *(len(self._groups[form]) for form in forms)])
        sets = [[*range(n_base), *range(i, j)] for i, j in pairwise(stops)]
        left = np.stack([scores.training_losses(one, sets, scores.RIDGE) for one in totals])
        for column, form in enumerate(forms):
            effect = self.forms[form].effect
            if effect is not None and effect.is_local:
                left[[not part.identifies for part in parts], column] = np.inf
        return np.where(left >= self._least, left + self._price[list(forms)], np.inf)

    def _of(self, forms: Sequence[int]) -> tuple[FloatArray, BoolArray]:
        """Gram matrices of the fit's and the forms' columns, and which products are of forms."""
        columns = [*self._base, *(i for form in forms for i in self._groups[form]), -1]
        own = np.arange(len(columns)) >= len(self._base)
        own[-1] = False
        return self._grams[:, columns][:, :, columns], own[:, None] | own

    def _inside(self, part: Part) -> FloatArray:
        return part.trials[self._data.unit_trial].astype(np.float64)


def best_local(
    data: ChannelData, fit: Fit, effects: Sequence[Effect], parts: Sequence[Part], most: float
) -> list[Candidate]:
    """Beside ``fit``, each effect in the part where it explains most; the best effects first.

    Only those that leave less than ``most``. All forms are tried in some parts of every side, the
    best of each effect in all parts of that side.
    """
    screen, rules = _Screen(data, fit, effects), data.rules
    names = [one.name for one in screen.forms]
    sides: dict[tuple[str, bool], list[Part]] = {}
    for part in parts:
        sides.setdefault((part.where.column, part.where.up_to < np.inf), []).append(part)
    coarse = [p for side in sides.values() for p in side[:: -(-len(side) // rules.parts_of_side)]]
    rough = screen.losses(coarse, range(len(names)))
    found: list[tuple[float, int, Where]] = []
    tried: list[str] = []
    for form in map(int, np.argsort(rough.min(axis=0))):
        if tried.count(names[form]) < rules.local_forms_tried:
            tried.append(names[form])
            where = coarse[int(np.argmin(rough[:, form]))].where
            side = sides[where.column, where.up_to < np.inf]
            losses = screen.losses(side, [form])[:, 0]
            best_part = int(np.argmin(losses))
            found.append((float(losses[best_part]), form, side[best_part].where))
    best: dict[str, list[Candidate]] = {}
    for loss, form, where in sorted(found, key=lambda one: one[:2]):
        same = best.setdefault(names[form], [])
        # Where amounts do not act linearly, how a form does here says little.
        if loss < most and not any(one.variant and one.variant.scales for one in same):
            (effect,) = (effect for effect in effects if effect.name == names[form])
            label = screen.forms[form].label.replace(str(EVERYWHERE), str(where))
            local = effect_candidates(data, fit.model, [effect.only(where)])
            same += [one for one in local if one.label == label]
    return [one for same in list(best.values())[: rules.local_effects_fitted] for one in same]


def local_p_value(
    data: ChannelData,
    rest: Fit,
    effect: Effect,
    label: str,
    parts: Sequence[Part],
    signs: FloatArray,
) -> float:
    """The p of a local ``effect``, in its form ``label``, differing in its part, beside ``rest``.

    The form's columns count in the proportion that they have in the part. The highest contrast
    between any part and the others, beside the same acting everywhere, is compared with the
    highest when signs of trials are flipped (F + 1, T); p is multiplied by the columns that were
    weighed.
    """
    everywhere = find_effect(effect.channel, effect.name).only(EVERYWHERE)
    inside, whole = (
        next(c.columns for c in effect_candidates(data, rest.model, [one]) if c.label == name)
        for one, name in (
            (effect, label),
            (everywhere, label.replace(str(effect.where), str(EVERYWHERE))),
        )
    )
    grams, (group,), base = scores.fit_grams(data, rest, [inside])
    weights = scores.coefficients(grams.sum(axis=0), [*base, *group], scores.RIDGE)[len(base) :]
    grams, ((column,),), base = scores.fit_grams(data, rest, [whole @ weights[:, None]])
    total, every = grams.sum(axis=0), [*base, column]
    fitted = np.linalg.lstsq(total[np.ix_(every, every)], total[every, -1], rcond=1e-10)[0]
    score = grams[:, column, -1] - grams[:, column][:, every] @ fitted
    information = scores.floored(grams[:, column, column])
    precision = np.sqrt(scores.score_weights(score, information) / information)
    own = information * precision
    own /= np.linalg.norm(own)
    held = np.stack([part.trials for part in parts], axis=1)[data.unit_trial]
    across = held * own[:, None] - np.outer(own, own**2 @ held)
    across /= np.linalg.norm(across, axis=0) + 1e-150
    score = score * precision
    score -= own * (own @ score)
    highest = ((signs @ (score[:, None] * across)) ** 2).max(axis=1)
    return min(len(weights) * scores.ranked({0: highest})[0], 1.0)
