"""One simulated grasp rendered by two contact laws: what an effect changes in the images."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacgen.collection.grid import plan_recipe
from tacgen.collection.perturbed import recipe_object
from tacgen.collection.pipeline import tactile_pad
from tacgen.collection.recipe import Recipe
from tacgen.contact import ContactLaw
from tacgen.core.errors import RecipeError
from tacgen.core.images import difference, evenly, side_by_side
from tacgen.core.records import ContactFrame, GraspObject
from tacgen.physics import GraspSimulator, run_grasp
from tacgen.report import figures as plots
from tacgen.report.formatting import number
from tacgen.report.page import Section, figure_section, pictures_section, write_page
from tacgen.sensor.gel_response import gel_loads
from tacgen.sensor.tactile_pad import TactileFrame

STRIP_FRAMES = 6  # what a page's width holds
THUMBNAIL_WIDTH_PX = 170  # six fit into a page's width
DIFFERENCE_GAIN = 4  # differences of a few grey levels become visible


def write_law_comparison(recipe: Recipe, before: ContactLaw, after: ContactLaw, path: Path) -> None:
    """Simulate the strongest grasp of ``recipe`` once and render it by each law.

    Raises ``RecipeError`` if the grasp cannot be executed, or the recipe asks for single images
    only.
    """
    if recipe.frames.mode != "sequence":
        msg = f"recipe {recipe.name!r} asks for single images; memory shows in `mode: sequence`"
        raise RecipeError(msg)
    grasped, frames = _strongest_grasp(recipe)
    pad = tactile_pad(recipe)
    rendered = {
        name: [
            pad.render(grasped.surface, frame.pose_gel_object, load)
            for frame, load in zip(frames, gel_loads(law, frames), strict=True)
        ]
        for name, law in (("before", before), ("after", after))
    }
    sections = [_strips(rendered), _curves(frames, rendered)]
    write_page(
        path, "One grasp with the law before and after", sections, summary=_summary(rendered)
    )


def _strongest_grasp(recipe: Recipe) -> tuple[GraspObject, tuple[ContactFrame, ...]]:
    planned = max(plan_recipe(recipe), key=lambda grasp: grasp.config.force_n)
    grasped = recipe_object(recipe.objects[planned.entry])
    with GraspSimulator(recipe.robot.name) as simulator:
        trace = run_grasp(
            simulator, grasped, planned.config, recipe.physics_settings, frames=recipe.frames
        )
    frames = next(iter(trace.frames.values()), ())
    if not frames:
        msg = f"recipe {recipe.name!r}: its strongest grasp was not executed: {trace.reason}"
        raise RecipeError(msg)
    return grasped, frames


def _curves(frames: Sequence[ContactFrame], rendered: dict[str, list[TactileFrame]]) -> Section:
    figure, grid = plots.new_figure(10, 3, 1, 2)
    force, volume = grid[0]
    times_s = [frame.time_s for frame in frames]
    force.plot(times_s, [frame.force_normal_n for frame in frames], color=plots.INK)
    force.set(xlabel="time, s", ylabel="normal force, N")
    for name, color in (("before", plots.MUTED), ("after", plots.ACCENT)):
        volumes = [one.imprint.volume_mm3 for one in rendered[name]]
        volume.plot(times_s, volumes, color=color, label=name)
    volume.set(xlabel="time, s", ylabel="imprint volume, mm³")
    volume.legend(frameon=False)
    return figure_section("Force and imprint volume", figure)


def _strips(rendered: dict[str, list[TactileFrame]]) -> Section:
    chosen = evenly(len(rendered["before"]), STRIP_FRAMES)
    before, after = ([rendered[name][k].rgb for k in chosen] for name in ("before", "after"))
    changes = [
        difference(new, old, DIFFERENCE_GAIN) for new, old in zip(after, before, strict=True)
    ]
    rows = (("before", before), ("after", after), (f"difference, {DIFFERENCE_GAIN}×", changes))
    strips = [(name, side_by_side(images, THUMBNAIL_WIDTH_PX)) for name, images in rows]
    return pictures_section("Images from the start of closing to the end", strips)


def _summary(rendered: dict[str, list[TactileFrame]]) -> str:
    before, after = (
        np.array([one.imprint.volume_mm3 for one in rendered[name]]) for name in ("before", "after")
    )
    pairs = zip(rendered["after"], rendered["before"], strict=True)
    grey = np.mean([np.abs(a.rgb.astype(int) - b.rgb).mean() for a, b in pairs])
    most = int(np.argmax(np.abs(after - before)))
    return (
        f"The imprint differs most at frame {most + 1}: {number(after[most], 3)} mm³ instead of "
        f"{number(before[most], 3)} mm³. The images differ by {number(float(grey), 2)} grey levels "
        "on average."
    )
