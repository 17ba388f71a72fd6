"""A pad's frame: moments about the middle of its contact, forces of its own time."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.core.engine_contacts import ContactPoint
from tacgen.core.resources import gripper_path
from tacgen.physics.contacts import Bodies, Snapshot, contact_frames, gel_pose
from tacgen.physics.gripper import load_gripper

PADS = load_gripper(gripper_path("wsg50")).sides
BODIES = Bodies(PADS, np.ones(3), np.eye(4), dict.fromkeys(PADS, 0.0), 0.002)


def snapshot_of(places_mm, pressed_n, sheared_n, moved_m=(0.0, 0.0, 0.0), step=1):
    """Contact points (n, 2) of the left pad with forces into the gel and along it."""
    rest = {
        "step": step,
        "object_position_m": (0.0, 0.0, 0.0),
        "object_quaternion": (0.0, 0.0, 0.0, 1.0),
        "gripper_position_m": tuple(moved_m),
        "gripper_quaternion": (0.0, 0.0, 0.0, 1.0),
        "object_angular_velocity": (0.0, 0.0, 0.0),
        "pad_distance_m": (0.03, 0.03),
    }
    gel = gel_pose(Snapshot(**rest, contacts=()), BODIES, "left")
    points = []
    for (x_mm, y_mm), normal_n, along_n in zip(places_mm, pressed_n, sheared_n, strict=True):
        at = tuple((gel @ [x_mm / 1e3, y_mm / 1e3, 0.0, 1.0])[:3])
        # The gel pushes the object out, and is pulled along by it.
        on_object = gel[:3, :3] @ [-along_n[0], -along_n[1], normal_n]
        points.append(ContactPoint("left", at, tuple(gel[:3, 2]), normal_n, tuple(on_object)))
    return Snapshot(**rest, contacts=tuple(points))


def frame_of(*contacts):
    """The left pad's frame of one moment."""
    return contact_frames([snapshot_of(*contacts)], BODIES, ["left"])["left"]


@pytest.mark.parametrize("at_mm", [(0.0, 0.0), (5.0, -3.0)])
def test_a_pull_has_no_moment_about_its_own_place(at_mm):
    found = frame_of([at_mm], [4.0], [(0.5, 2.0)])
    np.testing.assert_allclose(found.force_shear_n, (0.5, 2.0), atol=1e-12)
    assert found.force_normal_n == pytest.approx(4.0)
    np.testing.assert_allclose(found.center_mm, at_mm, atol=1e-9)
    assert found.torsion_n_mm == pytest.approx(0.0, abs=1e-9)


def test_a_couple_is_the_same_wherever_it_is():
    """1 N up and down, 2 mm apart; the middle is nearer the point that presses harder."""
    for shift in (0.0, 6.0):
        found = frame_of([(shift - 1, 0), (shift + 1, 0)], [1.0, 3.0], [(0, -1.0), (0, 1.0)])
        assert found.center_mm[0] == pytest.approx(shift + 0.5)
        assert found.torsion_n_mm == pytest.approx(2.0)


@pytest.mark.parametrize(("last", "force_n"), [(9, 1.0), (10, 4.0), (11, 5.0), (13, 7.0)])
def test_a_frame_of_the_lift_holds_nothing_from_before_it(last, force_n):
    """1 N up to step 9; 4, 6, 8, 10 N from 10 on; a window is of four steps after its first."""
    steps = {step: 1.0 if step < 10 else 2.0 * step - 16.0 for step in range(last - 4, last + 1)}
    window = [snapshot_of([(0.0, 0.0)], [n], [(0.0, 0.0)], step=step) for step, n in steps.items()]
    bodies = replace(BODIES, lift_step=10)
    found = contact_frames(window, bodies, ["left"])["left"]
    assert found.force_normal_n == pytest.approx(force_n)
