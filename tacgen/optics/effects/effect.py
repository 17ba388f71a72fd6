"""What an optical effect is, and the one registry of them.

An effect is one module: a subclass of ``OpticalEffect`` that says where in the chain it stands,
which parameters it has, what it does to an image or a surface, and how ball presses may show it.
``register`` makes it known to the renderer, to the fits of ``tacgen diagnose optics`` and to their
reports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.core.errors import TableError
from tacgen.optics.smooth import Window
from tacgen.optics.table import Leds, LookupTable

CHANNELS = ("r", "g", "b")
"""What names of parameters begin or end with where there is one for each channel."""


Relief = tuple[slice, NDArray[np.float32], float, list[FloatArray]]
"""Pixels of a press, height map, cell of it in mm, rows and columns of the pixels in it."""


class Stage(IntEnum):
    """Where in the chain an effect acts; the renderer and the fits go through it in this order."""

    PRESS = 0
    """On where a ball is and how large: of presses alone, nothing that the renderer applies."""
    SURFACE = 1
    """On the height map, before the look-up."""
    SHADOW = 2
    """On the light of each lamp, which the gel's relief may hide."""
    LIGHT = 3
    """On the strength of the light."""
    COLOR = 4
    """On the channels, which may leak into each other."""
    EXPOSURE = 5
    """On the camera's exposure."""
    LENS = 6
    """On what passes the lens."""
    CAMERA = 7
    """On the grey levels that the camera puts out."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number of an effect.

    Attributes
    ----------
    identity : float
        Where it does nothing.
    lower, upper : float
        How far a fit may go.
    unit : str
    step : float
        Of the finite differences of a fit.
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
    height_mm : (h, w) float32, optional
        The deformed gel over that window.
    """

    background: FloatArray
    u: FloatArray
    v: FloatArray
    mm_per_px: float
    window: Window = (0, 0, 0, 0)
    height_mm: NDArray[np.float32] | None = None


@dataclass(frozen=True, slots=True)
class PressScene:
    """What an effect may ask about ball presses and the model fitted to them.

    Attributes
    ----------
    contact_radius_mm : float
        Mean labelled radius of the contacts.
    ball_radii_mm : (N,) float
        Stated radius of each press's ball.
    has_table : bool
        Whether the colours are those of a given table, not fitted to the same presses.
    patch, grey : Patch and (n, 3) float
        The pixels of all presses, in a row, and their photographed grey levels.
    rendered : callable
        Grey levels (n, 3) by the model, with the effect of a name switched off.
    light_azimuths_rad : callable
        Direction (3,) that each channel is lit from.
    reliefs : callable
        From a reach (contact radii) and cells per radius, of each press: its pixels, its height
        map (mm), that one's cell (mm), and row and column in it of the pixels. The balls are where
        their labels say, so that nothing is learnt from held-out presses.
    """

    contact_radius_mm: float
    ball_radii_mm: FloatArray
    has_table: bool
    patch: Patch
    grey: FloatArray
    rendered: Callable[[str], FloatArray]
    light_azimuths_rad: Callable[[], FloatArray]
    reliefs: Callable[[float, int], Iterator[Relief]]


def start_as_it_is(scene: PressScene) -> Sequence[Mapping[str, float]]:
    """One start, which changes nothing."""
    return ({},)


@dataclass(frozen=True, slots=True)
class Candidate:
    """One way in which presses may show an effect: what a fit frees, and where it begins.

    Attributes
    ----------
    effect, label : str
        The effect's name, and the way in plain language.
    shared, own : mapping
        Parameters of all presses, and what those of each press differ by.
    starts : callable
        Values to begin with; of several, those that fit best after one step.
    chosen : mapping
        Parameters that ``starts`` picks from a few values, and the relative standard error of it.
    color_by_place : bool
        Whether the low terms of a fitted table change with the place in the image.
    hides_form : bool
        Whether it may hide which form the gel has around a ball: it is tried with each.
    first_weight : callable, optional
        Weights (n, 3) of the first steps from grey levels (n, 3): the pixels to trust then.
    form : str
        The form of the gel to try it with; the model's own where empty.
    """

    effect: str
    label: str
    shared: Mapping[str, Parameter] = field(default_factory=lambda: MappingProxyType({}))
    own: Mapping[str, Parameter] = field(default_factory=lambda: MappingProxyType({}))
    starts: Callable[[PressScene], Sequence[Mapping[str, float]]] = start_as_it_is
    chosen: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    color_by_place: bool = False
    hides_form: bool = False
    first_weight: Callable[[FloatArray], FloatArray] | None = None
    form: str = ""


class OpticalEffect:
    """An effect; the methods do nothing until a subclass says otherwise.

    Attributes
    ----------
    name : str
        What a table's ``effects`` and ``diagnosis.json`` call it.
    stage : Stage
    parameters : mapping
        Name → ``Parameter``; those of stage ``PRESS`` are never written into a table.
    follows_form_errors : bool
        Whether it can bend to the errors of form that a fitted table leaves around each contact.
    is_evident : bool
        Whether the grey levels show it by themselves, whatever a fitted table hides of it.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    parameters: ClassVar[Mapping[str, Parameter]]
    follows_form_errors: ClassVar[bool] = False
    is_evident: ClassVar[bool] = False

    def apply(self, array: FloatArray, patch: Patch, **values: Any) -> FloatArray:
        """The image (..., 3), or the height map of a ``SURFACE`` effect, changed; a new array.

        The renderer calls it with single numbers, a fit with (n,) of them, one a pixel. The
        result has the type of ``array``.
        """
        raise NotImplementedError

    def prepare(self, table: LookupTable, leds: Leds, **values: float) -> dict[str, Any]:
        """What ``apply`` needs beside its parameters, computed once for a table."""
        return {}

    def reach_mm(self, depth_mm: float, **values: Any) -> float:
        """How far around a deformation of a depth it changes anything; 0 for its own pixels."""
        return 0.0

    def on_press(
        self, place_mm: FloatArray, ball_mm: FloatArray, **values: Any
    ) -> tuple[FloatArray, FloatArray]:
        """Centre and contact radius (N, 3) and ball radii (N,) of presses, changed."""
        return place_mm, ball_mm

    def on_profile(self, slope: FloatArray, step_mm: float, **values: float) -> FloatArray:
        """The gel's radial slope (n,) at multiples of a step from a ball's centre, changed."""
        return slope

    def on_pixels(self, grey: FloatArray, patch: Patch, **values: Any) -> FloatArray:
        """The grey levels (n, 3) of pixels of many presses, changed, as a fit needs it."""
        return self.apply(grey, patch, **values)

    def before_fit(
        self, scene: PressScene, before: Mapping[str, FloatArray], **values: float
    ) -> dict[str, FloatArray]:
        """What ``on_pixels`` needs, an entry (or row) a pixel; it stays while a model is fitted.

        ``before`` is what the same model had for the presses that it was fitted to.
        """
        return {}

    def candidates(self, scene: PressScene) -> list[Candidate]:
        """The ways in which these presses may show it."""
        return [Candidate(self.name, "all parameters", self.parameters)]

    def cannot_tell(self, scene: PressScene, found: Sequence[Candidate]) -> str:
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


def by_channel(values: Sequence[Any], array: FloatArray) -> FloatArray:
    """Numbers of the three channels, or (n,) of them, along the last axis, in the array's type."""
    return np.stack(np.broadcast_arrays(*values), axis=-1).astype(array.dtype)
