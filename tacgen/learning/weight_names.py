"""ResNet-18 weights carry torchvision's names or those of transformers: one table between them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Literal, TypeVar

Naming = Literal["torchvision", "transformers"]
Value = TypeVar("Value")

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
# What other files put before a backbone's names, and the layers of theirs that it has not.
_PREFIXES = ("module.", "resnet.", "backbone.", "model.")
_CLASSIFIER = ("fc.", "classifier.")


def to_transformers(name: str) -> str:
    """The transformers name of a torchvision weight; any other name stays."""
    module, _, tail = name.rpartition(".")
    if module in _STEM:
        return f"{_STEM[module]}.{tail}"
    found = _BLOCK.fullmatch(name)
    if not found:
        return name
    stage, block, part, tail = found.groups()
    return f"encoder.stages.{int(stage) - 1}.layers.{block}.{_IN_BLOCK[part]}.{tail}"


def renamed(
    weights: Mapping[str, Value], naming: Naming, names: Mapping[str, object]
) -> dict[str, Value]:
    """``weights`` of either naming under the names of ``naming``, without any classifier.

    ``names`` are all weight names of the wanted network.
    """
    plain = {_without_prefix(name): value for name, value in weights.items()}
    plain = {name: v for name, v in plain.items() if not name.startswith(_CLASSIFIER)}
    common = {to_transformers(name): value for name, value in plain.items()}
    if naming == "transformers":
        return common
    back = {to_transformers(name): name for name in names}
    return {back.get(name, name): value for name, value in common.items()}


def _without_prefix(name: str) -> str:
    for prefix in _PREFIXES:
        name = name.removeprefix(prefix)
    return name
