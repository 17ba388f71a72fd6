"""Training recipes: YAML files with the network, its input and how it is trained."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    AllowInfNan,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
)

from tacgen.core.files import sha256_of_content
from tacgen.core.records import PadName, Until
from tacgen.core.schema import Section, YamlSource, load_checked

MIN_INPUT_PX, MAX_INPUT_PX = 32, 2048
"""ResNet-18 halves an image five times; no tactile camera has more pixels."""
POOLED = "pooled"  # name of the one model for all objects


def _input_size(size_px: tuple[int, int]) -> tuple[int, int]:
    if min(size_px) < MIN_INPUT_PX or max(size_px) > MAX_INPUT_PX:
        msg = f"[height, width] must lie between {MIN_INPUT_PX} and {MAX_INPUT_PX} pixels"
        raise ValueError(msg)
    return size_px


BesideImage = Literal["markers", "force_field", "commanded", "object"]
Channel = Literal["image", "vision", "markers", "force_field", "commanded", "object"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)


def _with_image(channels: tuple[str, ...]) -> tuple[Channel, ...]:
    named = ["image" if name == "touch" else name for name in channels]
    if not {"image", "vision"} & set(named) or len(set(named)) < len(named):
        msg = "names `touch` or `vision`, which the network is of, and each of the others once"
        raise ValueError(msg)
    return tuple(name for name in CHANNELS if name in named)


class ModelOptions(Section):
    """The network, with the paper's layers."""

    kind: Literal["single", "sequence"] = "single"
    """ResNet-18 on one image, or with an LSTM on a sequence."""
    weights: str = "auto"
    """Pre-trained weights: ``none``; ``imagenet`` (from the cache of the Hugging Face hub or of
    torch; an error if there are none); ``auto`` (``imagenet`` if they are there, else none, with a
    warning); or the path of a ResNet-18 weight file."""


class InputOptions(Section):
    """The network's input."""

    pad: PadName | None = None
    """The pad whose images are used; the dataset's first if not given."""
    channels: Annotated[
        tuple[Literal["touch", Channel], ...],
        AfterValidator(_with_image),
    ] = ("image",)
    """What the network sees: ``touch`` (or ``image``), the sensor's images; ``vision``, those of a
    camera, through a ResNet-18 of its own; and, a small branch each beside: the ``markers``' motion
    and the ``force_field``, as far as the dataset keeps them, what was ``commanded`` (force, place
    and yaw), and which ``object`` of the training it is."""
    camera: str | None = None
    """The camera of ``vision``; the dataset's first if not given."""
    size_px: Annotated[tuple[int, int], AfterValidator(_input_size)] = (120, 160)
    """Height and width to which images are resized."""
    image: Literal["difference", "change", "raw"] = "difference"
    """``difference`` to the gel at rest, ``change`` since the frame before (slip stands out; the
    first frame: since the gel at rest), or ``raw``."""
    normalised: bool = False
    """Whether each image's gain and each grasp's contrast are removed; not for ``raw``."""
    frames: Annotated[int, Field(ge=2, le=256)] | None = None
    """Frames of a sequence, evenly spaced; all if not given."""
    until: Until = "lift"
    """Where a sequence ends: at the start of the ``lift``, to predict the outcome, or after it, to
    detect the ``outcome``, which its last frames show."""
    cache_mb: NonNegativeInt = 1024
    """Memory for resized images."""


class Augmentation(Section):
    """Random changes of each grasp's images in each epoch, the same for all of its frames."""

    on: bool = False
    """Whether training images are changed."""
    shift_fraction: Annotated[float, Field(ge=0, le=0.5)] = 0.05
    """Largest shift, as a fraction of the image's sides."""
    gain_relative: Annotated[float, Field(ge=0, le=0.5)] = 0.05
    """Standard deviation of the camera's gain in each colour."""
    imprint_relative: Annotated[float, Field(ge=0, le=0.5)] = 0.15
    """Standard deviation, by colour, of the contrast of what the contact changes: other lamps."""
    noise_grey: Annotated[float, Field(ge=0, le=64)] = 1.0
    """Standard deviation of each pixel's noise in grey levels, at the network's input size."""
    blur_px: Annotated[float, Field(ge=0, le=16)] = 1.0
    """Largest standard deviation of a Gaussian blur of the imprint, at the network's input size."""


class TrainingOptions(Section):
    """The training."""

    epochs: Annotated[int, Field(ge=1, le=10_000)] = 30
    """Passes over the training grasps."""
    average_epochs: Annotated[int, Field(ge=1, le=10_000)] = 8
    """The kept model is the mean of the weights over about this many latest epochs."""
    batch_size: Annotated[int, Field(ge=2, le=4096)] = 8
    """Grasps per step."""
    learning_rate: Annotated[PositiveFloat, AllowInfNan(False)] = 1e-4
    """Adam's learning rate."""
    backbone_rate_factor: Annotated[NonNegativeFloat, AllowInfNan(False)] = 0.8
    """Learning rate of the ResNet-18 over that of the other layers."""
    weight_decay: Annotated[NonNegativeFloat, AllowInfNan(False)] = 5e-5
    """Adam's weight decay."""
    plateau_factor: Annotated[float, Field(gt=0, lt=1)] = 0.1
    """Factor on the learning rate when the validation loss stops falling."""
    plateau_patience: NonNegativeInt = 10
    """Epochs without improvement before that."""
    validation_fraction: Annotated[float, Field(gt=0, lt=0.9)] = 0.15
    """Share of the training grasps that is held out to choose the learning rate."""
    grasps: PositiveInt | None = None
    """Number of training grasps per object; all if not given."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """``auto``: a GPU if there is one."""
    threads: Annotated[int, Field(ge=1, le=256)] = 1
    """Threads of torch on a CPU."""


class TrainRecipe(Section):
    """One training job."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    """Name of the run."""
    description: str = ""
    """One sentence on it."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of every random number."""
    objects: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    """Objects of the dataset to train on; all if not given."""
    per_object: bool = True
    """One model per object, as in the paper, or one for all of them."""
    model: ModelOptions = ModelOptions()
    """The network."""
    input: InputOptions = InputOptions()
    """The network's input."""
    augmentation: Augmentation = Augmentation()
    """Random changes of the training images."""
    training: TrainingOptions = TrainingOptions()
    """The training."""

    def resolved(self) -> dict[str, Any]:
        """Every setting, written or not, as plain data."""
        return self.model_dump(mode="json")

    def sha256(self) -> str:
        """A hash of every setting, the same for recipes that mean the same."""
        return sha256_of_content(self.resolved())


def load_train_recipe(name: str | Path) -> TrainRecipe:
    """Read and check the training recipe ``name`` (a path, or the name of a shipped one).

    Raises ``TacgenError``, which lists everything that is wrong, each with its file, line and fix.
    """
    return load_checked(TrainRecipe, name, _problems)


def _problems(recipe: TrainRecipe, source: YamlSource) -> Iterator[str]:
    options = recipe.input
    if recipe.objects is not None and len(set(recipe.objects)) != len(recipe.objects):
        yield source.problem(("objects",), "names an object twice; keep one")
    if recipe.model.kind == "single" and options.frames is not None:
        yield source.problem(
            ("input", "frames"), "only applies to `model.kind: sequence`; remove it"
        )
    if options.camera is not None and "vision" not in options.channels:
        yield source.problem(("input", "camera"), "is of the channel `vision`; add it, or remove")
    if options.image == "raw" and options.normalised:
        yield source.problem(("input", "normalised"), "does not apply to `image: raw`; remove it")
