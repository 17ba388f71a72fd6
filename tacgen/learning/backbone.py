"""The ResNet-18 that looks at one image, and where its first weights come from.

torchvision's network is used where it can be imported, else that of transformers; they are the
same layers under other names (``weight_names``). Weight files are read as safetensors or with
``weights_only``: nothing in them is run.
"""

from __future__ import annotations

import importlib
import pickle
import struct
from collections.abc import Mapping
from pathlib import Path
from zipfile import BadZipFile

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from tacgen.core.errors import LearningError
from tacgen.core.files import is_file
from tacgen.learning.weight_names import Naming, renamed

FEATURES = 512
HUB_NAME = "microsoft/resnet-18"
TORCHVISION_FILE = "resnet18-f37072fd.pth"
NO_WEIGHTS = "none"
UNREADABLE = (
    OSError,
    RuntimeError,
    ValueError,
    KeyError,
    EOFError,
    IndexError,
    TypeError,
    AttributeError,
    AssertionError,
    OverflowError,
    struct.error,
    pickle.UnpicklingError,
    BadZipFile,
    SafetensorError,
)


class Backbone(nn.Module):
    """ResNet-18 without its classifier: images (B, 3, H, W) to features (B, 512).

    ``origin`` says where its weights come from: ``none`` is from scratch.
    """

    def __init__(self) -> None:
        super().__init__()
        self.naming, self.network = _new_network()
        self.origin = NO_WEIGHTS

    def forward(self, images: Tensor) -> Tensor:
        """Images (B, 3, H, W) to features (B, 512)."""
        features = self.network(images.contiguous(memory_format=torch.channels_last))
        if self.naming == "transformers":
            features = features.pooler_output
        return features.flatten(1)

    def load(self, weights: Mapping[str, Tensor], where: str) -> None:
        """Take ``weights``, of torchvision's or transformers' names.

        Raises
        ------
        LearningError
            If they are not those of a ResNet-18.
        """
        own = self.network.state_dict()
        given = renamed(weights, self.naming, own)
        problem = shape_problem(own, given)
        if problem:
            msg = f"{where}: these are not the weights of a ResNet-18 ({problem}); give such a file"
            raise LearningError(msg)
        self.network.load_state_dict(given, strict=False)
        self.origin = where


def make_backbone(weights: str) -> Backbone:
    """A ResNet-18 with the first weights that ``weights`` names.

    Parameters
    ----------
    weights : str
        ``none``; ``imagenet``; ``auto`` (``imagenet`` where the weights are at hand, else none);
        or the path of a weight file (``.safetensors``, or torch's ``.pth``, ``.pt``, ``.bin``).

    Raises
    ------
    LearningError
        If the named weights are not at hand or not a ResNet-18's.
    """
    backbone = Backbone()
    if weights == "none":
        return backbone
    if weights in ("auto", "imagenet"):
        path = cached_imagenet_file()
        if path is not None:
            backbone.load(read_weights(path), f"imagenet ({path.name})")
        elif weights == "imagenet":
            msg = (
                f"no ImageNet weights on this machine: neither {HUB_NAME} in the cache of the hub "
                f"nor {TORCHVISION_FILE} in that of torch; download one where there is a network "
                "and name its path in model.weights, or set model.weights: none"
            )
            raise LearningError(msg)
        return backbone
    path = Path(weights).expanduser()
    if not is_file(path):
        msg = (
            f"model.weights = {weights!r} is no file; give a ResNet-18 weight file, "
            "or auto, imagenet or none"
        )
        raise LearningError(msg)
    backbone.load(read_weights(path), str(path))
    return backbone


def cached_imagenet_file() -> Path | None:
    """The ImageNet weights that torchvision or the hub left on this machine, if any."""
    torchvision_file = Path(torch.hub.get_dir()) / "checkpoints" / TORCHVISION_FILE
    if torchvision_file.is_file():
        return torchvision_file
    from huggingface_hub import try_to_load_from_cache

    for name in ("model.safetensors", "pytorch_model.bin"):
        found = try_to_load_from_cache(HUB_NAME, name)
        if isinstance(found, str):
            return Path(found)
    return None


def read_weights(path: Path) -> dict[str, Tensor]:
    """Named tensors of a weight file, read without running anything in it.

    Raises
    ------
    LearningError
        If it is no such file, or holds more than tensors.
    """
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        content = torch.load(path, map_location="cpu", weights_only=True)
    except UNREADABLE as error:
        reason = str(error).strip().splitlines()[0][:200] if str(error).strip() else "empty"
        msg = f"{path}: cannot be read as weights ({reason}); give a .safetensors file"
        raise LearningError(msg) from error
    content = content.get("state_dict", content) if isinstance(content, dict) else content
    if not isinstance(content, dict) or not all(isinstance(v, Tensor) for v in content.values()):
        msg = f"{path}: does not hold named tensors; give a state dict of a ResNet-18"
        raise LearningError(msg)
    return content


def shape_problem(own: Mapping[str, Tensor], given: Mapping[str, Tensor]) -> str:
    """What keeps ``given`` from being the weights ``own``; empty where nothing does."""
    needed = [name for name in own if not name.endswith("num_batches_tracked")]
    missing = [name for name in needed if name not in given]
    if missing:
        return f"{len(missing)} of {len(needed)} are missing, the first is {missing[0]}"
    extra = sorted(set(given) - set(own))
    if extra:
        return f"{len(extra)} are of no use here, the first is {extra[0]}"
    for name in needed:
        if own[name].shape != given[name].shape:
            return f"{name} has shape {tuple(given[name].shape)}, not {tuple(own[name].shape)}"
    return ""


def _new_network() -> tuple[Naming, nn.Module]:
    try:
        models = importlib.import_module("torchvision.models")
    except (ImportError, RuntimeError):  # the latter from a torchvision built for another torch
        return "transformers", _transformers_network()
    network = models.resnet18(weights=None)
    network.fc = nn.Identity()
    return "torchvision", network


def _transformers_network() -> nn.Module:
    from transformers import ResNetConfig, ResNetModel

    config = ResNetConfig(
        embedding_size=64,
        hidden_sizes=[64, 128, 256, 512],
        depths=[2, 2, 2, 2],
        layer_type="basic",
        hidden_act="relu",
    )
    return ResNetModel(config)
