"""The contact law: force history in, imprint volume and shear motion out.

V = k_n F_n and D = k_s F_s (Si et al. 2022, Eq. 1), plus the effects that a calibrated sensor was
found to show. The same law predicts a press log and drives the simulation.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from pydantic import BeforeValidator, ConfigDict, Field

from tacgen.contact.effects import (
    STAGES,
    Channel,
    Effect,
    LoadHistory,
    Where,
    find_effect,
)
from tacgen.contact.effects.history import Memory, Reading
from tacgen.core.errors import ContactError, RecipeError
from tacgen.core.files import write_text
from tacgen.core.records import Estimate
from tacgen.core.resources import newer_explains
from tacgen.core.schema import Section, YamlSource, read_yaml, validate
from tacgen.core.types import PUBLISHED_K_N_MM3_PER_N, FloatArray, k_n_doubt

LawName = Literal["volume_linear", "linear_depth"]
LAWS: tuple[LawName, ...] = ("volume_linear", "linear_depth")
PLAIN_UNITS = {"normal": ("mm3", "mm3/N"), "shear": ("mm", "mm/N")}
"""Units of the response and of the compliance."""
USUAL_K_S_MM_PER_N, USUAL_PITCH_MM = 1.0, 2.0
"""Assumed: summed motion a newton of markers so far apart; a press log with shear gives a sensor's
own."""
USUAL_FRICTION = 0.8
"""Coulomb's coefficient of gel and object, where nothing says it."""

_ESTIMATES = {
    "k_n_mm3_per_n": "mm3/N",
    "k_s_mm_per_n": "mm/N",
    "k_depth_mm_per_n": "mm/N",
    "friction": "",
    "decay_mm": "mm",
}


def _estimate(given: Any) -> Any:
    """A number, or a mapping with ``value`` and perhaps ``stderr`` and ``unit``."""
    if isinstance(given, Estimate):
        return given
    given = given if isinstance(given, Mapping) else {"value": given}
    return {key: one for key, one in given.items() if one is not None}


Given = Annotated[Estimate, BeforeValidator(_estimate)]


@dataclass(frozen=True, slots=True)
class FittedEffect:
    """An effect of the registry with fitted parameters; those not given have their identity.

    With ``where`` it acts in that part of a log only.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    name: str
    channel: str
    parameters: Mapping[str, Given] = field(default_factory=dict)
    where: Where | None = None

    @property
    def effect(self) -> Effect:
        """The effect of the registry, acting where this one does."""
        return find_effect(self.channel, self.name).only(self.where)

    @property
    def values(self) -> dict[str, float]:
        """Parameter values, identities filled in."""
        given = {name: estimate.value for name, estimate in self.parameters.items()}
        return self.effect.complete(given)

    def in_simulation(self, history: LoadHistory) -> Effect | None:
        """What acts on a simulated grasp, which comes after the session; None where nothing does.

        Effects of the measurement do not act, nor do those whose columns the grasp lacks, or whose
        stretch of the session is over; one that lasted to the session's end acts from then on.
        """
        is_over = self.where is not None and self.where.is_over
        lasts = self.where is not None and self.where.is_stretch
        effect = replace(self, where=None).effect if lasts else self.effect
        acts = effect.in_simulation and history.has(*effect.needs) and not is_over
        return effect if acts else None


@dataclass(frozen=True, slots=True)
class ContactLaw:
    """A contact law and where it comes from.

    ``volume_linear`` is V = k_n F_n, ``linear_depth`` (TACTO's) indentation = k_depth F_n, which
    needs ``k_depth_mm_per_n``; of it the object has to cover ``collision_margin_mm`` before it
    touches, see :meth:`simulated`. k_s is NaN where shear was never measured. D is a sum over
    a grid of markers, of pitch ``marker_pitch_mm``: each stands for its square, and ∫ u dA is D
    times that.
    NaN where the pitch is not known: then D is the sum over whatever markers a sensor has.
    ``friction`` is Coulomb's coefficient of gel and object, ``decay_mm`` how far beside a contact
    the gel moves with it (``tacgen.contact.shear_field``); None where they were not measured.
    ``provenance`` holds hashes of the data, versions, trial counts, held-out error.

    Raises ``ContactError`` listing every parameter that is unknown, not finite or out of bounds.
    """

    law: LawName
    k_n_mm3_per_n: Estimate
    k_s_mm_per_n: Estimate = field(default_factory=lambda: Estimate(math.nan, math.nan, "mm/N"))
    marker_pitch_mm: float = math.nan
    effects: tuple[FittedEffect, ...] = ()
    k_depth_mm_per_n: Estimate | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    friction: Estimate | None = None
    decay_mm: Estimate | None = None
    collision_margin_mm: float = 0.0

    def __post_init__(self) -> None:
        ContactError.raise_if(_law_problems(self))

    @classmethod
    def default(cls) -> "ContactLaw":
        """The published slope, and a millimetre a newton of the motion of markers 2 mm apart."""
        return cls.linear(PUBLISHED_K_N_MM3_PER_N, USUAL_K_S_MM_PER_N, USUAL_PITCH_MM)

    @classmethod
    def linear(
        cls, k_n_mm3_per_n: float, k_s_mm_per_n: float = math.nan, marker_pitch_mm: float = math.nan
    ) -> "ContactLaw":
        """V = k_n F_n and D = k_s F_s and nothing else."""
        k_n, k_s = Estimate(k_n_mm3_per_n, 0.0, "mm3/N"), Estimate(k_s_mm_per_n, 0.0, "mm/N")
        return cls("volume_linear", k_n, k_s, marker_pitch_mm)

    def predict(
        self, columns: Mapping[str, ArrayLike], *, simulate: bool = False
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Imprint volume and summed marker motion of every row of a log.

        ``columns`` are a press log's, (N,) each, rows in any order: a mapping or a data frame. What
        happens in a trial carries through its samples; it starts from rest, or where creep is
        ``carried`` from what the trials before it left, which must then be in the log. With
        ``simulate`` they are a simulated grasp: effects of the measurement (zero offset, latency,
        drift with the session) do not act, nor do effects whose columns are missing (no
        thermometer, say), which then stay at their reference, nor those of a stretch of the session
        that was over before it ended.

        Returns the volume (N,), mm³, at least 0 when simulating (in a log, noise about 0 N shows),
        and the motion (N, 2), mm, along the gel's x and y; 0 where the log has no shear force.

        Raises ``ContactError`` if a column that an effect needs is missing, or a required one is
        not finite.
        """
        history = LoadHistory(columns, measured=not simulate)
        if not simulate:
            _require_columns(self, history)
        volume = self._respond(history, "normal", self.k_n_mm3_per_n.value, simulate=simulate)[:, 0]
        shear = self._respond(history, "shear", self.k_s_mm_per_n.value, simulate=simulate)
        if simulate:
            volume = np.maximum(volume, 0.0)
        return (
            np.asarray(history.unsorted(volume), np.float64),
            np.asarray(history.unsorted(shear), np.float64),
        )

    def advance(self, row: Mapping[str, float], before: Memory) -> tuple[float, FloatArray, Memory]:
        """The response of a simulated gel to its newest load, and what it then remembers.

        ``row`` has the columns of a press log, ``before`` is the memory that the row before it
        left: empty for a gel at rest. Row after row gives the numbers of ``predict`` with
        ``simulate``, in a time that does not grow; the normal response is the indentation, mm, of
        a ``linear_depth`` law and else the volume, mm³.
        """
        reading = Reading(row, before)
        normal, shear = self.simulated(reading)
        return float(normal[0]), shear[0], reading.memory

    def simulated(
        self, history: LoadHistory, k_factor: float = 1.0
    ) -> tuple[FloatArray, FloatArray]:
        """The response of a simulated gel: normal (N,), and motion (N, 2) as of ``predict``.

        Normal is the volume in mm³, of a ``linear_depth`` law the indentation in mm: max(0, c F −
        g), c being k_depth. TACTO moves the object by c F towards the gel from where the physics
        has it, and there Bullet keeps the collision margin g between them: 1 mm around each convex
        hull. Below g / c newtons the contact is lost. ``k_factor`` multiplies k_n or k_depth.

        Source: ``adjust_with_force`` of TACTO; that of Si et al. 2022 adds the gap that it finds
        (``get_bias``). Bullet's ``gUrdfDefaultCollisionMargin``.
        """
        depth = self.k_depth_mm_per_n if self.law == "linear_depth" else None
        k_n = self.k_n_mm3_per_n.value if depth is None else 1.0
        normal = self._respond(history, "normal", k_n, simulate=True)[:, 0]
        if depth is not None:
            normal = normal * depth.value
        normal = np.maximum(normal * k_factor - self.collision_margin_mm, 0.0)
        shear = self._respond(history, "shear", self.k_s_mm_per_n.value, simulate=True)
        return history.unsorted(normal), history.unsorted(shear)

    def _respond(
        self, history: LoadHistory, channel: Channel, compliance: float, *, simulate: bool
    ) -> FloatArray:
        acting = []
        for fitted in self.effects:
            effect = fitted.in_simulation(history) if simulate else fitted.effect
            if effect is not None and effect.channel == channel:
                acting.append((effect, fitted.values))
        return respond(history, channel, 0.0 if math.isnan(compliance) else compliance, acting)


def respond(
    history: LoadHistory,
    channel: Channel,
    compliance: float,
    effects: Sequence[tuple[Effect, Mapping[str, float]]],
    known: dict[tuple[str | float, ...], FloatArray] | None = None,
) -> FloatArray:
    """Volume (N, 1) or shear motion (N, 2) of a history's samples, in the history's order.

    ``effects`` act in the order of their stages, whatever the order they are given in; every
    parameter must be given. What comes out of each is taken from, or added to, ``known``: a fit
    changes one parameter at a time.
    """
    result = history.load(channel)
    key: tuple[str | float, ...] = ()
    for stage in STAGES:
        if stage == "output":
            result, key = compliance * result, (*key, compliance)
        for effect, parameters in effects:
            if effect.stage == stage:
                key = (*key, effect.name, *parameters.values())
                if known is None or key not in known:
                    seen = history.seen_by((effect.channel, effect.name))
                    result = effect.apply(result, seen, parameters)
                    if known is not None:
                        known[key] = result
                else:
                    result = known[key]
    for effect, parameters in effects:
        if effect.apply_at_end is not None:
            result = effect.apply_at_end(result, history, parameters)
    return result


def _unit_problems(file: "LawFile") -> list[str]:
    """Units that are not tacgen's, and a k_n that no gel has unless its unit is stated."""
    given = {key: one for key in _ESTIMATES if (one := getattr(file, key)) is not None}
    problems = [
        f"{key}.unit = {one.unit!r} is not {_ESTIMATES[key]}; convert the value"
        for key, one in given.items()
        if one.unit.replace("³", "3") not in ("", _ESTIMATES[key])
    ]
    if not file.k_n_mm3_per_n.unit and (doubt := k_n_doubt(file.k_n_mm3_per_n.value)):
        problems.append(f"k_n_mm3_per_n {doubt}")
    return problems


def _law_problems(law: ContactLaw) -> list[str]:
    """Everything that is wrong with a law."""
    problems = []
    if law.law not in LAWS:
        problems.append(f"law = {law.law!r} is unknown; there are {', '.join(LAWS)}")
    if not (math.isfinite(law.k_n_mm3_per_n.value) and law.k_n_mm3_per_n.value > 0):
        problems.append(f"k_n_mm3_per_n = {law.k_n_mm3_per_n.value} is not a positive number")
    if not math.isnan(law.k_s_mm_per_n.value) and not law.k_s_mm_per_n.value > 0:
        problems.append(f"k_s_mm_per_n = {law.k_s_mm_per_n.value} is not a positive number")
    if not (math.isnan(law.marker_pitch_mm) or law.marker_pitch_mm > 0):
        problems.append(f"marker_pitch_mm = {law.marker_pitch_mm} is not a positive number")
    for name in ("friction", "decay_mm"):
        given = getattr(law, name)
        if given is not None and not (math.isfinite(given.value) and given.value > 0):
            problems.append(f"{name} = {given.value} is not a positive number")
    if law.law == "linear_depth":
        depth = law.k_depth_mm_per_n
        if depth is None or not (math.isfinite(depth.value) and depth.value > 0):
            problems.append("linear_depth needs a positive k_depth_mm_per_n (mm of depth per N)")
    margin_mm = law.collision_margin_mm
    if margin_mm and not (law.law == "linear_depth" and 0 < margin_mm < math.inf):
        problems.append(f"collision_margin_mm = {margin_mm:g} needs linear_depth, and 0 or more")
    seen = set()
    for index, fitted in enumerate(law.effects):
        where = f"effects[{index}] ({fitted.name})"
        if (fitted.channel, fitted.name) in seen:
            problems.append(f"{where} is given twice")
        seen.add((fitted.channel, fitted.name))
        problems += _effect_problems(where, fitted)
    return problems


def _effect_problems(where: str, fitted: FittedEffect) -> list[str]:
    problems = []
    try:
        effect = fitted.effect
    except ContactError as error:
        return [f"{where}: {error}"]
    if fitted.where is None and fitted.effect.is_local:
        problems.append(f"{where}: acts in a part of a log only; give `where`")
    for name, estimate in fitted.parameters.items():
        try:
            low, high = effect.parameter(name).low, effect.parameter(name).high
        except ContactError as error:
            problems.append(f"{where}: {error}")
            continue
        if not low <= estimate.value <= high:
            problems.append(f"{where}: {name} = {estimate.value:g} is not in [{low:g}, {high:g}]")
    return problems


def _require_columns(law: ContactLaw, history: LoadHistory) -> None:
    """Raise a ``ContactError`` for columns that the law's effects need and the log lacks."""
    needed = {one.name: one.effect.needs for one in law.effects}
    lacking = {key: [n for n in names if not history.has(n)] for key, names in needed.items()}
    problems = [
        f"the law's effect {name!r} needs the column {', '.join(columns)}, which the log lacks; "
        "add it, or predict with simulate=True to leave it neutral"
        for name, columns in lacking.items()
        if columns
    ]
    ContactError.raise_if(problems)


def save_law(law: ContactLaw, path: Path) -> None:
    """Write ``contact.yaml``, whole or not at all."""
    content: dict[str, Any] = {"law": law.law}
    for key in _ESTIMATES:
        estimate = getattr(law, key)
        if estimate is not None:
            content[key] = _numbers(estimate)
            if key == "k_n_mm3_per_n" and k_n_doubt(estimate.value):
                content[key]["unit"] = "mm3/N"  # as measured: it is read without a question
    content["marker_pitch_mm"] = float(law.marker_pitch_mm)
    if law.collision_margin_mm:
        content["collision_margin_mm"] = float(law.collision_margin_mm)
    content["effects"] = [
        {
            "name": fitted.name,
            "channel": fitted.channel,
            "parameters": {
                name: {**_numbers(estimate), "unit": estimate.unit}
                for name, estimate in fitted.parameters.items()
            },
            **({"where": fitted.where.given} if fitted.where else {}),
        }
        for fitted in law.effects
    ]
    content["provenance"] = json.loads(json.dumps(dict(law.provenance), default=_plain))
    write_text(Path(path), yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def _numbers(estimate: Estimate) -> dict[str, Any]:
    return {"value": float(estimate.value), "stderr": float(estimate.stderr)}


def _plain(value: Any) -> Any:
    """What JSON does not know: numbers of numpy, and mappings."""
    return value.item() if isinstance(value, np.generic) else dict(value)


def load_law(path: Path | str) -> ContactLaw:
    """Read a ``contact.yaml``.

    Raises
    ------
    ContactError
        If the file is missing or is not a contact law; the message lists every problem.

    Examples
    --------
    >>> tacgen.load_law("contact.yaml").k_n_mm3_per_n.value
    5.135
    """
    path = Path(path)
    if not path.exists():
        msg = f"{path}: no such contact law; `tacgen calibrate contact` makes one"
        raise ContactError(msg)
    try:
        source = read_yaml(path)
    except RecipeError as error:
        raise ContactError(str(error)) from None
    for key in [key for key, value in source.data.items() if value is None]:
        del source.data[key]
    provenance = source.data.get("provenance")
    versions = provenance.get("versions") if isinstance(provenance, dict) else None
    with newer_explains(path, versions.get("tacgen") if isinstance(versions, dict) else None):
        return _law_of(path, source)


def _law_of(path: Path, source: YamlSource) -> ContactLaw:
    file = validate(LawFile, source, ContactError)
    ContactError.raise_if([f"{path}: {line}" for line in _unit_problems(file)])
    estimates = {
        key: replace(given, unit=given.unit or unit)
        for key, unit in _ESTIMATES.items()
        if (given := getattr(file, key)) is not None
    }
    try:
        return ContactLaw(
            law=file.law,
            marker_pitch_mm=file.marker_pitch_mm,
            collision_margin_mm=file.collision_margin_mm,
            effects=file.effects,
            provenance=file.provenance,
            **estimates,
        )
    except ContactError as error:
        problems = [f"{path}: {line}" for line in str(error).splitlines()]
        raise ContactError.from_problems(problems) from None


class LawFile(Section):
    """The content of a ``contact.yaml``."""

    law: LawName
    k_n_mm3_per_n: Given
    k_s_mm_per_n: Given | None = None
    k_depth_mm_per_n: Given | None = None
    marker_pitch_mm: float = math.nan
    collision_margin_mm: float = 0.0
    friction: Given | None = None
    decay_mm: Given | None = None
    effects: tuple[FittedEffect, ...] = ()
    provenance: dict[str, Any] = Field(default_factory=dict)
