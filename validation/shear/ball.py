"""A rigid ball pressed on a gel block, moved and turned, with Coulomb friction at each node."""

from dataclasses import dataclass, replace

import numpy as np

from tacgen.core.compiled import njit
from validation.shear.gel_block import Float64, GelBlock

TOLERANCE = 1e-6  # of the depth: what nodes may still move by in one more sweep
MAX_SWEEPS = 20000
SLIDING = 5e-3  # of μF_n: what may lack along the motion, as some nodes still slip aside


@njit(cache=True)
def _sweep(
    compliance: Float64,
    wanted: Float64,
    friction: float,
    force: Float64,
    motion: Float64,
    sweeps: int,
    tolerance: float,
) -> int:
    """Gauss–Seidel over nodes, projected on p ≥ 0 and |t| ≤ μp, in place.

    ``wanted`` (n, 3) is the motion of a node that sticks and touches; ``force`` and ``motion``
    (n, 3) are those of the nodes. Returns the number of sweeps, -1 if they did not end.
    """
    n = force.shape[0]
    change = np.empty(3)
    for sweep in range(sweeps):
        largest = 0.0
        for i in range(n):
            normal = min(
                0.0,
                force[i, 2] + (wanted[i, 2] - motion[i, 2]) / compliance[3 * i + 2, 3 * i + 2],
            )
            if normal == 0.0 and force[i, 2] == 0.0:
                continue
            x = force[i, 0] + (wanted[i, 0] - motion[i, 0]) / compliance[3 * i, 3 * i]
            y = force[i, 1] + (wanted[i, 1] - motion[i, 1]) / compliance[3 * i + 1, 3 * i + 1]
            size, limit = np.hypot(x, y), -friction * normal
            if size > limit:
                x, y = x * limit / size, y * limit / size
            change[0], change[1] = x - force[i, 0], y - force[i, 1]
            change[2] = normal - force[i, 2]
            force[i, 0], force[i, 1], force[i, 2] = x, y, normal
            for j in range(n):
                for c in range(3):
                    moved = 0.0
                    for d in range(3):
                        moved += compliance[3 * i + d, 3 * j + c] * change[d]
                    motion[j, c] += moved
            for c in range(3):
                largest = max(largest, abs(change[c]) * compliance[3 * i + c, 3 * i + c])
        if largest < tolerance:
            return sweep + 1
    return -1


@dataclass(frozen=True)
class BallPose:
    """How far the ball has been pressed in, moved along x and y, and turned about z."""

    depth_mm: float = 0.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    turn_rad: float = 0.0


@dataclass(frozen=True)
class Touch:
    """A state: forces on the nodes (n, 3), on the gel, and each node's motion (n, 3)."""

    pose: BallPose
    force_n: Float64
    motion_mm: Float64


class BallContact:
    """A ball of ``radius_mm`` over the block's middle; it may touch within ``reach_mm``."""

    def __init__(self, block: GelBlock, radius_mm: float, friction: float, reach_mm: float) -> None:
        self.block, self.radius_mm, self.friction = block, radius_mm, friction
        self.points_mm, self.index, self.sides, self.area_mm2 = block.contact_nodes(reach_mm)
        self._compliance = block.between(self.index, self.sides)
        self._away_mm = np.hypot(*self.points_mm.T)
        self._sag_mm = radius_mm - np.sqrt(radius_mm**2 - self._away_mm**2)
        self._reach_mm = reach_mm
        self.sweeps = 0

    def start(self) -> Touch:
        """The ball just above the gel."""
        return Touch(BallPose(), np.zeros((len(self.index), 3)), np.zeros((len(self.index), 3)))

    def _carried(self, pose: BallPose) -> Float64:
        """Motion (n, 2) of the ball's surface over each node."""
        x, y = self.points_mm.T
        return np.stack([pose.x_mm - pose.turn_rad * y, pose.y_mm + pose.turn_rad * x], axis=1)

    def moved(self, before: Touch, pose: BallPose) -> Touch:
        """One step: nodes that stick go with the ball from where it had them ``before``."""
        wanted = np.empty_like(before.motion_mm)
        apart = self._carried(before.pose) - before.motion_mm[:, :2]
        wanted[:, :2] = self._carried(pose) - apart
        wanted[:, 2] = self._sag_mm - pose.depth_mm
        force, motion = before.force_n.copy(), before.motion_mm.copy()
        tolerance = TOLERANCE * max(pose.depth_mm, before.pose.depth_mm)
        sweeps = _sweep(
            self._compliance, wanted, self.friction, force, motion, MAX_SWEEPS, tolerance
        )
        if sweeps < 0:
            msg = f"the contact did not converge in {MAX_SWEEPS} sweeps at {pose}"
            raise ArithmeticError(msg)
        self.sweeps += sweeps
        touching = force[:, 2] < 0
        if touching.any() and self._away_mm[touching].max() > self._reach_mm - self.block.fine_mm:
            msg = f"the ball touches beyond {self._reach_mm} mm at {pose}; enlarge the reach"
            raise ArithmeticError(msg)
        return Touch(pose, force, motion)

    def to(self, before: Touch, pose: BallPose, steps: int) -> Touch:
        """Several equal steps to a pose."""
        touch, start = before, before.pose
        for share in np.arange(1, steps + 1) / steps:
            between = {
                name: (1 - share) * getattr(start, name) + share * getattr(pose, name)
                for name in ("depth_mm", "x_mm", "y_mm", "turn_rad")
            }
            touch = self.moved(touch, BallPose(**between))
        return touch

    def normal_n(self, touch: Touch) -> float:
        """Force that presses the ball in."""
        return -float(touch.force_n[:, 2].sum())

    def shear_n(self, touch: Touch) -> Float64:
        """Force (2,) of the ball on the gel."""
        return touch.force_n[:, :2].sum(axis=0)

    def torque_n_mm(self, touch: Touch) -> float:
        """Moment of the ball on the gel about z through the middle."""
        x, y = self.points_mm.T
        return float((x * touch.force_n[:, 1] - y * touch.force_n[:, 0]).sum())

    def most_torque_n_mm(self, touch: Touch) -> float:
        """The moment at which every node slips about the middle."""
        return float(-self.friction * (touch.force_n[:, 2] * self._away_mm).sum())

    def slipping(self, touch: Touch) -> Float64:
        """By node (n,): 0 does not touch, 1 sticks, 2 slips."""
        limit = -self.friction * touch.force_n[:, 2]
        slips = np.hypot(*touch.force_n[:, :2].T) > (1 - 1e-6) * limit
        return np.where(limit > 0, np.where(slips, 2.0, 1.0), 0.0)

    def contact_radius_mm(self, touch: Touch) -> float:
        """Of the circle with the area of the nodes that touch."""
        return float(np.sqrt(self.area_mm2[touch.force_n[:, 2] < 0].sum() / np.pi))

    def sheared_to(self, before: Touch, direction: Float64, share: float, steps: int) -> Touch:
        """Moved along ``direction`` (2,) until the force along it is ``share`` of μF_n (± 0.2 %).

        A share of 1 or more (or -1) moves until all nodes slip.
        """
        along = np.asarray(direction) / np.hypot(*direction)

        def reached(touch: Touch) -> float:
            return float(self.shear_n(touch) @ along / (self.friction * self.normal_n(touch)))

        def at(touch: Touch, by_mm: float) -> Touch:
            x_mm, y_mm = touch.pose.x_mm + by_mm * along[0], touch.pose.y_mm + by_mm * along[1]
            return self.moved(touch, replace(touch.pose, x_mm=x_mm, y_mm=y_mm))

        return self._until(before, reached, at, share, self._slide_mm(before) / steps)

    def turned_to(self, before: Touch, share: float, steps: int) -> Touch:
        """Turned about z until the moment is ``share`` of what makes all nodes slip."""

        def reached(touch: Touch) -> float:
            return self.torque_n_mm(touch) / self.most_torque_n_mm(touch)

        def at(touch: Touch, by_rad: float) -> Touch:
            turn_rad = touch.pose.turn_rad + by_rad
            return self.moved(touch, replace(touch.pose, turn_rad=turn_rad))

        step_rad = 2 * self._slide_mm(before) / self.contact_radius_mm(before) / steps
        return self._until(before, reached, at, share, step_rad)

    def _slide_mm(self, touch: Touch) -> float:
        """About how far the ball moves until all nodes slip."""
        shear = self.block.young_n_mm2 / (2 * (1 + self.block.poisson))
        pull_n = self.friction * self.normal_n(touch)
        return 3 * pull_n * (2 - self.block.poisson) / (16 * shear * self.contact_radius_mm(touch))

    def _until(self, touch, reached, at, share: float, step: float):  # type: ignore[no-untyped-def]
        """March by ``step`` until ``reached`` is at ``share``, the last step by secants."""
        step = abs(step) * np.sign(share - reached(touch))
        for _ in range(400):
            value, following = reached(touch), at(touch, step)
            after = reached(following)
            if abs(share) >= 1 and abs(share - after) < SLIDING:
                return following
            if (after - share) * step >= 0:
                low, high, by = (0.0, value), (step, after), step
                for _ in range(12):
                    if abs(high[1] - low[1]) < 1e-12:
                        break
                    by = low[0] + (share - low[1]) * (high[0] - low[0]) / (high[1] - low[1])
                    following = at(touch, by)
                    found = reached(following)
                    if abs(found - share) < 2e-3:
                        break
                    if (found - share) * step < 0:
                        low = (by, found)
                    else:
                        high = (by, found)
                return following
            touch = following
        msg = f"no motion brings the load to {share} of what friction can hold"
        raise ArithmeticError(msg)
