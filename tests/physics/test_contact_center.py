"""The moment on a pad is about the middle of its contact."""

import numpy as np
import pytest

from tacgen.physics.contacts import Bodies, Snapshot, contact_frames, gel_pose

OBJECT, ROBOT, LINK = 1, 2, 3


def frame_of(places_mm, pressed_n, sheared_n, moved_m=(0.0, 0.0, 0.0)):
    """The left pad's frame of contact points (n, 2) with forces into the gel and along it."""
    rest = {
        "step": 1,
        "object_position_m": (0.0, 0.0, 0.0),
        "object_quaternion": (0.0, 0.0, 0.0, 1.0),
        "gripper_position_m": tuple(moved_m),
        "gripper_quaternion": (0.0, 0.0, 0.0, 1.0),
        "object_angular_velocity": (0.0, 0.0, 0.0),
        "pad_distance_m": (0.03, 0.03),
    }
    gel = gel_pose(Snapshot(**rest, contacts=()), "left")
    rows = []
    for (x_mm, y_mm), normal_n, (along_x, along_y) in zip(
        places_mm, pressed_n, sheared_n, strict=True
    ):
        at = tuple((gel @ [x_mm / 1e3, y_mm / 1e3, 0.0, 1.0])[:3])
        # Forces on the object: the gel pushes it out, and is pulled by it.
        axes = tuple(gel[:3, 2]), tuple(gel[:3, 0]), tuple(gel[:3, 1])
        bodies = OBJECT, ROBOT, -1, LINK
        rows.append(
            (0, *bodies, at, at, axes[0], 0.0, normal_n, -along_x, axes[1], -along_y, axes[2])
        )
    bodies = Bodies(OBJECT, ROBOT, {"left": LINK}, np.ones(3), np.eye(4), {"left": 0.0}, 0.002)
    return contact_frames([Snapshot(**rest, contacts=tuple(rows))], bodies, ["left"])["left"]


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
