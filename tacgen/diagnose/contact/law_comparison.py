"""One simulated grasp rendered by two contact laws: what an effect changes in the images."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe
from tacgen.contact import ContactLaw
from tacgen.contact.indenter import Imprint
from tacgen.core.errors import RecipeError
from tacgen.core.images import difference, evenly, side_by_side
from tacgen.core.records import ContactFrame
from tacgen.report import figures as plots
from tacgen.report.formatting import number
from tacgen.report.page import PageSection, figure_section, pictures_section, write_page

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
    planned = max(plan_recipe(recipe), key=lambda grasp: grasp.config.force_n)
    with GraspPipeline(recipe) as pipeline:
        grasp = pipeline.simulate(planned)
        if grasp.trace.status != "executed":
            reason = grasp.trace.reason
            msg = f"recipe {recipe.name!r}: its strongest grasp was not executed: {reason}"
            raise RecipeError(msg)
        pad, frames = next(iter(grasp.trace.frames.items()))
        laws = {"before": before, "after": after}
        rendered = {name: pipeline.render(grasp, pad, law=law) for name, law in laws.items()}
    sections = [_strips(rendered), _curves(frames, rendered)]
    write_page(
        path,
        "One grasp with the law before and after",
        sections,
        summary=_summary(rendered),
        made_by="diagnose contact",
    )


Rendered = tuple[NDArray[np.uint8], list[Imprint]]
"""Images (T, H, W, 3) of a grasp, and what they show."""


def _curves(frames: Sequence[ContactFrame], rendered: dict[str, Rendered]) -> PageSection:
    figure, grid = plots.new_figure(10, 3, 1, 2)
    force, volume = grid[0]
    times_s = [frame.time_s for frame in frames]
    force.plot(times_s, [frame.force_normal_n for frame in frames], color=plots.INK)
    force.set(xlabel="time, s", ylabel="normal force, N")
    for name, color in (("before", plots.MUTED), ("after", plots.ACCENT)):
        volumes = [one.volume_mm3 for one in rendered[name][1]]
        volume.plot(times_s, volumes, color=color, label=name)
    volume.set(xlabel="time, s", ylabel="imprint volume, mm³")
    volume.legend(frameon=False)
    return figure_section("Force and imprint volume", figure)


def _strips(rendered: dict[str, Rendered]) -> PageSection:
    chosen = list(evenly(len(rendered["before"][0]), STRIP_FRAMES))
    before, after = (list(rendered[name][0][chosen]) for name in ("before", "after"))
    changes = [
        difference(new, old, DIFFERENCE_GAIN) for new, old in zip(after, before, strict=True)
    ]
    rows = (("before", before), ("after", after), (f"difference, {DIFFERENCE_GAIN}×", changes))
    strips = [(name, side_by_side(images, THUMBNAIL_WIDTH_PX)) for name, images in rows]
    return pictures_section("Images from the start of closing to the end", strips)


def _summary(rendered: dict[str, Rendered]) -> str:
    before, after = (
        np.array([one.volume_mm3 for one in rendered[name][1]]) for name in ("before", "after")
    )
    grey = np.abs(rendered["after"][0].astype(int) - rendered["before"][0]).mean()
    most = int(np.argmax(np.abs(after - before)))
    return (
        f"The imprint differs most at frame {most + 1}: {number(after[most], 3)} mm³ instead of "
        f"{number(before[most], 3)} mm³. The images differ by {number(float(grey), 2)} grey levels "
        "on average."
    )
