"""Frames and the arm's kinematics, against published figures and PyBullet's own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tacgen.core import types as frames
from tacgen.physics import GraspSimulator, PhysicsSettings, ur5e
from tacgen.physics.engine import GripperTarget
from tacgen.physics.grasp import trapezoid
from tacgen.physics.gripper import default_gripper
from tacgen.physics.robots import BASE_POSITION_M

from .conftest import block


def test_quaternions_and_rotations_agree_with_scipy() -> None:
    rng = np.random.default_rng(5)
    for _ in range(200):
        quaternion = rng.normal(size=4)
        quaternion *= np.sign(quaternion[3]) / np.linalg.norm(quaternion)
        rotation = Rotation.from_quat(quaternion).as_matrix()
        assert frames.rotation_of(quaternion.tolist()) == pytest.approx(rotation, abs=1e-12)
        assert frames.quaternion_from_rotation(rotation) == pytest.approx(quaternion, abs=1e-12)
        assert frames.turn_rad(rotation) == pytest.approx(
            Rotation.from_matrix(rotation).magnitude(), abs=1e-12
        )


@pytest.mark.parametrize("pad", ["left", "right"])
def test_gel_axes_are_right_handed_and_rows_run_down(pad: str) -> None:
    side = default_gripper().side(pad)
    axes = side.gel_axes
    assert np.cross(axes[:, 0], axes[:, 1]) == pytest.approx(axes[:, 2])
    assert axes[:, 1] == pytest.approx([0, 0, -1])
    # z looks from the pad to the gripper's centre.
    assert axes[0, 2] == -side.side


def test_the_arm_at_zero_is_stretched_along_minus_x() -> None:
    # UR5e data: reach a2 + a3 = 0.8172 m, wrist offsets d4 + d6 = 0.2329 m, d1 − d5 = 0.0628 m.
    flange = ur5e.joint_frames(np.zeros(6))[-1]
    assert flange[:3, 3] == pytest.approx([-0.8172, -0.2329, 0.0628], abs=1e-12)


def test_inverse_kinematics_returns_to_where_it_came_from() -> None:
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(40):
        joints = np.array([0.3, -1.6, -1.9, -1.1, 1.57, -1.3]) + rng.uniform(-0.4, 0.4, 6)
        target = ur5e.joint_frames(joints)[-1]
        solved = ur5e.inverse_kinematics(target, joints + rng.uniform(-0.3, 0.3, 6))
        if solved is not None:
            found += 1
            assert ur5e.joint_frames(solved)[-1] == pytest.approx(target, abs=2e-7)
    assert found == 40


def test_what_is_out_of_reach_has_no_joint_angles() -> None:
    target = np.eye(4)
    target[:3, 3] = (1.2, 0.0, 0.2)
    assert ur5e.inverse_kinematics(target, np.full(6, 0.1)) is None


TARGET = GripperTarget(0.03, -0.05, 0.12, 0.4)


def test_the_arm_goes_where_it_is_sent(arm_simulator: GraspSimulator) -> None:
    _, arm = arm_simulator.world.build(block(), PhysicsSettings(), 1.0)
    assert arm.place(TARGET) == ""
    position, quaternion = arm.gripper_position()
    assert position == pytest.approx([0.03, -0.05, 0.12], abs=1e-6)
    expected = frames.rotation_about_z(0.4)
    assert frames.rotation_of(quaternion) == pytest.approx(expected, abs=1e-6)


def test_the_arm_lifts_straight(arm_simulator: GraspSimulator) -> None:
    """To a tenth of what slides at the pad count from, with the arm's own weight on its joints."""
    settings = PhysicsSettings()
    _, arm = arm_simulator.world.build(block(), settings, 1.0)
    arm.place(TARGET)
    assert arm.prepare_lift(0.18) == ""
    height_m, speed_m_s = trapezoid(0.18, 0.12, 0.12, settings.time_step_s)
    for now_m, now_m_s in zip(height_m.tolist(), speed_m_s.tolist(), strict=True):
        arm.command_lift(now_m, now_m_s)
        arm_simulator.world.step(1)
        position_m, _ = arm.gripper_position()
        assert position_m == pytest.approx([0.03, -0.05, 0.12 + now_m], abs=0.05e-3)


def test_the_body_in_pybullet_is_the_published_arm() -> None:
    pytest.importorskip("pybullet")
    with GraspSimulator("ur5e_wsg50", "pybullet") as simulator:
        world: Any = simulator.world
        _, arm = world.build(block(), PhysicsSettings(engine="pybullet"), 1.0)
        arm.place(TARGET)
        bullet, body = world.bullet, world.bullet.getNumBodies() - 1
        joints = [bullet.getJointState(body, joint)[0] for joint in range(6)]
        for joint in range(6):
            state = bullet.getLinkState(body, joint, computeForwardKinematics=1)
            frame = np.eye(4)
            for before in range(joint + 1):
                turn = frames.pose(frames.rotation_about_z(joints[before]), (0, 0, 0))
                frame = frame @ turn @ ur5e.link_transform(before)
            center = frame @ [*ur5e.LINK_CENTER_OF_MASS_M[joint], 1.0]
            assert state[0] == pytest.approx(center[:3] + BASE_POSITION_M, abs=1e-5)
            mass = bullet.getDynamicsInfo(body, joint)[0]
            assert mass == pytest.approx(ur5e.LINK_MASS_KG[joint])


@pytest.mark.parametrize("distance", [0.18, 0.05])
def test_the_lift_rises_rests_and_never_jerks(distance: float) -> None:
    step_s = 1 / 480
    positions, speeds = trapezoid(distance, 0.12, 0.12, step_s)
    assert positions[-1] == pytest.approx(distance, abs=1e-12)
    assert np.cumsum(speeds) * step_s == pytest.approx(positions)
    assert speeds.max() <= 0.12 + 1e-9
    accelerations = np.diff(np.concatenate([[0.0], speeds, [0.0]])) / step_s
    assert np.abs(accelerations).max() <= 0.12 * (1 + 1e-6)
    expected_s = distance / 0.12 + 1.0 if distance > 0.12 else 2 * np.sqrt(distance / 0.12)
    assert len(positions) * step_s == pytest.approx(expected_s, abs=step_s)
