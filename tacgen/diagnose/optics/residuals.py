"""What the residuals of held-out presses still follow that no listed effect explains."""

import numpy as np
from scipy.stats import t as student

from tacgen.core.types import BoolArray, FloatArray
from tacgen.diagnose.evidence import Dependence
from tacgen.diagnose.optics.fit import Model, PressFit, typical
from tacgen.diagnose.optics.selection import log_gain

PLACE = "place_on_gel"
AROUND = "distance_and_direction"
AROUND_BY_PLACE = "distance_and_direction_by_place"
PRESS = "press"
_TEN_MM = 10.0  # a gel's size


def dependences(fit: PressFit, model: Model) -> tuple[Dependence, ...]:
    """Covariates that a model's held-out residuals follow, the strongest first.

    For each the residuals are predicted from the other folds' presses and subtracted; a line in a
    condition is compared with a constant. A pattern of distance and direction from the contact
    counts by its grey levels: the same for all presses, changing over the gel, or of each press
    its own, seen in one half of its pixels and scored on the other.
    """
    rules = fit.rules
    residuals = fit.residuals(model)
    pattern = _pattern(fit, residuals)
    errors = {PLACE: (fit.mean_squares(residuals), _squares(fit, residuals, pattern))}
    changes = _changes(fit, model)
    constant = np.ones((len(residuals), 1))
    without = _squares(fit, residuals, _predicted(fit, changes, residuals, constant))
    for name, values in _conditions(fit).items():
        trend = _predicted(fit, changes, residuals, np.column_stack([constant, values]))
        errors[name] = (without, _squares(fit, residuals, trend))
    found = []
    for name, (before, after) in errors.items():
        gain, error = log_gain(before, after)
        p_value = float(student.sf(gain / error, len(before) - 1))
        least = rules.least_gain_of_place if name == PLACE else rules.least_gain_of_condition
        if gain >= least and p_value <= rules.false_alarm / len(errors):
            grey = np.sqrt(typical(before)) - np.sqrt(typical(after))
            found.append(Dependence(name, p_value, float(grey)))
    for name in (AROUND, AROUND_BY_PLACE, PRESS):
        if name == PRESS and found:
            break  # what follows another covariate differs from press to press too
        before, after = around_contact(fit, model, residuals, name)
        grey = float(np.sqrt(max(before.mean() - after.mean(), 0.0)))
        gain, error = log_gain(before, after)
        p_value = float(student.sf(gain / error, len(before) - 1))
        if grey > rules.least_structure_grey and p_value <= rules.false_alarm:
            found.append(Dependence(name, p_value, grey))
    return tuple(sorted(found, key=lambda dependence: -dependence.gain))


def _hats(values: FloatArray, nodes: FloatArray) -> FloatArray:
    """Weights (n, len(nodes)) of linear interpolation between even nodes; 0 beyond them."""
    apart = np.abs(values[:, None] - nodes) / (nodes[1] - nodes[0])
    return np.asarray(np.maximum(0.0, 1.0 - apart))


def around_contact(
    fit: PressFit, model: Model, residuals: list[FloatArray], follows: str
) -> tuple[FloatArray, FloatArray]:
    """Mean squares (E,) of the residuals around each contact, and of what a pattern leaves.

    The pattern is a smooth function of distance, in contact radii, and direction, fitted to the
    other folds' presses; by place it changes linearly over the gel. That of each press its own
    is fitted to the other half of its pixels, the two colours of a chess board of 8 × 8 pixels.
    """
    rules = fit.rules
    nodes = np.linspace(0.0, rules.reach_radii, rules.rings)
    columns, near, halves = [], [], []
    for view, (x, y, radius), residual in zip(fit.views, model.places, residuals, strict=True):
        dx, dy = view.pixels.x_mm - x, view.pixels.y_mm - y
        distance, turn = np.hypot(dx, dy) / radius, np.arctan2(dy, dx)
        seen = distance < rules.reach_radii
        waves = np.column_stack(
            [np.ones_like(turn), *(f(k * turn) for k in (1, 2) for f in (np.cos, np.sin))]
        )[seen]
        basis = np.einsum("nr,nw->nrw", _hats(distance[seen], nodes), waves)
        places = np.array([1.0, x / _TEN_MM, y / _TEN_MM])[: 3 if follows == AROUND_BY_PLACE else 1]
        columns.append(np.kron(places, basis.reshape(len(waves), -1)))
        near.append(residual[seen])
        halves.append(view.pixels.odd_block[seen])
    grams = np.array([c.T @ c for c in columns])
    moments = np.array([c.T @ r for c, r in zip(columns, near, strict=True)])
    mean = grams.mean(axis=0)
    size = np.trace(mean) / len(mean)
    held = rules.held_presses * np.diag(np.diag(mean)) + 1e-6 * size * np.eye(len(mean))
    after = []
    for k, fold in enumerate(fit.folds):
        if follows == PRESS:
            after.append(_of_other_half(columns[k], near[k], halves[k], rules.held_of_own * held))
            continue
        kept = fit.folds != fold
        weights = np.linalg.solve(grams[kept].sum(axis=0) + held, moments[kept].sum(axis=0))
        after.append(near[k] - columns[k] @ weights)
    return fit.mean_squares(near), fit.mean_squares(after)


def _of_other_half(
    columns: FloatArray, values: FloatArray, half: BoolArray, held: FloatArray
) -> FloatArray:
    """What columns (n, p) leave of the values (n, 3) of each half, fitted to the other one."""
    left = values.copy()
    for scored in (half, ~half):
        kept = columns[~scored]
        weights = np.linalg.solve(kept.T @ kept + held, kept.T @ values[~scored])
        left[scored] -= columns[scored] @ weights
    return left


def _squares(fit: PressFit, residuals: list[FloatArray], predicted: list[FloatArray]) -> FloatArray:
    """Mean squares (E,) of what a prediction leaves of the residuals."""
    return fit.mean_squares([r - p for r, p in zip(residuals, predicted, strict=True)])


def _conditions(fit: PressFit) -> dict[str, FloatArray]:
    """Conditions (N,) of each press that vary, standardised."""
    x, y, radius = np.array([view.expected for view in fit.views]).T
    named = {
        "image_number": np.array([view.patch.time for view in fit.views]),
        "x_mm": x,
        "y_mm": y,
        "distance_from_center_mm": np.hypot(x, y),
        "contact_radius_mm": radius,
        "ball_radius_mm": np.array([view.ball_mm for view in fit.views]),
    }
    return {
        name: (values - values.mean()) / values.std()
        for name, values in named.items()
        if values.std() > 1e-9 * max(1.0, float(np.abs(values).max()))
    }


def _changes(fit: PressFit, model: Model) -> list[FloatArray]:
    """What each contact changes in the picture, (n, 3) grey levels."""
    effects = model.effects()
    return [
        fit.grey(k, effects, model.places[k]) - view.patch.background
        for k, view in enumerate(fit.views)
    ]


def _predicted(
    fit: PressFit, changes: list[FloatArray], residuals: list[FloatArray], conditions: FloatArray
) -> list[FloatArray]:
    """What lines in the presses' conditions (N, c) predict, for each one's level and contrast."""
    predicted = [np.zeros_like(residual) for residual in residuals]
    for channel in range(3):
        columns = [
            np.kron(row, np.column_stack([np.full(len(change), 10.0), change[:, channel]]))
            for row, change in zip(conditions, changes, strict=True)
        ]
        grams = np.array([c.T @ c for c in columns])
        moments = np.array([c.T @ r[:, channel] for c, r in zip(columns, residuals, strict=True)])
        ridge = fit.rules.held_presses * np.diag(np.diag(grams.mean(axis=0)))
        for k, fold in enumerate(fit.folds):
            kept = fit.folds != fold
            weights = np.linalg.solve(grams[kept].sum(axis=0) + ridge, moments[kept].sum(axis=0))
            predicted[k][:, channel] = columns[k] @ weights
    return predicted


def _pattern(fit: PressFit, residuals: list[FloatArray]) -> list[FloatArray]:
    """The mean residual of the other folds' presses in each pixel's cell of the image."""
    n = fit.rules.cells
    places = [np.array([view.patch.v, view.patch.u]) for view in fit.views]
    cells = [np.array([n, 1]) @ np.clip((n * (p + 0.5)).astype(int), 0, n - 1) for p in places]
    counts = np.array([np.bincount(cell, minlength=n * n) for cell in cells])
    sums = np.array(
        [
            [np.bincount(cell, residual[:, channel], n * n) for channel in range(3)]
            for cell, residual in zip(cells, residuals, strict=True)
        ]
    )
    means = sums / np.maximum(counts, 1)[:, None]
    predicted = []
    for k, fold in enumerate(fit.folds):
        kept = fit.folds != fold
        views = (counts[kept] > 0).sum(axis=0)
        pattern = means[kept].sum(axis=0) / (views + fit.rules.held_presses)
        predicted.append(pattern[:, cells[k]].T)
    return predicted
