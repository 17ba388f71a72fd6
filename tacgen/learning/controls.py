"""Controls of an evaluation: how much is scored without the images, or against the labels."""

import copy
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import LearningError
from tacgen.core.progress import print_status
from tacgen.learning.checkpoint import load_model
from tacgen.learning.device import exact_torch
from tacgen.learning.grasps import SimulatedGrasps
from tacgen.learning.intervals import mean_scores
from tacgen.learning.loader import Batches, DecodedInputs
from tacgen.learning.network_input import InputSpec, frames_of, resized
from tacgen.learning.parameter_baseline import forest
from tacgen.learning.predictions import Predictions, predict
from tacgen.learning.run_folder import RunFolder
from tacgen.learning.scores import SAME_IMPRINT, score
from tacgen.learning.splits import ModelPlan, seed_of
from tacgen.learning.train import train_one
from tacgen.learning.training_recipe import TrainRecipe

CONTROL_EPOCHS = 5
"""Passes over the training grasps: what tells nothing is not learnt in more of them either."""
SHUFFLES = 3
"""Permutations of the labels: where images are of two kinds, one alone is right of all or none."""
_STREAM_SHUFFLE = 30  # keeps the random numbers of one seed apart

Tested = Mapping[str, tuple[NDArray[np.int64], InputSpec]]
"""By model the rows that it was tested on, and its input."""


def same_imprint_rule(source: SimulatedGrasps, tested: Tested) -> dict[str, Any]:
    """Scores of a rule without training: a grasp holds whose imprint is still that of the grasp.

    The last of the frames that the network sees, which are to show the lift, is compared with that
    of the moment of grasp, each less the gel at rest, at the network's size.
    """
    labels, held = [], []
    for rows, spec in tested.values():
        at_rest = resized(source.reference[None], spec.size_px)[0].astype(float)
        for row in map(int, rows):
            both = [int(source.table.grasp_frame[row]), frames_of(source, row, spec)[-1]]
            imprints = resized(source.frames(row, both), spec.size_px) - at_rest
            imprints -= imprints.mean(axis=(1, 2, 3), keepdims=True)
            grasped, last = imprints.reshape(2, -1)
            size = np.linalg.norm(grasped) * np.linalg.norm(last)
            held.append(float(grasped @ last > SAME_IMPRINT * size))
            labels.append(source.table.label[row])
    return score(np.array(labels), np.array(held))


def control_scores(
    folder: RunFolder,
    plan: Mapping[str, Any],
    recipe: TrainRecipe,
    source: SimulatedGrasps,
    tested: Tested,
    device: str,
) -> dict[str, dict[str, Any]]:
    """Scores on the tested grasps of what cannot know their outcome, by name.

    ``shuffled labels``: a network trained on the images, the labels of the training grasps
    permuted; the mean of ``SHUFFLES`` of them. ``constant images``: one that sees the gel at rest,
    whatever happens. ``force alone``: trees that see the commanded force instead. The networks are
    trained for ``CONTROL_EPOCHS`` on the run's grasps, as the run was.

    Raises ``LearningError`` if ``source`` is not the dataset that the run was trained on.
    """
    if source.identity()["shards_sha256"] != plan["dataset"].get("shards_sha256"):
        msg = (
            f"{source.root}: is not the dataset that {folder.root} was trained on, on which "
            "--controls are trained too; give it with --data"
        )
        raise LearningError(msg)
    places = {name: row for row, name in enumerate(source.table.ids.tolist())}
    plans = [
        ModelPlan(
            name,
            tuple(plan["models"][name]["objects"]),
            *(np.array([places[i] for i in plan["models"][name][side]]) for side in _SIDES),
        )
        for name in tested
    ]
    epochs = min(recipe.training.epochs, CONTROL_EPOCHS)
    training = recipe.training.model_copy(update={"epochs": epochs})
    short = recipe.model_copy(update={"training": training})
    print_status(f"controls: {SHUFFLES + 1} trainings of {epochs} epochs")

    def retrained(altered: Callable[[ModelPlan], SimulatedGrasps]) -> dict[str, Any]:
        return score_of([_retrained(short, altered(p), p, tested[p.name], device) for p in plans])

    shuffled = [
        retrained(partial(_with_shuffled_labels, source, seed=recipe.seed, shuffle=shuffle))
        for shuffle in range(SHUFFLES)
    ]
    return {
        "shuffled labels": mean_scores(shuffled),
        "constant images": retrained(lambda _: _ConstantImages(source)),
        "force alone": score_of([_by_force(source, one, tested[one.name][0]) for one in plans]),
    }


def score_of(parts: Sequence[Predictions]) -> dict[str, Any]:
    """The scores of some models' predictions together."""
    priors = np.concatenate([np.full(len(part.table), part.prior) for part in parts])
    return score(*Predictions.joined(parts), priors)


_SIDES = ("fit", "validation")


class _ConstantImages(SimulatedGrasps):
    """The same grasps with the image of the undeformed gel in every frame."""

    def __init__(self, source: SimulatedGrasps) -> None:
        self.__dict__.update(source.__dict__)

    def frames(self, row: int, frames: Sequence[int]) -> NDArray[np.uint8]:
        """The undeformed gel, (len(frames), H, W, 3) RGB."""
        return np.repeat(self.reference[None], len(frames), axis=0)

    def touch(self, row: int, frames: Sequence[int], name: str) -> NDArray[np.floating]:
        """No motion and no force."""
        return np.zeros_like(super().touch(row, frames, name))

    def vision(self, row: int, frames: Sequence[int], camera: str) -> NDArray[np.uint8]:
        """Black images."""
        return np.zeros_like(super().vision(row, frames, camera))


def _with_shuffled_labels(
    source: SimulatedGrasps, plan: ModelPlan, *, seed: int, shuffle: int
) -> SimulatedGrasps:
    """The same images with the labels permuted within those to fit to, and to validate on."""
    rng = np.random.default_rng(seed_of(seed, plan.name, (_STREAM_SHUFFLE, shuffle)))
    label = source.table.label.copy()
    for rows in (plan.fit_rows, plan.validation_rows):
        label[rows] = rng.permutation(label[rows])
    shuffled = copy.copy(source)
    shuffled.table = replace(source.table, label=label)
    return shuffled


def _retrained(
    recipe: TrainRecipe,
    source: SimulatedGrasps,
    plan: ModelPlan,
    tested: tuple[NDArray[np.int64], InputSpec],
    device: str,
) -> Predictions:
    """The predictions of a network that is trained on ``source`` and then thrown away."""
    rows, spec = tested
    with tempfile.TemporaryDirectory() as place, exact_torch(recipe.training.threads):
        run = RunFolder(Path(place))
        train_one(recipe, source, spec, run, device, plan)
        network, card, reference = load_model(run.model(plan.name).model_path)
        inputs = DecodedInputs(source, rows, card.input, recipe.input.cache_mb)
        at_rest = None if reference is None else resized(reference[None], spec.size_px)[0]
        batches = Batches(inputs, card.input, at_rest, recipe.training.batch_size)
        probabilities, _ = predict(network.to(device), batches.in_order(), device)
    return Predictions(source.table.take(rows), probabilities, (), network.prior)


def _by_force(source: SimulatedGrasps, plan: ModelPlan, rows: NDArray[np.int64]) -> Predictions:
    """What trees that see each object's force alone predict for some rows."""
    table, probabilities = source.table, np.zeros(len(rows))
    known = np.concatenate([plan.fit_rows, plan.validation_rows])
    for name in plan.objects:
        own, asked = known[table.objects[known] == name], table.objects[rows] == name
        if asked.any():
            trees = forest().fit(table.force_n[own, None], table.label[own])
            chances = trees.predict_proba(table.force_n[rows[asked], None])
            probabilities[asked] = chances @ trees.classes_
    return Predictions(table.take(rows), probabilities, (), float(table.label[known].mean()))
