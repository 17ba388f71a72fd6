"""The optical effects that the residual of ball presses is traced to, as nested candidates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tacgen.diagnose.optics.fit import Knob, Problem, fit, mean_square
from tacgen.diagnose.optics.model import GivenTable, Optics, PlainTable
from tacgen.diagnose.optics.occlusion import best_length_mm, with_shadow
from tacgen.diagnose.optics.surface import FORMS
from tacgen.optics.effects import CHANNELS, LEAKS, PLACES

EFFECT_NAMES = (
    "press_center",
    "scale",
    "illumination",
    "shadow",
    "blur",
    "background_gain",
    "vignetting",
    "cross_talk",
    "saturation",
)

FIRST_SIGMA_RADII = 0.15
FIRST_SHADOW = 0.4


def _same(problem: Problem, state: Optics) -> Optics:
    return state


@dataclass(frozen=True, slots=True)
class Candidate:
    """One way in which an effect may act.

    Attributes
    ----------
    name, label : str
        The effect, and the way in words.
    shared, own : tuple of Knob
        Quantities of all presses, and of each press.
    near : bool
        Whether the fitted table's low terms change with the place.
    form : str
        The form of skin to fit it with, where it is not the model's own.
    prepare : callable
        Where the fit begins.
    """

    name: str
    label: str
    shared: tuple[Knob, ...] = ()
    own: tuple[Knob, ...] = ()
    near: bool = False
    form: str = ""
    prepare: Callable[[Problem, Optics], Optics] = _same

    def complexity(self, n_presses: int) -> float:
        """How many quantities it frees; one of each press counts half, its prior holds it."""
        extra = 15 * len(PlainTable.moving()) if self.near else 0
        return len(self.shared) + 0.5 * n_presses * len(self.own) + extra


def _by_channel(key: str, step: float, bound: float, prior: float, unit: str) -> tuple[Knob, ...]:
    return tuple(
        Knob(key, c, step, -bound, bound, prior, unit, f"{key}_{name}")
        for c, name in enumerate(CHANNELS)
    )


def _press_channel(
    key: str, step: float, bound: float, prior: float, unit: str
) -> tuple[Knob, ...]:
    return tuple(
        Knob(key, c, step, -bound, bound, prior, unit, f"{key}_{name}", each_press=True)
        for c, name in enumerate(CHANNELS)
    )


DECAY = Knob("decay", 0, 0.01, 0.02, 3.0, 0.0, "1", "skirt_per_radius")
"""Not an effect: how far the gel is drawn in around a ball belongs to every gel."""

GAIN = _by_channel("gain", 0.01, 0.6, 0.3, "1")
OFFSET = _by_channel("offset", 0.5, 80.0, 30.0, "grey")
CENTER = tuple(
    Knob("shift", c, 0.01, -0.6, 0.6, 0.15, "radii", f"shift_{axis}", each_press=True)
    for c, axis in enumerate("xy")
)
RADIUS = Knob("growth", 0, 0.01, -0.4, 0.4, 0.1, "1", "growth", each_press=True)
FIELD = tuple(
    Knob("light", 5 * c + p, 0.02, -4.0, 4.0, 1.0, "1", f"{name}_{place}")
    for c, name in enumerate(CHANNELS)
    for p, place in enumerate(PLACES)
)
MIXING = tuple(Knob("mixing", k, 0.01, -0.6, 0.6, 0.3, "1", name) for k, name in enumerate(LEAKS))


def _blurred(problem: Problem, state: Optics) -> Optics:
    first = FIRST_SIGMA_RADII * float(problem.pixels.labels[:, 2].mean())
    return replace(state, sigma_mm=np.array([first]))


def _shaded(problem: Problem, state: Optics) -> Optics:
    shaded = with_shadow(problem, state, best_length_mm(problem, state))
    return replace(shaded, shadow=np.array([FIRST_SHADOW]))


FIRST_FACTORS = (0.7, 0.8, 0.9, 1.0, 1.12, 1.25)


def _rescaled(problem: Problem, state: Optics) -> Optics:
    """Begin at the factor that fits best: a wrong one may lie behind a hill."""
    starts = [replace(state, contact_factor=np.array([factor])) for factor in FIRST_FACTORS]
    tried = [
        fit(problem, start, (DECAY,) if start.form == "skirt" else (), (), steps=1)
        for start in starts
    ]
    errors = [mean_square(problem, found) for found, _ in tried]
    return tried[int(np.argmin(errors))][0]


MIN_CLIPPED = 0.01
"""Share of a channel's values that must stand at the brightest level for a camera to clip."""

PILE = 1.5
"""And there must be so many times more there than a little below: a tail only falls."""

BELOW_GREY = 8.0


def seems_clipped(problem: Problem) -> bool:
    """Whether the presses' brightest values pile up."""
    apart = problem.pixels.grey - clip_level(problem)
    piled = (np.abs(apart) < 2.5).mean(axis=0)
    below = (np.abs(apart + BELOW_GREY) < 2.5).mean(axis=0)
    return bool(((piled >= MIN_CLIPPED) & (piled >= PILE * below)).any())


def clip_level(problem: Problem) -> float:
    """The grey level near the brightest that most pixels of the presses stand at."""
    grey = problem.pixels.grey
    top = float(np.quantile(grey, 0.9998))
    counts = np.bincount(np.rint(grey).astype(int).ravel(), minlength=256)
    first = max(0, int(top) - 12)
    return float(first + np.argmax(counts[first : int(top) + 1]))


def _clipped(problem: Problem, state: Optics) -> Optics:
    return replace(state, level=np.array([clip_level(problem)]), knee=np.array([FIRST_KNEE_GREY]))


SATURATION = (
    Knob("level", 0, 0.5, 60.0, 255.0, 0.0, "grey", "level_grey"),
    Knob("knee", 0, 0.3, 0.0, 25.0, 0.0, "grey", "knee_grey"),
)
FIRST_KNEE_GREY = 1.0
SHADOW = Knob("shadow", 0, 0.02, 0.0, 1.0, 0.0, "1", "strength")


def candidates(problem: Problem) -> list[Candidate]:
    """Every candidate that these presses can speak of."""
    radius = float(problem.pixels.labels[:, 2].mean())
    is_given = isinstance(problem.table, GivenTable)
    blur = Knob("sigma_mm", 0, 0.02 * radius, 0.0, 0.8 * radius, 0.0, "mm", "sigma_mm")
    factor = Knob("contact_factor", 0, 0.005, 0.5, 1.6, 0.0, "1", "contact_per_label")
    ball = Knob("ball_factor", 0, 0.005, 0.6, 1.8, 0.15, "1", "ball_per_stated")
    corner = Knob("dimming", 0, 0.02, -0.6, 0.95, 0.0, "1", "strength")
    listed = [
        Candidate("press_center", "each press's centre", own=CENTER),
        Candidate("press_center", "each press's centre and radius", own=(*CENTER, RADIUS)),
        Candidate("scale", "ball over the stated, or pixel under it", (ball,)),
        Candidate("illumination", "light of each channel by place", FIELD),
        Candidate("shadow", "cast by the dent", (SHADOW,), prepare=_shaded),
        Candidate("background_gain", "exposure and offset since the background", (*GAIN, *OFFSET)),
        Candidate(
            "background_gain",
            "offset of each picture",
            OFFSET,
            _press_channel("press_offset", 0.5, 80.0, 4.0, "grey"),
        ),
        Candidate(
            "background_gain",
            "exposure of each picture",
            GAIN,
            _press_channel("press_gain", 0.01, 0.5, 0.05, "1"),
        ),
        Candidate("vignetting", "of what presses change", (corner,)),
        Candidate("vignetting", "of the background too", (replace(corner, key="dimming_all"),)),
    ]
    if seems_clipped(problem):
        listed.append(Candidate("saturation", "the camera clips", SATURATION, prepare=_clipped))
    # A wrong radius or a membrane may hide which form the skin has: try them with each.
    for form in ("",) if is_given else FORMS:
        listed += [
            Candidate(
                "scale",
                "contact radius over the labelled one",
                (factor,),
                form=form,
                prepare=_rescaled,
            ),
            Candidate("blur", "membrane", (blur,), form=form, prepare=_blurred),
        ]
    if is_given:
        listed.append(Candidate("cross_talk", "channels leak into each other", MIXING))
    else:
        listed.append(
            Candidate("illumination", "lamps close by: strength and direction by place", near=True)
        )
    return listed
