"""Training recipes: YAML files with the network, its input and how it is trained."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
)

from tacgen.core.config import Section, finite
from tacgen.core.errors import LearningError
from tacgen.core.resources import find_recipe
from tacgen.core.yaml_source import read_yaml, validate

MIN_INPUT_PX, MAX_INPUT_PX = 32, 2048
"""ResNet-18 halves an image five times; no tactile camera has more pixels."""
POOLED = "pooled"
"""Name of the one model for all objects."""


def _input_size(size_px: tuple[int, int]) -> tuple[int, int]:
    if min(size_px) < MIN_INPUT_PX or max(size_px) > MAX_INPUT_PX:
        msg = f"[height, width] must lie between {MIN_INPUT_PX} and {MAX_INPUT_PX} pixels"
        raise ValueError(msg)
    return size_px


class ModelOptions(Section):
    """The network; its layers are the paper's and have no switches.

    ``weights`` is ``none`` (from scratch), ``imagenet`` (from the cache of the Hugging Face hub or
    of torch; an error where there is none), ``auto`` (``imagenet`` where there is such a file, else
    from scratch with a warning), or the path of a ResNet-18 weight file.
    """

    kind: Literal["single", "sequence"] = "single"
    weights: str = "auto"


class InputOptions(Section):
    """The network's input: pad, image size, frames, and what is subtracted from each image.

    ``image`` is ``difference`` to the gel at rest, ``change`` since the frame before (of the first
    frame: since the gel at rest), or ``raw``. While a grasp holds, images do not change,
    so slip and rotation stand out in ``change``; for a single image it equals ``difference``.
    """

    pad: Literal["left", "right"] | None = None
    size_px: Annotated[tuple[int, int], AfterValidator(_input_size)] = (120, 160)
    image: Literal["difference", "change", "raw"] = "difference"
    frames: Annotated[int, Field(ge=2, le=256)] | None = None
    cache_mb: NonNegativeInt = 1024
    loader_workers: Annotated[int, Field(ge=0, le=64)] = 0


class Augmentation(Section):
    """Random changes of each grasp in each epoch, the same for all of its frames.

    ``shift_fraction`` is the largest shift as a fraction of the image's sides; ``gain_relative``
    and ``noise_grey`` are standard deviations.
    """

    on: bool = False
    shift_fraction: Annotated[float, Field(ge=0, le=0.5)] = 0.05
    gain_relative: Annotated[float, Field(ge=0, le=0.5)] = 0.05
    noise_grey: Annotated[float, Field(ge=0, le=64)] = 1.0


class TrainingOptions(Section):
    """How the network is trained. ``precision: auto`` is mixed precision on a GPU only.

    The kept model is the mean of the weights over about the latest ``average_epochs`` epochs; with
    1 it is the latest.
    """

    epochs: Annotated[int, Field(ge=1, le=10_000)] = 30
    average_epochs: Annotated[int, Field(ge=1, le=10_000)] = 8
    batch_size: Annotated[int, Field(ge=2, le=4096)] = 8
    learning_rate: Annotated[PositiveFloat, AfterValidator(finite)] = 1e-4
    backbone_rate_factor: Annotated[NonNegativeFloat, AfterValidator(finite)] = 0.8
    weight_decay: Annotated[NonNegativeFloat, AfterValidator(finite)] = 5e-5
    plateau_factor: Annotated[float, Field(gt=0, lt=1)] = 0.1
    plateau_patience: NonNegativeInt = 10
    validation_fraction: Annotated[float, Field(gt=0, lt=0.9)] = 0.15
    grasps: PositiveInt | None = None
    device: Literal["auto", "cpu", "cuda"] = "auto"
    precision: Literal["auto", "float32"] = "auto"
    threads: Annotated[int, Field(ge=1, le=256)] = 1


class TrainRecipe(Section):
    """One training job.

    ``per_object`` trains one model an object, as the paper does; otherwise one for all of them.
    ``objects`` selects some of the dataset; if not given, all are used.
    """

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    description: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    objects: tuple[str, ...] | None = None
    per_object: bool = True
    model: ModelOptions = ModelOptions()
    input: InputOptions = InputOptions()
    augmentation: Augmentation = Augmentation()
    training: TrainingOptions = TrainingOptions()

    def resolved(self) -> dict[str, Any]:
        """Every setting, written or not, as plain data."""
        return self.model_dump(mode="json")

    def sha256(self) -> str:
        """A hash of every setting, the same for recipes that mean the same."""
        return hashlib.sha256(json.dumps(self.resolved(), sort_keys=True).encode()).hexdigest()


def load_train_recipe(name: str | Path) -> TrainRecipe:
    """Read and check the training recipe ``name`` (a path, or the name of a shipped one).

    Raises ``TacgenError``, which lists everything that is wrong, each with its file, line and fix.
    """
    source = read_yaml(find_recipe(str(name)))
    recipe = validate(TrainRecipe, source, LearningError)
    problems = []
    if recipe.objects is not None and len(set(recipe.objects)) != len(recipe.objects):
        problems.append(source.problem(("objects",), "names an object twice; keep one"))
    if recipe.model.kind == "single" and recipe.input.frames is not None:
        problems.append(
            source.problem(("input", "frames"), "only applies to `model.kind: sequence`; remove it")
        )
    if problems:
        raise LearningError.from_problems(problems)
    return recipe
