"""Advances the simulation and records snapshots at the wanted steps."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence

from tacgen.physics.contacts import Placement, Snapshot
from tacgen.physics.engine import Body, Engine, Robot
from tacgen.physics.settings import FrameRequest, PhysicsSettings


def frame_end_steps(request: FrameRequest, time_step_s: float) -> list[int]:
    """The step at which each frame of a sequence ends, counted from closing on."""
    last = round(request.span_s / time_step_s)
    if request.count == 1:
        return [last]
    return [round(last * k / (request.count - 1)) for k in range(request.count)]


def frame_of_moment(frame_ends: Sequence[int], moment: int) -> int:
    """The frame that is taken at the step ``moment`` instead of at its own: the last one before.

    Not the first of a sequence, in which the gel is at rest.
    """
    return min(max(bisect_right(frame_ends, moment) - 1, 1), max(len(frame_ends) - 1, 0))


class Recorder:
    """Steps the world; every snapshot is taken once and kept by its step."""

    def __init__(
        self,
        world: Engine,
        robot: Robot,
        body: Body,
        stroke_m: float,
        settings: PhysicsSettings,
        frame_ends: Sequence[int],
    ) -> None:
        self._world = world
        self._robot = robot
        self._body = body
        self._half_stroke_m = stroke_m / 2
        self._average = settings.contact_average_steps
        self.frame_ends = frame_ends
        steps = {step for end in frame_ends for step in range(max(0, end - self._average), end + 1)}
        self._planned = sorted(steps, reverse=True)  # the next one is last
        self._past_every = 0
        self.step = 0
        self.snapshots: dict[int, Snapshot] = {}
        self.advance(0)

    def advance(self, count: int) -> None:
        """Advance by ``count`` steps, taking the planned snapshots on the way."""
        end = self.step + max(0, count)
        while (stop := self._next_stop(end)) <= end:
            if self._planned and self._planned[-1] == stop:
                self._planned.pop()
            self._world.step(stop - self.step)
            self.step = stop
            self.snapshot()
        self._world.step(end - self.step)
        self.step = end

    def _next_stop(self, end: int) -> int:
        """The next step of which a snapshot is to be taken, or one after ``end``."""
        stop = self._planned[-1] if self._planned else end + 1
        every = self._past_every
        return min(stop, (self.step // every + 1) * every) if every else stop

    def keep_past(self, every: int) -> None:
        """Take a snapshot now and at every so many steps from here on."""
        self._past_every = every
        self.snapshot()

    def past(self) -> list[Snapshot]:
        """The snapshots of the load's past: the same ones whatever frames are kept."""
        every = self._past_every
        return [one for step, one in sorted(self.snapshots.items()) if every and not step % every]

    def plan(self, steps: Iterable[int]) -> None:
        """Take a snapshot at these steps too, which are still to come."""
        self._planned = sorted({*self._planned, *steps}, reverse=True)

    def placement(self) -> Placement:
        """Where the object and the gripper are now."""
        return Placement(
            self.step, *self._body.inertial_position(), *self._robot.gripper_position()
        )

    def pad_distance_m(self) -> tuple[float, float]:
        """How far the left and the right pad now are from the gripper's middle."""
        left_m, right_m = self._robot.fingers.travel_m()
        return self._half_stroke_m - left_m, self._half_stroke_m - right_m

    def snapshot(self) -> Snapshot:
        """The world now."""
        if self.step not in self.snapshots:
            self.snapshots[self.step] = Snapshot(
                self.step,
                *self._body.inertial_position(),
                *self._robot.gripper_position(),
                contacts=self._world.contacts(),
                object_angular_velocity=self._body.velocity()[1],
                pad_distance_m=self.pad_distance_m(),
            )
        return self.snapshots[self.step]

    def observe(self) -> list[Snapshot]:
        """Advance by as many steps as forces are averaged over, and record each."""
        window = [self.snapshot()]
        for _ in range(self._average):
            self.advance(1)
            window.append(self.snapshot())
        return window

    def advance_to_frame(self, count: int) -> None:
        """Advance by ``count`` steps, at the end of which a frame can be taken."""
        early = max(0, count - self._average)
        self.advance(early)
        self.snapshot()
        for _ in range(count - early):
            self.advance(1)
            self.snapshot()

    def window(self, end: int) -> list[Snapshot]:
        """The snapshots of the frame that ends at step ``end``."""
        return [self.snapshots[step] for step in range(max(0, end - self._average), end + 1)]
