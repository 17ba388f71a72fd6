"""An object on the table, a gripper, and its tactile pads: what the environments act on."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.grid import PlannedGrasp, plan_recipe
from tacgen.collection.pipeline import GraspPipeline, HeldGrasp, SimulatedGrasp
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.core.errors import RecipeError, require_known
from tacgen.core.records import GraspConfig, GraspTrace
from tacgen.core.types import FloatArray
from tacgen.dataset import CameraSample, PadSample

OBJECTS_KEPT = 32  # some 5 MB each; loading one takes as long as a grasp


@dataclass(frozen=True, slots=True)
class Touch:
    """What is known of a grasp: its physics, and what each sensing pad shows, by name.

    The pads are at rest where the grasp was not executed, as ``status`` of the trace says;
    ``cameras`` is what each camera of the recipe sees, by name.
    """

    grasp: SimulatedGrasp
    pads: Mapping[str, PadSample]
    cameras: Mapping[str, CameraSample]

    @property
    def trace(self) -> GraspTrace:
        """The physics; before the lift its label is −1 and it has no margin."""
        return self.grasp.trace


class GraspWorld:
    """Grasps and regrasps of the objects of a recipe, by the recipe's own pipeline.

    ``place`` stands an object on the table, ``grasp`` grasps it and shows the pads as they are
    before the lift, ``lift`` lifts it and says how that ended. What the recipe's ``randomize`` has
    drawn of the object, the gel and the camera stays over all grasps until the next ``place``;
    where the gripper comes to is off anew in each grasp, as is the camera's noise. The first grasp
    of a planned grasp's object by that grasp's own values is ``tacgen collect``'s to the byte.

    An approximation: each grasp starts from the object's rest pose, as if what moved it before were
    undone. A grasp that closes off the object's middle pushes it by some millimetres.

    ``recipe`` is a recipe, its path, or the name of a shipped one. The physics starts with the
    first grasp; ``close`` ends it.

    Raises ``RecipeError``, ``TableError``, ``SensorError``, ``PhysicsError`` as ``tacgen collect``
    does.
    """

    def __init__(self, recipe: Recipe | str | Path) -> None:
        if not isinstance(recipe, Recipe | str | Path):
            msg = f"recipe is a {type(recipe).__name__}; give its name, its path or a Recipe"
            raise RecipeError(msg)
        self.recipe = recipe if isinstance(recipe, Recipe) else load_recipe(recipe)
        self.plan = plan_recipe(self.recipe)
        self.objects = tuple(entry.object_name for entry in self.recipe.objects)
        device = self.recipe.optics.device
        self.pipeline = GraspPipeline(self.recipe, device, objects_kept=OBJECTS_KEPT)
        values = np.array([grasp_values(grasp) for grasp in self.plan])
        self.low, self.high = values.min(axis=0), values.max(axis=0)
        """Smallest and largest of ``AXES`` (5,) in the plan, over all objects."""
        self._by_object: dict[str, list[PlannedGrasp]] = {}
        for grasp in self.plan:
            self._by_object.setdefault(grasp.config.object, []).append(grasp)
        self._is_open = False
        self._planned: PlannedGrasp | None = None
        self._attempt = 0
        self._held: HeldGrasp | None = None

    def draw(self, rng: np.random.Generator, object_name: str | None = None) -> PlannedGrasp:
        """A grasp of the plan at random, of a random object or that one, with a seed of its own.

        Raises ``RecipeError`` if the recipe has no such object.
        """
        if object_name is None:
            object_name = self.objects[int(rng.integers(len(self.objects)))]
        require_known("object", object_name, self.objects, RecipeError)
        own = self._by_object[object_name]
        return replace(own[int(rng.integers(len(own)))], seed=int(rng.integers(2**63)))

    def place(self, planned: PlannedGrasp) -> None:
        """Stand the object of ``planned`` on the table, with what its seed draws."""
        self._planned, self._attempt, self._held = planned, 0, None

    def grasp(self, values: FloatArray) -> Touch:
        """Grasp the object by the values (5,) of ``AXES``; the pads before the lift.

        The frames of a sequence end there: the outcome does not show.
        """
        held = self._start(values)
        return self._touch(held.look())

    def lift(self) -> GraspTrace:
        """Lift what ``grasp`` holds, once: label, failure mode, margin, or why nothing is held."""
        held, self._held = self._held, None
        if held is None:
            msg = "nothing is held; grasp first"
            raise RuntimeError(msg)
        return held.lift().trace

    def grasp_and_lift(self, values: FloatArray) -> Touch:
        """Both, with the frames that the recipe asks for."""
        whole = self._start(values, until_lift=False).lift()
        self._held = None
        return self._touch(whole)

    def untouched(self) -> Touch:
        """What is known before the first grasp: gels at rest, and what was drawn."""
        return self._shown(self.pipeline.at_rest(self._standing()), 0)

    def close(self) -> None:
        """End the physics; a later grasp starts it again."""
        if self._is_open:
            self.pipeline.__exit__(None, None, None)
        self._is_open, self._held = False, None

    def _standing(self) -> PlannedGrasp:
        if self._planned is None:
            msg = "no object stands on the table; place one first"
            raise RuntimeError(msg)
        return self._planned

    def _start(self, values: FloatArray, *, until_lift: bool = True) -> HeldGrasp:
        standing = self._standing()
        if not self._is_open:
            self.pipeline.__enter__()
            self._is_open = True
        index, name = standing.config.index, standing.config.object
        asked = replace(standing, config=GraspConfig(index, name, *map(float, values)))
        frames = self.recipe.frames
        if until_lift:
            frames = replace(frames, until="lift")
        self._held = self.pipeline.start(asked, self._attempt, frames=frames)
        self._attempt += 1
        return self._held

    def _touch(self, grasp: SimulatedGrasp) -> Touch:
        return self._shown(grasp, self._attempt - 1)

    def _shown(self, grasp: SimulatedGrasp, attempt: int) -> Touch:
        pads = self.pipeline.pad_samples(grasp, attempt)
        return Touch(grasp, pads, self.pipeline.camera_samples(grasp))


def grasp_values(planned: PlannedGrasp) -> NDArray[np.float64]:
    """The values (5,) of ``AXES`` of a grasp of the plan: N, mm, mm, mm, rad."""
    return np.array(planned.config.point[1:])
