"""The same grasp felt by two contact laws: what an effect that was found changes in the images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import felt_pad, frame_request, recipe_object
from tacgen.collection.recipe import Recipe
from tacgen.contact import ContactLaw
from tacgen.core.errors import RecipeError
from tacgen.core.records import ContactFrame, GraspObject
from tacgen.physics import GraspSimulator, run_grasp
from tacgen.report import Section, figure_section, image_section, write_page
from tacgen.sensor.gel_response import deformation
from tacgen.sensor.tactile_pad import Felt, Pad

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
    pad = felt_pad(recipe)
    felt = {
        name: _feel(pad, grasped, frames, law)
        for name, law in (("before", before), ("after", after))
    }
    sections = [_curves(frames, felt), _strips(felt)]
    write_page(path, "The same grasp before and after", sections, summary=_sentence(felt))


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


def _feel(
    pad: Pad, grasped: GraspObject, frames: Sequence[ContactFrame], law: ContactLaw
) -> list[Felt]:
    bulk = deformation(law, frames)
    return [
        pad.feel(
            grasped.surface,
            frame.pose_gel_object,
            volume_mm3=bulk.volume_mm3[k],
            indentation_mm=bulk.depth_mm[k],
            shear_sum_mm=bulk.shear_sum_mm[k],
            turn_sum_mm2=bulk.turn_sum_mm2[k],
        )
        for k, frame in enumerate(frames)
    ]


def _curves(frames: Sequence[ContactFrame], felt: dict[str, list[Felt]]) -> Section:
    figure = Figure(figsize=(10, 3), layout="constrained")
    force, volume = figure.subplots(1, 2)
    times_s = [frame.time_s for frame in frames]
    force.plot(times_s, [frame.force_normal_n for frame in frames], color="#1c2430")
    force.set(xlabel="time (s)", ylabel="normal force (N)")
    for name, color in (("before", "#8a94a3"), ("after", "#0b6e99")):
        volumes = [one.imprint.volume_mm3 for one in felt[name]]
        volume.plot(times_s, volumes, color=color, label=name)
    volume.set(xlabel="time (s)", ylabel="imprint volume (mm³)")
    volume.legend(frameon=False)
    return figure_section("Force and imprint", figure)


def _strips(felt: dict[str, list[Felt]]) -> Section:
    count = len(felt["before"])
    chosen = np.unique(np.linspace(0, count - 1, min(STRIP_FRAMES, count)).astype(int))
    rows = {name: np.stack([felt[name][k].rgb for k in chosen]) for name in felt}
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


def _sentence(felt: dict[str, list[Felt]]) -> str:
    before, after = (
        np.array([one.imprint.volume_mm3 for one in felt[name]]) for name in ("before", "after")
    )
    grey = np.mean(
        [
            np.abs(a.rgb.astype(int) - b.rgb).mean()
            for a, b in zip(felt["after"], felt["before"], strict=True)
        ]
    )
    most = int(np.argmax(np.abs(after - before)))
    return (
        f"The imprint differs most at frame {most + 1}: {after[most]:.3g} mm³ instead of "
        f"{before[most]:.3g} mm³. The images differ by {grey:.2g} grey levels on average."
    )
