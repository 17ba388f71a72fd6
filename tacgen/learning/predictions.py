"""Predicted probabilities of success, beside the true outcomes."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import optimize, special

from tacgen.learning.checkpoint import ModelCard
from tacgen.learning.grasps import GraspTable
from tacgen.learning.networks import NetworkInput, StabilityNet
from tacgen.optics.drift import press_in_background
from tacgen.optics.same_view import SAME_VIEW, other_view

MIN_PROBABILITY = 1e-12
"""Predictions are cut to this, so that one certain mistake does not make the loss infinite."""
LabelledBatches = Iterable[tuple[NetworkInput, torch.Tensor, NDArray[np.int64]]]
RANGE_MARGIN = 0.5
"""Share of the training's range, on either side: the extremes of some hundred grasps are chance."""
CONTRAST_RANGE = (0.75, 1.33)
"""Typical contrast over the training's: forces and chance alone change it by less."""
MIN_CONTRAST = 1e-6  # of training images that all show one colour
LOOKED_AT = 20  # grasps, spread evenly, whose view is compared
MIN_COMPARED = 20  # grasps; the median contrast of fewer depends on their forces
TEMPERATURE_RANGE = (1.0, 16.0)
"""Never below 1: some thirty grasps of the training's own sensor, often without a mistake, are no
reason to be surer on another one. A validation set of pure chance asks for infinity."""


@dataclass(frozen=True, slots=True)
class Predictions:
    """One model's predictions for N grasps.

    ``probabilities`` (N,) are of success; each of ``frames`` reads the images of a grasp as the
    network saw them, (T, h, w, 3) uint8. ``prior`` is the share of successes in training.
    """

    table: GraspTable
    probabilities: NDArray[np.float64]
    frames: Sequence[Callable[[], NDArray[np.uint8]]]
    prior: float = 0.5

    def wrong(self) -> list[int]:
        """Positions of the misclassified grasps."""
        predicted = self.probabilities >= 0.5
        return [int(i) for i in np.flatnonzero(predicted != (self.table.label == 1))]

    @staticmethod
    def joined(parts: Sequence["Predictions"]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Labels and probabilities of all parts, in their order."""
        labels = np.concatenate([part.table.label for part in parts])
        return labels, np.concatenate([part.probabilities for part in parts])


def input_statistics(batches: LabelledBatches) -> NDArray[np.float64]:
    """Mean and standard deviation of each colour, (N, 6), over all pixels of each grasp's input.

    Where the network sees a camera too, of the sensor's images.
    """
    inputs = (one if isinstance(one, torch.Tensor) else one.images for one, _, _ in batches)
    colors = [images[:, :, :3].transpose(1, 2).flatten(2).double() for images in inputs]
    return torch.cat([torch.cat([one.mean(2), one.std(2)], dim=1) for one in colors]).numpy()


def typical_contrast(statistics: NDArray[np.float64]) -> float:
    """The median over grasps (N, 6) of the standard deviation, averaged over the colours."""
    return float(np.median(statistics[:, 3:].mean(axis=1)))


def notes_on_images(statistics: NDArray[np.float64], card: ModelCard) -> list[str]:
    """What to warn of where images (N, 6) are unlike those that the model was trained on."""
    low, high = np.array(card.input_range).T
    margin, notes = RANGE_MARGIN * (high - low), []
    least = low - margin
    # A contrast has no values below 0: of blank images it is within any margin of a wide range.
    least[3:] = np.maximum(least, RANGE_MARGIN * low)[3:]
    strange = int(((statistics < least) | (statistics > high + margin)).any(axis=1).sum())
    if strange:
        notes.append(
            f"the brightness or contrast of {strange} of {len(statistics)} grasps lies OUTSIDE of "
            f"the training images of the model {card.name}; its probabilities are uncertain there: "
            "check the background, or train with stronger augmentation"
        )
    contrast = typical_contrast(statistics) / max(card.contrast, MIN_CONTRAST)
    if len(statistics) >= MIN_COMPARED and not CONTRAST_RANGE[0] <= contrast <= CONTRAST_RANGE[1]:
        notes.append(
            f"the images' contrast is {contrast:.2f} of that in training: other lamps, another "
            "sensor or other forces; calibrate again with `tacgen calibrate lookup`"
        )
    return notes


def notes_on_views(
    inputs: Sequence[NDArray[np.uint8]],
    rest: NDArray[np.uint8] | None,
    trained: NDArray[np.uint8] | None,
) -> list[str]:
    """Whether images are of another view than those of the training, or a background is a press.

    ``inputs`` are those of grasps, (T, h, w, 3 or 6), with the sensor's image first; ``rest`` and
    ``trained`` (h, w, 3) their gel at rest and that of the training.
    """
    if rest is None or trained is None:
        return []
    notes = []
    if wrong := other_view(rest, trained):
        notes.append(f"the background does NOT match the training's: {wrong}; {SAME_VIEW}")
    elif press := press_in_background(rest.astype(np.float64), trained.astype(np.float64)):
        sentence = press.sentence("the training's")
        notes.append(f"{sentence}, in pixels of the input; take it anew with nothing on the gel")
    some = inputs[:: max(1, len(inputs) // LOOKED_AT)]
    found = [wrong for one in some if (wrong := other_view(one[-1, ..., :3], rest))]
    if 2 * len(found) > len(some):
        wrong = max(found, key=found.count)
        notes.append(f"the images do NOT match their background: {wrong}; {SAME_VIEW}")
    return notes


def calibrated(
    probabilities: NDArray[np.float64], temperature: float, prior_logit: float
) -> NDArray[np.float64]:
    """Log odds (N,) of success of the calibrated model; the arguments are those of the next."""
    logit = special.logit(np.clip(probabilities, MIN_PROBABILITY, 1 - MIN_PROBABILITY))
    return np.asarray(logit / temperature + prior_logit)


def calibrated_temperature(
    probabilities: NDArray[np.float64], labels: NDArray[np.int64], prior_logit: float = 0.0
) -> float:
    """The temperature that makes labels (N,) most likely under an uncalibrated network's view.

    ``probabilities`` (N,) are those of a network to which both outcomes were equally likely,
    ``prior_logit`` the log odds of success among the grasps. Source: Guo et al. 2017, *On
    Calibration of Modern Neural Networks*, arXiv 1706.04599, section 4.2.
    """
    sign = np.where(labels == 1, 1, -1)

    def loss(log_temperature: float) -> float:
        logit = calibrated(probabilities, float(np.exp(log_temperature)), prior_logit)
        return float(np.logaddexp(0, -sign * logit).mean())

    bounds = tuple(np.log(TEMPERATURE_RANGE))
    return float(np.exp(optimize.minimize_scalar(loss, bounds=bounds, method="bounded").x))


def predict(
    network: StabilityNet, batches: LabelledBatches, device: str
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Probability of success (N,) and label (N,) of every grasp in ``batches``."""
    network.eval()
    probabilities, labels = [np.empty(0)], [np.empty(0, np.int64)]
    with torch.inference_mode():
        for inputs, truth, _ in batches:
            logits = network(inputs.to(device)).double() / network.temperature
            probability = (logits[:, 1] - logits[:, 0] + network.prior_logit).sigmoid()
            probabilities.append(probability.cpu().numpy())
            labels.append(truth.numpy())
    return np.concatenate(probabilities), np.concatenate(labels)
