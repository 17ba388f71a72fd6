"""Kinematics of the UR5e by its published Denavit-Hartenberg parameters.

Source: Universal Robots, "DH Parameters for calculations of kinematics and dynamics", UR5e.
"""

import numpy as np

from tacgen.core.types import FloatArray, Pose, cross, pose, twice_sine

A_M = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)  # Universal Robots, DH parameters of the UR5e
D_M = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)  # the same source
ALPHA_RAD = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
LINK_MASS_KG = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)  # the same source
LINK_CENTER_OF_MASS_M = (
    (0.0, -0.02561, 0.00193),
    (0.2125, 0.0, 0.11336),
    (0.15, 0.0, 0.0265),
    (0.0, -0.0018, 0.01634),
    (0.0, 0.0018, 0.01634),
    (0.0, 0.0, -0.001159),
)
"""In the frame after each joint."""
JOINT_TORQUE_LIMIT_N_M = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)
"""Universal Robots, datasheet of the UR5e."""
JOINT_LIMIT_RAD = 2 * np.pi

POSITION_TOLERANCE_M = 1e-7  # far below a pixel of the sensor
ANGLE_TOLERANCE_RAD = 1e-7  # far below what moves a label (0.1 mm)
_ITERATIONS = 200  # a place that is out of reach is given up after so many
_LARGEST_STEP_RAD = 0.3  # keeps the solution on the branch of its seed
_DAMPING = 1e-3
"""Small beside the arm's singular values, so that it acts near singular poses only."""


def link_transform(joint: int) -> Pose:
    """From the frame that joint ``joint`` (0 to 5) turns to the one the next joint stands in."""
    c, s = np.cos(ALPHA_RAD[joint]), np.sin(ALPHA_RAD[joint])
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return pose(rotation, (A_M[joint], 0.0, D_M[joint]))


_LINK_TRANSFORMS = tuple(link_transform(joint) for joint in range(6))


def joint_frames(joints_rad: FloatArray) -> list[Pose]:
    """The base frame and that after each joint, the last the flange's: (4, 4) with metres."""
    frames: list[Pose] = [np.eye(4)]
    for angle, transform in zip(joints_rad, _LINK_TRANSFORMS, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]])
        frames.append(frames[-1] @ turn @ transform)
    return frames


def inverse_kinematics(target: Pose, seed_rad: FloatArray) -> FloatArray | None:
    """Joint angles that bring the flange to ``target``, near ``seed_rad``; None if there are none.

    Source: Damped least squares, Wampler 1986, Nakamura & Hanafusa 1986.
    """
    joints = np.array(seed_rad, dtype=np.float64)
    for _ in range(_ITERATIONS):
        frames = joint_frames(joints)
        flange = frames[-1]
        error = np.concatenate(
            [target[:3, 3] - flange[:3, 3], _rotation_vector(target[:3, :3] @ flange[:3, :3].T)]
        )
        off_m, off_rad = np.linalg.norm(error[:3]), np.linalg.norm(error[3:])
        if off_m < POSITION_TOLERANCE_M and off_rad < ANGLE_TOLERANCE_RAD:
            return joints if np.all(np.abs(joints) <= JOINT_LIMIT_RAD) else None
        axes = np.stack([frame[:3, 2] for frame in frames[:-1]])
        arms = flange[:3, 3] - np.stack([frame[:3, 3] for frame in frames[:-1]])
        jacobian = np.concatenate([cross(axes, arms), axes], axis=1).T
        damped = jacobian @ jacobian.T + _DAMPING**2 * np.eye(6)
        step = jacobian.T @ np.linalg.solve(damped, error)
        largest = float(np.abs(step).max())
        joints += step * min(1.0, _LARGEST_STEP_RAD / largest)
    return None


def _rotation_vector(rotation: FloatArray) -> FloatArray:
    """Axis times angle of a (3, 3) rotation."""
    sine = 0.5 * twice_sine(rotation)
    length = float(np.linalg.norm(sine))
    angle = np.arctan2(length, 0.5 * (np.trace(rotation) - 1.0))
    if length < 1e-9:
        # Half a turn has no axis in its antisymmetric part: any step away from it will do.
        return np.array([angle, 0.0, 0.0]) if angle > 1.0 else sine
    return np.asarray(sine * (angle / length))
