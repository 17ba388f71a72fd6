"""The one registry of effects: what each is called, how it acts, and its parameters.

An effect takes the load of every sample (N, C), the load history and its parameters, and returns
the changed load. Adding one is adding a module that registers itself, and its test.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects.history import LoadHistory
from tacgen.core.errors import ContactError

Channel = Literal["normal", "shear"]
CHANNELS: tuple[Channel, ...] = ("normal", "shear")

Stage = Literal["input", "elastic", "memory", "gain", "output"]
STAGES: tuple[Stage, ...] = ("input", "elastic", "memory", "gain", "output")
"""Where an effect acts, in this order: on the force that is read, on the elastic response, on its
memory, on the compliance, on the volume or motion that comes out."""

Role = Literal["amount", "shape", "reference"]
Parameters = Mapping[str, float]
Apply = Callable[[NDArray[np.float64], LoadHistory, Parameters], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    ``identity`` is the value it has where nothing else is said; with every ``amount`` at its
    identity the effect changes nothing. A ``shape`` (an exponent, a time constant) says how the
    amount acts and is fitted with it; a ``reference`` (a load, a time) is set, not fitted.
    """

    name: str
    unit: str
    role: Role
    identity: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Variant:
    """One way in which an effect may show: a starting point for its fit.

    ``probes`` are settings of the amounts, one for each column of the linearised model; ``shapes``
    are held while probing; ``free`` are the parameters fitted afterwards. Where ``scales`` is
    false the amounts do not act linearly (a limit) and the fit starts from the probe itself.
    """

    label: str
    probes: tuple[Mapping[str, float], ...]
    free: tuple[str, ...]
    shapes: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    scales: bool = True


@dataclass(frozen=True, slots=True)
class Effect:
    """A named effect on one channel.

    ``needs`` are the columns it cannot do without. ``in_simulation`` is false for what belongs to
    the measurement (a gauge's zero, two clocks, the session) and not to the gel.
    ``per_indenter`` allows further parameters ``gain_<indenter>``.
    """

    name: str
    channel: Channel
    stage: Stage
    about: str
    parameters: tuple[Parameter, ...]
    apply: Apply
    references: Callable[[LoadHistory], dict[str, float]]
    variants: Callable[[LoadHistory, Parameters], tuple[Variant, ...]]
    needs: tuple[str, ...] = ()
    in_simulation: bool = True
    per_indenter: bool = False

    def parameter(self, name: str) -> Parameter | None:
        """Its parameter called ``name``, or None."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        if self.per_indenter and name.startswith("gain_"):
            return Parameter(name, "1", "amount", 0.0, -0.9, 5.0)
        return None

    def complete(self, parameters: Parameters) -> dict[str, float]:
        """``parameters`` with the identity for every one that is not given."""
        return {p.name: p.identity for p in self.parameters} | dict(parameters)


_REGISTRY: dict[tuple[Channel, str], Effect] = {}


def register(effect: Effect) -> Effect:
    """Add ``effect`` to the registry.

    Raises
    ------
    ContactError
        If the channel already has an effect of that name.
    """
    key = (effect.channel, effect.name)
    if key in _REGISTRY:
        msg = f"effect {effect.name!r} of the {effect.channel} channel is registered twice"
        raise ContactError(msg)
    _REGISTRY[key] = effect
    return effect


def effect_names(channel: Channel) -> tuple[str, ...]:
    """Names of the channel's effects, in the order of their registration."""
    return tuple(name for registered, name in _REGISTRY if registered == channel)


def all_effects() -> tuple[Effect, ...]:
    """Every registered effect."""
    return tuple(_REGISTRY.values())


def find_effect(channel: str, name: str) -> Effect:
    """The effect of that name.

    Raises
    ------
    ContactError
        If there is none; the message lists those there are.
    """
    for (registered, known), effect in _REGISTRY.items():
        if (registered, known) == (channel, name):
            return effect
    if channel not in CHANNELS:
        msg = f"channel {channel!r} is unknown; there are {', '.join(CHANNELS)}"
        raise ContactError(msg)
    known_names = [n for c, n in _REGISTRY if c == channel]
    msg = f"effect {name!r} is unknown; the {channel} channel has {', '.join(known_names)}"
    raise ContactError(msg)


def no_references(history: LoadHistory) -> dict[str, float]:
    """For effects that have no reference values."""
    return {}


def amount(name: str, low: float, high: float, unit: str = "1", identity: float = 0.0) -> Parameter:
    """A parameter that makes the effect vanish at its identity."""
    return Parameter(name, unit, "amount", identity, low, high)


def shape(name: str, low: float, high: float, start: float, unit: str = "1") -> Parameter:
    """A parameter that says how an amount acts."""
    return Parameter(name, unit, "shape", start, low, high)


def reference(name: str, unit: str, default: float = 1.0) -> Parameter:
    """A parameter that is set from the log, not fitted."""
    return Parameter(name, unit, "reference", default, -np.inf, np.inf)


def variant(
    label: str,
    probes: Sequence[Mapping[str, float]],
    shapes: Mapping[str, float] | None = None,
    *,
    fit_shapes: bool = True,
    scales: bool = True,
) -> Variant:
    """A ``Variant`` that frees every probed amount and, unless told otherwise, the shapes."""
    shapes = dict(shapes or {})
    amounts = [name for probe in probes for name in probe]
    free = tuple(dict.fromkeys([*amounts, *(shapes if fit_shapes else ())]))
    return Variant(label, tuple(probes), free, shapes, scales)
