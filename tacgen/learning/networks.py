"""The two grasp-stability networks, layer by layer as published.

Source: Si et al. 2022, *Grasp Stability Prediction with Sim-to-Real Transfer from Tactile Sensing*,
arXiv 2208.02885, section III.D.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from scipy.special import expit
from torch import Tensor, nn
from torch.optim.lr_scheduler import ReduceLROnPlateau

from tacgen.core.errors import LearningError
from tacgen.learning.backbone import FEATURES, Backbone, make_backbone, shape_problem
from tacgen.learning.training_recipe import TrainingOptions

# Sizes are the paper's.
CLASSES = 2
DROPOUT = 0.2
LSTM_LAYERS, LSTM_UNITS, SEQUENCE_HIDDEN = 3, 128, 64
SINGLE_HIDDEN = 256
TOUCH_HIDDEN, TOUCH_FEATURES = 128, 64  # of each channel beside the image


class TouchedImages(NamedTuple):
    """Images (B, T, 3 or 6, H, W) with what is known of the touch in each frame, (B, T, n)."""

    images: Tensor
    touch: Tensor

    def to(self, device: str) -> "TouchedImages":
        """Both on a device."""
        return TouchedImages(self.images.to(device), self.touch.to(device))


NetworkInput = Tensor | TouchedImages


class StabilityNet(nn.Module):
    """The base of both networks: the backbone, and how weights are loaded."""

    kind: str
    temperature: float = 1.0
    """Logits are divided by it before they become probabilities (Guo et al. 2017)."""
    prior_logit: float = 0.0
    """Log odds of success among the grasps to predict, added to the logits: training weighs the
    outcomes to be equally likely."""

    @property
    def prior(self) -> float:
        """Share of successes among the grasps to predict."""
        return float(expit(self.prior_logit))

    def __init__(self, weights: str, touch: Sequence[int] = (), n_images: int = 1) -> None:
        super().__init__()
        self.backbone: Backbone = make_backbone(weights)
        # Of the camera's image where it is seen beside the sensor's.
        self.second: Backbone | None = make_backbone(weights) if n_images == 2 else None
        self._touch_sizes = list(touch)
        self.branches = nn.ModuleList(_branch(size) for size in touch)

    @property
    def n_features(self) -> int:
        """How many features a frame has."""
        n_images = 1 if self.second is None else 2
        return FEATURES * n_images + TOUCH_FEATURES * len(self.branches)

    def features(self, inputs: NetworkInput) -> Tensor:
        """Features (B·T, n_features) of each frame: of its images, and beside them of its touch."""
        images = (inputs if isinstance(inputs, Tensor) else inputs.images).flatten(0, 1)
        found: list[Tensor] = [self.backbone(images[:, :3])]
        if self.second is not None:
            found.append(self.second(images[:, 3:]))
        if not isinstance(inputs, Tensor):
            parts = torch.split(inputs.touch.flatten(0, 1), self._touch_sizes, dim=1)
            found += [branch(part) for branch, part in zip(self.branches, parts, strict=True)]
        return torch.cat(found, dim=1)

    def load(self, weights: Mapping[str, Tensor], where: str) -> None:
        """Load all ``weights`` of a saved network.

        Raises ``LearningError`` if they are those of another network.
        """
        problem = shape_problem(self.state_dict(), weights)
        if problem:
            msg = f"{where}: not a checkpoint of the {self.kind} network ({problem})"
            raise LearningError(msg)
        self.load_state_dict(weights, strict=False)


def _branch(size: int) -> nn.Sequential:
    first, last = nn.Linear(size, TOUCH_HIDDEN), nn.Linear(TOUCH_HIDDEN, TOUCH_FEATURES)
    return nn.Sequential(first, nn.ReLU(), last, nn.ReLU())


def _head(features: int, hidden: int) -> nn.Sequential:
    first, last = nn.Linear(features, hidden), nn.Linear(hidden, CLASSES)
    return nn.Sequential(first, nn.ReLU(), nn.Dropout(DROPOUT), last)


class SingleImageNet(StabilityNet):
    """One image (B, 1, 3, H, W) to two logits (B, 2): ResNet-18, then 512-256-2.

    Channels beside the image have a branch of n-128-64 each, whose features join the 512, as do
    those of a second ResNet-18 where a camera is seen beside the sensor.
    """

    kind = "single"

    def __init__(self, weights: str = "none", touch: Sequence[int] = (), n_images: int = 1) -> None:
        super().__init__(weights, touch, n_images)
        self.head = _head(self.n_features, SINGLE_HIDDEN)

    def forward(self, inputs: NetworkInput) -> Tensor:
        """Normalised images to logits of failure and success."""
        logits: Tensor = self.head(self.features(inputs))
        return logits


class SequenceNet(StabilityNet):
    """T images (B, T, 3, H, W) to two logits (B, 2).

    ResNet-18 on each, a 3-layer LSTM(128) over them, its last hidden state, then 128-64-2; channels
    beside the image as in ``SingleImageNet``.
    """

    kind = "sequence"

    def __init__(self, weights: str = "none", touch: Sequence[int] = (), n_images: int = 1) -> None:
        super().__init__(weights, touch, n_images)
        self.lstm = nn.LSTM(self.n_features, LSTM_UNITS, LSTM_LAYERS, batch_first=True)
        self.head = _head(LSTM_UNITS, SEQUENCE_HIDDEN)

    def forward(self, inputs: NetworkInput) -> Tensor:
        """Normalised images to logits of failure and success."""
        images = inputs if isinstance(inputs, Tensor) else inputs.images
        n_grasps, n_frames = images.shape[:2]
        features = self.features(inputs).view(n_grasps, n_frames, self.n_features)
        _, (last_hidden, _) = self.lstm(features)
        logits: Tensor = self.head(last_hidden[-1])
        return logits


def build_network(
    kind: str, weights: str = "none", touch: Sequence[int] = (), n_images: int = 1
) -> StabilityNet:
    """The network of ``kind`` ``single`` or ``sequence``, its backbone from ``weights``.

    ``touch`` are the numbers a frame of each channel beside the image, ``n_images`` is 2 where a
    camera is seen beside the sensor.
    """
    return {"single": SingleImageNet, "sequence": SequenceNet}[kind](weights, touch, n_images)


def build_optimizer(network: StabilityNet, options: TrainingOptions) -> torch.optim.Adam:
    """Adam, with the backbone at its own fraction of the learning rate."""
    rate = options.learning_rate
    named = list(network.named_parameters())
    backbone = [p for name, p in named if name.startswith(("backbone.", "second."))]
    head = [p for name, p in named if not name.startswith(("backbone.", "second."))]
    return torch.optim.Adam(
        [
            {"params": backbone, "lr": rate * options.backbone_rate_factor},
            {"params": head, "lr": rate},
        ],
        lr=rate,
        weight_decay=options.weight_decay,
        fused=True,  # one pass over 11 million weights instead of seven: 0.02 s a step, not 0.06
    )


def build_scheduler(
    optimizer: torch.optim.Optimizer, options: TrainingOptions
) -> ReduceLROnPlateau:
    """Lower both rates when the validation loss stops falling."""
    factor, patience = options.plateau_factor, options.plateau_patience
    return ReduceLROnPlateau(optimizer, factor=factor, patience=patience)
