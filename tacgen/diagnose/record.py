"""Verdict, sentence and ``diagnosis.json`` of a diagnosis, the same for every kind of data."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from tacgen.core.files import write_text
from tacgen.report.formatting import unit_text

SCHEMA = 1  # of diagnosis.json; a key that changes its meaning makes it 2
Verdict = Literal["sufficient", "effect_found", "unexplained"]
VERDICTS: tuple[Verdict, ...] = ("unexplained", "effect_found", "sufficient")


def verdict_of(found: object, remaining: object) -> Verdict:
    """``unexplained`` if structure is left, whatever was found."""
    if remaining:
        return "unexplained"
    return "effect_found" if found else "sufficient"


@dataclass(frozen=True, slots=True)
class Summary:
    """What a channel's diagnosis says in short, by errors on ``held`` held-out units.

    ``subject`` is the model without effects, ``lacking`` are the effects that were found, in words,
    ``remaining`` the covariates that the residual still follows. ``instead`` are the effects that
    the selection found where it was repeated without the held-out units, if they are others.
    """

    subject: str
    lacking: Sequence[str]
    remaining: Sequence[str]
    before: float
    after: float
    floor: float
    unit: str
    held: str
    instead: Sequence[str] | None = None

    @property
    def verdict(self) -> Verdict:
        """Of the whole channel."""
        return verdict_of(self.lacking, self.remaining)

    @property
    def sentence(self) -> str:
        """The verdict in one plain sentence."""
        unit = unit_text(self.unit)
        names, remaining = " and ".join(self.lacking), ", ".join(self.remaining)
        error = f"{self.before:.3g} {unit} on {self.held}"
        change = f"the error on {self.held} goes from {self.before:.3g} to {self.after:.3g} {unit}"
        if self.instead is not None:
            others = " and ".join(self.instead) or "nothing"
            change = f"the same search without the {self.held} finds {others}; there {change}"
        floor = f"noise floor {self.floor:.3g} {unit}"
        if self.verdict == "sufficient":
            times = f"{self.before / self.floor:.2f} times the " if self.floor > 0 else ""
            return (
                f"{self.subject} is sufficient: nothing that was looked at explains more of the "
                f"error, {error}, {times}{floor}."
            )
        if self.verdict == "effect_found":
            with_them = "with it, " if len(self.lacking) == 1 else "with them, "
            with_them = "" if self.instead is not None else with_them
            return f"{self.subject} lacks {names}: {with_them}{change} ({floor})."
        if names:
            return (
                f"{self.subject} lacks {names} ({change}), and a residual that follows "
                f"{remaining} remains."
            )
        return (
            f"{self.subject} has a residual that follows {remaining} and that no listed effect "
            f"explains ({error}, {floor})."
        )


class Result(Protocol):
    """A channel's diagnosis."""

    @property
    def verdict(self) -> Verdict:
        """Whether the model suffices, lacks what was found, or leaves structure unexplained."""

    @property
    def sentence(self) -> str:
        """The verdict in plain words."""


class Summarised:
    """A channel's diagnosis whose verdict and sentence are those of a summary."""

    @property
    def summary(self) -> Summary:
        """What it says in short."""
        raise NotImplementedError

    @property
    def verdict(self) -> Verdict:
        """Whether the model suffices, lacks what was found, or leaves structure unexplained."""
        return self.summary.verdict

    @property
    def sentence(self) -> str:
        """The verdict in a plain sentence."""
        return self.summary.sentence


def channel_record(
    found: Result,
    *,
    effects: Sequence[Mapping[str, Any]],
    unexplained: Sequence[Mapping[str, Any]],
    errors: tuple[Mapping[str, Any], Mapping[str, Any]],
    noise_floor: tuple[float, str],
    trials: tuple[int, int],
    **more: Any,
) -> dict[str, Any]:
    """A channel of ``diagnosis.json``: the contract's keys and further ones.

    ``errors`` are those before and after, ``noise_floor`` is its RMSE and how it was measured,
    ``trials`` how many were fitted and tested.
    """
    (before, after), (floor, how) = errors, noise_floor
    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "effects": list(effects),
        "unexplained": list(unexplained),
        "error_before": before,
        "error_after": after,
        "noise_floor": {"rmse": finite(floor), "how": how},
        "trials": dict(zip(("fit", "test"), trials, strict=True)),
        **more,
    }


def diagnosis_record(
    channels: Mapping[str, Mapping[str, Any]], notes: Sequence[str] = ()
) -> dict[str, Any]:
    """The content of ``diagnosis.json``."""
    return {"schema": SCHEMA, "notes": list(notes), "channels": dict(channels)}


def write_record(record: Mapping[str, Any], out: Path) -> None:
    """Write ``diagnosis.json`` into the folder ``out``."""
    text = json.dumps(record, indent=1, ensure_ascii=False)
    write_text(out / "diagnosis.json", text + "\n")


def error(rmse: float, scale: float, unit: str, **more: Any) -> dict[str, Any]:
    """An error and the same over ``scale``, the size of what is measured."""
    relative = rmse / max(scale, 1e-300)
    return {"rmse": finite(rmse), "nrmse": finite(relative), "unit": unit, **more}


def estimate(value: float, stderr: float | None, unit: str) -> dict[str, Any]:
    """A value with its standard error; null where it is not known."""
    known = stderr is not None and math.isfinite(stderr)
    return {"value": finite(value), "stderr": stderr if known else None, "unit": unit}


def finite(value: float) -> float | None:
    """A float that JSON knows; what is not finite becomes null."""
    return float(value) if math.isfinite(value) else None
