"""The recipe of a virtual rig session, checked whole before anything is pressed."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    Tag,
)

from tacgen.contact.ball_shear import Place
from tacgen.contact.effects import Where, find_effect
from tacgen.core.errors import ContactError
from tacgen.core.schema import KeyPath, Located, Section, YamlSource, load_checked
from tacgen.core.sensors import SensorByName, SensorChoice, sensor_problems
from tacgen.core.types import PUBLISHED_K_N_MM3_PER_N


def _ordered(values: tuple[float, float]) -> tuple[float, float]:
    if values[1] < values[0]:
        msg = f"runs from {values[0]:g} down to {values[1]:g}; put the smaller value first"
        raise ValueError(msg)
    return values


ORDERED = AfterValidator(_ordered)
Range = Annotated[tuple[FiniteFloat, FiniteFloat], ORDERED]
RangeFromZero = Annotated[tuple[NonNegativeFloat, FiniteFloat], ORDERED]
PositiveRange = Annotated[tuple[PositiveFloat, FiniteFloat], ORDERED]


def _kind(given: Any) -> str:
    return "range" if isinstance(given, (list, tuple)) else "number"


ONE_OR_RANGE = Discriminator(_kind)
Duration = Annotated[
    Annotated[NonNegativeFloat, Tag("number")] | Annotated[RangeFromZero, Tag("range")],
    ONE_OR_RANGE,
]
PositiveDuration = Annotated[
    Annotated[PositiveFloat, Tag("number")] | Annotated[PositiveRange, Tag("range")], ONE_OR_RANGE
]


class Indenter(Section):
    """A rigid ball."""

    name: str
    """Name in the press log."""
    radius_mm: PositiveFloat
    """Radius of the ball."""


class RigLaw(Section):
    """The true law of the gel."""

    k_n_mm3_per_n: PositiveFloat = PUBLISHED_K_N_MM3_PER_N
    """Indented volume per normal force."""
    k_s_mm_per_n: NonNegativeFloat = 0.8
    """Sum of the markers' motion per shear force."""


class Schedule(Located):
    """The presses: load, hold, shear out and back, unload, rest."""

    path_key: ClassVar[str] = "follow"

    presses: PositiveInt = 24
    """Number of presses."""
    force_n: PositiveRange = (2.0, 10.0)
    """Range from which each press's normal force is drawn."""
    shear_ratio: RangeFromZero = (0.1, 0.3)
    """Range from which each press's ratio of shear to normal force is drawn."""
    rate_hz: PositiveFloat = 20.0
    """Samples per second."""
    load_s: PositiveDuration = 1.0
    """Duration of loading, or the range it is drawn from; so for the three below."""
    hold_s: Duration = 1.5
    """Duration at full force."""
    shear_s: Duration = 1.5
    """Duration of shearing out and back."""
    unload_s: PositiveDuration = 1.0
    """Duration of unloading."""
    rest_s: NonNegativeFloat = 8.0
    """Pause after a press."""
    jitter: Annotated[float, Field(ge=0, lt=1)] = 0.2
    """Relative variation of every duration."""
    x_mm: Range = (-4.0, 4.0)
    """Range of the contact's centre along x, gel frame."""
    y_mm: Range = (-3.0, 3.0)
    """Range of the contact's centre along y, gel frame."""
    follow: Annotated[str, Field(min_length=1)] | None = None
    """CSV file of presses to make after these, as ``diagnose contact --rig`` proposes them; a path
    from the recipe's folder."""

    @property
    def follow_path(self) -> Path | None:
        """The path of ``follow``; None if the schedule follows no file."""
        return None if self.follow is None else (self.folder or Path()) / self.follow


class Noise(Section):
    """Standard deviations of the measurements."""

    force_n: NonNegativeFloat = 0.01
    """Noise of each force component."""
    volume_mm3: NonNegativeFloat = 0.2
    """Noise of the indented volume."""
    marker_sum_mm: NonNegativeFloat = 0.03
    """Noise of the sum of the markers' motion."""
    camera_grey: NonNegativeFloat = 1.0
    """Noise of each pixel, in grey levels."""


class Temperature(Section):
    """Room temperature: a sinusoid, measured by a thermometer."""

    mean_c: FiniteFloat = 23.0
    """Mean."""
    swing_c: NonNegativeFloat = 1.0
    """Amplitude."""
    period_s: PositiveFloat = 400.0
    """Period."""
    noise_c: NonNegativeFloat = 0.02
    """Standard deviation of a reading."""


class RigEffect(Section):
    """An effect of the contact law, by its parameters or by its strength."""

    name: str
    """Name of the effect, such as ``creep``."""
    channel: Literal["normal", "shear"] = "normal"
    """The channel that it changes."""
    strength: NonNegativeFloat | None = None
    """RMS residual of the best linear law over the channel's noise; sets the amplitudes."""
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict)
    """Values of the effect's parameters."""
    where: Where | None = None
    """The part of the log in which alone it acts, such as ``{column: x_mm, above: 2}``."""


class Images(Section):
    """Press images."""

    per_press: PositiveInt = 1
    """Images of each press, at evenly spaced loads."""
    markers: bool = False
    """Draw the gel's dots."""
    labels: bool = True
    """Write the true centre and radius of each contact to presses.csv."""
    blur_mm: NonNegativeFloat = 0.0
    """Standard deviation of the camera's blur, on the gel."""
    shadow: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Strength of shadows."""


class MarkerTracks(Section):
    """Tracks of the gel's dots, in markers.csv."""

    rate_hz: PositiveFloat = 5.0
    """Frames per second."""
    noise_mm: NonNegativeFloat = 0.004
    """Standard deviation of a dot's place, along each axis."""
    decay_mm: PositiveFloat = 1.5
    """How far the gel's motion reaches beside the contact."""
    friction: PositiveFloat | None = None
    """Coulomb's coefficient, by which the contact slips in part; null: all of it sticks."""
    place: Place | None = None
    """A place with another friction."""
    grid_turn_deg: FiniteFloat = 0.0
    """By how much the dots are printed turned, from x to y."""
    grid_shift_mm: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """By how much they are printed beside their places."""


def _effect(given: Any) -> Any:
    return {"name": given, "strength": 2.0} if isinstance(given, str) else given


EffectByName = Annotated[
    RigEffect, BeforeValidator(_effect, json_schema_input_type=str | RigEffect)
]


class RigRecipe(Section):
    """One session on the virtual rig."""

    name: str = "rig"
    """Name of the session."""
    seed: NonNegativeInt = 0
    """Seed of every random number."""
    output: Literal["log", "images", "both"] = "log"
    """Write press_log.csv, presses/ or both."""
    sensor: SensorByName = SensorChoice()
    """The sensor: a name, or a section with a name."""
    indenters: tuple[Indenter, ...] = (
        Indenter(name="ball_4mm", radius_mm=2.0),
        Indenter(name="ball_8mm", radius_mm=4.0),
        Indenter(name="ball_12mm", radius_mm=6.0),
    )
    """Balls, pressed in turn."""
    law: RigLaw = RigLaw()
    """Coefficients of the contact law."""
    schedule: Schedule = Schedule()
    """The presses."""
    noise: Noise = Noise()
    """Measurement noise."""
    temperature: Temperature | None = Temperature()
    """Room temperature; null: not logged."""
    effects: tuple[EffectByName, ...] = ()
    """Effects of the contact law: names (strength 2), or sections with a name."""
    images: Images = Images()
    """Press images."""
    markers: MarkerTracks | None = None
    """Marker tracks; null: none are written."""


def load_rig_recipe(name: str | Path) -> RigRecipe:
    """Read and check a rig recipe (a path, or the name of a shipped one).

    Raises ``RecipeError`` that lists everything that is wrong, each with its file, line and fix.
    """
    return load_checked(RigRecipe, name, _name_problems, _effect_problems)


def _name_problems(recipe: RigRecipe, source: YamlSource) -> Iterable[str]:
    if not recipe.indenters:
        yield source.problem(("indenters",), "is empty; give at least one ball")
    names = [indenter.name for indenter in recipe.indenters]
    yield from source.repeated("indenters", names, "rename one")
    drawn: KeyPath | None = ("images", "markers") if recipe.images.markers else None
    markers = drawn or (("markers",) if recipe.markers else None)
    yield from sensor_problems(recipe.sensor, source, markers)


def _effect_problems(recipe: RigRecipe, source: YamlSource) -> Iterable[str]:
    for i, given in enumerate(recipe.effects):
        where = ("effects", i)
        try:
            effect = find_effect(given.channel, given.name)
        except ContactError as error:
            yield source.problem(where, f"= {given.name!r}: {error}")
            continue
        for name in given.parameters:
            try:
                effect.parameter(name)
            except ContactError as error:
                key = (*where, "parameters", name)
                yield source.problem(key, f"is no parameter of it: {error}")
        if given.strength is None and not given.parameters:
            yield source.problem(where, "has neither strength nor parameters; give one of them")
        if effect.is_local and given.where is None:
            yield source.problem(where, "acts in a part of the log only; give `where`")
        names = [indenter.name for indenter in recipe.indenters]
        if given.where and given.where.equals not in ("", *names):
            message = f"= {given.where.equals!r} is no indenter; they are {', '.join(names)}"
            yield source.problem((*where, "where", "equals"), message)
        if "temperature_c" in effect.needs and recipe.temperature is None:
            yield source.problem(where, "needs a temperature; add a `temperature:` section")
        repeated = [(e.channel, e.name) for e in recipe.effects[:i]]
        if (given.channel, given.name) in repeated:
            yield source.problem(where, f"= {given.name!r} is given twice; keep one")
