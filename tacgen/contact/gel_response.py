"""The load on a pad's gel over a grasp: the physics' forces put through a contact law."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects.history import LoadHistory, Memory
from tacgen.contact.law import USUAL_FRICTION, ContactLaw
from tacgen.core.records import ContactFrame
from tacgen.core.types import FloatArray

LOAD = ("time_s", "force_normal_n", "force_shear_x_n", "force_shear_y_n")
"""The columns of a press log that a load has."""
ONSET_S = 1e-3  # before the first load that is known, the gel is at rest

PLACE_STEP_MM = 2e-4  # to which the place of an object under the gel is rounded

NEAR_MM, NEAR_SHARE = 0.05, 0.01
"""A tenth of the lattice's cell, and a part of the normal force: by as much as object and load may
differ from those by which the shear was last advanced before it is advanced again."""
NEAR_LEVER_MM, NEAR_ARM_MM = 8.0, 1.0  # half a window, and about the arm of a patch's torsion


@dataclass(frozen=True, slots=True)
class GelLoad:
    """What a contact law asks of one pad's gel at one time; the default is an unloaded gel.

    The law gives either ``volume_mm3``, which the gel loses (V = k_n F_n), or ``indentation_mm``
    (δ = c F_n, TACTO's law). ``shear_sum_mm`` (2,) is D = k_s F_s, the sum of the markers' shear
    motion, with which the object moves; ``turn_sum_mm2`` is k_s times the moment about the patch's
    middle: the sum of r × motion. Where ``pull_sum_mm`` (2,), k_s F_s alone, is given, it is the
    moment about the gel's origin, from which that of the pull is to be taken. The sums are over
    markers of ``marker_pitch_mm``; 0: over the sensor's own, whatever they are. ``center_mm`` (2,)
    is the centre of pressure, None where it is not known; loads that differ in it alone are equal.

    ``force_n`` (3,) is the force that this is the response to, along x, y and into the gel, None
    where it is not known; ``k_s_mm_per_n`` the law's, 0 where it has none. ``friction`` is
    Coulomb's coefficient of gel and object, ``decay_mm`` how far beside the contact the gel moves
    with it; None: the sensor's own.
    """

    volume_mm3: float | None = None
    indentation_mm: float | None = None
    shear_sum_mm: FloatArray | tuple[float, float] = (0.0, 0.0)
    turn_sum_mm2: float = 0.0
    pull_sum_mm: tuple[float, float] = (0.0, 0.0)
    marker_pitch_mm: float = 0.0
    center_mm: tuple[float, float] | None = field(default=None, compare=False)
    force_n: tuple[float, float, float] | None = None
    k_s_mm_per_n: float = 0.0
    friction: float = math.inf
    decay_mm: float | None = None

    def turn_about_mm2(self, center_mm: FloatArray | tuple[float, float]) -> float:
        """The sum of r × motion about a patch whose middle is at ``center_mm`` (2,)."""
        x, y = self.pull_sum_mm
        return float(self.turn_sum_mm2 - (center_mm[0] * y - center_mm[1] * x))


def gel_loads(
    law: ContactLaw,
    frames: Sequence[ContactFrame],
    *,
    grasp_index: int = 0,
    k_n_factor: float = 1.0,
    friction: float | None = None,
) -> tuple[GelLoad, ...]:
    """The load on the gel at each of a grasp's frames.

    The history that the law sees is each frame's past; where it is not known, that of the frames
    before it, from a gel that the first of them finds at rest. ``grasp_index`` counts the grasps on
    this gel, so that a gel that is conditioned by its first presses is so in a dataset too.
    ``friction`` is that of the object, else the law's.
    """
    alone = bool(law.effects) and any(frame.past is not None for frame in frames)
    normal, shear_mm = list[float](), list[FloatArray]()
    for part in [[frame] for frame in frames] if alone or not frames else [frames]:
        response, motion_mm = law.simulated(load_history(part, grasp_index), k_n_factor)
        normal += response[-len(part) :].tolist()
        shear_mm += list(motion_mm[-len(part) :])
    rows = zip(frames, normal, shear_mm, strict=True)
    return tuple(gel_load(law, frame, one, shear, friction) for frame, one, shear in rows)


class GelCourse:
    """The gel of one sensor over time: what its law's effects remember goes from load to load."""

    def __init__(self, law: ContactLaw) -> None:
        self._law = law
        self._press = -1
        self._before: Memory = {}
        self._after: Memory = {}
        self.last_s: float | None = None
        self.begin()

    def begin(self) -> None:
        """A new press, of a gel at rest."""
        self._press += self._press < 0 or self.last_s is not None
        self.last_s = None

    def load(self, frame: ContactFrame, at_rest_s: float) -> GelLoad:
        """The load of the newest frame; again, where it is of the time of the last one.

        ``at_rest_s`` is how long before a press's first frame its gel was at rest.
        """
        if self.last_s is None:
            start_s = frame.time_s - max(at_rest_s, ONSET_S)
            *_, self._before = self._law.advance(self._row((start_s, 0.0, 0.0, 0.0)), {})
        elif frame.time_s > self.last_s:
            self._before = self._after
        load = frame.time_s, frame.force_normal_n, *frame.force_shear_n
        normal, shear, self._after = self._law.advance(self._row(load), self._before)
        self.last_s = frame.time_s
        return gel_load(self._law, frame, normal, shear)

    def _row(self, load: Sequence[float]) -> dict[str, float]:
        return {"trial": float(self._press), **dict(zip(LOAD, load, strict=True))}


def gel_load(
    law: ContactLaw,
    frame: ContactFrame,
    normal: float,
    shear_sum_mm: FloatArray,
    friction: float | None = None,
) -> GelLoad:
    """The load of a frame from the law's responses; ``normal`` is a volume, or TACTO's depth."""
    k_s = 0.0 if math.isnan(law.k_s_mm_per_n.value) else law.k_s_mm_per_n.value
    turn_mm2, pull_mm, center_mm = k_s * frame.torsion_n_mm, (0.0, 0.0), None
    if frame.center_mm is not None:
        x, y = (float(k_s * force) for force in frame.force_shear_n)
        center_mm = float(frame.center_mm[0]), float(frame.center_mm[1])
        turn_mm2 += float(frame.center_mm[0]) * y - float(frame.center_mm[1]) * x
        pull_mm = x, y
    if friction is None:
        friction = USUAL_FRICTION if law.friction is None else law.friction.value
    along_x, along_y = frame.force_shear_n
    is_depth = law.law == "linear_depth"
    return GelLoad(
        volume_mm3=None if is_depth else normal,
        indentation_mm=normal if is_depth else None,
        shear_sum_mm=shear_sum_mm,
        turn_sum_mm2=turn_mm2,
        pull_sum_mm=pull_mm,
        marker_pitch_mm=0.0 if math.isnan(law.marker_pitch_mm) else law.marker_pitch_mm,
        center_mm=center_mm,
        force_n=(float(along_x), float(along_y), float(frame.force_normal_n)),
        k_s_mm_per_n=k_s,
        friction=friction,
        decay_mm=None if law.decay_mm is None else law.decay_mm.value,
    )


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
    pull_x_mm, pull_y_mm = load.pull_sum_mm
    return pose, replace(
        load,
        volume_mm3=None if load.volume_mm3 is None else round(load.volume_mm3, 5),
        indentation_mm=None if load.indentation_mm is None else round(load.indentation_mm, 5),
        shear_sum_mm=(round(float(x_mm), 5), round(float(y_mm), 5)),
        turn_sum_mm2=round(load.turn_sum_mm2, 5),
        pull_sum_mm=(round(pull_x_mm, 5), round(pull_y_mm, 5)),
        force_n=load.force_n
        and (
            round(load.force_n[0], 5),
            round(load.force_n[1], 5),
            round(load.force_n[2], 5),
        ),
    )


def is_near(pose: FloatArray, load: GelLoad, other_pose: FloatArray, other: GelLoad) -> bool:
    """Whether an object's pose (4, 4), mm, and load are those by which a shear was last advanced.

    Steps at a constant load need not be made: the gel is as after one.
    """

    def numbers(pose: FloatArray, load: GelLoad) -> tuple[FloatArray, FloatArray, float]:
        rotation, k_s = pose[:3, :3], load.k_s_mm_per_n or 1.0
        place_mm = np.append(-rotation.T @ pose[:3, 3], NEAR_LEVER_MM * rotation)
        sums_mm = *load.shear_sum_mm, load.turn_sum_mm2 / NEAR_ARM_MM
        loads_n = np.append(load.force_n or (0.0,) * 3, np.array(sums_mm) / k_s)
        return place_mm, loads_n, load.indentation_mm or load.volume_mm3 or 0.0

    (place_mm, loads_n, pressed), (at_mm, by_n, by) = (
        numbers(pose, load),
        numbers(other_pose, other),
    )
    return bool(
        np.abs(place_mm - at_mm).max() <= NEAR_MM
        and np.abs(loads_n - by_n).max() <= NEAR_SHARE * by_n[2]
        and abs(pressed - by) <= NEAR_SHARE * by
    )


def load_history(frames: Sequence[ContactFrame], grasp_index: int = 0) -> LoadHistory:
    """The loads of one grasp: the past of its first frame, then the frames."""
    past = frames[0].past
    if past is None or not len(past):
        past = np.array([[frames[0].time_s - ONSET_S, 0.0, 0.0, 0.0]])
    own = [[one.time_s, one.force_normal_n, *one.force_shear_n] for one in frames]
    rows = np.concatenate([past, own])
    columns = dict(zip(LOAD, rows.T, strict=True))
    trial = np.full(len(rows), float(grasp_index))
    return LoadHistory({"trial": trial, **columns}, measured=False)
