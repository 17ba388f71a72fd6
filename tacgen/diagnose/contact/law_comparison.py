"""One grasp rendered with two contact laws: what an effect that was found changes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import frame_request, recipe_object, tactile_pad
from tacgen.collection.recipe import Recipe
from tacgen.contact import ContactLaw
from tacgen.core.errors import RecipeError
from tacgen.core.records import ContactFrame, GraspObject
from tacgen.physics import GraspSimulator, run_grasp
from tacgen.report import Section, figure_section, image_section, write_page
from tacgen.sensor.gel_response import gel_loads
from tacgen.sensor.tactile_pad import TactileFrame, TactilePad

STRIP_FRAMES = 6
THUMBNAIL_WIDTH_PX = 170
DIFFERENCE_GAIN = 4


def write_before_after(recipe: Recipe, before: ContactLaw, after: ContactLaw, path: Path) -> None:
    """Simulate the strongest grasp of ``recipe`` once and show what each law makes of it.

    Raises
    ------
    RecipeError
        If the grasp cannot be executed, or the recipe asks for single images only.
    """
    if recipe.frames.mode != "sequence":
        msg = f"recipe {recipe.name!r} asks for single images; memory shows in `mode: sequence`"
        raise RecipeError(msg)
    grasped, frames = _strongest_grasp(recipe)
    pad = tactile_pad(recipe)
    rendered = {
        name: _render(pad, grasped, frames, law)
        for name, law in (("before", before), ("after", after))
    }
    sections = [_curves(frames, rendered), _strips(rendered)]
    write_page(path, "The same grasp before and after", sections, summary=_sentence(rendered))


def _strongest_grasp(recipe: Recipe) -> tuple[GraspObject, tuple[ContactFrame, ...]]:
    planned = max(plan_recipe(recipe), key=lambda grasp: grasp.config.force_n)
    grasped = recipe_object(recipe.objects[planned.entry])
    with GraspSimulator(recipe.robot.name) as simulator:
        trace = run_grasp(
            simulator,
            grasped,
            planned.config,
            recipe.physics_settings,
            frames=frame_request(recipe),
        )
    frames = next(iter(trace.frames.values()), ())
    if not frames:
        msg = f"recipe {recipe.name!r}: its strongest grasp was not executed: {trace.reason}"
        raise RecipeError(msg)
    return grasped, frames


def _render(
    pad: TactilePad, grasped: GraspObject, frames: Sequence[ContactFrame], law: ContactLaw
) -> list[TactileFrame]:
    loads = gel_loads(law, frames)
    return [
        pad.render(grasped.surface, frame.pose_gel_object, load)
        for frame, load in zip(frames, loads, strict=True)
    ]


def _curves(frames: Sequence[ContactFrame], rendered: dict[str, list[TactileFrame]]) -> Section:
    figure = Figure(figsize=(10, 3), layout="constrained")
    force, volume = figure.subplots(1, 2)
    times_s = [frame.time_s for frame in frames]
    force.plot(times_s, [frame.force_normal_n for frame in frames], color="#1c2430")
    force.set(xlabel="time (s)", ylabel="normal force (N)")
    for name, color in (("before", "#8a94a3"), ("after", "#0b6e99")):
        volumes = [one.imprint.volume_mm3 for one in rendered[name]]
        volume.plot(times_s, volumes, color=color, label=name)
    volume.set(xlabel="time (s)", ylabel="imprint volume (mm³)")
    volume.legend(frameon=False)
    return figure_section("Force and imprint", figure)


def _strips(rendered: dict[str, list[TactileFrame]]) -> Section:
    count = len(rendered["before"])
    chosen = np.unique(np.linspace(0, count - 1, min(STRIP_FRAMES, count)).astype(int))
    rows = {name: np.stack([rendered[name][k].rgb for k in chosen]) for name in rendered}
    difference = rows["after"].astype(int) - rows["before"]
    grey = np.clip(128 + DIFFERENCE_GAIN * difference, 0, 255).astype(np.uint8)
    strips = [_strip(images) for images in (rows["before"], rows["after"], grey)]
    return image_section(
        "Images: before, after, difference",
        np.concatenate(strips),
        f"Frames from the start of closing to the end; the difference is shown {DIFFERENCE_GAIN}× "
        "about grey.",
    )


def _strip(images: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height = round(THUMBNAIL_WIDTH_PX * images.shape[1] / images.shape[2])
    size = (THUMBNAIL_WIDTH_PX, height)
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in images]
    return np.concatenate(small, axis=1)


def _sentence(rendered: dict[str, list[TactileFrame]]) -> str:
    before, after = (
        np.array([one.imprint.volume_mm3 for one in rendered[name]]) for name in ("before", "after")
    )
    grey = np.mean(
        [
            np.abs(a.rgb.astype(int) - b.rgb).mean()
            for a, b in zip(rendered["after"], rendered["before"], strict=True)
        ]
    )
    most = int(np.argmax(np.abs(after - before)))
    return (
        f"The imprint differs most at frame {most + 1}: {after[most]:.3g} mm³ instead of "
        f"{before[most]:.3g} mm³. The images differ by {grey:.2g} grey levels on average."
    )
