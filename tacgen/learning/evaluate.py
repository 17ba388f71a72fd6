"""``tacgen eval``: the models of a run on grasps that no part of the training has seen."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import LearningError
from tacgen.core.files import write_text
from tacgen.learning.checkpoint import ModelCard, load_model
from tacgen.learning.device import Device, choose_device, exact_torch
from tacgen.learning.grasps import GraspSource, SimulatedGrasps
from tacgen.learning.inputs import check_source, read_input, resized
from tacgen.learning.leakage import unseen_tests
from tacgen.learning.loader import Batches, DecodedInputs
from tacgen.learning.predictions import Predictions, predict
from tacgen.learning.progress import tell
from tacgen.learning.real_grasps import RealGraspImages
from tacgen.learning.reports import started_from, write_evaluation_report
from tacgen.learning.run_folder import ModelFolder, RunFolder, read_json
from tacgen.learning.scores import score
from tacgen.learning.training_recipe import TrainRecipe

MAX_GROUPS = 8
_AUROC_NOTE = (
    "The AUROC overall ranks the grasps of all models together; by object it ranks one model's."
)


def evaluate(run: Path, data: Path | None = None, real: Path | None = None) -> dict[str, Any]:
    """Test the models of ``run`` on the test grasps of a dataset, or on real grasps.

    Writes ``eval.json`` and ``eval.html`` into the run, and the same figures as
    ``eval_sim.json`` or ``eval_real.json``, from which the sim-to-real gap is computed.

    Raises
    ------
    TacgenError
        If the run, the dataset or the folder of real grasps cannot be used, or a grasp to be
        tested was trained on.
    """
    if (data is None) == (real is None):
        msg = "give either --data DIR (simulated test grasps) or --real DIR (real grasps)"
        raise LearningError(msg)
    folder = RunFolder(run)
    plan = folder.plan()
    recipe = folder.recipe()
    notes: list[str] = []
    if data is not None:
        source: GraspSource = SimulatedGrasps(data, recipe.input.pad)
    else:
        source = RealGraspImages(Path(str(real)))
        notes += source.warnings
    where = str(data if data is not None else real)
    unseen, about_unseen = unseen_tests(plan, source, where)
    notes += about_unseen
    device = choose_device(recipe.training)
    with exact_torch(recipe.training.threads):
        predictions, cards = _predict_all(
            folder, plan, recipe, source, unseen, where, device, notes
        )
    result = _summary(predictions, cards, "sim" if data is not None else "real", where, notes)
    result["real_is_simulated"] = real is not None and source.made_with is not None
    _add_gap(folder, result)
    text = json.dumps(result, indent=1)
    write_text(folder.eval_path, text)
    write_text(folder.source_eval_path(result["source"]), text)
    write_evaluation_report(folder.eval_report_path, result, predictions)
    for note in notes:
        tell(note)
    return result


def scores_by_value(
    values: NDArray[np.float64], labels: NDArray[np.int64], probabilities: NDArray[np.float64]
) -> dict[str, Any]:
    """Scores of (N,) grasps by each of their values, or by ranges where there are many.

    Ranges hold about as many grasps each; their names are their ends. Grasps whose value is not
    known (NaN) are in none.
    """
    known = np.isfinite(values)
    values, labels, probabilities = values[known], labels[known], probabilities[known]
    distinct = np.unique(values)
    if len(distinct) <= MAX_GROUPS:
        groups = [(f"{value:g}", values == value) for value in distinct]
    else:
        edges = np.unique(np.quantile(values, np.linspace(0, 1, MAX_GROUPS // 2 + 1)))
        places = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
        groups = [
            (f"{low} to {high}", places == k)
            for k, (low, high) in enumerate(itertools.pairwise(_told_apart(edges)))
        ]
    return {name: score(labels[g], probabilities[g]) for name, g in groups if g.any()}


def _predict_all(
    folder: RunFolder,
    plan: Mapping[str, Any],
    recipe: TrainRecipe,
    source: GraspSource,
    unseen: NDArray[np.bool_],
    where: str,
    device: Device,
    notes: list[str],
) -> tuple[list[Predictions], list[ModelCard]]:
    wanted = [name for model in plan["models"].values() for name in model["objects"]]
    names = source.table.object_names()
    if not set(wanted) & set(names):
        msg = (
            f"{where}: has grasps of {', '.join(names)}; the models of {folder.root} are for "
            f"{', '.join(wanted)}; train on the same objects"
        )
        raise LearningError(msg)
    unknown = [name for name in names if name not in wanted]
    if unknown:
        notes.append(f"NOT tested, since no model is for them: {', '.join(unknown)}")
    predictions, cards = [], []
    for name, model in plan["models"].items():
        rows = np.flatnonzero(np.isin(source.table.objects, model["objects"]) & unseen)
        if not len(rows):
            notes.append(f"the model {name} was NOT tested: {where} has no test grasps for it")
            continue
        network, card, reference = load_model(folder.model(name).model_path)
        notes += _unfinished(folder.model(name), name, recipe.training.epochs)
        if (card.input.kind, card.name) != (recipe.model.kind, name):
            msg = (
                f"{folder.model(name).model_path}: is the {card.input.kind} model {card.name!r}, "
                f"where the run has the {recipe.model.kind} model {name!r}; put its own back, or "
                "train again"
            )
            raise LearningError(msg)
        check_source(card.input, source, rows, where)
        batches, spec = _batches(recipe, source, rows, card, reference, notes), card.input
        network.to(device.name)
        probabilities, _ = predict(network, batches.in_order(), device)
        if not np.isfinite(probabilities).all():
            msg = f"{folder.model(name).model_path}: judges grasps with NaN; train it again"
            raise LearningError(msg)

        def frames(i: int, rows: NDArray[np.int64] = rows, spec: Any = spec) -> NDArray[np.uint8]:
            return read_input(source, int(rows[i]), spec)

        predictions.append(Predictions(name, source.table.take(rows), probabilities, frames))
        cards.append(card)
    if not predictions:
        msg = f"{where}: no test grasps in it; collect it with split.test_fraction above 0"
        raise LearningError(msg)
    return predictions, cards


def _unfinished(folder: ModelFolder, name: str, epochs: int) -> list[str]:
    done = len(folder.read_metrics(up_to_epoch=epochs))
    if done == epochs:
        return []
    return [f"the model {name} is NOT trained to its end: {done} of {epochs} epochs"]


def _batches(
    recipe: TrainRecipe,
    source: GraspSource,
    rows: NDArray[np.int64],
    card: ModelCard,
    trained_reference: NDArray[np.uint8] | None,
    notes: list[str],
) -> Batches:
    spec = card.input
    own = source.reference()
    reference = trained_reference if own is None else resized(own[None], spec.size_px)[0]
    if isinstance(source, RealGraspImages):
        if spec.image != "raw" and own is None:
            _note(
                notes,
                f"{source.folder}: no background.png, so the difference is taken to the "
                "undeformed gel of the training data",
            )
        if spec.kind == "single":
            several = sum(source.frame_count(int(row)) > 1 for row in rows)
            if several:
                which = (
                    "first one at 95 % of the largest change from the gel at rest"
                    if spec.grasp_fraction is None
                    else f"one {spec.grasp_fraction:.0%} through, as in the training data,"
                )
                _note(
                    notes,
                    f"{source.folder}: of grasps with several images the {which} is taken as the "
                    "moment of grasp",
                )
    inputs = DecodedInputs(source, rows, spec, recipe.input.cache_mb)
    labels = source.table.label[rows]
    return Batches(
        inputs, labels, spec, reference, recipe.training.batch_size, recipe.input.loader_workers
    )


def _note(notes: list[str], text: str) -> None:
    if text not in notes:
        notes.append(text)


def _summary(
    predictions: Sequence[Predictions],
    cards: Sequence[ModelCard],
    source: str,
    where: str,
    notes: list[str],
) -> dict[str, Any]:
    labels, probabilities = Predictions.joined(predictions)

    def column(name: str) -> NDArray:
        return np.concatenate([getattr(part.table, name) for part in predictions])

    objects = column("objects")
    weights = sorted({card.weights for card in cards})
    return {
        "source": source,
        **score(labels, probabilities),
        "by_object": {
            str(name): score(labels[objects == name], probabilities[objects == name])
            for name in np.unique(objects)
        },
        "by_force_n": scores_by_value(column("force_n"), labels, probabilities),
        "by_z_mm": scores_by_value(column("z_mm"), labels, probabilities),
        "data": where,
        "kind": cards[0].input.kind,
        "weights": ", ".join(weights),
        "weights_note": f"pre-trained weights: {', '.join(started_from(name) for name in weights)}",
        "auroc_note": _AUROC_NOTE if len(cards) > 1 else "",
        "misjudged": [
            {
                "object": str(part.table.objects[i]),
                "grasp_id": str(part.table.ids[i]),
                "label": int(part.table.label[i]),
                "probability": float(part.probabilities[i]),
            }
            for part in predictions
            for i in part.wrong()
        ],
        "notes": notes,
    }


def _told_apart(values: NDArray[np.float64]) -> list[str]:
    """Different numbers as different texts, with as few digits as that takes, but at least four."""
    texts = ([f"{value:.{digits}g}" for value in values] for digits in range(4, 18))
    return next(found for found in texts if len(set(found)) == len(values))


def _add_gap(folder: RunFolder, result: dict[str, Any]) -> None:
    """The accuracy lost from simulated to real grasps, on the objects that both have."""
    path = folder.source_eval_path("sim")
    if result["source"] != "real" or not path.is_file():
        return
    simulated = read_json(path, "run `tacgen eval RUN --data DIR` again")
    shared = sorted(set(simulated.get("by_object", {})) & set(result["by_object"]))
    if not shared:
        return
    sim_accuracy = _pooled_accuracy(simulated["by_object"], shared)
    result["sim_accuracy"] = sim_accuracy
    result["sim_to_real_gap"] = sim_accuracy - _pooled_accuracy(result["by_object"], shared)
    result["gap_objects"] = shared


def _pooled_accuracy(by_object: Mapping[str, Any], names: Sequence[str]) -> float:
    n_right = sum(by_object[name]["accuracy"] * by_object[name]["n"] for name in names)
    return float(n_right / sum(by_object[name]["n"] for name in names))
