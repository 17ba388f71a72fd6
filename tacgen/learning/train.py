"""``tacgen train``: a trained model for each object of a dataset."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.core.files import write_text
from tacgen.core.processes import map_in_processes
from tacgen.core.progress import print_status
from tacgen.core.records import Until
from tacgen.core.resources import __version__, versions
from tacgen.dataset.real_grasps import FRAME_UNKNOWN
from tacgen.learning.backbone import NO_WEIGHTS
from tacgen.learning.checkpoint import load_model
from tacgen.learning.device import choose_device, exact_torch
from tacgen.learning.fit import FitJob, TrainingState
from tacgen.learning.grasps import (
    EqualRanges,
    GraspTable,
    SimulatedGrasps,
    frames_until,
)
from tacgen.learning.loader import Batches, DecodedInputs
from tacgen.learning.network_input import (
    InputSpec,
    VisionInput,
    check_source,
    resized,
    touch_input,
    with_normalisation,
    with_touch_scale,
)
from tacgen.learning.predictions import predict
from tacgen.learning.reports import write_training_report
from tacgen.learning.run_folder import SCHEMA, RunFolder
from tacgen.learning.scores import score
from tacgen.learning.splits import ModelPlan, class_weights, few_grasps_warning, plan_models
from tacgen.learning.training_recipe import TrainRecipe
from tacgen.learning.twins import equal_ranges, one_sided

INFLUENTIAL = ("torch", "transformers", "numpy", "opencv-python-headless")  # on the weights
NO_WEIGHTS_WARNING = (
    "NO ImageNet weights: the backbone is trained from scratch, unlike the paper's; "
    "name a ResNet-18 weight file in model.weights to change that"
)


def train(
    recipe: TrainRecipe, data: Path, out: Path, *, workers: int = 1, device: str | None = None
) -> dict[str, Any]:
    """Train every model of ``recipe`` on the training grasps of ``data`` into the folder ``out``.

    A run that was stopped resumes after its last complete epoch. ``workers`` models are trained at
    a time, which changes no bit of them; ``models`` of the result has an entry for each. Raises
    ``TacgenError`` if the dataset, the recipe or the folder cannot be used, or the loss diverges.
    """
    device = choose_device(recipe.training, device)
    source = SimulatedGrasps(data, recipe.input.pad)
    kind, options = recipe.model.kind, recipe.input
    until: Until = "outcome"
    n_frames = 1
    if kind == "sequence":
        until, note = _where_frames_end(recipe, source)
        if note:
            print_status(f"{data}: {note}")
        n_frames = max(frames_until(source, row, until) for row in range(len(source.table)))
        n_frames = min(options.frames or n_frames, n_frames)
    spec = InputSpec(
        kind=kind,
        size_px=options.size_px,
        n_frames=n_frames,
        until=until,
        image=options.image,
        source_shape_px=source.shape_px,
        normalised=options.normalised,
        touch=tuple(
            touch_input(source, name, recipe.objects or source.table.object_names())
            for name in options.channels
            if name != "image" and name != "vision" and name != "touch"
        ),
        vision=VisionInput.of(source.camera(options.camera))
        if "vision" in options.channels
        else None,
        sees_touch="image" in options.channels,
    )
    equal = equal_ranges(source)
    table, notes = one_sided(source.table, equal)
    for note in notes:
        print_status(f"{data}: {note}")
    plans = plan_models(recipe, table, str(data), equal)
    for plan in plans:
        check_source(spec, source, plan.fit_rows, str(data))
        if warning := few_grasps_warning(plan, source.table):
            print_status(f"warning: {warning}")
    run = RunFolder(out)
    run_plan = _run_plan(recipe, source, table, plans, equal, device)
    if run.prepare(run_plan | {"until": spec.shows_until}, recipe.resolved()):
        print_status(f"{out}: resumes the run that is there")
    job = partial(train_one, recipe, source, spec, run, device)
    done = map_in_processes(job, plans, workers, method="spawn")
    results = {plan.name: result for plan, result in zip(plans, done, strict=True)}
    summary = {
        "recipe": recipe.name,
        "data": str(data),
        "kind": recipe.model.kind,
        "until": spec.shows_until,
        "frames_seen": spec.frames_seen(),
        "device": device,
        "threads": recipe.training.threads,
        "versions": versions(*INFLUENTIAL),
        "models": results,
    }
    write_text(run.summary_path, json.dumps(summary, indent=1))
    return summary


def _run_plan(
    recipe: TrainRecipe,
    source: SimulatedGrasps,
    table: GraspTable,
    plans: list[ModelPlan],
    equal: EqualRanges,
    device: str,
) -> dict[str, Any]:
    """The identity of this run; a folder with another run is refused."""
    moved = np.flatnonzero((table.split == "test") & (source.table.split == "train"))
    models = {}
    for plan in plans:
        used = table.take(np.concatenate([plan.fit_rows, plan.validation_rows]))
        known = sorted(zip(used.configurations(), used.label.tolist(), strict=True))
        models[plan.name] = {
            "objects": list(plan.objects),
            "fit": table.ids[plan.fit_rows].tolist(),
            "validation": table.ids[plan.validation_rows].tolist(),
            "configurations": [text for text, _ in known],
            "labels": [label for _, label in known],
        }
    return {
        "schema": SCHEMA,
        "tacgen_version": __version__,
        "recipe": recipe.resolved(),
        "recipe_sha256": recipe.sha256(),
        "dataset": source.identity(),
        "device": device,
        "equal_ranges": equal,
        "test_groups": sorted(set(table.take(moved).configurations(equal))),
        "models": models,
    }


def _where_frames_end(recipe: TrainRecipe, source: SimulatedGrasps) -> tuple[Until, str]:
    """What a sequence shows last, by recipe and dataset, and what to report where they differ."""
    asked = recipe.input.until
    if source.dataset.until == "lift":
        other = "its frames end at the start of the lift, whatever input.until asks for"
        return "lift", "" if asked == "lift" else other
    if asked == "lift" and (source.lift_frame == FRAME_UNKNOWN).any():
        return "outcome", (
            "does NOT tell when its lifts start, so the network sees all frames, and with them the "
            "outcome; collect it again with this version for a network that predicts"
        )
    return asked, ""


def train_one(
    recipe: TrainRecipe,
    source: SimulatedGrasps,
    spec: InputSpec,
    run: RunFolder,
    device: str,
    plan: ModelPlan,
) -> dict[str, Any]:
    """Train one model, or finish it; its entry in ``train.json``."""
    folder = run.model(plan.name)
    with folder.locked(), exact_torch(recipe.training.threads):
        reference = resized(source.reference[None], spec.size_px)[0]
        parts = [
            DecodedInputs(source, rows, spec, recipe.input.cache_mb)
            for rows in (plan.fit_rows, plan.validation_rows)
        ]
        every = (parts[0][item] for item in range(len(parts[0])))
        spec = with_normalisation(spec, every, reference)
        spec = with_touch_scale(spec, (parts[0].touch(k) for k in range(len(parts[0]))))
        weights = class_weights(parts[0].labels)
        batches, validation = (
            Batches(inputs, spec, reference, recipe.training.batch_size) for inputs in parts
        )
        sensor = source.dataset.sensor
        job = FitJob(
            plan.name, plan.objects, recipe, spec, sensor, batches, validation, weights, reference
        )
        fit = TrainingState(job, folder, device)
        if fit.network.backbone.origin == NO_WEIGHTS:
            print_status(f"{plan.name}: {NO_WEIGHTS_WARNING}")
        metrics = fit.run()
        network, card, _ = load_model(folder.model_path)
        probabilities, labels = predict(network.to(device), validation.in_order(), device)
        epochs, scores = metrics[-1]["epoch"], score(labels, probabilities, network.prior)
        result: dict[str, Any] = {
            "objects": list(plan.objects),
            "frames_seen": spec.frames_seen(),
            "grasps_fit": len(plan.fit_rows),
            "grasps_validation": len(plan.validation_rows),
            "successes_fit": int(parts[0].labels.sum()),
            "class_weights": weights.tolist(),
            "weights": card.weights,
            "best_epoch": card.epoch,
            "epochs": epochs,
            "validation": scores,
            "epoch_s": float(np.median([line["epoch_s"] for line in metrics])),
        }
        write_training_report(folder.report_path, recipe, plan.name, metrics, result)
    print_status(
        f"{plan.name}: kept epoch {card.epoch} of {epochs}, validation accuracy "
        f"{scores['accuracy']:.3f} on {len(labels)} grasps"
    )
    return result
