"""What the pads of the shipped sensors would show of a grasp, before it is simulated."""

from functools import lru_cache

import numpy as np

from tacgen.contact.gel_response import GelLoad
from tacgen.core.records import ContactFrame, ContactPatch, Mesh
from tacgen.core.sensors import load_sensor
from tacgen.core.types import PUBLISHED_K_N_MM3_PER_N, FloatArray
from tacgen.physics.gripper import default_gripper
from tacgen.physics.settings import PhysicsSettings
from tacgen.sensor.tactile_pad import TactilePad

SENSORS = ("gelsight_mini", "digit", "gelsight")
"""By which suggested grasps are judged; a flat gel first, which shows least."""
USUAL_SENSOR = "digit"  # its dome lies between the others', and so does the moment that it holds


def is_shown(surface: Mesh, y_mm: float, z_mm: float, force_n: float) -> bool:
    """Whether all ``SENSORS`` show the contact of a pad centred there on the object as it stands.

    It is the pad that carries a sensor where one alone does.
    """
    (side, *_), gripper = PhysicsSettings().sensing_pads, default_gripper()
    pose = np.eye(4)
    pose[:3, :3] = gripper.side(side).gel_axes.T
    pose[:3, 3] = pose[:3, :3] @ (0.0, -y_mm, -z_mm)
    return is_shown_in(surface, pose, force_n)


def is_shown_in(surface: Mesh, pose_gel_object: FloatArray, force_n: float) -> bool:
    """Whether the pictures of all ``SENSORS`` show the contact, by the published k_n."""
    load = GelLoad(volume_mm3=PUBLISHED_K_N_MM3_PER_N * force_n)
    for name in SENSORS:
        pad = _pad_of(name)
        if not pad.shows_contact(pad.render(surface, pose_gel_object, load)):
            return False
    return True


def usual_patch(surface: Mesh, frame: ContactFrame) -> ContactPatch:
    """Where the gel of ``USUAL_SENSOR`` presses on the surface, by the published k_n."""
    load = GelLoad(volume_mm3=PUBLISHED_K_N_MM3_PER_N * frame.force_normal_n)
    return _pad_of(USUAL_SENSOR).indenter.patch(surface, frame.pose_gel_object, load)


def common_window_mm() -> FloatArray:
    """Width and height (2,) of the gel that all ``SENSORS`` see, about the pad's middle."""
    seen = [_pad_of(name).sensor for name in SENSORS]
    sizes_mm: FloatArray = np.array(
        [(s.width_px * s.mm_per_px, s.height_px * s.mm_per_px) for s in seen]
    )
    smallest_mm: FloatArray = sizes_mm.min(axis=0)
    return smallest_mm


@lru_cache(maxsize=len(SENSORS))
def _pad_of(sensor: str) -> TactilePad:
    """A sensor on the default gripper."""
    gripper = default_gripper()
    side = PhysicsSettings().sensing_pads[0]
    return TactilePad(gripper.carrying(load_sensor(sensor), side))
