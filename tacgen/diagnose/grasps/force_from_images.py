"""The force that was really delivered, from the tactile images of real grasps.

The volume that a pad's gel is indented by grows with the normal force and with nothing else that a
diagnosis of labels considers: V = k_n F. So how strongly a real image differs from the untouched
one is compared with simulated images of the same grasp at several forces.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tacgen.collection.grid import PlannedGrasp
from tacgen.collection.pipeline import GraspPipeline, tactile_pad
from tacgen.collection.recipe import Randomize, Recipe
from tacgen.collection.scene_section import Scene
from tacgen.core.errors import TacgenError
from tacgen.core.safe_io import read_rgb
from tacgen.core.types import FloatArray
from tacgen.dataset.real_grasps import FRAME_UNKNOWN, RealGrasp, RealGrasps
from tacgen.diagnose.grasps.model_comparison import NO_READING, ForceReading
from tacgen.diagnose.rules import GRASPS

Image = NDArray[np.uint8]


def force_from_images(
    recipe: Recipe, real: RealGrasps, show: Callable[[int, int], None]
) -> tuple[ForceReading, str]:
    """The delivered force over the declared one by images, and a sentence about it.

    Successful grasps are read first: where an object slides, its imprint changes.
    """
    grasps = sorted((g for g in real.grasps if g.images), key=lambda grasp: -grasp.label)[
        : GRASPS.images_read
    ]
    if len(grasps) < GRASPS.least_images:
        return NO_READING, "no images to read the force from: labels alone decide"
    measured, simulated = imprint_strengths(recipe, real.folder, grasps, show)
    readings = [
        float(np.interp(one, curve, np.log(GRASPS.image_forces)))
        for one, curve in zip(measured, simulated, strict=True)
        if (np.diff(curve) > 0).all() and curve[0] <= one <= curve[-1]
    ]
    if len(readings) < GRASPS.least_images:
        return NO_READING, (
            f"the images of {len(grasps)} grasps do not compare with those of the recipe's sensor "
            "at any force: labels alone decide"
        )
    middle = float(np.median(readings))
    spread = 1.48 * float(np.median(np.abs(np.array(readings) - middle)))
    k_n_error = GRASPS.calibrated_k_n_error if recipe.contact.file else GRASPS.declared_k_n_error
    stderr = float(np.hypot(k_n_error, spread / np.sqrt(len(readings))))
    return ForceReading(middle, stderr), (
        f"the imprints of {len(readings)} grasps are those of {np.exp(middle):.2f} times the "
        f"declared force, to {100 * stderr:.0f} % (the gel's compliance included)"
    )


def imprint_strengths(
    recipe: Recipe, folder: Path, grasps: Sequence[RealGrasp], show: Callable[[int, int], None]
) -> tuple[FloatArray, FloatArray]:
    """How strong each grasp's imprint is: measured (N,), simulated (N, len(GRASPS.image_forces)).

    Compared are the moments of grasp where they are known or the sequences are equally long, else
    the strongest images. NaN where an image lacks.
    """
    measured = np.full(len(grasps), np.nan)
    simulated = np.full((len(grasps), len(GRASPS.image_forces)), np.nan)
    for column, factor in enumerate(GRASPS.image_forces):
        world = _at_force(recipe, grasps, factor)
        untouched = tactile_pad(world).at_rest_rgb
        names = [entry.object_name for entry in world.objects]
        with GraspPipeline(world) as pipeline:
            for row, grasp in enumerate(grasps):
                entry = names.index(grasp.config.object)
                sample = pipeline.sample(PlannedGrasp(grasp.config, entry, "test", 0, 0))
                show(column * len(grasps) + row + 1, simulated.size)
                if not sample.pads:
                    continue
                frames = next(iter(sample.pads.values())).rgb
                known = grasp.grasp_frame != FRAME_UNKNOWN
                alike = known or len(frames) == len(grasp.images)
                moment = sample.grasp_frame if alike else None
                simulated[row, column] = _strongest(frames, moment, untouched)
                if factor == 1.0:
                    own = grasp.grasp_frame if known else moment
                    measured[row] = _measured(grasp, folder, own, untouched)
    return measured, simulated


def imprint_strength(image: Image, untouched: Image) -> float:
    """Mean of |image − untouched| beyond the noise, grey levels.

    The image is brought to the brightness of the untouched one first, so that a camera's gain
    does not count; most of a gel is untouched.
    """
    height, width = image.shape[:2]
    size = GRASPS.image_width_px, max(1, round(height * GRASPS.image_width_px / width))
    # A small size averages the camera's noise away.
    small, base = (
        cv2.resize(one, size, interpolation=cv2.INTER_AREA).astype(np.float64)
        for one in (image, untouched)
    )
    small *= np.median(base) / max(float(np.median(small)), 1.0)
    return float(
        np.maximum(np.abs(small - base).mean(axis=2) - GRASPS.image_noise_grey, 0.0).mean()
    )


def _strongest(frames: Sequence[Image] | Image, moment: int | None, untouched: Image) -> float:
    chosen = frames if moment is None else [frames[moment]]
    return max(imprint_strength(frame, untouched) for frame in chosen)


def _measured(grasp: RealGrasp, folder: Path, moment: int | None, expected: Image) -> float:
    """The strength of a real imprint; NaN if an image cannot be read or is of another shape.

    Untouched is ``background.png``, else the first image of a sequence, else as simulated.
    """
    frames = [_read(path) for path in grasp.images]
    background = _read(folder / "background.png")
    if background is None:
        background = frames[0] if len(frames) > 1 else expected
    usable = [f for f in frames if f is not None and f.shape == expected.shape]
    if len(usable) < len(frames) or background is None or background.shape != expected.shape:
        return float("nan")
    return _strongest(usable, moment, background)


def _at_force(recipe: Recipe, grasps: Sequence[RealGrasp], factor: float) -> Recipe:
    """The recipe at another delivered force, without noise, naming every object."""
    names = dict.fromkeys(entry.object_name for entry in recipe.objects)
    names |= dict.fromkeys(grasp.config.object for grasp in grasps)
    physics = recipe.physics
    force_scale = physics.delivered_force_scale * factor
    return recipe.model_copy(
        update={
            "objects": tuple(map(recipe.entry_of, names)),
            "physics": replace(physics, delivered_force_scale=force_scale),
            "optics": recipe.optics.model_copy(update={"noise": False}),
            "dataset": recipe.dataset.model_copy(update={"scene_pictures": False}),
            "scene": Scene(),
            "randomize": Randomize(),
        }
    )


def _read(path: Path) -> Image | None:
    """An RGB image, or None where there is none that can be read."""
    with contextlib.suppress(TacgenError):
        return read_rgb(path)
    return None
