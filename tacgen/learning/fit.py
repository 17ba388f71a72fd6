"""Training of one model; an epoch depends on the state before it and the seed alone."""

import functools
import math
import multiprocessing
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.metrics import log_loss
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel
from torch.utils.tensorboard import SummaryWriter

from tacgen.core.errors import LearningError
from tacgen.core.progress import progress_counter
from tacgen.learning.checkpoint import FROM_THE_START, ModelCard, load_state, save_model, save_state
from tacgen.learning.loader import Batches
from tacgen.learning.network_input import InputSpec
from tacgen.learning.networks import StabilityNet, build_network, build_optimizer, build_scheduler
from tacgen.learning.predictions import (
    calibrated,
    calibrated_temperature,
    input_statistics,
    predict,
    typical_contrast,
)
from tacgen.learning.run_folder import ModelFolder
from tacgen.learning.scores import score
from tacgen.learning.splits import seed_of
from tacgen.learning.training_recipe import TrainRecipe

DIVERGED_LOSS = 50.0
"""Mean cross entropy that only diverging weights reach; guessing has log 2 = 0.69."""
CHOOSING_EPOCHS = 5
"""Epochs whose validation scores are summed to choose the best model: with some twenty validation
grasps a single epoch is good or bad by chance."""
_BEST_KEYS = ("epoch", "recent")
_WITH_STATE = ("optimizer", "scheduler")
_STATE_KEYS = ("epoch", "pretrained", "best", "network", "average", *_WITH_STATE)
CALIBRATION_PASSES = 5
"""Views of each validation grasp that the temperature is fitted to: some twenty grasps are few."""
# Streams that keep the random numbers of one seed apart.
_STREAM_START, _STREAM_EPOCH, _STREAM_CALIBRATION = 20, 21, 22


@dataclass(frozen=True, slots=True)
class FitJob:
    """Everything that the training of one model depends on.

    ``reference`` (h, w, 3) is the undeformed gel at the network's size.
    """

    name: str
    objects: tuple[str, ...]
    recipe: TrainRecipe
    spec: InputSpec
    sensor: str
    fit: Batches
    validation: Batches
    class_weights: NDArray[np.float64]
    reference: NDArray[np.uint8] | None


class TrainingState:
    """The state of one training, from its start or its last checkpoint.

    ``network`` is trained; ``average`` is the running mean of its weights after each epoch, which
    is the model that is validated and kept.
    """

    def __init__(self, job: FitJob, folder: ModelFolder, device: str) -> None:
        options = job.recipe.training
        self.job, self.folder, self.device = job, folder, device
        torch.manual_seed(self._seed(_STREAM_START))
        resumes = folder.checkpoint_path.is_file()
        weights = "none" if resumes else job.recipe.model.weights
        sizes = [one.size for one in job.spec.touch]
        self.network = build_network(job.spec.kind, weights, sizes, job.spec.n_images)
        self.network.to(device)
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.average = AveragedModel(
            self.network, avg_fn=_mean_of_latest(options.average_epochs), use_buffers=True
        )
        self.optimizer = build_optimizer(self.network, options)
        self.scheduler = build_scheduler(self.optimizer, options)
        balance = torch.tensor(job.class_weights, dtype=torch.float32, device=device)
        self.criterion = nn.CrossEntropyLoss(weight=balance)
        self.epoch = 0
        self._temperature = 1.0
        self.best: dict[str, Any] = {"epoch": 0, "recent": 0.0}
        if resumes:
            self._resume()
        self.metrics = folder.read_metrics(up_to_epoch=self.epoch)

    def run(self) -> list[dict[str, Any]]:
        """Train to the recipe's last epoch; the metrics, one entry an epoch.

        Raises ``LearningError`` if the loss diverges; the last good checkpoint stays.
        """
        epochs = self.job.recipe.training.epochs
        # Epochs of a run that was stopped are cut off the log.
        board = SummaryWriter(str(self.folder.board_path), purge_step=self.epoch + 1)
        with progress_counter("epoch", name=self.job.name) as show, board:
            while self.epoch < epochs:
                _stop_if_orphaned(self.job.name)
                line = self._run_epoch(self.epoch + 1)
                self.metrics.append(line)
                self._keep(line)
                for name, value in line.items():
                    if isinstance(value, float):
                        board.add_scalar(name.replace("_", "/", 1), value, self.epoch)
                loss, accuracy = line["train_loss"], line["validation_accuracy"]
                show(self.epoch, epochs, f"loss {loss:.3f}, accuracy {accuracy:.3f}")
        return self.metrics

    def _run_epoch(self, epoch: int) -> dict[str, Any]:
        start_s = time.perf_counter()
        torch.manual_seed(self._seed(_STREAM_EPOCH, epoch))
        rates = [group["lr"] for group in self.optimizer.param_groups]
        train_loss, train_accuracy = self._learn(epoch)
        self.average.update_parameters(self.network)
        probabilities, labels = predict(self._kept, self.job.validation.in_order(), self.device)
        if not np.isfinite(probabilities).all():
            self._stop_diverged(epoch, math.nan)
        weights = self.job.class_weights[labels]
        loss = float(log_loss(labels, probabilities, sample_weight=weights, labels=[0, 1]))
        self.scheduler.step(loss)
        scores = score(labels, probabilities)
        self._temperature = self._fitted_temperature()
        likely = calibrated(probabilities, self._temperature, self._prior_logit)
        return {
            "epoch": epoch,
            "train_loss": train_loss,
            "train_accuracy": train_accuracy,
            "validation_loss": loss,
            # Of the calibrated model, which is what is kept and evaluated.
            "validation_accuracy": float(((likely >= 0) == labels).mean()),
            "validation_balanced_accuracy": scores["balanced_accuracy"],
            "backbone_rate": rates[0],
            "learning_rate": rates[1],
            "weights": self.network.backbone.origin,
            "epoch_s": time.perf_counter() - start_s,
        }

    def _learn(self, epoch: int) -> tuple[float, float]:
        """One pass over the training grasps: mean loss and accuracy on the way."""
        augmentation, order_seed = self.job.recipe.augmentation, self._seed(_STREAM_EPOCH)
        self.network.train()
        loss_sum, n_right, n = 0.0, 0, 0
        for images, labels, _ in self.job.fit.shuffled(order_seed, epoch, augmentation):
            self.optimizer.zero_grad(set_to_none=True)
            logits = self.network(images.to(self.device))
            loss = self.criterion(logits, labels.to(self.device))
            value = float(loss.detach())
            if not math.isfinite(value):
                self._stop_diverged(epoch, value)
            loss.backward()
            self.optimizer.step()
            loss_sum += value * len(labels)
            n_right += int((logits.detach().argmax(1).cpu() == labels).sum())
            n += len(labels)
        if loss_sum / n > DIVERGED_LOSS:
            self._stop_diverged(epoch, loss_sum / n)
        return loss_sum / n, n_right / n

    def _keep(self, line: dict[str, Any]) -> None:
        """Save the best model, then the state that marks this epoch as done.

        Best is the highest sum of the last epochs' balanced accuracies; of equals, the later.
        """
        self.epoch = line["epoch"]
        recent = sum(m["validation_balanced_accuracy"] for m in self.metrics[-CHOOSING_EPOCHS:])
        if recent >= self.best["recent"]:
            self.best = {"epoch": self.epoch, "recent": recent}
            save_model(self.folder.model_path, self._kept, self._card(), self.job.reference)
        self.folder.write_metrics(self.metrics)
        state = {
            "epoch": self.epoch,
            "pretrained": self.network.backbone.origin,
            "network": self.network.state_dict(),
            "average": self._kept.state_dict(),
            "best": self.best,
        } | {name: getattr(self, name).state_dict() for name in _WITH_STATE}
        save_state(self.folder.checkpoint_path, state)

    @property
    def _kept(self) -> StabilityNet:
        return cast(StabilityNet, self.average.module)

    def _fitted_temperature(self) -> float:
        """Temperature on the validation grasps, as other cameras see them where there is such."""
        changes, batches = self.job.recipe.augmentation, self.job.validation
        passes = range(CALIBRATION_PASSES if changes.on else 1)
        seeds = [self._seed(_STREAM_CALIBRATION, k) for k in passes]
        views = (batches.shuffled(seed, 0, changes) for seed in seeds)
        found = [predict(self._kept, view, self.device) for view in views]
        probabilities, labels = (np.concatenate(part) for part in zip(*found, strict=True))
        return calibrated_temperature(probabilities, labels, self._prior_logit)

    @property
    def _prior_logit(self) -> float:
        """The log odds of success in training, which the classes' weights take away."""
        failure, success = self.job.class_weights
        return float(np.log(failure / success))

    @functools.cached_property
    def _input_statistics(self) -> NDArray[np.float64]:
        """Statistics (N, 6) of the inputs in one augmented pass over the training grasps."""
        seed, batches = self._seed(_STREAM_CALIBRATION), self.job.fit.as_taken()
        return input_statistics(batches.shuffled(seed, 0, self.job.recipe.augmentation))

    def _card(self) -> ModelCard:
        found = self._input_statistics
        return ModelCard(
            name=self.job.name,
            objects=self.job.objects,
            input=self.job.spec,
            sensor=self.job.sensor,
            weights=self.network.backbone.origin,
            epoch=self.epoch,
            recipe_sha256=self.job.recipe.sha256(),
            temperature=self._temperature,
            input_range=tuple(zip(found.min(0).tolist(), found.max(0).tolist(), strict=True)),
            contrast=typical_contrast(found),
            prior_logit=self._prior_logit,
        )

    def _resume(self) -> None:
        path = self.folder.checkpoint_path
        state = load_state(path, _STATE_KEYS)
        try:
            origin = str(state["pretrained"])
            self.network.backbone.origin = self._kept.backbone.origin = origin
            self.network.load(state["network"], str(path))
            self._kept.load(state["average"], str(path))
            self._check_moments(state["optimizer"])
            for name in _WITH_STATE:
                getattr(self, name).load_state_dict(state[name])
            self.epoch = int(state["epoch"])
            self.average.n_averaged.fill_(self.epoch)
            self.best = {name: state["best"][name] for name in _BEST_KEYS}
        except (ValueError, KeyError, TypeError, AttributeError, RuntimeError) as error:
            msg = f"{path}: does not fit this network ({error}); {FROM_THE_START}"
            raise LearningError(msg) from error

    def _check_moments(self, state: Mapping[str, Any]) -> None:
        """Check shapes, which Adam's fused step does not: it would write out of bounds."""
        for k, parameter in enumerate(p for g in self.optimizer.param_groups for p in g["params"]):
            for name in ("exp_avg", "exp_avg_sq"):
                if state["state"][k][name].shape != parameter.shape:
                    msg = f"the optimizer's {name} {k} has another shape"
                    raise ValueError(msg)

    def _stop_diverged(self, epoch: int, value: float) -> None:
        kept = f"the checkpoint of epoch {self.epoch} is kept" if self.epoch else "nothing is kept"
        rate = self.job.recipe.training.learning_rate
        msg = (
            f"{self.job.name}: the loss diverged to {value:g} in epoch {epoch} at a learning rate "
            f"of {rate:g}; lower training.learning_rate and give another --out; {kept}"
        )
        raise LearningError(msg)

    def _seed(self, *parts: int) -> int:
        return seed_of(self.job.recipe.seed, self.job.name, parts)


def _stop_if_orphaned(name: str) -> None:
    """Stop where the process that started this training has been killed."""
    parent = multiprocessing.parent_process()
    if parent is not None and not parent.is_alive():
        msg = f"{name}: the process that started this training was killed; run it again to resume"
        raise LearningError(msg)


def _mean_of_latest(epochs: int) -> Callable[[Tensor, Tensor, Tensor | int], Tensor]:
    """The plain mean of the first epochs' weights, then an exponential one over about ``epochs``.

    Averages along the way of Adam lie in flatter minima than its last step (Izmailov et al. 2018,
    arXiv 1803.05407).
    """

    def mixed(average: Tensor, latest: Tensor, n_averaged: Tensor | int) -> Tensor:
        share = max(2 / (epochs + 1), 1 / (int(n_averaged) + 1))
        return torch.lerp(average, latest, share) if latest.is_floating_point() else latest

    return mixed
