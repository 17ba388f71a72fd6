"""What an optical effect is, and the one registry of them.

An effect is one module: a subclass of ``OpticalEffect`` that says where in the chain it stands,
which parameters it has, what it does to an image or a surface, and how ball presses may show it.
``register`` makes it known to the renderer, to the fits of ``tacgen diagnose optics`` and to their
reports.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import TableError
from tacgen.core.types import FloatArray, Window
from tacgen.optics.table import Leds, LookupTable

CHANNELS = ("r", "g", "b")
"""What names of parameters begin or end with where there is one for each channel."""


class Stage(IntEnum):
    """Where in the chain an effect acts; the renderer and the fits go through it in this order."""

    PRESS = 0
    """On where a ball is and how large: of presses alone, nothing that the renderer applies."""
    GEL = 1
    """On the gel's shape beside a contact: before the renderer, by the pad."""
    SURFACE = 2
    """On the height map, before the look-up."""
    SHADOW = 3
    """On the light of each lamp, which the gel's relief may hide."""
    FOCUS = 4
    """On the sharpness of the picture."""
    LIGHT = 5
    """On the strength of the light."""
    COLOR = 6
    """On the channels, which may leak into each other."""
    EXPOSURE = 7
    """On the camera's exposure."""
    LENS = 8
    """On what passes the lens."""
    CAMERA = 9
    """On the grey levels that the camera puts out."""


@dataclass(frozen=True, slots=True)
class OpticalParameter:
    """A number of an effect.

    Attributes
    ----------
    identity : float
        Where it does nothing.
    lower, upper : float
        How far a fit may go.
    unit : str
    step : float
        Step of the finite differences of a fit.
    prior : float
        Standard deviation, around the identity, that a fit holds it by; 0 for none.
    """

    identity: float
    lower: float
    upper: float
    unit: str = "1"
    step: float = 0.01
    prior: float = 0.0


@dataclass(frozen=True, slots=True)
class Patch:
    """What an effect may look at beside the image: some of its pixels, and where they lie.

    Attributes
    ----------
    background : (..., 3) float
        Grey levels of the gel at rest.
    u, v : float
        Position in the image, −½ to ½, as in the table; they broadcast to the pixels' shape.
    mm_per_px : float
    window : tuple of int
        Top, bottom, left, right of a patch that the renderer draws.
    height_mm : (H, W) float32, optional
        The whole deformed gel.
    time : float
        When in the session the picture was taken, from −½ to ½.
    """

    background: FloatArray
    u: FloatArray
    v: FloatArray
    mm_per_px: float
    window: Window = (0, 0, 0, 0)
    height_mm: NDArray[np.float32] | None = None
    time: float = 0.0


@dataclass(frozen=True, slots=True)
class PressScene:
    """What an effect may ask about the presses that are diagnosed.

    Attributes
    ----------
    contact_radius_mm : float
        Mean labelled radius of the contacts.
    ball_radii_mm : (N,) float
        Stated radius of each press's ball.
    mm_per_px : float
    has_table : bool
        Whether the table was fitted to other presses before, not to these.
    grey : (n, 3) float
        Grey levels of the pixels of all press images.
    """

    contact_radius_mm: float
    ball_radii_mm: FloatArray
    mm_per_px: float
    has_table: bool
    grey: FloatArray


@dataclass(frozen=True, slots=True)
class OpticalCandidate:
    """One way in which presses may show an effect: what a fit frees, and where it begins.

    Attributes
    ----------
    effect, label : str
        The effect's name, and the way in plain language.
    shared : mapping
        Parameters that all presses share.
    each : tuple of str
        Parameters that every press has its own value of: of its place where the effect acts on
        the presses, of its exposure where it acts on that.
    starts : tuple of mappings
        Values to begin with; of several, those from which the fit ends best.
    over_session : bool
        Whether it grows over the session: what else changes all presses alike cannot look so.
    evident : bool
        Whether something beside the error shows it: it is not one of many that are tried.
    rigid : bool
        Whether geometry gives its form, which bends to no other error of a table.
    """

    effect: str
    label: str
    shared: Mapping[str, OpticalParameter] = field(default_factory=lambda: MappingProxyType({}))
    each: tuple[str, ...] = ()
    starts: tuple[Mapping[str, float], ...] = (MappingProxyType({}),)
    over_session: bool = False
    evident: bool = False
    rigid: bool = False


class OpticalEffect:
    """An effect; the methods do nothing until a subclass says otherwise.

    Attributes
    ----------
    name : str
        What a table's ``effects`` call it, and ``diagnosis.json`` too.
    reported_name : str
        What ``diagnosis.json`` calls it, where it shares the name of another.
    stage : Stage
    parameters : mapping
        Name → ``Parameter``; those of stage ``PRESS`` are never written into a table.
    """

    name: ClassVar[str]
    reported_name: ClassVar[str] = ""
    stage: ClassVar[Stage]
    parameters: ClassVar[Mapping[str, OpticalParameter]]

    def apply(self, array: FloatArray, patch: Patch, **values: Any) -> FloatArray:
        """The image (..., 3), or the height map of a ``SURFACE`` effect, changed; a new array.

        Of the stages after ``FOCUS`` it changes each pixel by itself. The result has the type of
        ``array``.
        """
        return array.copy()

    def change(self, image: FloatArray, patch: Patch, **values: Any) -> None:
        """``apply`` to an image in place: for effects that leave most pixels as they are."""
        image[...] = self.apply(image, patch, **values)

    def prepare(self, table: LookupTable, leds: Leds, **values: float) -> dict[str, Any]:
        """What ``apply`` needs beside its parameters, computed once for a table."""
        return {}

    def reach_mm(self, depth_mm: float, **values: Any) -> float:
        """How far around a deformation of a depth it changes anything; 0 for its own pixels."""
        return 0.0

    def on_press(
        self, place_mm: FloatArray, ball_mm: float, **values: float
    ) -> tuple[FloatArray, float]:
        """Expected centre and contact radius (3,) and ball radius of a press, changed."""
        return place_mm, ball_mm

    def slope_factors(self, **values: float) -> tuple[tuple[float, float], ...]:
        """Contact radii, and by what the slope there that a press adds is multiplied."""
        return ()

    def candidates(self, scene: PressScene) -> list[OpticalCandidate]:
        """The ways in which these presses may show it."""
        return [OpticalCandidate(self.name, "all parameters", self.parameters)]

    def cannot_tell(self, scene: PressScene, found: Sequence[OpticalCandidate]) -> str:
        """What these presses cannot say about it, and what measurement would; or nothing."""
        return ""


_REGISTRY: dict[str, OpticalEffect] = {}


def register(effect: OpticalEffect) -> OpticalEffect:
    """Make an effect known.

    Raises
    ------
    TableError
        If there is one of that name.
    """
    if effect.name in _REGISTRY:
        msg = f"optical effect {effect.name!r} is registered twice: give the new one its own name"
        raise TableError(msg)
    _REGISTRY[effect.name] = effect
    return effect


def unregister(name: str) -> None:
    """Forget an effect."""
    del _REGISTRY[name]


def optical_effects(first: Stage = Stage.PRESS, last: Stage = Stage.CAMERA) -> list[OpticalEffect]:
    """The effects of some stages, in the order in which they act."""
    within = [effect for effect in _REGISTRY.values() if first <= effect.stage <= last]
    return sorted(within, key=lambda effect: effect.stage)


def optical_effect(name: str) -> OpticalEffect:
    """The effect of that name."""
    return _REGISTRY[name]


def check_effects(effects: Mapping[str, Mapping[str, float]]) -> None:
    """Refuse effects, or parameters of effects, that the renderer does not know.

    Raises
    ------
    TableError
        Lists every one of them.
    """
    problems = []
    for name, parameters in effects.items():
        if name not in _REGISTRY:
            known = ", ".join(effect.name for effect in optical_effects())
            problems.append(f"effect {name!r} is unknown; known: {known}")
            continue
        effect = _REGISTRY[name]
        problems += [
            f"effect {name!r} has no parameter {parameter!r}; it has {', '.join(effect.parameters)}"
            for parameter in parameters
            if parameter not in effect.parameters and effect.stage > Stage.PRESS
        ]
    TableError.raise_if(problems)


def by_channel(values: Sequence[float], array: FloatArray) -> FloatArray:
    """Numbers of the three channels in the array's type."""
    return np.array(values, dtype=array.dtype)
