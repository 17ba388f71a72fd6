"""``tacgen eval``: the models of a run on grasps that no part of the training has seen."""

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import LearningError, require_known
from tacgen.core.files import refuse_other_page, write_text
from tacgen.core.progress import print_status
from tacgen.core.records import AXES
from tacgen.dataset.folder import differences
from tacgen.dataset.real_grasps import FRAME_UNKNOWN
from tacgen.learning.checkpoint import ModelCard, load_model
from tacgen.learning.controls import Tested, control_scores, same_imprint_rule, score_of
from tacgen.learning.device import choose_device, exact_torch
from tacgen.learning.grasps import (
    CONFIGURATION_DIGITS,
    GraspSource,
    RealGraspImages,
    SimulatedGrasps,
)
from tacgen.learning.intervals import paired_gain, standardised_gap
from tacgen.learning.loader import Batches, DecodedInputs
from tacgen.learning.network_input import (
    ACROSS,
    InputSpec,
    camera_note,
    check_source,
    read_input,
    resized,
    taken_otherwise,
)
from tacgen.learning.parameter_baseline import predicted_by_trees
from tacgen.learning.predictions import (
    LOOKED_AT,
    Predictions,
    input_statistics,
    notes_on_images,
    notes_on_views,
    predict,
)
from tacgen.learning.reports import started_from, write_evaluation_report
from tacgen.learning.run_folder import RunFolder, read_json
from tacgen.learning.scores import score, tested_on
from tacgen.learning.splits import unseen_tests
from tacgen.learning.training_recipe import POOLED, TrainRecipe

MAX_NAMED = 6  # settings that differ from the training's; more are counted
FORCE_MARGIN = (0.95, 1.05)
"""Of the training's range of forces: the next step of a grid is further out."""
MAX_GROUPS = 8
"""Rows of a table of scores by value; more values than that are put into half as many ranges."""
_AUROC_NOTE = (
    "The AUROC overall ranks the grasps of all models together; by object it ranks one model's."
)


def evaluate(
    run: Path,
    data: Path | None = None,
    real: Path | None = None,
    *,
    device: str | None = None,
    across: Sequence[str] = (),
    controls: bool = False,
) -> dict[str, Any]:
    """Test the models of ``run`` on the test grasps of a dataset, or on real grasps.

    Writes ``eval.json`` and ``index.html`` into the run, and the same figures as
    ``eval_sim.json`` or ``eval_real.json``, from which the sim-to-real gap is computed. A dataset
    may differ from the training data in what is named in ``across`` (see ``ACROSS``); of real
    grasps every known difference is noted. With ``controls`` the result has those of
    ``control_scores`` beside the networks, by default on the run's own dataset.

    Raises ``TacgenError`` if the run or the grasps cannot be used, all of them were trained on, or
    the images were taken in another way.
    """
    folder = RunFolder(run)
    refuse_other_page(folder.eval_report_path, "eval")
    if controls and real is not None:
        msg = "--controls are trained again, on simulated grasps; give --data DIR instead of --real"
        raise LearningError(msg)
    if controls and data is None:
        trained_on = read_json(folder.summary_path, "finish `tacgen train` first").get("data")
        data = None if trained_on is None else Path(trained_on)
    if (data is None) == (real is None):
        msg = "give either --data DIR (simulated test grasps) or --real DIR (real grasps)"
        raise LearningError(msg)
    plan, recipe = folder.plan(), folder.recipe()
    source: GraspSource
    where, notes = str(data or real), []
    if data is not None:
        source = SimulatedGrasps(data, recipe.input.pad)
    elif real is not None:
        source = RealGraspImages(real)
        notes = list(source.warnings)
    source_name = "sim" if real is None else "real"
    unseen, about_unseen = unseen_tests(plan, source, where)
    notes += about_unseen
    notes += _differences(plan, recipe, source, where, across)
    notes += new_to_the_network(plan, source, where)
    test = _Test(folder, plan, recipe, source, where, choose_device(recipe.training, device), notes)
    with exact_torch(recipe.training.threads):
        predictions, cards, tested = test.predict_all(unseen)
    result = _summary(predictions, cards, source_name, where, notes)
    if baseline := baseline_predictions(plan, predictions, list(tested)):
        result["without_touch"] = compared_with(predictions, baseline)
    if isinstance(source, SimulatedGrasps):
        if result["until"] == "outcome":
            result["same_imprint_rule"] = same_imprint_rule(source, tested)
        if controls:
            result["controls"] = control_scores(folder, plan, recipe, source, tested, test.device)
    result["real_is_simulated"] = source_name == "real" and source.is_simulated
    _add_gap(folder, result)
    text = json.dumps(result, indent=1)
    write_text(folder.eval_path, text)
    write_text(folder.source_eval_path(source_name), text)
    write_evaluation_report(folder.eval_report_path, result, predictions)
    for note in notes:
        print_status(note)
    return result


def _differences(
    plan: Mapping[str, Any],
    recipe: TrainRecipe,
    source: GraspSource,
    where: str,
    across: Sequence[str],
) -> list[str]:
    """Notes on how else the images were taken than those of the training, as far as it is known.

    Raises ``LearningError`` if a dataset differs in what is not named in ``across``.
    """
    for name in across:
        require_known("--across", name, ACROSS, LearningError)
    trained = _taken_with(plan)
    differing = taken_otherwise(trained, source.taken_with, recipe.model.kind)
    refused = [name for name in differing if name not in across]
    if refused and isinstance(source, SimulatedGrasps):
        msg = (
            f"{where}: its images were taken with another {', '.join(refused)} than those that the "
            "run was trained on; use a dataset with the same, or accept it by name: "
            f"{' '.join(f'--across {name}' for name in refused)}"
        )
        raise LearningError(msg)
    return [
        f"{where}: ACROSS {name}: its images were taken with another {name} than the training's"
        for name in differing
    ]


def new_to_the_network(plan: Mapping[str, Any], source: GraspSource, where: str) -> list[str]:
    """A note on what the grasps of a source have that no training grasp had.

    That is another world, as far as both are known, other objects, and forces beyond those of the
    training, by object. ``plan`` is the run's ``run.json``.
    """
    worlds = [taken.get("world") or {} for taken in (_taken_with(plan), source.taken_with)]
    before, now = _of_both(*worlds)
    of_objects = _of_both(*(world.get("objects") or {} for world in worlds))
    for world, objects in zip((before, now), of_objects, strict=True):
        world["objects"] = objects
    found = list(differences(before, now))
    if more := found[MAX_NAMED:]:
        found[MAX_NAMED:] = [f"{len(more)} more settings"]
    trained_n: dict[str, list[float]] = {}
    for model in plan["models"].values():
        for text in model["configurations"]:
            name, force_n, *_ = text.rsplit(" ", len(AXES))
            trained_n.setdefault(name, []).append(float(force_n))
    for name in source.table.object_names():
        if name not in trained_n:
            found.append(f"the object {name}")
            continue
        low, high = min(trained_n[name]), max(trained_n[name])
        force_n = source.table.force_n[source.table.objects == name]
        n = int(((force_n < FORCE_MARGIN[0] * low) | (force_n > FORCE_MARGIN[1] * high)).sum())
        if n:
            beyond = f"outside of {low:g} to {high:g} N"
            found.append(f"{n} of {len(force_n)} forces of {name}, {beyond}")
    return [f"{where}: NEW to the network: {'; '.join(found)}"] if found else []


def _taken_with(plan: Mapping[str, Any]) -> Mapping[str, Any]:
    found: Mapping[str, Any] = plan["dataset"].get("taken_with", {})
    return found


def _of_both(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The entries of each whose keys the other has too."""
    return [{k: part[k] for k in one if k in other} for part in (one, other)]


def scores_by_value(
    values: NDArray[np.float64],
    labels: NDArray[np.int64],
    probabilities: NDArray[np.float64],
    prior: float | NDArray[np.float64] = 0.5,
) -> dict[str, Any]:
    """Scores of (N,) grasps by each of their values, or by ranges where there are many.

    Ranges hold about as many grasps each; their names are their ends. Grasps whose value is not
    known (NaN) are in none. ``prior`` is as for ``score``.
    """
    known = np.isfinite(values)
    priors = np.broadcast_to(prior, values.shape)[known]
    values, labels, probabilities = values[known], labels[known], probabilities[known]
    values = np.round(values, CONFIGURATION_DIGITS)
    distinct = np.unique(values)
    places, names = np.searchsorted(distinct, values), _distinct_texts(distinct, 6)
    if len(distinct) > MAX_GROUPS:
        edges = np.unique(np.quantile(values, np.linspace(0, 1, MAX_GROUPS // 2 + 1)))
        places = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
        names = [f"{low} to {high}" for low, high in itertools.pairwise(_distinct_texts(edges))]
    groups = {name: places == k for k, name in enumerate(names)}
    return {
        name: score(labels[g], probabilities[g], priors[g]) for name, g in groups.items() if g.any()
    }


@dataclass(frozen=True, slots=True)
class _Test:
    """The models of one run on the grasps of one source; ``notes`` collects what to report."""

    folder: RunFolder
    plan: Mapping[str, Any]
    recipe: TrainRecipe
    source: GraspSource
    where: str
    device: str
    notes: list[str] = field(default_factory=list)

    def predict_all(
        self, unseen: NDArray[np.bool_]
    ) -> tuple[list[Predictions], list[ModelCard], Tested]:
        """The predictions of each model for the ``unseen`` (N,) grasps of its objects."""
        wanted = {name: model["objects"] for name, model in self.plan["models"].items()}
        known = [one for objects in wanted.values() for one in objects]
        names = self.source.table.object_names()
        unknown = [name for name in names if name not in known]
        if unknown == names and POOLED in wanted:
            wanted[POOLED] = names
        elif unknown == names:
            msg = (
                f"{self.where}: has grasps of {', '.join(names)}; the models of {self.folder.root} "
                f"are for {', '.join(known)}; train on the same objects"
            )
            raise LearningError(msg)
        elif unknown:
            self._note(f"NOT tested, since no model is for them: {', '.join(unknown)}")
        found, tested = [], {}
        for name, objects in wanted.items():
            rows = np.flatnonzero(np.isin(self.source.table.objects, objects) & unseen)
            if len(rows):
                predicted, card = self._predict(name, rows)
                found.append((predicted, card))
                tested[name] = rows, card.input
            else:
                where = self.where
                self._note(f"the model {name} was NOT tested: {where} has no test grasps for it")
        if not found:
            msg = f"{self.where}: has no test grasps; collect it with split.test_fraction above 0"
            raise LearningError(msg)
        return [predicted for predicted, _ in found], [card for _, card in found], tested

    def _predict(self, name: str, rows: NDArray[np.int64]) -> tuple[Predictions, ModelCard]:
        folder, kind = self.folder.model(name), self.recipe.model.kind
        network, card, reference = load_model(folder.model_path)
        epochs = self.recipe.training.epochs
        done = len(folder.read_metrics(up_to_epoch=epochs))
        if done < epochs:
            self._note(f"the model {name} is NOT trained to its end: {done} of {epochs} epochs")
        if (card.input.kind, card.name) != (kind, name):
            there = f"{folder.model_path}: is the {card.input.kind} model {card.name!r}"
            msg = f"{there}, where the run has the {kind} model {name!r}; train again"
            raise LearningError(msg)
        check_source(card.input, self.source, rows, self.where)
        batches = self._batches(rows, card, reference)
        network.to(self.device)
        probabilities, _ = predict(network, batches.in_order(), self.device)
        if not np.isfinite(probabilities).all():
            msg = f"{folder.model_path}: predicts NaN; train the model again"
            raise LearningError(msg)
        statistics = input_statistics(batches.as_taken().in_order())
        found = notes_on_images(statistics, card)
        if card.input.sees_touch:
            some = rows[:: max(1, len(rows) // LOOKED_AT)]
            images = [read_input(self.source, int(row), card.input) for row in some]
            found += notes_on_views(images, batches.reference, reference)
        for note in found:
            self._note(f"{self.where}: {note}")
        if card.input.vision is not None:
            camera = self.source.camera(card.input.vision.camera)
            if note := camera_note(card.input.vision, camera):
                self._note(f"{self.where}: {note}")
        frames = [partial(_first_images, self.source, int(row), card.input) for row in rows]
        table = self.source.table.take(rows)
        return Predictions(table, probabilities, frames, network.prior), card

    def _batches(
        self, rows: NDArray[np.int64], card: ModelCard, trained_reference: NDArray[np.uint8] | None
    ) -> Batches:
        spec, source = card.input, self.source
        own = source.reference
        reference = trained_reference if own is None else resized(own[None], spec.size_px)[0]
        if spec.image != "raw" and own is None:
            self._note(
                f"{self.where}: has no background.png, so images are compared with the undeformed "
                "gel of the training data"
            )
        sequences = np.array([source.frame_count(int(row)) > 1 for row in rows])
        unknown = sequences & (source.table.grasp_frame[rows] == FRAME_UNKNOWN)
        if spec.kind == "single" and unknown.any():
            self._note(
                f"{self.where}: of grasps with several images and no moment of grasp, the image "
                "after which the change from the gel at rest stops growing is taken for it"
            )
        if spec.shows_until == "lift" and (source.lift_frame[rows] == FRAME_UNKNOWN).any():
            self._note(
                f"{self.where}: does not tell when the lifts start, so all images are used, where "
                "the network was trained on those before; give lift_frame in grasps.csv"
            )
        inputs = DecodedInputs(source, rows, spec, self.recipe.input.cache_mb)
        return Batches(inputs, spec, reference, self.recipe.training.batch_size)

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)


def _summary(
    predictions: Sequence[Predictions],
    cards: Sequence[ModelCard],
    source: str,
    where: str,
    notes: list[str],
) -> dict[str, Any]:
    labels, probabilities = Predictions.joined(predictions)
    priors = np.concatenate([np.full(len(part.table), part.prior) for part in predictions])
    objects, force_n, z_mm = (
        np.concatenate([getattr(part.table, name) for part in predictions])
        for name in ("objects", "force_n", "z_mm")
    )
    weights = sorted({card.weights for card in cards})
    wrong = [(part.table, part.probabilities, i) for part in predictions for i in part.wrong()]
    return {
        "source": source,
        **score(labels, probabilities, priors),
        "by_object": {
            str(name): score(labels[own], probabilities[own], priors[own])
            for name, own in ((name, objects == name) for name in np.unique(objects))
        },
        "by_force_n": scores_by_value(force_n, labels, probabilities, priors),
        "by_z_mm": scores_by_value(z_mm, labels, probabilities, priors),
        "data": where,
        "kind": cards[0].input.kind,
        "until": cards[0].input.shows_until,
        "frames_seen": cards[0].input.frames_seen(),
        "weights": ", ".join(weights),
        "weights_note": f"pre-trained weights: {', '.join(started_from(name) for name in weights)}",
        "auroc_note": _AUROC_NOTE if len(cards) > 1 else "",
        "misclassified": [
            {
                "object": str(table.objects[i]),
                "grasp_id": str(table.ids[i]),
                "label": int(table.label[i]),
                "probability": float(chances[i]),
            }
            for table, chances, i in wrong
        ],
        "notes": notes,
    }


def baseline_predictions(
    plan: Mapping[str, Any], predictions: Sequence[Predictions], names: Sequence[str]
) -> list[Predictions]:
    """What trees predict that know what was commanded alone, of the same grasps.

    They learn from the training grasps of the models ``names``; empty where the run does not tell
    how these ended, or the grasps not what was commanded.
    """
    models = [plan["models"][name] for name in names]
    is_known = all(np.isfinite(part.table.commanded()).all() for part in predictions)
    if not is_known or not all(model.get("labels") for model in models):
        return []
    return [
        replace(part, probabilities=predicted_by_trees(model, part.table), frames=())
        for part, model in zip(predictions, models, strict=True)
    ]


def compared_with(
    predictions: Sequence[Predictions], baseline: Sequence[Predictions]
) -> dict[str, Any]:
    """The scores of a ``baseline``, and the ``gain`` of the networks over it.

    ``gain_interval`` is its 95 % interval, paired on the same grasps.
    """
    right = [
        np.concatenate([(part.probabilities >= 0.5) == (part.table.label == 1) for part in parts])
        for parts in (predictions, baseline)
    ]
    gain, interval = paired_gain(*right)
    return {**score_of(baseline), "gain": gain, "gain_interval": list(interval)}


def _distinct_texts(values: NDArray[np.float64], least: int = 4) -> list[str]:
    """Different numbers as different texts, with as few digits as that takes above ``least``."""
    texts = ([f"{value:.{digits}g}" for value in values] for digits in range(least, 18))
    return next(found for found in texts if len(set(found)) == len(values))


def _first_images(source: GraspSource, row: int, spec: InputSpec) -> NDArray[np.uint8]:
    """What a page shows of a grasp: the sensor's images, or the camera's where it is alone."""
    return read_input(source, row, spec)[..., :3]


def _add_gap(folder: RunFolder, result: dict[str, Any]) -> None:
    """The accuracy lost from simulated to real grasps; every object of both weighs the same."""
    path = folder.source_eval_path("sim")
    if result["source"] != "real" or not path.is_file():
        return
    simulated = read_json(path, "run `tacgen eval RUN --data DIR` again").get("by_object", {})
    shared = sorted(set(simulated) & set(result["by_object"]))
    if shared:
        accuracy, real, interval = standardised_gap(simulated, result["by_object"])
        result |= {
            "sim_accuracy": accuracy,
            "real_accuracy": real,
            "sim_to_real_gap": accuracy - real,
            "gap_interval": list(interval),
            "gap_objects": shared,
            "gap_missing": {
                "simulated": sorted(set(result["by_object"]) - set(shared)),
                tested_on(result): sorted(set(simulated) - set(shared)),
            },
        }
