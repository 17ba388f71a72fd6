"""The part of a log in which an effect acts: a region, a stretch of the session, an indenter."""

import math
from dataclasses import dataclass

import numpy as np
from pydantic import ConfigDict

from tacgen.contact.effects.history import LoadHistory
from tacgen.core.arrays import BoolArray


@dataclass(frozen=True, slots=True)
class Where:
    """Samples whose ``column`` is above one value and at most another, or equals a text."""

    __pydantic_config__ = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    column: str
    """Column of the press log."""
    above: float = -math.inf
    """Values above this are in it."""
    up_to: float = math.inf
    """Values above this are not."""
    equals: str = ""
    """The text that the column has in it, such as the name of an indenter."""

    def holds(self, history: LoadHistory) -> BoolArray:
        """Whether each sample (N,) is in it; those without a number are not."""
        if self.equals:
            return np.asarray(history.text(self.column) == self.equals)
        values = history.column(self.column)
        return np.asarray((values > self.above) & (values <= self.up_to))

    @property
    def is_stretch(self) -> bool:
        """Whether it is a stretch of the session."""
        return self.column == "trial"

    @property
    def is_over(self) -> bool:
        """Whether it is a stretch of the session that ended before the session did."""
        return self.is_stretch and self.up_to < math.inf

    @property
    def given(self) -> dict[str, str | float]:
        """What it was given, for a file."""
        limits = {"above": self.above, "up_to": self.up_to}
        finite = {name: value for name, value in limits.items() if math.isfinite(value)}
        return {"column": self.column, **finite, **({"equals": self.equals} if self.equals else {})}

    def __str__(self) -> str:
        """In words, as in "only in trials after 31"."""
        if self.equals:
            return f"with the {self.column} {self.equals}"
        name, _, unit = self.column.rpartition("_")
        low, high = (f"{limit:.4g}" for limit in (self.above, self.up_to))
        if self.is_stretch:
            return f"in trials after {low}" if math.isinf(self.up_to) else f"in trials up to {high}"
        if math.isinf(self.up_to):
            return f"at {name} > {low} {unit}"
        return f"at {name} ≤ {high} {unit}" + f" and > {low} {unit}" * math.isfinite(self.above)
