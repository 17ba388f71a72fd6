"""The load on a pad's gel over a grasp: the physics' forces put through a contact law."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.law import ContactLaw
from tacgen.core.arrays import FloatArray
from tacgen.core.records import ContactFrame

PLACE_STEP_MM = 2e-4  # to which the place of an object under the gel is rounded


@dataclass(frozen=True, slots=True)
class GelLoad:
    """What a contact law asks of one pad's gel at one time; the default is an unloaded gel.

    The law gives either ``volume_mm3``, which the gel loses (V = k_n F_n), or ``indentation_mm``
    (δ = c F_n, TACTO's law). ``shear_sum_mm`` (2,) is D = k_s F_s, the sum of the markers' shear
    motion, with which the object moves; ``turn_sum_mm2`` is k_s times the moment about the gel's
    normal: the sum of r × motion.
    """

    volume_mm3: float | None = None
    indentation_mm: float | None = None
    shear_sum_mm: FloatArray | tuple[float, float] = (0.0, 0.0)
    turn_sum_mm2: float = 0.0


def gel_loads(
    law: ContactLaw,
    frames: Sequence[ContactFrame],
    *,
    grasp_index: int = 0,
    k_n_factor: float = 1.0,
) -> tuple[GelLoad, ...]:
    """The load on the gel at each of a grasp's frames.

    The history that the law sees starts unloaded at the start of closing, so that effects with
    memory know how long the load has been on. ``grasp_index`` counts the grasps on this gel, so
    that a gel that is conditioned by its first presses is so in a dataset too.
    """
    history = load_history(frames, grasp_index)
    volume_mm3, shear_sum_mm = (values[1:] for values in law.predict(history, simulate=True))
    k_s = 0.0 if math.isnan(law.k_s_mm_per_n.value) else law.k_s_mm_per_n.value
    turn_sum_mm2 = k_s * np.array([frame.torsion_n_mm for frame in frames])
    if law.law == "linear_depth":
        depths: list[float | None] = (law.predict_depth(history)[1:] * k_n_factor).tolist()
        volumes: list[float | None] = [None] * len(frames)
    else:
        depths, volumes = [None] * len(frames), (volume_mm3 * k_n_factor).tolist()
    return tuple(map(GelLoad, volumes, depths, shear_sum_mm, turn_sum_mm2.tolist()))


def rounded_pose_and_load(
    pose_gel_object: FloatArray, load: GelLoad
) -> tuple[NDArray[np.float64], GelLoad]:
    """A pose (4, 4), mm, and a load, rounded so that frames of a steady hold are equal.

    The physics lets a held object creep by some 0.01 µm from frame to frame, which no picture
    shows. The rotation is rounded to 1e-5, the object's point at the gel's origin to 0.2 µm (a
    pixel is 30 µm and more), loads to 1e-5 of their units.
    """
    rotation = np.round(pose_gel_object[:3, :3], 5)
    point_mm = -pose_gel_object[:3, :3].T @ pose_gel_object[:3, 3]
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ (PLACE_STEP_MM * np.round(point_mm / PLACE_STEP_MM))
    x_mm, y_mm = load.shear_sum_mm
    return pose, GelLoad(
        None if load.volume_mm3 is None else round(load.volume_mm3, 5),
        None if load.indentation_mm is None else round(load.indentation_mm, 5),
        (round(float(x_mm), 5), round(float(y_mm), 5)),
        round(load.turn_sum_mm2, 5),
    )


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
