"""Models and training states on disk: safetensors, and torch files read with ``weights_only``."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass
from safetensors import safe_open
from safetensors.torch import save

from tacgen.core.errors import LearningError
from tacgen.core.files import DiskFile, atomic_path, require_readable
from tacgen.core.resources import __version__
from tacgen.learning.backbone import read_tensors
from tacgen.learning.network_input import InputSpec
from tacgen.learning.networks import StabilityNet, build_network

_CARD_KEY = "tacgen_model"
_REFERENCE_KEY = "input.reference"
FROM_THE_START = "remove it to train from the start"


@dataclass(frozen=True, slots=True)
class ModelCard:
    """The metadata of a model file.

    ``weights`` names the pre-trained weights (``none``: from scratch);
    ``epoch`` is that of the model, counted from 1; ``temperature`` and ``prior_logit``, the log
    odds of success in training, calibrate its probabilities (0 in models of early versions);
    ``input_range`` is the lowest and highest of each ``input_statistics`` in training,
    ``contrast`` their ``typical_contrast``.
    """

    name: str
    objects: tuple[str, ...]
    input: InputSpec
    sensor: str
    weights: str
    epoch: int
    recipe_sha256: str
    temperature: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    input_range: tuple[tuple[float, float], ...]
    contrast: float
    prior_logit: Annotated[float, Field(allow_inf_nan=False)] = 0.0
    tacgen_version: str = __version__


def save_model(
    path: Path, network: StabilityNet, card: ModelCard, reference: NDArray[np.uint8] | None
) -> None:
    """Write a model, its card and the image of the undeformed gel, whole or not at all."""
    state = network.state_dict()
    tensors = {name: value.detach().cpu().contiguous() for name, value in state.items()}
    if reference is not None:
        tensors[_REFERENCE_KEY] = torch.from_numpy(np.ascontiguousarray(reference))
    content = save(tensors, metadata={_CARD_KEY: json.dumps(asdict(card))})
    with atomic_path(path) as partial:
        partial.write_bytes(content)


def load_model(path: Path) -> tuple[StabilityNet, ModelCard, NDArray[np.uint8] | None]:
    """Read a model, its card, and the image of the undeformed gel that it was trained with.

    Raises ``LearningError`` if the file is missing, damaged, or that of another network.
    """
    if not path.is_file():
        msg = (
            f"{path}: the model is missing; remove {path.parent / 'checkpoint.pt'} if there is one "
            "and run `tacgen train` with the same recipe again"
        )
        raise LearningError(msg)
    require_readable(path, LearningError)
    try:
        with safe_open(path, framework="pt") as file:
            text = (file.metadata() or {}).get(_CARD_KEY, "")
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        card = TypeAdapter(ModelCard).validate_json(text)
    except ValidationError as error:
        msg = f"{path}: not a model that this version of `tacgen train` writes; train it again"
        raise LearningError(msg) from error
    except Exception as error:  # the readers raise whatever a damaged file leads them to
        msg = f"{path}: cannot be read as a model ({error}); train it again"
        raise LearningError(msg) from error
    reference = tensors.pop(_REFERENCE_KEY, None)
    sizes = [one.size for one in card.input.touch]
    network = build_network(card.input.kind, touch=sizes, n_images=card.input.n_images)
    network.load(tensors, str(path))
    network.backbone.origin = card.weights
    network.temperature, network.prior_logit = card.temperature, card.prior_logit
    return network.eval(), card, None if reference is None else reference.numpy()


def save_state(path: Path, state: dict[str, Any]) -> None:
    """Write a training state of tensors and plain values, whole or not at all."""
    with atomic_path(path) as partial, DiskFile(partial) as disk:
        torch.save(state, disk)
        disk.raise_failure()


def load_state(path: Path, keys: tuple[str, ...]) -> dict[str, Any]:
    """Read a training state that holds ``keys``; nothing in the file is run.

    Raises ``LearningError`` if it cannot be read, or is not such a state.
    """
    require_readable(path, LearningError)
    state = read_tensors(path, "a checkpoint", FROM_THE_START)
    if not isinstance(state, dict) or set(state) != set(keys):
        msg = f"{path}: not a checkpoint of this version of tacgen; {FROM_THE_START}"
        raise LearningError(msg)
    return state
