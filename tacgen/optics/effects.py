"""Optical effects that a sensor was found to show, as small pure functions in one registry.

A table names those it needs in ``table.effects`` and the renderer applies them, in the order of
the registry. ``surface`` effects change the height map before the look-up; ``image`` effects
change the rendered image, each pixel for itself. Image effects are relative to the reference
image of the gel at rest where they say so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import TableError
from tacgen.optics.smooth import half_kernel, smooth

Image = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Patch:
    """What an effect may look at: a rectangle of the image and where it lies.

    Attributes
    ----------
    background : (h, w, 3) float32
        Grey levels of the table's background there.
    u, v : (w,) and (h,) float32
        Position in the image, −½ to ½, as in the table.
    mm_per_px : float
    """

    background: Image
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    mm_per_px: float


@dataclass(frozen=True, slots=True)
class Bounds:
    """A parameter of an effect: where it does nothing, and how far it may go."""

    identity: float
    lower: float
    upper: float
    unit: str = ""


@dataclass(frozen=True, slots=True)
class OpticalEffect:
    """An effect: ``apply(array, patch, **parameters)`` returns a new array of the same shape."""

    name: str
    stage: Literal["surface", "light", "image"]
    apply: Callable[..., Image]
    parameters: Mapping[str, Bounds]


def blur(height_mm: Image, patch: Patch, *, sigma_mm: float) -> Image:
    """The membrane bridges what is narrower than its own thickness: a Gaussian on the height map.

    Beyond the edges the surface goes on with its slope there.
    """
    kernel = half_kernel(sigma_mm / patch.mm_per_px)
    reach = min(len(kernel) - 1, min(height_mm.shape) - 1)
    if reach < 1:
        return height_mm.copy()
    padded = np.pad(height_mm, reach, mode="reflect", reflect_type="odd").astype(np.float32)
    whole = (0, padded.shape[0], 0, padded.shape[1])
    smooth(padded, whole, kernel, np.empty_like(padded))
    return np.ascontiguousarray(padded[reach:-reach, reach:-reach])


def illumination(image: Image, patch: Patch, **shares: float) -> Image:
    """Light that differs with the place: what a contact changes is brighter or dimmer there.

    ``r_u`` is what red gains along u, ``r_uu`` what it gains with u², and so on.
    """
    u, v = patch.u[None, :], patch.v[:, None]
    place = {"uu": u * u, "vv": v * v, "uv": u * v, "u": u, "v": v}
    brighter = np.ones(image.shape, dtype=np.float32)
    for name, share in shares.items():
        channel, along = name.split("_")
        brighter[..., "rgb".index(channel)] += np.float32(share) * place[along]
    return patch.background + (image - patch.background) * brighter


def background_gain(
    image: Image,
    patch: Patch,
    *,
    gain_r: float = 1.0,
    gain_g: float = 1.0,
    gain_b: float = 1.0,
    offset_r: float = 0.0,
    offset_g: float = 0.0,
    offset_b: float = 0.0,
) -> Image:
    """Lights or exposure that changed since the background was taken: gain and offset a channel."""
    gain = np.array([gain_r, gain_g, gain_b], dtype=np.float32)
    offset = np.array([offset_r, offset_g, offset_b], dtype=np.float32)
    return image * gain + offset


def vignetting(
    image: Image, patch: Patch, *, strength: float = 0.0, change_strength: float = 0.0
) -> Image:
    """The lens darkens towards the corners: 1 − strength · r², r = 1 at the corners.

    ``change_strength`` is for a background that was photographed through the same lens: only what
    a contact changes is dimmed.
    """
    square = ((patch.u**2)[None, :] + (patch.v**2)[:, None])[..., None]
    gain = (1 - np.float32(2 * strength) * square).astype(np.float32)
    dimmed = (image - patch.background) * (np.float32(2 * change_strength) * square)
    return (image - dimmed.astype(np.float32)) * gain


def cross_talk(
    image: Image,
    patch: Patch,
    *,
    rg: float = 0.0,
    rb: float = 0.0,
    gr: float = 0.0,
    gb: float = 0.0,
    br: float = 0.0,
    bg: float = 0.0,
) -> Image:
    """The change of one colour shows in another: ``rg`` is the share of green's change in red."""
    change = image - patch.background
    red, green, blue = change[..., 0], change[..., 1], change[..., 2]
    mixed = np.stack(
        [
            np.float32(rg) * green + np.float32(rb) * blue,
            np.float32(gr) * red + np.float32(gb) * blue,
            np.float32(br) * red + np.float32(bg) * green,
        ],
        axis=-1,
    )
    return image + mixed


def saturation(image: Image, patch: Patch, *, level_grey: float, knee_grey: float = 0.0) -> Image:
    """The camera clips: nothing is brighter than the level, towards which it bends over a knee."""
    level, knee = np.float32(level_grey), np.float32(knee_grey)
    if knee < SHARP_KNEE_GREY:
        return np.minimum(image, level)
    return level - knee * np.logaddexp(np.float32(0), (level - image) / knee)


CHANNELS = ("r", "g", "b")
PLACES = ("uu", "vv", "uv", "u", "v")
LEAKS = ("rg", "rb", "gr", "gb", "br", "bg")
"""What names of parameters are made of: channels, terms of the place, and which channel leaks into
which."""

SHARP_KNEE_GREY = 0.05
"""A knee below this is none."""

_LIGHT = Bounds(0.0, -4.0, 4.0)
_UNIT = Bounds(1.0, 0.5, 2.0)
_GREY = Bounds(0.0, -60.0, 60.0, "grey")
_SHARE = Bounds(0.0, -0.5, 0.5)

EFFECTS: Mapping[str, OpticalEffect] = MappingProxyType(
    {
        effect.name: effect
        for effect in (
            OpticalEffect("blur", "surface", blur, {"sigma_mm": Bounds(0.0, 0.0, 2.0, "mm")}),
            OpticalEffect(
                "illumination",
                "image",
                illumination,
                {f"{channel}_{place}": _LIGHT for channel in CHANNELS for place in PLACES},
            ),
            OpticalEffect(
                "cross_talk",
                "image",
                cross_talk,
                dict.fromkeys(LEAKS, _SHARE),
            ),
            OpticalEffect(
                "background_gain",
                "image",
                background_gain,
                {
                    **dict.fromkeys((f"gain_{channel}" for channel in CHANNELS), _UNIT),
                    **dict.fromkeys((f"offset_{channel}" for channel in CHANNELS), _GREY),
                },
            ),
            OpticalEffect(
                "vignetting",
                "image",
                vignetting,
                dict.fromkeys(("strength", "change_strength"), Bounds(0.0, -0.6, 0.95)),
            ),
            OpticalEffect(
                "saturation",
                "image",
                saturation,
                {
                    "level_grey": Bounds(255.0, 60.0, 255.0, "grey"),
                    "knee_grey": Bounds(0.0, 0.0, 25.0, "grey"),
                },
            ),
        )
    }
)

ELSEWHERE = ("shadow", "press_center", "scale")
"""Names that a table may carry and that are no function here: shadows are cast by ``shadow.py``
from ``strength`` and ``length_mm``; the others are of the presses, and the table is free of them.
"""


def check_effects(effects: Mapping[str, Mapping[str, float]]) -> None:
    """Refuse effects, or parameters of effects, that the renderer does not know.

    Raises
    ------
    TableError
        Lists every one of them.
    """
    problems = []
    for name, parameters in effects.items():
        if name in ELSEWHERE:
            continue
        if name not in EFFECTS:
            problems.append(
                f"effect {name!r} is unknown; known: {', '.join((*EFFECTS, *ELSEWHERE))}"
            )
            continue
        known = EFFECTS[name].parameters
        problems += [
            f"effect {name!r} has no parameter {parameter!r}; it has {', '.join(known)}"
            for parameter in parameters
            if parameter not in known
        ]
    if problems:
        raise TableError.from_problems(problems)
