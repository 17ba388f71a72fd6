"""Success, failure mode and first slip, from how the object moved in the gripper's hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.core.records import LABEL_FAILURE, LABEL_SUCCESS, FailureMode
from tacgen.physics.settings import PhysicsSettings


@dataclass(frozen=True, slots=True)
class Motion:
    """How the object moved during the lift, n samples from its start on.

    Attributes
    ----------
    time_s : (n,)
        Since closing on.
    rise_mm : (n,)
        Height of the centre of mass above where it was.
    turn_rad : (n,)
        Rotation relative to the gripper.
    slide_mm : (n, 2)
        Displacement of the object's point between the pads, in the gel's x and y.
    center_slide_mm : (n, 2)
        Displacement of the centre of mass relative to the gripper, in the gel's x and y.
    """

    time_s: NDArray[np.float64]
    rise_mm: NDArray[np.float64]
    turn_rad: NDArray[np.float64]
    slide_mm: NDArray[np.float64]
    center_slide_mm: NDArray[np.float64]


def label_of(rise_mm: float, turn_rad: float, settings: PhysicsSettings) -> int:
    """1 if the object rose far enough and turned little enough, else 0."""
    held = rise_mm >= settings.success_rise_mm and turn_rad < settings.success_turn_rad
    return LABEL_SUCCESS if held else LABEL_FAILURE


def failure_mode(motion: Motion, settings: PhysicsSettings) -> FailureMode:
    """Which limit the object passed first: the turn's, or the slide that the rise allows.

    Where neither was passed, the one it came closer to.
    """
    allowed_mm = settings.lift_mm - settings.success_rise_mm
    slide = np.linalg.norm(motion.slide_mm, axis=1) / allowed_mm
    turn = motion.turn_rad / settings.success_turn_rad
    first_slide, first_turn = _first(slide >= 1.0), _first(turn >= 1.0)
    if first_slide == first_turn:
        turned = turn.max() >= slide.max()
    else:
        turned = first_turn < first_slide
    return "rotational_slip" if turned else "translational_slip"


def first_slip(motion: Motion, settings: PhysicsSettings) -> tuple[float, NDArray[np.float64]]:
    """Time and direction (2,) of the first slip; NaN and 0 where nothing slips.

    The direction is that in which the object slides at the pad, in the gel's x and y; where it
    only turns, that in which its centre of mass goes.
    """
    slid = np.linalg.norm(motion.slide_mm, axis=1) >= settings.slip_mm
    k = _first(slid | (motion.turn_rad >= settings.slip_turn_rad))
    if k == len(slid):
        return float("nan"), np.zeros(2)
    direction = motion.slide_mm[k] if slid[k] else motion.center_slide_mm[k]
    length = float(np.linalg.norm(direction))
    return float(motion.time_s[k]), direction / length if length > 0 else np.zeros(2)


def _first(flags: NDArray[np.bool_]) -> int:
    """Index of the first True, or the length where there is none."""
    return int(np.argmax(flags)) if flags.any() else len(flags)
