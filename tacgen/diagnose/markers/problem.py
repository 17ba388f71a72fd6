"""The field of marker motion: friction as a problem of the one search, and the grid of the dots.

The base is a field that sticks everywhere, of dots that lie where the sensor's file has them. It
lacks ``partial_slip`` (the contact's rim slips), ``friction_place`` (a place with other friction),
``grid_turned`` or ``grid_shifted`` where that explains a share of the squared error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from tacgen.calibrate.contact.marker_fit import PLACE_NAMES, FieldData, Slip, fit_slip
from tacgen.contact.ball_shear import Place
from tacgen.contact.shear import turned
from tacgen.core.types import FloatArray
from tacgen.diagnose.engine import Problem
from tacgen.diagnose.rules import MarkerRules
from tacgen.presses.marker_tracks import AT_REST, MarkerTracks, rigid_fit

PARTIAL_SLIP, PLACE, TURNED, SHIFTED = (
    "partial_slip",
    "friction_place",
    "grid_turned",
    "grid_shifted",
)


@dataclass(frozen=True, slots=True)
class FieldSet:
    """Names of effects with the field that they are fitted in, and its squared error, mm²."""

    members: tuple[str, ...]
    grip: Slip
    loss: float


class FrictionProblem(Problem[str, FieldSet]):
    """Slip of the contact's rim, and a place with other friction, beside a field that sticks."""

    rules: MarkerRules

    def __init__(self, data: FieldData, which: Sequence[int], rules: MarkerRules) -> None:
        self.data, self.which, self.rules = data, which, rules
        self._grips: dict[frozenset[str], Slip] = {}

    def fitted(self, names: Sequence[str]) -> FieldSet:
        """The effects of these names, fitted once; beside slip a place may come out better."""
        key = frozenset(names)
        if key not in self._grips:
            self._grips[key] = self._fit(key)
        grip = self._grips[key]
        return FieldSet(tuple(names), grip, self._loss(grip))

    def add(self, current: FieldSet, more: Sequence[str]) -> FieldSet:
        """The effects of both, fitted."""
        return self.fitted([*current.members, *more])

    def without(self, full: FieldSet, member: str) -> FieldSet:
        """The others, fitted."""
        return self.fitted([name for name in full.members if name != member])

    def least_gain(self, current: FieldSet) -> float:
        """A share of the squared error, noise included."""
        return self.rules.min_gain * current.loss

    def accepts(self, full: FieldSet, member: str) -> bool:
        """Whether the member explains that share of what the others leave."""
        rest = self.without(full, member)
        return rest.loss - full.loss >= self.least_gain(rest)

    def _fit(self, names: frozenset[str]) -> Slip:
        data, which = self.data, self.which
        if not names:
            return fit_slip(data, which, Slip(), free(()))
        if names == {PARTIAL_SLIP}:
            return fit_slip(data, which, self.fitted(()).grip, free(names))
        if names == {PLACE}:
            return self._with_place(self.fitted(()).grip, (PLACE,))
        both = self._with_place(self.fitted((PARTIAL_SLIP,)).grip, (PARTIAL_SLIP, PLACE))
        placed = self.fitted((PLACE,)).grip
        if self._off(both):
            both = min(both, fit_slip(data, which, placed, free(names)), key=self._loss)
        alone = fit_slip(data, which, replace(both, per_friction=0.0), free((PLACE,)))
        self._grips[frozenset({PLACE})] = min(placed, alone, key=self._loss)
        return both

    def pool(self, current: FieldSet) -> list[tuple[str, float]]:
        """What is not in the set yet, while presses are off; a place only beside slip too."""
        if current.members and not self._off(current.grip):
            return []
        found = [PARTIAL_SLIP] if PARTIAL_SLIP not in current.members else []
        if PLACE not in current.members:
            slips = self.fitted((PARTIAL_SLIP,))
            is_worth = current.loss - slips.loss >= self.least_gain(current)
            if self._off(slips.grip if is_worth else current.grip):
                found.append(PLACE)
        return [(name, inf) for name in found]

    def _loss(self, grip: Slip) -> float:
        data, which = self.data, self.which
        return float(data.losses(grip, data.linear(grip, which), which).sum())

    def _off(self, grip: Slip) -> list[int]:
        """Presses whose error is clearly more than noise."""
        data, fit, rules = self.data, self.which, self.rules
        linear, found = data.linear(grip, fit), []
        for one in fit:
            press = data.presses[one]
            # In the dots about its contact: where it slips, the others hardly move otherwise.
            away = np.hypot(*(data.tracks.rest_mm - press.center_mm).T)
            near = np.broadcast_to((away < press.patch_mm + grip.decay_mm)[:, None], (len(away), 2))
            chosen = np.broadcast_to(near, press.motion_mm.shape)[np.isfinite(press.motion_mm)]
            left = data.residual(one, grip, linear)[chosen]
            most = 1.0 + rules.excess * np.sqrt(2.0 / max(len(left), 1))
            if len(left) and (left**2).mean() > most * data.noise_mm**2:
                found.append(one)
        return found

    def _with_place(self, start: Slip, names: Sequence[str]) -> Slip:
        """The fit with a place: tried at presses that are off, then fitted from the best spot on.

        Where no press is off, there is no place, and ``start`` is returned.
        """
        data, fit, rules = self.data, self.which, self.rules
        linear, at = data.linear(start, fit), self._off(start)
        if not at:
            return start
        centers = np.stack([data.presses[one].center_mm for one in at])
        reach = np.array([data.presses[one].patch_mm for one in at])
        low, high = (centers - reach[:, None]).min(axis=0), (centers + reach[:, None]).max(axis=0)
        step = rules.scan_mm
        axes = [np.arange(a, b + step / 2, step) for a, b in zip(low, high, strict=True)]
        spots = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        away = np.linalg.norm(spots[:, None] - centers, axis=2)
        spots = spots[(away < reach).any(axis=1)]
        values = [rules.least_slip]
        if start.per_friction > 0:
            values = [rules.more * start.per_friction, rules.less * start.per_friction]
        tried = [
            replace(start, place=Place(float(x), float(y), rules.scan_radius_mm, 1.0 / one))
            for x, y in spots
            for one in values
        ]

        def loss(grip: Slip) -> float:
            return float(data.losses(grip, linear, fit).sum())

        # One spot may lead into a valley of its own: the place is fitted from the best few.
        starts = sorted(tried, key=loss)[: rules.spots]
        fitted = [fit_slip(data, fit, one, PLACE_NAMES) for one in starts]
        return fit_slip(data, fit, min(fitted, key=self._loss), free(names))


class Grid:
    """How the dots at rest are turned and shifted, and what of both is needed beside a field."""

    def __init__(self, tracks: MarkerTracks) -> None:
        self._tracks = tracks
        self.turn_rad, self.shift_mm, self.errors = grid_of(tracks)

    def needed(self, problem: FrictionProblem, grip: Slip) -> list[str]:
        """Those without which the error is clearly larger; nothing of them is fitted."""
        data, linear = problem.data, problem.data.linear(grip, problem.which)

        def loss(*names: str) -> float:
            offset = self.offset_mm(names)
            return sum(squares(data, one, grip, linear, offset) for one in problem.which)

        both, least = loss(TURNED, SHIFTED), 1.0 - problem.rules.min_gain
        others = {TURNED: SHIFTED, SHIFTED: TURNED}
        return [name for name, other in others.items() if both < least * loss(other)]

    def offset_mm(self, names: Sequence[str]) -> FloatArray:
        """By how much dots at rest (M, 2) lie beside their places, these effects taken away."""
        tracks = self._tracks
        grid = turned(tracks.grid_mm, self.turn_rad * (TURNED in names))
        return np.asarray(tracks.rest_mm - grid - self.shift_mm * (SHIFTED in names))


def free(names: Sequence[str] | frozenset[str]) -> tuple[str, ...]:
    """Parameters of the field with these effects."""
    slips = ("grip",) if PARTIAL_SLIP in names else ()
    return ("decay", *slips, *(PLACE_NAMES if PLACE in names else ()))


def squares(
    data: FieldData, index: int, grip: Slip, linear: FloatArray, offset_mm: FloatArray
) -> float:
    """Sum of squares of a press, with the dots at rest ``offset_mm`` (M, 2) beside their places."""
    motion = data.presses[index].motion_mm
    off = np.broadcast_to(offset_mm, motion.shape)[np.isfinite(motion)]
    return float(((data.residual(index, grip, linear) + off) ** 2).sum())


def grid_of(tracks: MarkerTracks) -> tuple[float, FloatArray, tuple[float, float, float]]:
    """Turn and shift of the dots at rest, and their errors by the scatter between presses."""
    seen = np.isfinite(tracks.rest_mm).all(axis=1)
    turn, shift = rigid_fit(tracks.rest_mm[seen], tracks.grid_mm[seen])
    force, single = tracks.load["force_normal_n"], list[list[float]]()
    for press in np.unique(tracks.press):
        rows = np.flatnonzero(tracks.press == press)
        places = tracks.places_mm[rows[np.abs(force[rows]) <= AT_REST * force[rows].max()]]
        known = np.isfinite(places).all(axis=(0, 2))
        if len(places) and known.sum() > 2:
            one, beside = rigid_fit(np.median(places[:, known], axis=0), tracks.grid_mm[known])
            single.append([one, *beside])
    error = np.full(3, np.nan)
    if len(single) > 1:
        error = np.std(single, axis=0, ddof=1) / np.sqrt(len(single))
    return turn, shift, (float(error[0]), float(error[1]), float(error[2]))
