"""The ResNet-18 that looks at one image, and its pre-trained weights.

The network is that of transformers; torchvision's has the same layers under other names.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from tacgen.core.errors import LearningError
from tacgen.core.files import is_file
from tacgen.core.safe_io import refuse_packed

FEATURES = 512  # width of ResNet-18's last stage
WIDTHS = [64, 128, 256, FEATURES]  # of its stages
DEPTHS = [2, 2, 2, 2]  # their blocks
HUB_NAME = "microsoft/resnet-18"
TORCHVISION_FILE = "resnet18-f37072fd.pth"
NO_WEIGHTS = "none"
_STEM = {"conv1": "embedder.embedder.convolution", "bn1": "embedder.embedder.normalization"}
_IN_BLOCK = {
    "conv1": "layer.0.convolution",
    "bn1": "layer.0.normalization",
    "conv2": "layer.1.convolution",
    "bn2": "layer.1.normalization",
    "downsample.0": "shortcut.convolution",
    "downsample.1": "shortcut.normalization",
}
_BLOCK = re.compile(r"layer(\d)\.(\d)\.(conv\d|bn\d|downsample\.\d)\.(\w+)")
# What files put before a backbone's names, and the layers of a classifier, which are left out.
_PREFIXES = ("module.", "resnet.", "backbone.", "model.")
_CLASSIFIER = ("fc.", "classifier.")


class Backbone(nn.Module):
    """ResNet-18 without its classifier: images (B, 3, H, W) to features (B, 512).

    ``origin`` names its pre-trained weights: ``none`` is from scratch.
    """

    def __init__(self) -> None:
        from transformers import ResNetConfig, ResNetModel  # takes seconds to import

        super().__init__()
        self.network = ResNetModel(
            ResNetConfig(
                embedding_size=WIDTHS[0], hidden_sizes=WIDTHS, depths=DEPTHS, layer_type="basic"
            )
        )
        self.origin = NO_WEIGHTS

    def forward(self, images: Tensor) -> Tensor:
        """Images (B, 3, H, W) to features (B, 512)."""
        images = images.contiguous(memory_format=torch.channels_last)
        features: Tensor = self.network(images).pooler_output.flatten(1)
        return features

    def load(self, weights: Mapping[str, Tensor], where: str) -> None:
        """Load pre-trained ``weights``, named as by transformers or torchvision.

        Raises ``LearningError`` if they are not those of a ResNet-18.
        """
        given = {own_name(name): value for name, value in weights.items()}
        given = {name: v for name, v in given.items() if not name.startswith(_CLASSIFIER)}
        problem = shape_problem(self.network.state_dict(), given)
        if problem:
            msg = f"{where}: these are not the weights of a ResNet-18 ({problem}); give such a file"
            raise LearningError(msg)
        self.network.load_state_dict(given, strict=False)
        self.origin = where


def own_name(name: str) -> str:
    """The network's name of a weight in a file: no prefix, and torchvision's names translated."""
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    module, _, tail = name.rpartition(".")
    if module in _STEM:
        return f"{_STEM[module]}.{tail}"
    found = _BLOCK.fullmatch(name)
    if not found:
        return name
    stage, block, part, tail = found.groups()
    return f"encoder.stages.{int(stage) - 1}.layers.{block}.{_IN_BLOCK[part]}.{tail}"


def make_backbone(weights: str) -> Backbone:
    """A ResNet-18 with the pre-trained weights that ``weights`` names.

    That is ``none``; ``imagenet``; ``auto`` (``imagenet`` where the weights are at hand, else
    none); or the path of a weight file (``.safetensors``, or torch's ``.pth``, ``.pt``, ``.bin``).
    Raises ``LearningError`` if the named weights are not at hand or not a ResNet-18's.
    """
    backbone = Backbone()
    imagenet = cached_imagenet_file() if weights in ("auto", "imagenet") else None
    if imagenet is not None:
        backbone.load(read_weights(imagenet), f"imagenet ({imagenet.name})")
    elif weights == "imagenet":
        msg = (
            f"no ImageNet weights on this machine: neither {HUB_NAME} in the cache of the "
            f"Hugging Face hub nor {TORCHVISION_FILE} in that of torch; download one and name "
            "its path in model.weights, or set model.weights: none"
        )
        raise LearningError(msg)
    elif weights not in ("auto", NO_WEIGHTS):
        path = Path(weights).expanduser()
        if not is_file(path):
            msg = (
                f"model.weights = {weights!r} is no file; give a ResNet-18 weight file, auto, "
                "imagenet or none"
            )
            raise LearningError(msg)
        backbone.load(read_weights(path), str(path))
    return backbone


def cached_imagenet_file() -> Path | None:
    """The ImageNet weights in the cache of torch or of the Hugging Face hub, if any."""
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
    """Named tensors of a weight file; raises ``LearningError`` if it does not hold just these."""
    content = read_tensors(path, "weights", "give a .safetensors file")
    content = content.get("state_dict", content) if isinstance(content, dict) else content
    if not isinstance(content, dict) or not all(isinstance(v, Tensor) for v in content.values()):
        msg = f"{path}: does not hold named tensors; give a state dict of a ResNet-18"
        raise LearningError(msg)
    return content


def read_tensors(path: Path, what: str, fix: str) -> Any:
    """The content of a safetensors file or of one of torch's; nothing in it is run.

    Raises ``LearningError`` if it cannot be read; the message says as ``what``, and the ``fix``.
    """
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        refuse_packed(path)
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the readers raise whatever a damaged file leads them to
        reason = f"{type(error).__name__} {str(error).strip()}".splitlines()[0][:200]
        msg = f"{path}: cannot be read as {what} ({reason}); {fix}"
        raise LearningError(msg) from error


def shape_problem(own: Mapping[str, Tensor], given: Mapping[str, Tensor]) -> str:
    """Why ``given`` cannot be loaded as the weights ``own``; empty where it can."""
    needed = [name for name in own if not name.endswith("num_batches_tracked")]
    missing = [name for name in needed if name not in given]
    if missing:
        return f"{len(missing)} of {len(needed)} are missing, the first is {missing[0]}"
    extra = sorted(set(given) - set(own))
    if extra:
        return f"{len(extra)} do not belong to it, the first is {extra[0]}"
    for name in needed:
        if own[name].shape != given[name].shape:
            return f"{name} has shape {tuple(given[name].shape)}, not {tuple(own[name].shape)}"
    return ""
