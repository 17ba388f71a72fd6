"""What the field of marker motion lacks that its sum cannot show.

The base is a field that sticks everywhere, of dots that lie where the sensor's file has them. It
lacks ``partial_slip`` (the contact's rim slips), ``friction_place`` (a place with other friction),
``grid_turned`` or ``grid_shifted`` where that explains a share of the squared error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import spearmanr

from tacgen.calibrate.contact.marker_fit import (
    PLACE_NAMES,
    FieldData,
    Slip,
    arrow_figure,
    field_data,
    fit_slip,
    refined,
)
from tacgen.contact.law import ContactLaw
from tacgen.core.records import Estimate, Sensor
from tacgen.core.types import FloatArray
from tacgen.presses.ball_shear import Place
from tacgen.presses.marker_tracks import AT_REST, MarkerTracks, rigid_fit, turned

PARTIAL_SLIP, PLACE, TURNED, SHIFTED = (
    "partial_slip",
    "friction_place",
    "grid_turned",
    "grid_shifted",
)


@dataclass(frozen=True, slots=True)
class MarkerRules:
    """Thresholds of the choice, set on other seeds of validation/blind/markers.py than reported."""

    min_gain: float = 0.002
    """Share of the squared error, noise included, that an effect explains: by chance 0.0005."""
    frames: int = 6
    """Of a press, in the choice: a place is tried in some hundred spots."""
    scan_mm: float = 1.5
    """Distance of those spots: half of a contact's radius."""
    spots: int = 4
    """Best ones, from which a place is fitted."""
    scan_radius_mm: float = 1.75
    """Of a place that is tried; it is fitted then."""
    excess: float = 2.5
    """Standard deviations of the noise's own squared error that a press is off by: a place is
    looked for there."""
    more: float = 4.0
    """Times 1/μ in a place that is tried."""
    less: float = 0.25
    """The same, of a place with more friction."""
    least_slip: float = 4.0
    """1/μ in a place that is tried in a contact that sticks."""
    test_every: int = 4
    """Every so many presses one is held out."""
    unexplained: float = 1.2
    """Times the noise floor: what is left is looked into."""
    alpha: float = 0.01
    """p-value, for all covariates together, below which the residual follows one."""


DEFAULT_RULES = MarkerRules()


@dataclass(frozen=True)
class MarkerDiagnosis:
    """What the residual of the marker field was traced to.

    ``base`` is fitted to the presses that are not held out, ``final`` to all; ``data`` are their
    frames. Errors, mm, are of one coordinate of a dot in held-out presses, before and after;
    ``gains`` are the shares of the squared error there that effects take away, in the order in
    which they were added. ``beside_mm`` (M, 2) is by how much dots at rest are off where the base,
    and the extended field, have them.
    """

    data: FieldData
    base: Slip
    final: Slip
    effects: dict[str, dict[str, tuple[float, float, str]]]
    gains: dict[str, float]
    runner_up: dict[str, str]
    before_mm: float
    after_mm: float
    motion_mm: float
    unexplained: tuple[tuple[str, float], ...]
    k_s: tuple[float, float]
    decay_mm: tuple[float, float]
    n_test: int
    beside_mm: tuple[FloatArray, FloatArray]

    @property
    def verdict(self) -> Literal["sufficient", "effect_found", "unexplained"]:
        """``unexplained`` if structure is left, whatever was found."""
        if self.unexplained:
            return "unexplained"
        return "effect_found" if self.effects else "sufficient"

    @property
    def sentence(self) -> str:
        """The verdict in one plain sentence."""
        um = [1e3 * value for value in (self.before_mm, self.after_mm, self.data.noise_mm)]
        error = f"{um[0]:.3g} µm on held-out presses"
        floor = f"noise floor {um[2]:.3g} µm"
        left = ", ".join(name for name, _ in self.unexplained)
        if not self.effects:
            if left:
                return f"The shear field that sticks is off by {error} ({floor}): it follows {left}"
            return f"The shear field that sticks is sufficient: {error}, {floor}."
        names = []
        for name, parameters in self.effects.items():
            shown = ", ".join(
                f"{key} {value:.3g} ± {1.96 * stderr:.2g}"
                for key, (value, stderr, _) in parameters.items()
            )
            names.append(f"{name.replace('_', ' ')} ({shown})")
        text = f"The shear field lacks {' and '.join(names)}: the error goes from {error} to "
        text += f"{um[1]:.3g} µm ({floor})"
        return text + (f", and a residual that follows {left} remains." if left else ".")

    def extended(self, law: ContactLaw) -> ContactLaw:
        """The law with what the field says that it lacks."""
        found: dict[str, Any] = {"decay_mm": Estimate(*self.decay_mm, "mm")}
        if PARTIAL_SLIP in self.effects:
            value, stderr, _ = self.effects[PARTIAL_SLIP]["friction"]
            found["friction"] = Estimate(value, stderr)
        if np.isnan(law.k_s_mm_per_n.value):
            found["k_s_mm_per_n"] = Estimate(*self.k_s, "mm/N")
        if np.isnan(law.marker_pitch_mm):
            found["marker_pitch_mm"] = self.data.tracks.pitch_mm
        return replace(law, **found)

    def figure(self, *, extended: bool) -> Figure:
        """Arrows of a few presses, of the field that sticks or with the effects that were found."""
        grip, beside_mm = (self.base, self.final)[extended], self.beside_mm[extended]
        linear = self.data.linear(grip, range(len(self.data.presses)))
        return arrow_figure(self.data, grip, linear, beside_mm)

    def record(self) -> dict[str, Any]:
        """The channel ``markers`` of ``diagnosis.json``."""

        def error(rmse: float) -> dict[str, Any]:
            return {"rmse": rmse, "nrmse": rmse / max(self.motion_mm, 1e-12), "unit": "mm"}

        def estimate(value: float, stderr: float, unit: str) -> dict[str, Any]:
            known = np.isfinite(stderr)
            return {"value": value, "stderr": stderr if known else None, "unit": unit}

        noise = self.data.noise_mm
        return {
            "verdict": self.verdict,
            "sentence": self.sentence,
            "effects": [
                {
                    "name": name,
                    "parameters": {key: estimate(*one) for key, one in parameters.items()},
                    "heldout_gain": self.gains[name],
                    "runner_up": self.runner_up.get(name, ""),
                }
                for name, parameters in self.effects.items()
            ],
            "unexplained": [
                {"covariate": name, "p_value": p_value} for name, p_value in self.unexplained
            ],
            "error_before": error(self.before_mm),
            "error_after": error(self.after_mm),
            "noise_floor": {
                "rmse": noise if np.isfinite(noise) else None,
                "how": "second differences of a dot's place over the frames of a press",
            },
            "trials": {"fit": len(self.data.presses) - self.n_test, "test": self.n_test},
            "field": {
                "k_s": estimate(*self.k_s, "mm/N"),
                "decay_mm": estimate(*self.decay_mm, "mm"),
            },
        }


def diagnose_markers(
    tracks: MarkerTracks,
    sensor: Sensor,
    k_n_mm3_per_n: float,
    rules: MarkerRules = DEFAULT_RULES,
) -> MarkerDiagnosis:
    """Diagnose the field of marker tracks; ``k_n`` gives the size of the contacts.

    Raises ``PressError`` with too few presses that shear the gel.
    """
    data = field_data(tracks, sensor, k_n_mm3_per_n, rules.frames)
    every = list(range(len(data.presses)))
    test = every[rules.test_every // 2 :: rules.test_every]
    fit = [one for one in every if one not in test]
    field, chosen, runner_up = _choose(data, fit, rules)
    turn, shift, grid_errors = _grid(tracks)

    def offset(names: Sequence[str]) -> FloatArray:
        grid = turned(tracks.grid_mm, turn * (TURNED in names)) + shift * (SHIFTED in names)
        return np.asarray(tracks.rest_mm - grid)

    def loss(which: Sequence[int], grip: Slip, names: Sequence[str]) -> float:
        linear, beside = data.linear(grip, fit), offset(names)
        return float(sum(_loss(data, one, grip, linear, beside) for one in which))

    whole = loss(fit, field[-1], (TURNED, SHIFTED))
    grid: tuple[str, ...] = ()
    for name, other in ((TURNED, (SHIFTED,)), (SHIFTED, (TURNED,))):
        without = loss(fit, field[-1], other)
        if without - whole > rules.min_gain * without:
            grid += (name,)
    # Errors and gains on presses that neither fitting nor choosing saw.
    losses = [loss(test, one, ()) for one in field]
    order = [*chosen, *grid]
    losses += [loss(test, field[-1], grid[: k + 1]) for k in range(len(grid))]
    gains = {n: 1.0 - b / a for n, a, b in zip(order, losses, losses[1:], strict=False)}
    count = sum(int(np.isfinite(data.presses[one].motion_mm).sum()) for one in test)
    square = sum(float(np.nansum(data.presses[one].motion_mm ** 2)) for one in test)
    after_mm = float(np.sqrt(losses[-1] / count))
    # Parameters of all presses.
    names = _free(chosen)
    base = field[0]
    final, linear, stderr = refined(data, field[-1], names)
    effects = {name: _parameters(name, final, stderr, turn, shift, grid_errors) for name in order}
    pitch2 = tracks.pitch_mm**2
    left = _left(data, final, linear, offset(grid))
    is_left = after_mm > rules.unexplained * data.noise_mm
    return MarkerDiagnosis(
        data=data,
        base=base,
        final=final,
        effects=effects,
        gains=gains,
        runner_up=runner_up,
        before_mm=float(np.sqrt(losses[0] / count)),
        after_mm=after_mm,
        motion_mm=float(np.sqrt(square / count)),
        unexplained=_followed(data, left, rules) if is_left else (),
        k_s=(float(linear[0]) / pitch2, stderr["compliance"] / pitch2),
        decay_mm=(final.decay_mm, stderr["decay"]),
        n_test=len(test),
        beside_mm=(offset(()), offset(grid)),
    )


def _free(chosen: Sequence[str]) -> tuple[str, ...]:
    """Parameters of the field with these effects."""
    slips = ("grip",) if PARTIAL_SLIP in chosen else ()
    return ("decay", *slips, *(PLACE_NAMES if PLACE in chosen else ()))


def _choose(
    data: FieldData, fit: Sequence[int], rules: MarkerRules
) -> tuple[list[Slip], tuple[str, ...], dict[str, str]]:
    """Fits without, with one and with all effects of friction; their names; competitors."""

    def loss(grip: Slip) -> float:
        return float(data.losses(grip, data.linear(grip, fit), fit).sum())

    def gain(grip: Slip, than: Slip) -> float:
        return 1.0 - loss(grip) / loss(than)

    base = fit_slip(data, fit, Slip(), _free(()))
    slipping = fit_slip(data, fit, base, _free((PARTIAL_SLIP,)))
    slips = gain(slipping, base) >= rules.min_gain
    if not _off(data, fit, slipping if slips else base, rules):
        return ([base, slipping], (PARTIAL_SLIP,), {}) if slips else ([base], (), {})
    placed = _with_place(data, fit, base, (PLACE,), rules)
    better = [(gain(one, base), name) for one, name in ((slipping, PARTIAL_SLIP), (placed, PLACE))]
    if max(better)[0] < rules.min_gain:
        return [base], (), {}
    first, names = slipping, (PARTIAL_SLIP, PLACE)
    if loss(placed) < loss(slipping):
        first, names = placed, (PLACE, PARTIAL_SLIP)
    runner_up = {names[0]: names[1]} if min(better)[0] >= rules.min_gain else {}
    if not _off(data, fit, first, rules):
        return [base, first], names[:1], runner_up
    both = _with_place(data, fit, slipping, (PARTIAL_SLIP, PLACE), rules)
    if _off(data, fit, both, rules):
        other = fit_slip(data, fit, placed, _free((PARTIAL_SLIP, PLACE)))
        both = min(both, other, key=loss)
    # Beside slip the place may have come out better than alone: it is fitted alone from there.
    alone = fit_slip(data, fit, replace(both, per_friction=0.0), _free((PLACE,)))
    if loss(alone) < loss(first):
        first, names = alone, (PLACE, PARTIAL_SLIP)
    if gain(both, first) < rules.min_gain:
        return [base, first], names[:1], runner_up
    return [base, first, both], names, runner_up


def _off(data: FieldData, fit: Sequence[int], grip: Slip, rules: MarkerRules) -> list[int]:
    """Presses whose error is clearly more than noise."""
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


def _with_place(
    data: FieldData, fit: Sequence[int], start: Slip, chosen: Sequence[str], rules: MarkerRules
) -> Slip:
    """The fit with a place: tried at presses that are off, then fitted from the best spot on.

    Where no press is off, there is no place, and ``start`` is returned.
    """
    linear = data.linear(start, fit)
    at = _off(data, fit, start, rules)
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
    found = min(fitted, key=lambda one: data.losses(one, data.linear(one, fit), fit).sum())
    return fit_slip(data, fit, found, _free(chosen))


def _loss(
    data: FieldData, index: int, grip: Slip, linear: FloatArray, offset_mm: FloatArray
) -> float:
    """Sum of squares of a press, with the dots at rest ``offset_mm`` (M, 2) beside their places."""
    motion = data.presses[index].motion_mm
    off = np.broadcast_to(offset_mm, motion.shape)[np.isfinite(motion)]
    return float(((data.residual(index, grip, linear) + off) ** 2).sum())


def _grid(tracks: MarkerTracks) -> tuple[float, FloatArray, tuple[float, float, float]]:
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


def _parameters(
    name: str,
    grip: Slip,
    stderr: dict[str, float],
    turn_rad: float,
    shift_mm: FloatArray,
    grid_errors: tuple[float, float, float],
) -> dict[str, tuple[float, float, str]]:
    """Value, standard error and unit of an effect's parameters."""
    if name == PARTIAL_SLIP:
        return {"friction": (grip.friction, stderr["grip"] * grip.friction**2, "1")}
    if name == TURNED:
        return {"turn_rad": (turn_rad, grid_errors[0], "rad")}
    if name == SHIFTED:
        x, y = shift_mm
        return {
            "shift_x_mm": (float(x), grid_errors[1], "mm"),
            "shift_y_mm": (float(y), grid_errors[2], "mm"),
        }
    place = grip.place
    if place is None:
        return {}
    mu = place.friction
    return {
        "x_mm": (place.x_mm, stderr["place_x"], "mm"),
        "y_mm": (place.y_mm, stderr["place_y"], "mm"),
        "radius_mm": (place.radius_mm, stderr["place_radius"], "mm"),
        "friction": (mu, stderr["place_slip"] * mu**2, "1"),
    }


def _left(data: FieldData, grip: Slip, linear: FloatArray, offset_mm: FloatArray) -> FloatArray:
    """Mean square of each press's residual (P,), mm²."""
    return np.array(
        [
            _loss(data, one, grip, linear, offset_mm) / np.isfinite(press.motion_mm).sum()
            for one, press in enumerate(data.presses)
        ]
    )


def _followed(
    data: FieldData, left: FloatArray, rules: MarkerRules
) -> tuple[tuple[str, float], ...]:
    """The column of the log, at the largest shear, that the residual of presses follows."""
    columns = {name: [p.load[name] for p in data.presses] for name in data.presses[0].load}
    found = []
    for name, values in columns.items():
        known = np.isfinite(values)
        if known.sum() > 3 and np.ptp(np.array(values)[known]) > 0:
            p_value = float(spearmanr(np.array(values)[known], left[known]).pvalue)
            found.append((p_value * len(columns), name))
    p_value, name = min(found, default=(1.0, ""))
    return ((name, min(p_value, 1.0)),) if p_value <= rules.alpha else ()
