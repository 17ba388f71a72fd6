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

from tacgen.errors import TableError
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
    gain = np.array([gain_r, gain_g, gain_b], dtype=np.float32) - 1
    offset = np.array([offset_r, offset_g, offset_b], dtype=np.float32)
    return image + (patch.background * gain + offset)


def vignetting(image: Image, patch: Patch, *, strength: float) -> Image:
    """The lens darkens towards the corners: 1 − strength · r², r = 1 at the corners."""
    square = (patch.u**2)[None, :] + (patch.v**2)[:, None]
    gain = 1 - np.float32(2 * strength) * square
    return image * gain[..., None].astype(np.float32)


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


def saturation(image: Image, patch: Patch, *, level_grey: float) -> Image:
    """The camera clips: nothing is brighter than the level."""
    return np.minimum(image, np.float32(level_grey))


_UNIT = Bounds(1.0, 0.5, 2.0)
_GREY = Bounds(0.0, -60.0, 60.0, "grey")
_SHARE = Bounds(0.0, -0.5, 0.5)

EFFECTS: Mapping[str, OpticalEffect] = MappingProxyType(
    {
        effect.name: effect
        for effect in (
            OpticalEffect("blur", "surface", blur, {"sigma_mm": Bounds(0.0, 0.0, 0.6, "mm")}),
            OpticalEffect(
                "cross_talk",
                "image",
                cross_talk,
                dict.fromkeys(("rg", "rb", "gr", "gb", "br", "bg"), _SHARE),
            ),
            OpticalEffect(
                "background_gain",
                "image",
                background_gain,
                {
                    **dict.fromkeys(("gain_r", "gain_g", "gain_b"), _UNIT),
                    **dict.fromkeys(("offset_r", "offset_g", "offset_b"), _GREY),
                },
            ),
            OpticalEffect("vignetting", "image", vignetting, {"strength": Bounds(0.0, -0.5, 0.9)}),
            OpticalEffect(
                "saturation",
                "image",
                saturation,
                {"level_grey": Bounds(255.0, 60.0, 255.0, "grey")},
            ),
        )
    }
)

ELSEWHERE = ("shadow", "illumination", "press_center", "scale")
"""Names that a table may carry and that are no function here: shadows are cast by ``shadow.py``
from ``strength`` and ``length_mm``; the others are already in the table's coefficients."""


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
