"""Joint fit of a smooth table and of where each ball is: centres, radii and the gel's rim."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from operator import add
from typing import Any

import numpy as np

from tacgen.calibrate.lookup.prepared import Pixels, PreparedPresses, Sample
from tacgen.calibrate.lookup.settings import RULES, FitSettings
from tacgen.calibrate.lookup.smooth_model import (
    SmoothModel,
    design,
    first_features,
    light_terms,
    n_position_features,
    solve_ridge,
    weighed,
)
from tacgen.core.types import FloatArray, IntArray
from tacgen.presses.experiments import is_clear
from tacgen.presses.geometry import MAX_RADIUS_SHARE, Membrane, PressedGel, rest_height, rest_slope
from tacgen.presses.press_images import PressImages, label_mm, place_mm

LABEL_SCATTER_RADII = np.array(
    [RULES.center_scatter_radii, RULES.center_scatter_radii, RULES.radius_scatter_radii]
)
"""Standard deviations of a label's centre and radius, in label radii."""


_TEN_MM = 10.0  # an image's size: over this a label's shift grows by what it is at the centre


@dataclass(frozen=True, slots=True)
class LabelModel:
    """How labelled centres and radii relate to the true ones, learnt from the presses.

    The expected contact radius is ``contact_radius_mm`` + ``radius_slope`` × (label −
    ``reference_radius_mm``): a slope below 1 where labels scatter more than the presses do.
    """

    shift_mm: FloatArray  # (3, 2), mean of (true − labelled centre) along x and y: a constant, and
    # what it grows by in 10 mm along x and along y
    contact_radius_mm: float
    reference_radius_mm: float
    radius_slope: float

    def geometry(self, label: FloatArray) -> FloatArray:
        """Expected centre and contact radius (..., 3) from labels (..., 3), mm."""
        ones = np.ones_like(label[..., 0])
        basis = np.stack([ones, label[..., 0] / _TEN_MM, label[..., 1] / _TEN_MM], axis=-1)
        radius = self.contact_radius_mm + self.radius_slope * (
            label[..., 2] - self.reference_radius_mm
        )
        most_mm = RULES.largest_shift_radii * self.reference_radius_mm
        shift = np.clip(basis @ self.shift_mm, -most_mm, most_mm)
        return np.concatenate([label[..., :2] + shift, radius[..., None]], axis=-1)


def learn_labels(labels: FloatArray, geometry: FloatArray) -> LabelModel:
    """The label model by least squares from labels (n, 3) and estimated geometry (n, 3), mm.

    The shift is what is expected of a true centre given its label: where presses lie closer
    together than labels scatter, it leads back to their middle. What grows with position is held
    back by a ridge, the first of some unless under a weaker one presses that are left out are
    expected clearly better.
    """
    basis = np.column_stack([np.ones(len(labels)), labels[:, :2] / _TEN_MM])
    off = (geometry - labels)[:, :2]
    least: FloatArray | None = None
    for ridge in RULES.tilt_ridges:
        solve = np.linalg.solve(basis.T @ basis + np.diag([0.0, ridge, ridge]), basis.T)
        own = np.einsum("nk,kn->n", basis, solve)  # of each press in what is expected of it
        left_out = (off - basis @ (solve @ off)) / np.maximum(1.0 - own, 1e-3)[:, None]
        error = (left_out**2).sum(axis=1)
        if least is None or is_clear(least - error):
            least, shift = error, solve @ off
    reference = float(labels[:, 2].mean())
    spread = labels[:, 2] - reference
    slope = float(spread @ geometry[:, 2] / (spread @ spread + 1e-6 * reference**2))
    return LabelModel(
        shift_mm=shift,
        contact_radius_mm=float(geometry[:, 2].mean()),
        reference_radius_mm=reference,
        radius_slope=float(np.clip(slope, 0.0, 1.0)),
    )


@dataclass(frozen=True, slots=True)
class PressModel:
    """Everything besides the table that turns a label into a picture of a press."""

    labels: LabelModel
    membrane: Membrane
    dome_radius_mm: float = 0.0

    def surface(
        self, geometry: FloatArray, ball_radius_mm: float, pixels: Pixels
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The gel at ``pixels`` around a ball at ``geometry`` (centre and radius, mm).

        Slopes along x and y, and depth below the gel at rest, mm; each (n,).
        """
        dx, dy = pixels.x_mm - geometry[0], pixels.y_mm - geometry[1]
        pressed = self._pressed(geometry, ball_radius_mm)
        added = pressed.slope(dx, dy)
        rest = rest_slope(pixels.x_mm, pixels.y_mm, self.dome_radius_mm)
        return added[0] + rest[0], added[1] + rest[1], pressed.depth(np.sqrt(dx * dx + dy * dy))

    def height(
        self, geometry: FloatArray, ball_radius_mm: float, x_mm: FloatArray, y_mm: FloatArray
    ) -> FloatArray:
        """Height of the gel, mm, around a ball at ``geometry``.

        At places ``x_mm`` and ``y_mm`` on it, broadcast against each other.
        """
        r_mm = np.sqrt((x_mm - geometry[0]) ** 2 + (y_mm - geometry[1]) ** 2)
        added = self._pressed(geometry, ball_radius_mm).height(r_mm)
        return added + rest_height(x_mm, y_mm, self.dome_radius_mm)

    def _pressed(self, geometry: FloatArray, ball_radius_mm: float) -> PressedGel:
        return PressedGel(float(geometry[2]), ball_radius_mm, self.membrane, self.dome_radius_mm)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for a table's provenance."""
        shift = {"shift_mm": self.labels.shift_mm.tolist()}
        dome = {"dome_radius_mm": self.dome_radius_mm}
        return asdict(self.labels) | shift | asdict(self.membrane) | dome

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "PressModel":
        """The inverse of ``as_dict``."""
        known = {**values, "shift_mm": np.asarray(values["shift_mm"], dtype=np.float64)}
        labels = LabelModel(**{name: known[name] for name in LabelModel.__slots__})
        factors = tuple((float(r), float(f)) for r, f in known.get("slope_factors", ()))
        membrane = Membrane(known["decay_mm"], known["sharpness"], factors)
        return cls(labels, membrane, known["dome_radius_mm"])


def plain_press_model(contact_radius_mm: float, dome_radius_mm: float = 0.0) -> PressModel:
    """Labels taken at their word and a membrane that bends over 0.4 contact radii."""
    labels = LabelModel(np.zeros((3, 2)), contact_radius_mm, contact_radius_mm, 1.0)
    return PressModel(labels, Membrane(0.4 * contact_radius_mm, 4.0), dome_radius_mm)


@dataclass(frozen=True, slots=True)
class JointFit:
    """A smooth model, the press model, and the geometry (N, 3), mm, of each press.

    ``drift_share`` is the share of the presses' drift (lamps and camera drift in a session) that
    was subtracted from the contacts, so that it does not go into the table.
    """

    model: SmoothModel
    press_model: PressModel
    geometry: FloatArray
    drift_share: float = 0.0


def predicted(
    sample: Sample, geometry: FloatArray, press_model: PressModel, model: SmoothModel
) -> FloatArray:
    """Change of grey level (n, 3) that ``model`` gives at a press's pixels."""
    terms = _added_terms(sample, geometry, press_model, model.degree, model.bend)
    return model.of_terms(terms, sample.position)


def _added_terms(
    sample: Sample, geometry: FloatArray, press_model: PressModel, degree: int, bend: float
) -> FloatArray:
    surface = press_model.surface(geometry, sample.ball_radius_mm, sample.pixels)
    terms = light_terms(*surface, degree, bend)
    if press_model.dome_radius_mm > 0:
        terms = terms - _rest_terms(sample, press_model, degree, bend)
    return terms


def _rest_terms(sample: Sample, press_model: PressModel, degree: int, bend: float) -> FloatArray:
    """The terms of the gel at rest."""
    x, y = sample.pixels.x_mm, sample.pixels.y_mm
    return light_terms(
        *rest_slope(x, y, press_model.dome_radius_mm), np.zeros_like(x), degree, bend
    )


@dataclass(frozen=True, slots=True)
class PressSums:
    """Weighted normal equations of one press, or of several together.

    Moments hold the three channels of one background after those of another.
    """

    gram: FloatArray
    moment: FloatArray
    square: FloatArray
    weight: float

    def __add__(self, other: "PressSums") -> "PressSums":
        """Those of more presses."""
        return PressSums(*(getattr(self, n) + getattr(other, n) for n in self.__slots__))

    def __sub__(self, other: "PressSums") -> "PressSums":
        """Those of fewer presses."""
        return PressSums(*(getattr(self, n) - getattr(other, n) for n in self.__slots__))

    def of_columns(self, index: IntArray) -> "PressSums":
        """The same for a model of fewer columns."""
        return PressSums(
            self.gram[np.ix_(index, index)], self.moment[index], self.square, self.weight
        )


def press_sums(
    sample: Sample,
    geometry: FloatArray,
    press_model: PressModel,
    settings: FitSettings,
    target: FloatArray,
) -> PressSums:
    """Normal equations of a press at a place, for targets (n, 3 · n_targets)."""
    root = np.sqrt(sample.weight)[:, None]
    terms = _added_terms(sample, geometry, press_model, settings.degree, settings.bend)
    position = first_features(sample.position, n_position_features(settings.position_degree))
    weighted = design(terms * root, position)
    return PressSums(
        gram=weighted.T @ weighted,
        moment=weighted.T @ (target * root),
        square=sample.weight @ target**2,
        weight=float(sample.weight.sum()),
    )


def model_of_sums(sums: PressSums, settings: FitSettings) -> SmoothModel:
    """The smooth model of some presses by ridge regression."""
    total = max(sums.weight, 1.0)
    return solve_ridge(sums.gram / total, sums.moment / total, settings)


def place_jointly(
    prepared: PreparedPresses,
    background: FloatArray,
    settings: FitSettings,
    *,
    iterations: int = 5,
    start: JointFit | None = None,
) -> JointFit:
    """Alternate between a rough smooth model, each press's place, the rim and the label model.

    All on a thinned lattice of pixels. ``start`` is an earlier fit of the same presses to go on
    from.
    """
    presses = prepared.presses
    thinned = prepared.samples(background, RULES.pixels_to_place)
    labels = np.array([sample.label for sample in thinned])
    rough = FitSettings(
        min(settings.degree, RULES.rough_settings.degree),
        min(settings.position_degree, RULES.rough_settings.position_degree),
        max(settings.ridge, RULES.rough_settings.ridge),
        settings.bend,
    )
    if start is None:
        radius = np.minimum(RULES.first_radius_share * labels[:, 2], 0.9 * presses.ball_radius_mm)
        if presses.seen_px is not None:
            radius = np.fmin(radius, presses.seen_px[:, 2] * presses.mm_per_px)
        geometry = np.column_stack([labels[:, :2], radius])
        press_model, share = plain_press_model(float(radius.mean()), presses.dome_radius_mm), 0.0
    else:
        press_model, geometry, share = start.press_model, start.geometry, start.drift_share
    for _ in range(iterations):
        samples = _less(thinned, share * prepared.drift)
        model = _fit_model(samples, geometry, press_model, rough)
        expected, scatter = _expected(presses, press_model.labels)
        geometry = np.array(
            [
                _place_sample(sample, model, press_model, place, *prior)
                for sample, place, *prior in zip(samples, geometry, expected, scatter, strict=True)
            ]
        )
        errors = [
            sample.change - predicted(sample, place, press_model, model)
            for sample, place in zip(samples, geometry, strict=True)
        ]
        share = _drift_share(samples, errors, share, prepared.drift)
        membrane = _refine_membrane(samples, geometry, model, press_model, errors)
        press_model = replace(press_model, membrane=membrane, labels=learn_labels(labels, geometry))
    return JointFit(model, press_model, geometry, share)


def fit_light(
    prepared: PreparedPresses, background: FloatArray, settings: FitSettings, placed: JointFit
) -> JointFit:
    """The smooth model of presses placed as in ``placed``, on more of their pixels."""
    samples = _less(prepared.samples(background), placed.drift_share * prepared.drift)
    return replace(placed, model=_fit_model(samples, placed.geometry, placed.press_model, settings))


def _less(samples: list[Sample], offsets: FloatArray) -> list[Sample]:
    """The samples less each press's offset (N, 3)."""
    return [
        replace(sample, change=sample.change - offset)
        for sample, offset in zip(samples, offsets, strict=True)
    ]


def _fit_model(
    samples: list[Sample], geometry: FloatArray, press_model: PressModel, settings: FitSettings
) -> SmoothModel:
    """The smooth model by ridge regression, for a given geometry of the presses."""
    sums = (
        press_sums(sample, place, press_model, settings, sample.change)
        for sample, place in zip(samples, geometry, strict=True)
    )
    return model_of_sums(reduce(add, sums), settings)


def _drift_share(
    samples: list[Sample], errors: Sequence[FloatArray], share: float, drift: FloatArray
) -> float:
    """The share, 0 to 1, of the bare gel's drift (N, 3) that shows in the contacts too.

    ``errors`` (n, 3) of each press are those without ``share`` of it.
    """
    residual = np.zeros_like(drift)
    for k, (sample, error) in enumerate(zip(samples, errors, strict=True)):
        seen = sample.pixels.inside & (sample.weight > 0)
        if seen.any():
            residual[k] = share * drift[k] + error[seen].mean(axis=0)
    residual -= residual.mean(axis=0)
    size = float((drift**2).sum()) + len(drift) * RULES.drift_noise_grey**2
    return float(np.clip((residual * drift).sum() / size, 0.0, 1.0))


def expected_by_label(presses: PressImages, labels: LabelModel) -> FloatArray:
    """Expected geometry (N, 3), mm, of each picture by its press's labels.

    Pictures of a press share its place, so that each is expected in the middle of where all their
    labels say. Not where these are further apart than labels scatter, nor in a named trial: there
    the ball may have moved.
    """
    label = label_mm(presses)
    expected = labels.geometry(label)
    expected[:, 2] = np.minimum(
        expected[:, 2], RULES.expected_radius_share * presses.ball_radius_mm
    )
    named = presses.trial is not None and np.isfinite(presses.trial).any()
    if not named and presses.n_experiments < len(presses):
        of_press = (presses.experiment[:, None] == presses.experiment).astype(np.float64)
        of_press /= of_press.sum(axis=1, keepdims=True)
        square = ((label[:, :2] - of_press @ label[:, :2]) ** 2).mean(axis=1)
        apart_radii = np.sqrt(of_press @ (square / label[:, 2] ** 2))
        at_rest = apart_radii < RULES.same_place_scatters * RULES.center_scatter_radii
        expected[at_rest, :2] = (of_press @ expected[:, :2])[at_rest]
    return expected


def _expected(presses: PressImages, labels: LabelModel) -> tuple[FloatArray, FloatArray]:
    """Expected geometry (N, 3), mm, and its scatter (N, 3), label radii.

    A circle that is seen in the picture says more about the centre than a label does, and keeps a
    shift that all labels share from going into the table. Where it stands in for the label it is no
    second piece of evidence.
    """
    expected = expected_by_label(presses, labels)
    scatter = np.tile(LABEL_SCATTER_RADII, (len(presses), 1))
    if presses.seen_px is not None:
        known = np.isfinite(presses.seen_px).all(axis=1)
        if len(presses.found):
            known &= ~presses.found
        x, y = presses.seen_px[:, 0], presses.seen_px[:, 1]
        seen = np.column_stack(place_mm(x, y, presses.shape_px, presses.mm_per_px))
        label, circle = RULES.center_scatter_radii, RULES.seen_scatter_radii
        share = label**2 / (label**2 + circle**2)
        expected[known, :2] += share * (seen - expected[:, :2])[known]
        scatter[known, :2] = circle * np.sqrt(share)
    return expected, scatter


@dataclass(frozen=True, slots=True)
class PlacePrior:
    """What is known of a press's place before its picture is looked at.

    ``expected`` (3,), mm, and ``scatter`` (3,), label radii, are mean and standard deviations of
    centre and contact radius; ``label_mm`` and ``ball_mm`` the radii of the label and of the ball.
    """

    expected: FloatArray
    scatter: FloatArray
    label_mm: float
    ball_mm: float


@dataclass(frozen=True, slots=True)
class Descent:
    """How a place is searched: moved by ``nudge`` for derivatives, settled below ``tolerance``.

    Both in label radii.
    """

    nudge: float
    steps: int
    tolerance: float


def place_press(
    grey: Callable[[FloatArray], FloatArray],
    target: FloatArray,
    weight: FloatArray,
    prior: PlacePrior,
    start: FloatArray,
    descent: Descent,
) -> FloatArray:
    """Centre and contact radius (3,), mm, of one press: Gauss–Newton from a start.

    ``grey`` gives the press's grey levels (n, 3) at a place, ``target`` (n, 3) is what they should
    be, ``weight`` (n,) that of each pixel.
    """
    label_mm, nudge_mm = prior.label_mm, descent.nudge * prior.label_mm
    held = 1.0 / (prior.scatter * label_mm) ** 2
    precision = np.repeat(weight, 3) / (RULES.noise_grey**2 * RULES.correlated_pixels)
    place = np.array(start, dtype=np.float64)
    for _ in range(descent.steps):
        value = grey(place)
        columns = [(grey(place + m) - value).ravel() / nudge_mm for m in nudge_mm * np.eye(3)]
        jacobian = np.stack(columns, axis=-1)
        weighted = jacobian * precision[:, None]
        step = np.linalg.solve(
            weighted.T @ jacobian + np.diag(held),
            weighted.T @ (target - value).ravel() - held * (place - prior.expected),
        )
        longest = RULES.largest_step_radii * label_mm
        place += np.clip(step, -longest, longest)
        place[2] = np.clip(place[2], 0.1 * label_mm, MAX_RADIUS_SHARE * prior.ball_mm)
        if np.abs(step).max() < descent.tolerance * label_mm:
            break
    return place


def _place_sample(
    sample: Sample,
    model: SmoothModel,
    press_model: PressModel,
    start: FloatArray,
    expected: FloatArray,
    scatter: FloatArray,
) -> FloatArray:
    """``place_press`` of one press under a smooth model."""
    at_places = model.at_places(sample.position)
    target = sample.change
    if press_model.dome_radius_mm > 0:
        target = target + weighed(
            _rest_terms(sample, press_model, model.degree, model.bend), at_places
        )

    def grey(place: FloatArray) -> FloatArray:
        surface = press_model.surface(place, sample.ball_radius_mm, sample.pixels)
        return weighed(light_terms(*surface, model.degree, model.bend), at_places)

    prior = PlacePrior(expected, scatter, float(sample.label[2]), sample.ball_radius_mm)
    return place_press(grey, target, sample.weight, prior, start, _ROUGH_DESCENT)


_ROUGH_DESCENT = Descent(nudge=1e-3, steps=5, tolerance=0.02)


def _refine_membrane(
    samples: list[Sample],
    geometry: FloatArray,
    model: SmoothModel,
    press_model: PressModel,
    errors: Sequence[FloatArray],
) -> Membrane:
    """One Gauss–Newton step, in logarithms, for how the gel leaves the ball, from its errors."""
    now, nudge = press_model.membrane, 0.02
    trials = [
        replace(press_model, membrane=replace(now, decay_mm=now.decay_mm * (1 + nudge))),
        replace(press_model, membrane=replace(now, sharpness=now.sharpness * (1 + nudge))),
    ]
    normal_matrix, moment = np.zeros((2, 2)), np.zeros(2)
    for sample, place, error in zip(samples, geometry, errors, strict=True):
        value = sample.change - error
        columns = [((predicted(sample, place, t, model) - value) / nudge).ravel() for t in trials]
        jacobian = np.stack(columns, axis=-1)
        weighted = jacobian * np.repeat(sample.weight, 3)[:, None]
        normal_matrix += weighted.T @ jacobian
        moment += weighted.T @ error.ravel()
    damped = normal_matrix + 1e-3 * np.trace(normal_matrix) * np.eye(2)
    step = np.clip(RULES.membrane_step * np.linalg.solve(damped, moment), -0.4, 0.4)
    radius = press_model.labels.contact_radius_mm
    return Membrane(
        decay_mm=float(np.clip(now.decay_mm * np.exp(step[0]), 0.05 * radius, 3.0 * radius)),
        sharpness=float(np.clip(now.sharpness * np.exp(step[1]), 1.5, 30.0)),
    )
