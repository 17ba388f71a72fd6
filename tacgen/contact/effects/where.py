"""The part of a log in which an effect acts: a region, a stretch of the session, an indenter."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import ConfigDict

from tacgen.contact.effects.history import LoadHistory
from tacgen.core.types import BoolArray

WhereColumn = Literal["trial", "x_mm", "y_mm", "radius_mm", "indenter"]


@dataclass(frozen=True, slots=True)
class Where:
    """Trials whose ``column`` is, on average, above one value and at most another, or is a text.

    Raises ``ValueError`` if it is no part of a log.
    """

    __pydantic_config__ = ConfigDict(extra="forbid", use_attribute_docstrings=True)

    column: WhereColumn
    """Column of the press log."""
    above: float = -math.inf
    """Values above this are in it."""
    up_to: float = math.inf
    """Values above this are not."""
    equals: str = ""
    """The text that the column has in it, such as the name of an indenter."""

    def __post_init__(self) -> None:
        limits = self.above > -math.inf or self.up_to < math.inf
        if self.column == "indenter":
            if not self.equals or limits:
                msg = "indenter needs `equals`, an indenter's name, and no limits"
                raise ValueError(msg)
        elif self.equals or not limits:
            msg = f"{self.column} needs a limit, `above` or `up_to`, and no `equals`"
            raise ValueError(msg)
        elif not self.above < self.up_to:
            msg = f"above = {self.above:g} is not below up_to = {self.up_to:g}"
            raise ValueError(msg)

    def holds(self, history: LoadHistory) -> BoolArray:
        """Whether each sample (N,) is in it; those of a trial without a number are not."""
        if self.equals:
            return history.is_text(self.column, self.equals)
        values = history.means_of_trials(self.column)[history.trial_index]
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
        """The keys and values of a file that state it."""
        limits = {"above": self.above, "up_to": self.up_to}
        finite = {name: value for name, value in limits.items() if math.isfinite(value)}
        return {"column": self.column, **finite, **({"equals": self.equals} if self.equals else {})}

    def __str__(self) -> str:
        """In words, as in "only in trials after 31"."""
        if self.equals:
            return f"with the {self.column} {self.equals}"
        after, up_to = ("after", "up to") if self.is_stretch else (">", "≤")
        limits = [
            f"{word} {limit:.4g}"
            for word, limit in ((after, self.above), (up_to, self.up_to))
            if math.isfinite(limit)
        ]
        if self.is_stretch:
            return f"in trials {' and '.join(limits)}"
        name, _, unit = self.column.rpartition("_")
        return f"at {name} {' and '.join(limits)} {unit}"
