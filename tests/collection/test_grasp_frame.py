"""The moment of grasp, also of a grasp that met nothing."""

import numpy as np
import pytest

from tacgen.collection.pipeline import grasp_frame
from tacgen.core.records import ContactFrame, GraspConfig, GraspTrace


def trace_of(forces_n: list[float], pads: tuple[str, ...] = ("left",)) -> GraspTrace:
    frames = tuple(
        ContactFrame(0.1 * k, force, np.zeros(2), 0.0, np.eye(4))
        for k, force in enumerate(forces_n)
    )
    config = GraspConfig(0, "can", 5.0, 0.0, 0.0, 40.0)
    return GraspTrace(
        config, "executed", 1, "", dict.fromkeys(pads, frames), np.zeros((len(frames), 7)), 0.0, 0.0
    )


@pytest.mark.parametrize(
    ("forces_n", "frame"), [([0, 1, 4.8, 5, 5], 2), ([5, 5, 5], 0), ([0, 2, 5, 1, 0], 2)]
)
def test_it_is_the_first_frame_at_nearly_the_full_force(forces_n, frame):
    assert grasp_frame(trace_of(forces_n)) == frame


def test_a_grasp_without_frames_has_its_moment_at_the_first():
    assert grasp_frame(trace_of([])) == 0
    assert grasp_frame(trace_of([], pads=())) == 0
