"""Covariates that are no effect of the list, as columns that compete with those that are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.contact.channel import ChannelData

MAX_LEVELS_IF_FEW = 4
"""Levels of a text column that may be compared however few trials there are."""

How = Literal["gain", "added"]
HOWS: tuple[How, ...] = ("gain", "added")


@dataclass(frozen=True)
class Nuisance:
    """A dependence on ``covariate`` that acts on the compliance (``gain``) or is added.

    ``kind`` says of what form: ``levels`` of a text column, a ``polynomial`` in a numeric one, a
    ``wave`` of ``frequency_hz`` in the session's clock.
    """

    covariate: str
    kind: Literal["levels", "polynomial", "wave"]
    how: How
    levels: tuple[str, ...] = ()
    center: float = 0.0
    scale: float = 1.0
    degree: int = 1
    frequency_hz: float = 0.0
    n_outputs: int = 1
    p_search: float = 0.0
    """p of having found it among all frequencies that were looked at."""

    @property
    def n_columns(self) -> int:
        """Number of columns; ``added`` has its own for each output."""
        basis = {"levels": len(self.levels), "polynomial": self.degree, "wave": 2}[self.kind]
        return basis * (self.n_outputs if self.how == "added" else 1)

    @property
    def n_parameters(self) -> int:
        """Columns, and the frequency."""
        return self.n_columns + (self.kind == "wave")

    @property
    def label(self) -> str:
        """In words."""
        if self.kind == "wave":
            period = f"period {1 / self.frequency_hz:.4g} s"
            return f"oscillation in {self.covariate}, {period} ({self.how})"
        power = f", degree {self.degree}" if self.kind == "polynomial" else ""
        return f"{self.covariate} ({self.how}{power})"

    def basis(self, data: ChannelData) -> list[FloatArray]:
        """Functions of the covariate, each (N,)."""
        if self.kind == "levels":
            text = data.history.text(self.covariate)
            return [(text == level).astype(np.float64) for level in self.levels]
        values = data.history.column(self.covariate)
        if self.kind == "wave":
            phase = 2.0 * np.pi * self.frequency_hz * (values - self.center)
            return [np.cos(phase), np.sin(phase)]
        scaled = np.nan_to_num((values - self.center) / self.scale, nan=0.0)
        return [scaled**power for power in range(1, self.degree + 1)]

    def columns(self, data: ChannelData, response: FloatArray) -> list[FloatArray]:
        """Columns (N, C) of the linear model, scaled by the response or by its span."""
        if self.how == "gain":
            return [basis[:, None] * response for basis in self.basis(data)]
        axes = 0.1 * data.span * np.eye(response.shape[1])
        return [basis[:, None] * axis for axis in axes for basis in self.basis(data)]


def text_nuisances(covariate: str, data: ChannelData) -> list[Nuisance]:
    """Both forms for a text column; none if it has one level, or hardly any level twice."""
    text = data.history.text(covariate)
    per_trial = text[data.history.starts[:-1]]
    levels, counts = np.unique(per_trial, return_counts=True)
    if levels.size < 2 or levels.size > max(MAX_LEVELS_IF_FEW, data.history.n_trials // 3):
        return []
    used = tuple(str(level) for level, count in zip(levels, counts, strict=True) if count >= 2)
    if not used:
        return []
    # On the compliance one level is the reference; an added one may be of any level, so that
    # what is added to one of them alone is not taken for a zero offset beside the others.
    every = len(used) == levels.size
    return [
        Nuisance(
            covariate,
            "levels",
            how,
            levels=used[1:] if every and how == "gain" else used,
            n_outputs=data.n_outputs,
        )
        for how in HOWS
    ]


def numeric_nuisances(covariate: str, data: ChannelData) -> list[Nuisance]:
    """Line and parabola, on the compliance and added; none if the column is constant."""
    values = data.history.column(covariate)
    finite = values[np.isfinite(values)]
    spread = float(finite.std()) if finite.size else 0.0
    if finite.size < 0.5 * values.size or spread <= 1e-9 * (1.0 + float(np.abs(finite).max())):
        return []
    center = float(finite.mean())
    return [
        Nuisance(
            covariate,
            "polynomial",
            how,
            center=center,
            scale=spread,
            degree=degree,
            n_outputs=data.target.shape[1],
        )
        for degree in (1, 2)
        for how in HOWS
    ]
