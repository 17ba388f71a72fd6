"""Columns of a log, and oscillations, that compete with the effects."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.channel import ChannelData

How = Literal["gain", "added"]
HOWS: tuple[How, ...] = ("gain", "added")


@dataclass(frozen=True)
class Covariate:
    """A dependence on ``column`` that acts on the compliance (``gain``) or is added.

    ``kind`` is its form: ``levels`` of a text column, a ``polynomial`` in a numeric one, a
    ``oscillation`` of ``frequency_hz`` in the session's clock.
    """

    column: str
    kind: Literal["levels", "polynomial", "oscillation"]
    how: How
    levels: tuple[str, ...] = ()
    center: float = 0.0
    scale: float = 1.0
    degree: int = 1
    frequency_hz: float = 0.0
    p_search: float = 0.0  # p of having found it among all frequencies that were looked at

    @property
    def label(self) -> str:
        """Its name for a reader."""
        if self.kind == "oscillation":
            period = f"period {1 / self.frequency_hz:.4g} s"
            harmonics = f", {self.degree} harmonics" if self.degree > 1 else ""
            return f"oscillation in {self.column}, {period} ({self.how}{harmonics})"
        power = f", degree {self.degree}" if self.kind == "polynomial" else ""
        return f"{self.column} ({self.how}{power})"

    def basis(self, data: ChannelData) -> list[FloatArray]:
        """Functions of the covariate, each (N,)."""
        return data.history.once(self, lambda: self._basis(data))

    def _basis(self, data: ChannelData) -> list[FloatArray]:
        if self.kind == "levels":
            held = (data.history.is_text(self.column, level) for level in self.levels)
            return [one.astype(np.float64) for one in held]
        values = data.history.column(self.column)
        if self.kind == "oscillation":
            phase = 2.0 * np.pi * self.frequency_hz * (values - self.center)
            orders = range(1, self.degree + 1)
            return [wave(order * phase) for order in orders for wave in (np.cos, np.sin)]
        scaled = np.nan_to_num((values - self.center) / self.scale, nan=0.0)
        return [scaled**power for power in range(1, self.degree + 1)]

    def columns(self, data: ChannelData, response: FloatArray) -> list[FloatArray]:
        """Columns (N, C) of the linear model, scaled by the response or, for each output, added."""
        if self.how == "gain":
            return [basis[:, None] * response for basis in self.basis(data)]
        axes = 0.1 * data.span * np.eye(response.shape[1])
        return [basis[:, None] * axis for axis in axes for basis in self.basis(data)]


def max_levels(data: ChannelData) -> int:
    """Most levels of a text column that the trials are enough to compare."""
    return data.history.n_trials // data.rules.trials_per_level


def text_covariates(column: str, data: ChannelData) -> list[Covariate]:
    """Both forms for a text column; none if it has one level, or hardly any level twice."""
    text = data.history.text(column)
    per_trial = text[data.history.starts[:-1]]
    names, counts = np.unique(per_trial, return_counts=True)
    used = tuple(map(str, names[counts >= 2]))
    if not (2 <= names.size <= max_levels(data) and used):
        return []
    # On the compliance one level is the reference; an added one may be of any level, so that
    # what is added to one of them alone is not taken for a zero offset beside the others; the two
    # are never in one model (`candidates.confounded`).
    every = len(used) == names.size
    levels = {"gain": used[1:] if every else used, "added": used}
    return [Covariate(column, "levels", how, levels=levels[how]) for how in HOWS]


def numeric_covariates(column: str, data: ChannelData) -> list[Covariate]:
    """Line and parabola, on the compliance and added; none if the column is constant."""
    values = data.history.column(column)
    finite = values[np.isfinite(values)]
    spread = float(finite.std()) if finite.size else 0.0
    if finite.size < 0.5 * values.size or spread <= 1e-9 * (1.0 + float(np.abs(finite).max())):
        return []
    line = Covariate(column, "polynomial", "gain", center=float(finite.mean()), scale=spread)
    return [replace(line, how=how, degree=degree) for degree in (1, 2) for how in HOWS]
