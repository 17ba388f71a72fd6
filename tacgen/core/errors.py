"""Errors that a user can fix; the command line turns each into one message and exit code 2."""

import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from importlib.util import find_spec

MOST_LETTERS, MOST_LINES = 1500, 200  # of a message; what is cut out comes from a file, as a rule

_CONTROL = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]"
)
"""What steers a terminal or turns the direction of writing, and what is no letter."""


def readable(text: str) -> str:
    """A message in which what a file holds is neither endless nor steers the terminal."""
    lines = text.split("\n")
    if len(lines) > MOST_LINES:
        lines = [*lines[:MOST_LINES], f"… and {len(lines) - MOST_LINES} more lines"]
    third = MOST_LETTERS // 3
    shown = [
        line if len(line) <= MOST_LETTERS else f"{line[: 2 * third]} … {line[-third:]}"
        for line in lines
    ]
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], "\n".join(shown))


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`` (did you mean 'x'?)`` with the known name that resembles ``name``; empty if none does."""
    near = get_close_matches(name, list(known), n=1, cutoff=0.6)
    return f" (did you mean {near[0]!r}?)" if near else ""


class TacgenError(Exception):
    """Wrong input: the message says what is wrong, where, and how to fix it."""

    exit_code = 2

    def __init__(self, message: str = "") -> None:
        super().__init__(readable(str(message)))

    @classmethod
    def from_problems(cls, problems: Sequence[str]) -> "TacgenError":
        """One error that lists every problem found, a line each."""
        return cls("\n".join(dict.fromkeys(problems)))

    @classmethod
    def raise_if(cls, problems: Sequence[str]) -> None:
        """Raise one error that lists every problem, if there are any."""
        if problems:
            raise cls.from_problems(problems)


def require_known(what: str, value: str, known: Iterable[str], error: type[TacgenError]) -> None:
    """Raise ``error``, which lists what is known, unless ``value`` is among it."""
    known = list(known)
    if value not in known:
        near = did_you_mean(value, known)
        msg = f"{what} {value!r} is not known{near}; give one of {', '.join(known)}"
        raise error(msg)


class Interrupted(BaseException):
    """Ctrl-C or a request to terminate; passes through ``except Exception`` as it should."""


class RecipeError(TacgenError):
    """A recipe, sensor or object description that cannot be used."""


class ObjectError(TacgenError):
    """An object folder or mesh that cannot be used."""


class PhysicsError(TacgenError):
    """A simulation that cannot be set up on this machine."""


class ContactError(TacgenError):
    """A contact problem with no solution, or a contact law that cannot be used."""


class TableError(TacgenError):
    """A lookup table that cannot be read or does not fit the sensor."""


class SensorError(TacgenError):
    """A simulated sensor that is not attached, or attached to what is not there."""


class DatasetError(TacgenError):
    """A dataset that cannot be read, written or continued."""


class VerificationError(TacgenError):
    """A check that failed: the input was readable, what it holds is not right."""

    exit_code = 1


class PressError(TacgenError):
    """A press log or a set of press images that cannot be used."""


class LearningError(TacgenError):
    """Training or evaluation that cannot go on."""


class ClusterError(TacgenError):
    """Jobs that cannot be handed to a scheduler, or whose records cannot be read."""


EXTRAS = {
    "learn": ("torch", "transformers", "safetensors", "sklearn", "tensorboard"),
    "parquet": ("pyarrow",),
    "cluster": ("submitit",),
    "view": ("rerun",),
    "mcap": ("mcap",),
    "batch": ("warp",),
    "gym": ("gymnasium",),
}


def missing_extra(extra: str, purpose: str) -> str:
    """What ``purpose`` lacks of ``extra`` and how to install it; empty if nothing is missing."""
    missing = [name for name in EXTRAS[extra] if find_spec(name) is None]
    if not missing:
        return ""
    return (
        f"{purpose} {', '.join(missing)}, not installed here; install it with "
        f"`pip install 'tacgen[{extra}]'` (in a checkout: `make setup`)"
    )


def require_extra(extra: str, purpose: str, error: type[TacgenError]) -> None:
    """Raise ``error`` unless all packages of ``extra`` are installed."""
    if problem := missing_extra(extra, purpose):
        raise error(problem)
