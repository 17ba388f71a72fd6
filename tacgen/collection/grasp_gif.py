"""One grasp of a recipe as an animation, without a dataset."""

from pathlib import Path

import numpy as np
from PIL import Image

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline, planned_times_s
from tacgen.collection.recipe import Recipe
from tacgen.core.errors import RecipeError
from tacgen.core.files import atomic_path
from tacgen.core.images import side_by_side
from tacgen.dataset.schema import FLAG_WORDS
from tacgen.dataset.summary import CHANGE

MAX_WIDTH_PX = 420  # of each pad's image: several fit beside one another on a page
LEAST_FRAME_MS = 100  # viewers slow down animations that are faster


def write_gif(recipe: Recipe, index: int, path: Path) -> str:
    """Simulate a grasp and write the frames of its pads, side by side; how the grasp ended.

    That includes what its pictures lack at the moment of grasp, and what to change.

    Raises ``RecipeError`` if the recipe has no such grasp, or it could not be executed.
    """
    planned = plan_recipe(recipe)
    if not 0 <= index < len(planned):
        msg = f"--grasp {index}: {recipe.name} has grasps 0 to {len(planned) - 1}"
        raise RecipeError(msg)
    with GraspPipeline(recipe) as pipeline:
        sample = pipeline.sample(planned[index])
    if not sample.pads:
        msg = f"--grasp {index}: could not be executed ({sample.reason or sample.status})"
        raise RecipeError(msg)
    moments = zip(*(pad.rgb for pad in sample.pads.values()), strict=True)
    frames = [Image.fromarray(side_by_side(list(pads), MAX_WIDTH_PX)) for pads in moments]
    times_s = np.asarray(planned_times_s(recipe))
    step_ms = 1000.0 * float(np.diff(times_s).mean()) if len(times_s) > 1 else 1000.0
    with atomic_path(path) as partial:
        frames[0].save(
            partial,
            format="GIF",
            save_all=True,
            append_images=frames[1:],
            duration=round(max(step_ms, LEAST_FRAME_MS)),
            loop=0,
        )
    outcome = "success" if sample.label == 1 else sample.failure_mode or sample.status
    flags = {name: pad.flags(sample.grasp_frame) for name, pad in sample.pads.items()}
    found = [outcome, *(f"{pad} pad: {', '.join(words)}" for pad, words in flags.items() if words)]
    if any(FLAG_WORDS["nothing_to_see"] in words for words in flags.values()):
        found.append(CHANGE)
    return "; ".join(found)
