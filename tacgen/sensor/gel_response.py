"""What a contact law asks of the gel over a grasp: the joint of physics' forces and contact."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.law import ContactLaw
from tacgen.core.records import ContactFrame


@dataclass(frozen=True, slots=True)
class Deformation:
    """The deformation of one pad's gel over T frames.

    Of ``volume_mm3`` and ``depth_mm``, T values each, the one that the law does not give is None
    throughout. ``shear_sum_mm`` (T, 2) is D; ``turn_sum_mm2`` (T,) its counterpart for the moment
    about the gel's normal.
    """

    volume_mm3: Sequence[float | None]
    depth_mm: Sequence[float | None]
    shear_sum_mm: NDArray[np.float64]
    turn_sum_mm2: NDArray[np.float64]


def deformation(
    law: ContactLaw,
    frames: Sequence[ContactFrame],
    *,
    grasp_index: int = 0,
    k_n_factor: float = 1.0,
) -> Deformation:
    """The deformation of the gel at a grasp's frames.

    The history that the law sees starts unloaded at the start of closing, so that effects with
    memory know how long the load has been on. ``grasp_index`` counts the grasps on this gel, so
    that a gel that is conditioned by its first presses is so in a dataset too.
    """
    history = load_history(frames, grasp_index)
    volume_mm3, shear_sum_mm = (values[1:] for values in law.predict(history, simulate=True))
    k_s = 0.0 if math.isnan(law.k_s_mm_per_n.value) else law.k_s_mm_per_n.value
    turn_sum_mm2 = k_s * np.array([frame.torsion_n_mm for frame in frames])
    nothing = [None] * len(frames)
    if law.law == "linear_depth":
        depth_mm = law.predict_depth(history)[1:] * k_n_factor
        return Deformation(nothing, depth_mm.tolist(), shear_sum_mm, turn_sum_mm2)
    return Deformation((volume_mm3 * k_n_factor).tolist(), nothing, shear_sum_mm, turn_sum_mm2)


def load_history(
    frames: Sequence[ContactFrame], grasp_index: int = 0
) -> Mapping[str, NDArray[np.float64]]:
    """The columns of a press log for one grasp, with an unloaded sample before the first frame."""
    first_s = min(0.0, frames[0].time_s)
    # Two samples of one trial may not share a time.
    start_s = first_s if frames[0].time_s > first_s else first_s - 1e-3
    return {
        "trial": np.full(len(frames) + 1, float(grasp_index)),
        "time_s": np.array([start_s, *(frame.time_s for frame in frames)]),
        "force_normal_n": np.array([0.0, *(frame.force_normal_n for frame in frames)]),
        "force_shear_x_n": np.array([0.0, *(frame.force_shear_n[0] for frame in frames)]),
        "force_shear_y_n": np.array([0.0, *(frame.force_shear_n[1] for frame in frames)]),
    }
