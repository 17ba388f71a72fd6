"""The contact law: force history in, imprint volume and shear motion out.

V = k_n F_n and D = k_s F_s (Si et al. 2022, Eq. 1), plus the effects that a calibrated sensor was
found to show. The same law predicts a press log and drives the simulation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray

from tacgen.contact.effects import STAGES, Channel, Effect, LoadHistory, find_effect
from tacgen.core.arrays import FloatArray
from tacgen.core.errors import ContactError
from tacgen.core.files import write_text
from tacgen.core.records import Estimate

LawName = Literal["volume_linear", "linear_depth"]
LAWS: tuple[LawName, ...] = ("volume_linear", "linear_depth")
PUBLISHED_K_N_MM3_PER_N = 5.135
"""taxim-robot's slope of 200 039 px³/N at its 0.0295 mm/px."""
USUAL_K_S_MM_PER_N = 1.0
"""Assumed: summed marker motion a newton; a press log with shear gives a sensor's own."""

_ESTIMATES = {"k_n_mm3_per_n": "mm3/N", "k_s_mm_per_n": "mm/N", "k_depth_mm_per_n": "mm/N"}
_KEYS = ("law", *_ESTIMATES, "marker_pitch_mm", "effects", "provenance")


@dataclass(frozen=True, slots=True)
class FittedEffect:
    """An effect of the registry with fitted parameters; those not given have their identity."""

    name: str
    channel: str
    parameters: Mapping[str, Estimate]

    @property
    def values(self) -> dict[str, float]:
        """Parameter values, identities filled in."""
        given = {name: estimate.value for name, estimate in self.parameters.items()}
        return find_effect(self.channel, self.name).complete(given)


@dataclass(frozen=True, slots=True)
class ContactLaw:
    """A contact law and where it comes from.

    Attributes
    ----------
    law : str
        ``volume_linear`` (V = k_n F_n) or ``linear_depth`` (indentation = k_depth F_n, TACTO's).
    k_n_mm3_per_n, k_s_mm_per_n : Estimate
        Compliances; k_s is NaN where shear was never measured.
    marker_pitch_mm : float
        Pitch of the markers whose motion was summed to D; NaN where there were none.
    effects : tuple of FittedEffect
    k_depth_mm_per_n : Estimate, optional
        Needed by ``linear_depth`` alone.
    provenance : mapping
        Hashes of the data, versions, trial counts, held-out error.

    Raises
    ------
    ContactError
        Listing every parameter that is unknown, not finite or out of bounds.
    """

    law: LawName
    k_n_mm3_per_n: Estimate
    k_s_mm_per_n: Estimate = field(default_factory=lambda: Estimate(math.nan, math.nan, "mm/N"))
    marker_pitch_mm: float = math.nan
    effects: tuple[FittedEffect, ...] = ()
    k_depth_mm_per_n: Estimate | None = None
    provenance: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        problems = _law_problems(self)
        if problems:
            raise ContactError.from_problems(problems)

    @classmethod
    def default(cls) -> ContactLaw:
        """The published slope, and one millimetre of summed marker motion a newton."""
        return cls.linear(PUBLISHED_K_N_MM3_PER_N, USUAL_K_S_MM_PER_N)

    @classmethod
    def linear(
        cls, k_n_mm3_per_n: float, k_s_mm_per_n: float = math.nan, marker_pitch_mm: float = math.nan
    ) -> ContactLaw:
        """V = k_n F_n and D = k_s F_s and nothing else."""
        return cls(
            "volume_linear",
            Estimate(k_n_mm3_per_n, 0.0, "mm3/N"),
            Estimate(k_s_mm_per_n, 0.0, "mm/N"),
            marker_pitch_mm,
        )

    def predict(
        self, columns: Mapping[str, ArrayLike], *, simulate: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Imprint volume and summed marker motion of every row of a log.

        Parameters
        ----------
        columns : mapping of name to (N,) array, or a data frame
            Columns of a press log (tacgen's units); rows in any order. Each trial starts from
            rest, and what happens in it carries through its samples.
        simulate : bool
            The columns are a simulated grasp: effects of the measurement (zero offset, latency,
            drift with the session) do not act, nor do effects whose columns are missing
            (no thermometer, say), which then stay at their reference.

        Returns
        -------
        volume_mm3 : (N,) float64
            At least 0 when simulating; in a log, noise about 0 N shows.
        shear_mm : (N, 2) float64
            Along the gel's x and y; 0 where the log has no shear force.

        Raises
        ------
        ContactError
            If a column that an effect needs is missing, or a required one is not finite.
        """
        history = LoadHistory(columns)
        if not simulate:
            _require_columns(self, history)
        volume = history.unsorted(self._respond(history, "normal", simulate))[:, 0]
        shear = history.unsorted(self._respond(history, "shear", simulate))
        volume = np.maximum(volume, 0.0) if simulate else volume
        return volume.astype(np.float64, copy=False), shear.astype(np.float64, copy=False)

    def predict_depth(self, columns: Mapping[str, ArrayLike]) -> FloatArray:
        """Indentation (N,) in mm of a ``linear_depth`` law, for a simulated grasp.

        Raises
        ------
        ContactError
            If the law is not ``linear_depth``.
        """
        if self.law != "linear_depth" or self.k_depth_mm_per_n is None:
            msg = f"law {self.law!r} gives a volume; only linear_depth gives a depth by itself"
            raise ContactError(msg)
        history = LoadHistory(columns)
        load = history.unsorted(self._respond(history, "normal", True, compliance=1.0))[:, 0]
        return np.maximum(load, 0.0) * self.k_depth_mm_per_n.value

    def _respond(
        self,
        history: LoadHistory,
        channel: Channel,
        simulate: bool,
        compliance: float | None = None,
    ) -> FloatArray:
        acting = []
        for fitted in self.effects:
            effect = find_effect(fitted.channel, fitted.name)
            left_out = simulate and not (effect.in_simulation and history.has(*effect.needs))
            if effect.channel == channel and not left_out:
                acting.append((effect, fitted.values))
        if compliance is None:
            estimate = self.k_n_mm3_per_n if channel == "normal" else self.k_s_mm_per_n
            compliance = 0.0 if math.isnan(estimate.value) else estimate.value
        return respond(history, channel, compliance, acting)


def respond(
    history: LoadHistory,
    channel: Channel,
    compliance: float,
    effects: Sequence[tuple[Effect, Mapping[str, float]]],
) -> FloatArray:
    """Volume (N, 1) or shear motion (N, 2) of a history's samples, in the history's order.

    ``effects`` act in the order of their stages, whatever the order they are given in; every
    parameter must be given.
    """
    load = history.load(channel)
    acting = sorted(effects, key=lambda pair: STAGES.index(pair[0].stage))
    for effect, parameters in acting:
        if effect.stage != "output":
            load = effect.apply(load, history, parameters)
    result = compliance * load
    for effect, parameters in acting:
        if effect.stage == "output":
            result = effect.apply(result, history, parameters)
    return result


def _law_problems(law: ContactLaw) -> list[str]:
    """Everything that is wrong with a law."""
    problems = []
    if law.law not in LAWS:
        problems.append(f"law = {law.law!r} is unknown; there are {', '.join(LAWS)}")
    if not (math.isfinite(law.k_n_mm3_per_n.value) and law.k_n_mm3_per_n.value > 0):
        problems.append(f"k_n_mm3_per_n = {law.k_n_mm3_per_n.value} is not a positive number")
    if not math.isnan(law.k_s_mm_per_n.value) and not law.k_s_mm_per_n.value > 0:
        problems.append(f"k_s_mm_per_n = {law.k_s_mm_per_n.value} is not a positive number")
    if law.law == "linear_depth":
        depth = law.k_depth_mm_per_n
        if depth is None or not (math.isfinite(depth.value) and depth.value > 0):
            problems.append("linear_depth needs a positive k_depth_mm_per_n (mm of depth per N)")
    seen = set()
    for index, fitted in enumerate(law.effects):
        where = f"effects[{index}] ({fitted.name})"
        if (fitted.channel, fitted.name) in seen:
            problems.append(f"{where} is given twice")
        seen.add((fitted.channel, fitted.name))
        problems += _effect_problems(where, fitted)
    return problems


def _effect_problems(where: str, fitted: FittedEffect) -> list[str]:
    try:
        effect = find_effect(fitted.channel, fitted.name)
    except ContactError as error:
        return [f"{where}: {error}"]
    problems = []
    for name, estimate in fitted.parameters.items():
        parameter = effect.parameter(name)
        if parameter is None:
            known = ", ".join(p.name for p in effect.parameters)
            problems.append(f"{where}: parameter {name!r} is unknown; there are {known}")
        elif math.isnan(estimate.value) or not (parameter.low <= estimate.value <= parameter.high):
            problems.append(
                f"{where}: {name} = {estimate.value:g} is not in "
                f"[{parameter.low:g}, {parameter.high:g}] {parameter.unit}"
            )
    return problems


def _require_columns(law: ContactLaw, history: LoadHistory) -> None:
    """Raise a ``ContactError`` for columns that the law's effects need and the log lacks."""
    problems = []
    for fitted in law.effects:
        effect = find_effect(fitted.channel, fitted.name)
        lacking = [name for name in effect.needs if not history.has(name)]
        if lacking:
            problems.append(
                f"the law's effect {fitted.name!r} needs the column {', '.join(lacking)}, "
                "which the log lacks; add it, or predict with simulate=True to leave it neutral"
            )
    if problems:
        raise ContactError.from_problems(problems)


def save_law(law: ContactLaw, path: Path) -> None:
    """Write ``contact.yaml``, whole or not at all."""
    content: dict[str, Any] = {"law": law.law}
    for key in _ESTIMATES:
        estimate = getattr(law, key)
        if estimate is not None:
            content[key] = {"value": float(estimate.value), "stderr": float(estimate.stderr)}
    content["marker_pitch_mm"] = float(law.marker_pitch_mm)
    content["effects"] = [
        {
            "name": fitted.name,
            "channel": fitted.channel,
            "parameters": {
                name: {
                    "value": float(estimate.value),
                    "stderr": float(estimate.stderr),
                    "unit": estimate.unit,
                }
                for name, estimate in fitted.parameters.items()
            },
        }
        for fitted in law.effects
    ]
    content["provenance"] = _plain(law.provenance)
    write_text(Path(path), yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def load_law(path: Path | str) -> ContactLaw:
    """Read a ``contact.yaml``.

    Raises
    ------
    ContactError
        If the file is missing or is not a contact law; the message lists every problem.
    """
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        msg = f"{path}: no such contact law; `tacgen calibrate contact` makes one"
        raise ContactError(msg) from None
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        msg = f"{path}: cannot be read as a contact law: {error}"
        raise ContactError(msg) from None
    problems = _content_problems(content)
    if problems:
        raise ContactError.from_problems([f"{path}: {problem}" for problem in problems])
    estimates = {
        key: _estimate(content[key], unit)
        for key, unit in _ESTIMATES.items()
        if content.get(key) is not None
    }
    pitch = content.get("marker_pitch_mm")
    try:
        return ContactLaw(
            law=content["law"],
            marker_pitch_mm=math.nan if pitch is None else float(pitch),
            effects=tuple(_effect(entry) for entry in content.get("effects") or []),
            provenance=MappingProxyType(content.get("provenance") or {}),
            **estimates,
        )
    except ContactError as error:
        raise ContactError.from_problems(
            [f"{path}: {line}" for line in str(error).splitlines()]
        ) from None


def _effect(entry: Mapping[str, Any]) -> FittedEffect:
    parameters = {
        str(name): _estimate(value, "") for name, value in (entry.get("parameters") or {}).items()
    }
    return FittedEffect(str(entry["name"]), str(entry["channel"]), MappingProxyType(parameters))


def _estimate(value: Any, unit: str) -> Estimate:
    if isinstance(value, Mapping):
        stderr = value.get("stderr")
        return Estimate(
            float(value["value"]),
            math.nan if stderr is None else float(stderr),
            str(value.get("unit", unit)),
        )
    return Estimate(float(value), math.nan, unit)


def _content_problems(content: Any) -> list[str]:
    if not isinstance(content, Mapping):
        return ["is not a contact law: a mapping with `law` and `k_n_mm3_per_n` is expected"]
    problems = [
        f"{key} is unknown; a contact law has {', '.join(_KEYS)}"
        for key in content
        if key not in _KEYS
    ]
    problems += [
        f"{key} is missing" for key in ("law", "k_n_mm3_per_n") if content.get(key) is None
    ]
    for key in _ESTIMATES:
        if content.get(key) is not None:
            problems += _estimate_problems(key, content[key])
    pitch = content.get("marker_pitch_mm")
    if pitch is not None and not _is_number(pitch):
        problems.append(f"marker_pitch_mm = {pitch!r} is not a number")
    if not isinstance(content.get("provenance") or {}, Mapping):
        problems.append("provenance is not a mapping")
    entries = content.get("effects") or []
    if not isinstance(entries, list):
        return [*problems, "effects is not a list"]
    for index, entry in enumerate(entries):
        where = f"effects[{index}]"
        if not isinstance(entry, Mapping) or not {"name", "channel"} <= set(entry):
            problems.append(f"{where} lacks name or channel")
        elif not isinstance(entry.get("parameters") or {}, Mapping):
            problems.append(f"{where}.parameters is not a mapping")
        else:
            for name, value in (entry.get("parameters") or {}).items():
                problems += _estimate_problems(f"{where}.parameters.{name}", value)
    return problems


def _estimate_problems(where: str, value: Any) -> list[str]:
    numbers = [value.get("value") if isinstance(value, Mapping) else value]
    if isinstance(value, Mapping) and value.get("stderr") is not None:
        numbers.append(value["stderr"])
    if not all(_is_number(number) for number in numbers):
        return [f"{where} = {value!r} is not a number nor {{value, stderr}}"]
    return []


def _is_number(value: Any) -> bool:
    """Whether it is a number that a float can be; YAML has integers without end."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and (isinstance(value, float) or abs(value) < 1 << 1000)


def _plain(value: Any) -> Any:
    """``value`` in types that YAML knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return value
