"""Environments of Gymnasium: grasp once, or grasp, look, and lift or regrasp."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, SupportsFloat

import cv2
import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle, RecordConstructorArgs
from numpy.typing import NDArray

from tacgen.collection.grid import PlannedGrasp
from tacgen.collection.recipe import Recipe
from tacgen.core.errors import LearningError
from tacgen.core.records import AXES, LABEL_SUCCESS
from tacgen.core.types import FloatArray
from tacgen.envs.grasp_world import GraspWorld, Touch, grasp_values

Observation = dict[str, Any]
Info = dict[str, Any]
Action = NDArray[np.float32]

OPTIONS = ("grasp", "object")
VECTORS = ("markers_mm", "force_field_n")
SEEN = ("rgb", "depth_mm")
"""What observations hold of a camera; its segments are what a robot does not see."""
FIXED_FORCE_RANGE, FIXED_RANGE = 0.01, np.array([0.1, 0.1, 0.1, 0.001])
"""How wide an axis of actions is to which the recipe gives one value: of the force as a share,
below it; of the others in mm and rad, above. No grasp notices, but learners divide by it."""
MOST_REGRASPS = 98  # fewer steps than at which Gymnasium would cut an episode short
ROUNDING = 1e-4  # of an axis, by which an action in single precision may be outside


class TactileEnv(gymnasium.Env[Observation, Action], EzPickle):
    """An object on the table, and a gripper with tactile pads.

    An observation is a dictionary. Of each sensing pad, such as ``left``, it has ``left_rgb``,
    (H, W, 3), or (T, H, W, 3) where the recipe asks for a sequence, and ``left_markers_mm`` and
    ``left_force_field_n`` where its ``dataset`` asks for them, as in a shard; of each camera, such
    as ``front``, ``camera_front_rgb`` and ``camera_front_depth_mm``. ``gripper`` (6,) is what the
    gripper was commanded to (force_n, x_mm, y_mm, z_mm, yaw_rad) and the distance between its pads
    in mm, the full opening where they hold nothing.

    ``info`` has what a robot could not know: the ``object``, what was ``drawn`` of it and
    ``commanded``, ``status`` (why, if the grasp was not executed, in ``reason``) and, after a lift,
    ``label`` (−1 where it was not executed), ``failure_mode`` and, where it was,
    ``margin_translational`` and ``margin_rotational`` as in a shard. ``saturated`` and
    ``outside_window`` say of the moment of grasp whether an image does not show the whole force.

    A copy, or one that is sent to another process, is made anew from the arguments: ``reset`` it.

    Parameters
    ----------
    recipe
        A recipe, its path, or the name of a shipped one.
    image_px
        (height, width) to which images are reduced; if not given, they are the sensor's.
    render_mode
        ``rgb_array``: ``render`` gives the pads' images beside a picture of the scene.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": 2,
    }

    def __init__(
        self,
        recipe: Recipe | str | Path,
        *,
        image_px: tuple[int, int] | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            msg = f"render_mode {render_mode!r} is not known; give 'rgb_array', or none"
            raise LearningError(msg)
        if image_px is not None and not _is_size(image_px):
            msg = f"image_px = {image_px!r}; give (height, width) in whole pixels"
            raise LearningError(msg)
        self.render_mode, self._image_px = render_mode, image_px
        self.world = GraspWorld(recipe)
        self.low, self.high = _with_width(self.world.low, self.world.high)
        self._planned, self._ended = self.world.plan[0], True
        self.world.place(self._planned)
        self._touch = self.world.untouched()
        self.observation_space = self._spaces_of(self._observe())

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Stand another object on the table, with what the recipe's ``randomize`` draws of it.

        ``options={"object": name}`` chooses it; ``options={"grasp": index}`` takes a grasp of the
        recipe's grid with the random numbers that it has in ``tacgen collect``.

        Raises ``LearningError`` or ``RecipeError`` if there is no such option, grasp or object.
        """
        super().reset(seed=seed)
        self._planned, self._ended = self._chosen(dict(options or {})), False
        self.world.place(self._planned)
        self._touch = self._first_touch()
        return self._observe(), self._info()

    def render(self) -> NDArray[np.uint8] | None:
        """The pads' images at the moment of grasp beside the scene, (h, w, 3)."""
        if self.render_mode is None:
            return None
        frame = self._touch.trace.grasp_frame
        images = [sample.rgb[frame] for sample in self._touch.pads.values()]
        scene = self.world.pipeline.picture(self._touch.grasp)
        height = len(images[0])
        size_px = round(scene.shape[1] * height / scene.shape[0]), height
        scene = np.asarray(cv2.resize(scene, size_px, interpolation=cv2.INTER_LINEAR), np.uint8)
        return np.hstack([*images, scene])

    def close(self) -> None:
        """End the physics."""
        self.world.close()

    def _first_touch(self) -> Touch:
        """What the first observation of an episode shows."""
        return self.world.untouched()

    def _chosen(self, options: dict[str, Any]) -> PlannedGrasp:
        if len(options) > 1 or not set(options) <= set(OPTIONS):
            msg = f"options {options!r}; give one of {', '.join(OPTIONS)}, or none"
            raise LearningError(msg)
        if "grasp" not in options:
            return self.world.draw(self.np_random, options.get("object"))
        index, count = options["grasp"], len(self.world.plan)
        if not isinstance(index, int | np.integer) or not 0 <= index < count:
            msg = f"options: grasp = {index!r}; the recipe's grasps are 0 to {count - 1}"
            raise LearningError(msg)
        return self.world.plan[int(index)]

    def _observe(self) -> Observation:
        found: Observation = {}
        for pad, sample in self._touch.pads.items():
            found[f"{pad}_rgb"] = self._resized(sample.rgb)
            for name in VECTORS:
                array = getattr(sample, name)
                if array is not None:
                    found[f"{pad}_{name}"] = array.copy()
        if self.world.recipe.frames.mode == "single":
            found = {name: frames[0] for name, frames in found.items()}
        for camera, view in self._touch.cameras.items():
            found |= {f"camera_{camera}_{name}": getattr(view, name).copy() for name in SEEN}
        trace, opening_mm = self._touch.trace, self._stroke_mm
        if trace.pad_distance_mm is not None:
            opening_mm = float(trace.pad_distance_mm[trace.grasp_frame].sum())
        values = grasp_values(self._touch.grasp.planned)
        found["gripper"] = np.array([*values, opening_mm], np.float32)
        return found

    def _spaces_of(self, observation: Observation) -> spaces.Dict:
        """The space of observations like that one."""
        found: dict[str, spaces.Space[Any]] = {}
        for name, array in observation.items():
            low, high = (0, 255) if array.dtype == np.uint8 else (-np.inf, np.inf)
            found[name] = spaces.Box(low, high, array.shape, array.dtype.type)
        least, most = np.append(self.low, 0.0), np.append(self.high, self._stroke_mm)
        found["gripper"] = spaces.Box(least.astype(np.float32), most.astype(np.float32))
        return spaces.Dict(found)

    @property
    def _stroke_mm(self) -> float:
        return self.world.pipeline.simulator.robot.gripper.stroke_mm

    def _resized(self, images: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if self._image_px is None:
            return images.copy()
        height, width = self._image_px
        resized = [cv2.resize(i, (width, height), interpolation=cv2.INTER_AREA) for i in images]
        return np.asarray(resized, np.uint8)

    def _info(self, **more: Any) -> Info:
        grasp, trace = self._touch.grasp, self._touch.trace
        moment, samples = trace.grasp_frame, self._touch.pads.values()
        flags = ("saturated", "outside_window")
        return {
            "object": grasp.planned.config.object,
            "status": trace.status,
            "reason": trace.reason,
            "commanded": dict(zip(AXES, grasp_values(grasp.planned).tolist(), strict=True)),
            "drawn": {
                "friction": grasp.grasped.friction,
                "mass_kg": grasp.grasped.mass_kg,
                "center_of_mass_mm": np.array(grasp.grasped.center_of_mass_mm),
                "k_n_factor": grasp.variation.k_n_factor,
                "sensor_gain_factor": grasp.variation.gain_factor,
                "gripper_off_mm": np.array(grasp.variation.position_mm),
                "gripper_off_rad": grasp.variation.yaw_rad,
            },
            **{name: any(bool(getattr(s, name)[moment]) for s in samples) for name in flags},
            **more,
        }

    def _outcome(self) -> tuple[float, Info]:
        """The reward of a lift, and ``info`` after it."""
        trace = self._touch.trace
        ended: Info = {"label": trace.label, "failure_mode": trace.failure_mode}
        if trace.margin is not None:
            ended["margin_translational"] = trace.margin.translational
            ended["margin_rotational"] = trace.margin.rotational
        return float(trace.label == LABEL_SUCCESS), self._info(**ended)

    def _checked(self, action: object, names: tuple[str, ...]) -> FloatArray:
        """The numbers of an action, within the action space.

        Raises ``ResetNeeded`` after the end of an episode, ``LearningError`` if the action is none.
        """
        if self._ended:
            msg = "the episode is over; call reset"
            raise gymnasium.error.ResetNeeded(msg)
        box = self.action_space
        assert isinstance(box, spaces.Box)
        try:
            values = np.asarray(action, np.float64)
        except (TypeError, ValueError):
            values = np.zeros(0)
        if values.shape != box.shape:
            shape = getattr(action, "shape", type(action).__name__)
            msg = f"the action {shape} is not {len(names)} numbers: {', '.join(names)}"
            raise LearningError(msg)
        slack = ROUNDING * (box.high - box.low)
        within = (box.low - slack <= values) & (values <= box.high + slack)
        for k in np.flatnonzero(~within):  # what is not a number is not within either
            msg = (
                f"the action's {names[k]} = {values[k]:g} is not within {box.low[k]:.6g} to "
                f"{box.high[k]:.6g}; clip it to env.action_space, or wrap the environment in "
                "tacgen.envs.Normalized"
            )
            raise LearningError(msg)
        return np.asarray(np.clip(values, box.low, box.high))


class GraspEnv(TactileEnv):
    """``tacgen/Grasp-v0``: one grasp, which is lifted; an episode is one step.

    An action is force_n, x_mm, y_mm, z_mm, yaw_rad, each within what the recipe's grid has of it
    over all objects (an axis with one value is a hair wide). The reward is 1 if the object is
    lifted as a success, else 0, also where the grasp cannot be executed. The observation of
    ``reset`` shows the gels at rest, and in ``gripper`` a grasp of the recipe's grid for this
    object, which an action may improve on; that of the step has the frames that the recipe asks
    for.
    """

    def __init__(self, recipe: Recipe | str | Path, **options: Any) -> None:
        EzPickle.__init__(self, recipe, **options)
        super().__init__(recipe, **options)
        low, high = self.low.astype(np.float32), self.high.astype(np.float32)
        self.action_space = spaces.Box(low, high)

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, Info]:
        """Grasp and lift.

        The grasp that ``gripper`` shows after ``reset``, in single precision, stands for itself.
        """
        values, planned = self._checked(action, AXES), grasp_values(self._planned)
        if np.array_equal(values.astype(np.float32), planned.astype(np.float32)):
            values = planned
        self._touch, self._ended = self.world.grasp_and_lift(values), True
        reward, info = self._outcome()
        return self._observe(), reward, True, False, info


class RegraspEnv(TactileEnv):
    """``tacgen/Regrasp-v0``: look at what the pads show, and lift, or change the grasp.

    ``reset`` makes a first grasp, one of the recipe's grid. An action is ``lift`` (−1 to 1), then
    changes of force_n, x_mm, y_mm, z_mm and yaw_rad. With ``lift`` above 0 the object is lifted,
    whatever the changes: the reward is 1 for a success, else 0, and the episode ends. Otherwise the
    gripper opens and grasps again by the changed values, kept within the recipe's grid, which costs
    ``regrasp_cost``. After ``max_regrasps`` of them any action lifts; ``regrasps_left`` in the
    observation counts down to it. A grasp that cannot be executed shows gels at rest, and to lift
    it is a failure.

    Observations end before the lift, also in sequences of recipes that go on to the outcome. An
    object's friction, mass and centre of mass stay through an episode; each grasp starts from its
    rest pose (``GraspWorld`` says more).
    """

    def __init__(
        self,
        recipe: Recipe | str | Path,
        *,
        max_regrasps: int = 3,
        regrasp_cost: float = 0.1,
        **options: Any,
    ) -> None:
        own = {"max_regrasps": max_regrasps, "regrasp_cost": regrasp_cost}
        EzPickle.__init__(self, recipe, **own, **options)
        known = isinstance(max_regrasps, int | np.integer)
        if not known or not 0 <= max_regrasps <= MOST_REGRASPS:
            msg = f"max_regrasps = {max_regrasps!r}; give a whole number, 0 to {MOST_REGRASPS}"
            raise LearningError(msg)
        if (
            not isinstance(regrasp_cost, int | float | np.number)
            or not 0 <= regrasp_cost < math.inf
        ):
            msg = f"regrasp_cost = {regrasp_cost!r}; give 0 or more: a success is worth 1"
            raise LearningError(msg)
        self._max_regrasps, self._cost = int(max_regrasps), float(regrasp_cost)
        self._left = self._max_regrasps
        super().__init__(recipe, **options)
        reach = np.append(1.0, self.high - self.low).astype(np.float32)
        self.action_space = spaces.Box(-reach, reach)

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, Info]:
        """Lift or regrasp."""
        names = ("lift", *(f"change of {axis}" for axis in AXES))
        lift, *changes = self._checked(action, names)
        if lift > 0 or self._left == 0:
            whole = replace(self._touch.grasp, trace=self.world.lift())
            self._touch, self._ended = replace(self._touch, grasp=whole), True
            reward, info = self._outcome()
            return self._observe(), reward, True, False, info
        values = grasp_values(self._touch.grasp.planned) + changes
        self._left -= 1
        self._touch = self.world.grasp(np.clip(values, self.low, self.high))
        return self._observe(), -self._cost, False, False, self._info()

    def _first_touch(self) -> Touch:
        self._left = self._max_regrasps
        return self.world.grasp(grasp_values(self._planned))

    def _observe(self) -> Observation:
        return super()._observe() | {"regrasps_left": np.int64(self._left)}

    def _spaces_of(self, observation: Observation) -> spaces.Dict:
        found = super()._spaces_of(observation)
        found["regrasps_left"] = spaces.Discrete(self._max_regrasps + 1)
        return found

    def _info(self, **more: Any) -> Info:
        return super()._info(regrasps=self._max_regrasps - self._left, **more)


class Normalized(
    gymnasium.ObservationWrapper[Observation, Action, Observation], RecordConstructorArgs
):
    """What learners such as Stable-Baselines3 take: actions and the gripper's state in −1 to 1.

    The frames of a sequence become channels of one image, (H, W, 3 T). Markers and force fields
    become vectors, the latter as shares of the recipe's largest force.

    Raises ``LearningError`` where an image is not larger each way than its channels are many:
    learners take the smallest side for the channels.
    """

    def __init__(self, env: gymnasium.Env[Observation, Action]) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)
        if not isinstance(env.unwrapped, TactileEnv):
            msg = f"Normalized is of environments of tacgen, not {type(env.unwrapped).__name__}"
            raise LearningError(msg)
        self._force_n = float(env.unwrapped.high[0])
        inner = env.action_space
        assert isinstance(inner, spaces.Box)
        self._low, self._range = inner.low.astype(np.float64), (inner.high - inner.low) / 2.0
        self.action_space = spaces.Box(-1.0, 1.0, inner.shape)
        assert isinstance(env.observation_space, spaces.Dict)
        found = {}
        for name, space in env.observation_space.items():
            found[name] = space
            if name == "gripper":
                found[name] = spaces.Box(-1.0, 1.0, space.shape)
            elif name.endswith("_rgb") and space.shape is not None and len(space.shape) == 4:
                count, height, width, colors = space.shape
                if count * colors >= min(height, width):
                    msg = (
                        f"{name}: {count} frames of {colors} colours are {count * colors} "
                        f"channels over {height} × {width} px, of which learners take the smallest "
                        f"for the channels; give image_px above {count * colors} each way, or a "
                        f"recipe with frames.count at most {(min(height, width) - 1) // colors}"
                    )
                    raise LearningError(msg)
                found[name] = spaces.Box(0, 255, (height, width, count * colors), np.uint8)
            elif name.endswith(VECTORS):
                assert isinstance(space, spaces.Box)
                found[name] = spaces.Box(-np.inf, np.inf, (space.low.size,))
        self.observation_space = spaces.Dict(found)

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, Info]:
        """As the environment's, by an action in −1 to 1, to which others are clipped."""
        given = np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        if given.shape == self._low.shape:  # any other is the environment's to refuse
            given = self._low + (given + 1.0) * self._range
        return super().step(given.astype(np.float32))

    def observation(self, observation: Observation) -> Observation:
        """The observation as its space is declared."""
        found = dict(observation)
        for name, array in observation.items():
            if name == "gripper":
                box = self.env.observation_space[name]  # type: ignore[index]
                share = (array - box.low) / (box.high - box.low)
                found[name] = np.clip(2.0 * share - 1.0, -1.0, 1.0).astype(np.float32)
            elif name.endswith("_rgb") and array.ndim == 4:
                found[name] = np.concatenate(array, axis=-1)
            elif name.endswith(VECTORS):
                unit = self._force_n if name.endswith("_n") else 1.0
                found[name] = array.ravel() / np.float32(unit)
        return found


def _is_size(given: object) -> bool:
    if not isinstance(given, tuple | list) or len(given) != 2:
        return False
    return all(isinstance(n, int | np.integer) and n > 0 for n in given)


def _with_width(low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The bounds (5,) with ``FIXED_RANGE`` between those that are equal.

    Less force and higher up: the other way might be out of the gripper's reach.
    """
    fixed = low == high
    low, high = low.copy(), high + np.append(0.0, FIXED_RANGE) * fixed
    low[0] *= 1.0 - FIXED_FORCE_RANGE * fixed[0]
    return low, high
