"""What an effect is, and the one registry of effects.

An effect takes the load of every sample (N, C), the load history and its parameters, and returns
the changed load. It also holds what the diagnosis, the virtual rig and the reports need to know
of it, so that adding one is adding a module that calls ``register``.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from tacgen.contact.effects.history import CHANNELS as CHANNELS
from tacgen.contact.effects.history import Channel as Channel
from tacgen.contact.effects.history import LoadHistory as LoadHistory
from tacgen.contact.effects.where import Where as Where
from tacgen.core.errors import ContactError
from tacgen.core.types import FloatArray as FloatArray

Stage = Literal["input", "memory", "elastic", "gain", "output"]
STAGES: tuple[Stage, ...] = ("input", "memory", "elastic", "gain", "output")
"""Where an effect acts, in this order: on the force that is read, on its memory, on the elastic
response (to what has crept, too), on the compliance, on the volume or motion that comes out."""

Role = Literal["amount", "shape", "reference"]
Parameters: TypeAlias = Mapping[str, float]
Apply: TypeAlias = Callable[[FloatArray, LoadHistory, Parameters], FloatArray]
Bounds: TypeAlias = Callable[[LoadHistory, Parameters], tuple[float, float]]

_LOGARITHMIC_UNITS = ("s", "N", "mm3", "trials")
MIN_GAIN = 0.02  # least factor on the compliance: beyond the fitted range a gel stays a gel
LIGHT_SHARE = 0.02  # of a reference load that stands for none
_MIN_RATIO = 1e-3  # keeps the logarithm of a ratio finite


@dataclass(frozen=True, slots=True)
class Parameter:
    """One number of an effect.

    ``identity`` is its default; with every ``amount`` at its identity the effect changes nothing.
    A ``shape`` (an exponent, a time constant) says how the amount acts and is fitted with it; a
    ``reference`` (a load, a time) is set, not fitted. ``bounds`` narrows ``low`` to ``high`` to
    what a given log can determine; ``of_response`` marks a reference that is the span of the
    measured response. An amount that ``is_free`` is one of many that together give the effect any
    shape: no variant frees it, a fit adds all of them to a variant (``Effect.corrected``).
    """

    name: str
    unit: str
    role: Role
    identity: float
    low: float
    high: float
    bounds: Bounds | None = None
    of_response: bool = False
    is_free: bool = False

    @property
    def is_logarithmic(self) -> bool:
        """Whether a fit searches it on a logarithmic scale: times, forces and limits."""
        return self.low > 0 and (np.isinf(self.identity) or self.unit in _LOGARITHMIC_UNITS)

    def bounds_on(self, history: LoadHistory, values: Parameters) -> tuple[float, float]:
        """Bounds of a fit to ``history``, ``values`` being the effect's parameters."""
        if self.bounds is None:
            return self.low, self.high
        low, high = self.bounds(history, values)
        return max(low, self.low), min(high, self.high)


@dataclass(frozen=True, slots=True)
class Variant:
    """One form of an effect: a starting point for its fit.

    ``probes`` are settings of the amounts, one for each column of the linearised model; ``shapes``
    are held while probing; ``free`` are the parameters fitted afterwards. Where ``scales`` is
    false the amounts do not act linearly (a limit) and the fit starts from the probe itself.
    ``prior_sd`` is the standard deviation about 0 that a fit expects of free amounts.
    """

    label: str
    probes: tuple[Parameters, ...]
    free: tuple[str, ...]
    shapes: Parameters = field(default_factory=dict)
    scales: bool = True
    prior_sd: float = np.inf

    @property
    def form(self) -> tuple[object, ...]:
        """Its function: variants of one form differ only in where their fit starts."""
        held = {name: value for name, value in self.shapes.items() if name not in self.free}
        return self.free, tuple(sorted(held.items()))


@dataclass(frozen=True, slots=True)
class Effect:
    """An effect on one channel, by its name.

    ``apply`` turns load (N, C), history and parameters into the changed load (N, C), and
    ``apply_at_end`` what comes out of all effects, in mm³ or mm, likewise; of the samples before
    it sees only what an operator of the history (``low_pass``, ``play``, …) makes of them, whose
    state then goes from reading to reading in a simulation. ``variants`` gives the
    forms that a fit starts from, ``references`` the reference values on a history. ``needs`` are
    columns that it cannot do without; ``is_identifiable`` says whether a history varies in what
    it follows; with ``needs_session_clock`` it has no meaning where the clock
    restarts with every trial. ``in_simulation`` is false for what belongs to the measurement (a
    gauge's zero, two clocks, the session). ``per_indenter`` allows further parameters
    ``gain_<indenter>``. ``is_of_trials`` is true of what follows the place, the indenter or the
    session anyway, ``is_local`` of what shows only where it acts in a part of the log: ``where``.
    Its residual is plotted against ``shown_against``. ``separated_by`` names other effects (or
    covariates) that it can be confused with, and the measurement that separates the two.
    """

    name: str
    channel: Channel
    stage: Stage
    about: str
    parameters: tuple[Parameter, ...]
    apply: Apply
    variants: Callable[[LoadHistory, Parameters], tuple[Variant, ...]]
    apply_at_end: Apply | None = None
    references: Callable[[LoadHistory], dict[str, float]] = lambda history: {}
    needs: tuple[str, ...] = ()
    needs_session_clock: bool = False
    in_simulation: bool = True
    per_indenter: bool = False
    is_of_trials: bool = False
    is_local: bool = False
    where: Where | None = None
    is_identifiable: Callable[[LoadHistory], bool] = lambda history: True
    shown_against: str = "load"
    separated_by: Mapping[str, str] = field(default_factory=dict)

    def __reduce__(self) -> tuple[Callable[..., "Effect"], tuple[str, str, Where | None]]:
        """Between processes it goes by its name: most of its functions have none."""
        return _registered, (self.channel, self.name, self.where)

    def parameter(self, name: str) -> Parameter:
        """Its parameter called ``name``; raises ``ContactError`` if it has none."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        if self.per_indenter and name.startswith("gain_"):
            return Parameter(name, "1", "amount", 0.0, -0.9, 5.0)
        known = ", ".join(parameter.name for parameter in self.parameters)
        msg = f"parameter {name!r} is unknown; there are {known}"
        raise ContactError(msg)

    def complete(self, parameters: Parameters) -> dict[str, float]:
        """``parameters`` with the identity for every one that is not given."""
        return {p.name: p.identity for p in self.parameters} | dict(parameters)

    @property
    def free_amounts(self) -> tuple[str, ...]:
        """Names of its free amounts."""
        return tuple(one.name for one in self.parameters if one.is_free)

    def corrected(self, form: Variant, prior_sd: float) -> Variant:
        """``form`` with all free amounts: any shape, near that of ``form`` unless data differ."""
        label, free = f"{form.label}, corrected", (*form.free, *self.free_amounts)
        return replace(form, label=label, free=free, prior_sd=prior_sd)

    def can_act_on(self, history: LoadHistory) -> bool:
        """Whether the log has the columns that it needs and varies in them.

        At one displacement alone nothing shows what another load does.
        """
        is_whole = self.where is None and self.is_local
        is_of_load = self.stage in ("input", "elastic", "output")
        is_seen = history.is_moved(self.channel) or not is_of_load
        can_act = history.has(*self.needs) and is_seen and not is_whole
        return can_act and self.is_identifiable(history)

    def only(self, where: Where | None) -> "Effect":
        """The same effect, but with the load unchanged outside of ``where``, if there is one.

        What is 1 at a reference load over a whole log may also be so at no load: then the part has
        the compliance of the rest where it is pressed lightly.
        """
        if where is None:
            return self

        def within(apply: Apply) -> Apply:
            def only_there(load: FloatArray, history: LoadHistory, p: Parameters) -> FloatArray:
                return np.where(where.holds(history)[:, None], apply(load, history, p), load)

            return only_there

        def variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
            forms = []
            for one in self.variants(history, references):
                forms.append((one, one.label, dict(one.shapes)))
                # Below 0 an exponent levels off: from no load that would be a change of compliance.
                if "reference_n" in references and one.shapes.get("exponent", 0.0) > 0:
                    light = {"reference_n": LIGHT_SHARE * references["reference_n"]}
                    forms.append((one, f"{one.label} from no load", {**one.shapes, **light}))
            return tuple(
                replace(v, label=f"{label}, only {where}", shapes=shapes)
                for v, label, shapes in forms
            )

        return replace(
            self,
            apply=within(self.apply),
            apply_at_end=self.apply_at_end and within(self.apply_at_end),
            variants=variants,
            needs=(*self.needs, where.column),
            where=where,
        )


_REGISTRY: dict[tuple[str, str], Effect] = {}


def register(effect: Effect) -> Effect:
    """Add ``effect`` to the registry.

    Raises ``ContactError`` if the channel already has an effect of that name.
    """
    key = (effect.channel, effect.name)
    if key in _REGISTRY:
        msg = f"effect {effect.name!r} of the {effect.channel} channel is registered twice"
        raise ContactError(msg)
    _REGISTRY[key] = effect
    return effect


def all_effects() -> tuple[Effect, ...]:
    """Every registered effect."""
    return tuple(_REGISTRY.values())


def find_effect(channel: str, name: str) -> Effect:
    """The effect of that name.

    Raises ``ContactError`` if there is none; the message lists those there are.
    """
    if found := _REGISTRY.get((channel, name)):
        return found
    if channel not in CHANNELS:
        msg = f"channel {channel!r} is unknown; there are {', '.join(CHANNELS)}"
        raise ContactError(msg)
    known_names = [n for c, n in _REGISTRY if c == channel]
    msg = f"effect {name!r} is unknown; the {channel} channel has {', '.join(known_names)}"
    raise ContactError(msg)


def _registered(channel: str, name: str, where: Where | None) -> Effect:
    return find_effect(channel, name).only(where)


def separating_measurement(name: str, other: str) -> str | None:
    """The measurement that separates two effects (or an effect and a covariate), if any is known.

    Whichever of the two modules states it.
    """
    for effect in _REGISTRY.values():
        for this, that in ((name, other), (other, name)):
            if effect.name == this and that in effect.separated_by:
                return effect.separated_by[that]
    return None


def amount(
    name: str,
    low: float,
    high: float,
    unit: str = "1",
    identity: float = 0.0,
    bounds: Bounds | None = None,
) -> Parameter:
    """A parameter that makes the effect vanish at its identity."""
    return Parameter(name, unit, "amount", identity, low, high, bounds)


def free_amounts(name: str, count: int) -> tuple[Parameter, ...]:
    """Free amounts ``name_1`` to ``name_<count>``."""
    return tuple(
        Parameter(f"{name}_{k}", "1", "amount", 0.0, -10.0, 10.0, is_free=True)
        for k in range(1, count + 1)
    )


def shape(
    name: str, low: float, high: float, start: float, unit: str = "1", bounds: Bounds | None = None
) -> Parameter:
    """A parameter that says how an amount acts."""
    return Parameter(name, unit, "shape", start, low, high, bounds)


def reference(
    name: str, unit: str, default: float = 1.0, *, of_response: bool = False
) -> Parameter:
    """A parameter that is set from the log, not fitted."""
    return Parameter(name, unit, "reference", default, -np.inf, np.inf, of_response=of_response)


def variant(
    label: str,
    probes: Sequence[Parameters],
    shapes: Parameters | None = None,
    *,
    fitted: Sequence[str] | None = None,
    scales: bool = True,
) -> Variant:
    """A ``Variant`` that frees every probed amount and the ``fitted`` shapes, by default all."""
    shapes = shapes or {}
    amounts = [name for probe in probes for name in probe]
    free = tuple(dict.fromkeys([*amounts, *(shapes if fitted is None else fitted)]))
    return Variant(label, tuple(probes), free, shapes, scales)


def share_of(reference: str, low: float, high: float) -> Bounds:
    """Bounds that are shares of one of the effect's reference values."""
    return lambda history, p: (low * p[reference], high * p[reference])


@dataclass(frozen=True, slots=True)
class Curve:
    """A function of any shape: a line from knot to knot, held beyond them, 0 by default."""

    name: str
    knots: tuple[float, ...]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its value at every knot: free amounts."""
        return free_amounts(self.name, len(self.knots))

    def __call__(self, at: FloatArray, p: Parameters) -> FloatArray:
        """Its values (N,) ``at`` (N,) the variable."""
        values = [p[f"{self.name}_{k}"] for k in range(1, len(self.knots) + 1)]
        return np.asarray(np.interp(at, self.knots, values)) if any(values) else np.zeros_like(at)


def power_shape(ratio: FloatArray, exponent: float) -> FloatArray:
    """(ratio^exponent − 1)/exponent, and log(ratio) at exponent 0: 0 and of slope 1 at ratio 1.

    Source: Box & Cox 1964.
    """
    log_ratio = np.log(np.maximum(ratio, _MIN_RATIO))
    if abs(exponent) < 1e-6:
        return log_ratio
    return np.expm1(exponent * log_ratio) / exponent


def with_gain(load: FloatArray, relative: FloatArray) -> FloatArray:
    """``load`` (N, C) times 1 + ``relative`` (N,), never turned round; NaN counts as 0."""
    gain = np.maximum(1.0 + np.where(np.isnan(relative), 0.0, relative), MIN_GAIN)
    return np.asarray(load * gain[:, None])


def limited(ratio: FloatArray, sharpness: float) -> FloatArray:
    """What is left of a quantity that has a limit, by its ratio to it: (1 + ratio^s)^(−1/s)."""
    log_ratio = np.log(np.maximum(ratio, 1e-12))
    return np.asarray(np.exp(-np.logaddexp(0.0, sharpness * log_ratio) / sharpness))


def varies(values: FloatArray) -> bool:
    """Whether the finite ``values`` are more than one."""
    finite = values[np.isfinite(values)]
    return bool(finite.size and np.ptp(finite) > 1e-9 * (1.0 + np.abs(finite).max()))
