"""The pages of a training and of an evaluation."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.images import evenly, side_by_side
from tacgen.learning.predictions import Predictions
from tacgen.learning.scores import reliability, tested_on
from tacgen.learning.training_recipe import TrainRecipe
from tacgen.report import figures as plots
from tacgen.report.formatting import number, percent
from tacgen.report.page import (
    Section,
    facts_section,
    figure_section,
    pictures_section,
    table_section,
    text_section,
    write_page,
)

MAX_SHOWN = 24  # misclassified grasps that the page shows, the most certain first
MAX_FRAMES, FRAME_WIDTH_PX = 8, 160  # of the strip of images of a misclassified grasp
CLASS_NAMES = ("failure", "success")
SCORE_HEADER = ("accuracy", "95 % interval", "balanced", "AUROC", "ECE", "n")


def write_training_report(
    path: Path,
    recipe: TrainRecipe,
    name: str,
    metrics: Sequence[Mapping[str, Any]],
    result: Mapping[str, Any],
) -> None:
    """Curves, scores on the validation grasps, and what the model started from."""
    validation = result["validation"]
    curves = plots.training_curves(metrics, result["best_epoch"])
    about_curves = "Training: during the epoch. Validation: the averaged weights, which are kept."
    about_scores = (
        "These grasps chose the best epoch, so the scores are optimistic; tacgen eval scores the "
        "test grasps."
    )
    facts = [
        ("network", recipe.model.kind),
        ("objects", ", ".join(result["objects"])),
        ("pre-trained weights", started_from(result["weights"])),
        ("training grasps", result["grasps_fit"]),
        ("of these successes", result["successes_fit"]),
        ("validation grasps", result["grasps_validation"]),
        ("best epoch", result["best_epoch"]),
        ("epochs over which weights are averaged", recipe.training.average_epochs),
        ("time per epoch, median", f"{number(result['epoch_s'], 3)} s"),
        ("share of it in the data loader, median", percent(result["loader_share"])),
        ("time to decode the images once", f"{number(result['decode_s'], 3)} s"),
    ]
    title, rows = "Validation grasps", [score_row(validation)]
    sections = [
        figure_section("Curves", curves, about_curves),
        _confusion(f"{title}: confusion", validation["confusion"]),
        table_section(f"{title}: scores", SCORE_HEADER, rows, about_scores),
        facts_section("What was trained", facts),
    ]
    summary = (
        f"Validation accuracy {validation['accuracy']:.3f} at epoch {result['best_epoch']} "
        f"(n = {validation['n']}). {recipe.description}".strip()
    )
    write_page(path, f"Training: {name}", sections, summary=summary)


def write_evaluation_report(
    path: Path, result: Mapping[str, Any], predictions: Sequence[Predictions]
) -> None:
    """Scores overall and in parts, calibration, and the grasps that were misclassified."""
    bins = reliability(*Predictions.joined(predictions))
    counts = dict(zip((bins["lo"] + bins["hi"]) / 2, bins["n"], strict=True))
    diagram = plots.reliability_diagram(
        bins["predicted"].tolist(), bins["succeeded"].tolist(), counts
    )
    sections = [
        _confusion("Confusion", result["confusion"]),
        figure_section("Calibration", diagram, f"Expected calibration error {result['ece']:.3f}."),
        _overview(result),
    ]
    for title, column, scores_by, note in (
        ("By object", "object", result["by_object"], result["auroc_note"]),
        ("By force", "force, N", result["by_force_n"], ""),
        ("By height", "height of the pad, mm", result["by_z_mm"], ""),
    ):
        rows = [(name, *score_row(scores)) for name, scores in scores_by.items()]
        sections.append(table_section(title, (column, *SCORE_HEADER), rows, note))
    sections.append(_misclassified(predictions))
    title = "Evaluation on simulated grasps" if result["source"] == "sim" else "Evaluation"
    lo, hi = result["accuracy_interval"]
    summary = (
        f"Accuracy {result['accuracy']:.3f} ({lo:.3f} to {hi:.3f}) on {result['n']} grasps "
        f"({tested_on(result)}): {result['data']}"
    )
    write_page(path, title, sections, summary=summary)


def started_from(weights: str) -> str:
    """The pre-trained weights of the backbone, for a reader."""
    return "NONE, trained from scratch" if weights == "none" else weights


def score_row(scores: Mapping[str, Any]) -> tuple[object, ...]:
    """One row of the scores' table."""
    lo, hi = scores["accuracy_interval"]
    return (
        f"{scores['accuracy']:.3f}",
        f"{lo:.3f} to {hi:.3f}",
        f"{scores['balanced_accuracy']:.3f}",
        "one class" if scores["auroc"] is None else f"{scores['auroc']:.3f}",
        f"{scores['ece']:.3f}",
        scores["n"],
    )


def _confusion(title: str, confusion: Sequence[Sequence[int]]) -> Section:
    return figure_section(title, plots.confusion(np.asarray(confusion), CLASS_NAMES, CLASS_NAMES))


def _overview(result: Mapping[str, Any]) -> Section:
    notes = [f"Pre-trained weights: {started_from(result['weights'])}."]
    if "sim_to_real_gap" in result:
        accuracy, gap = result["sim_accuracy"], result["sim_to_real_gap"]
        notes.append(
            f"On simulated test grasps the accuracy was {accuracy:.3f}: a gap of {gap:+.3f}."
        )
    row, notes = (tested_on(result), *score_row(result)), [*notes, *result["notes"]]
    return table_section("Overall", ("tested on", *SCORE_HEADER), [row], " ".join(notes))


def _misclassified(predictions: Sequence[Predictions]) -> Section:
    title, every = "Misclassified grasps", [(part, i) for part in predictions for i in part.wrong()]
    if not every:
        return text_section(title, "None.")
    wrong = sorted(every, key=lambda one: -abs(one[0].probabilities[one[1]] - 0.5))[:MAX_SHOWN]
    note = f"{len(every)} in all; shown: the {len(wrong)} with the most confident wrong prediction."
    return pictures_section(title, itertools.starmap(_strip, wrong), note)


def _strip(part: Predictions, i: int) -> tuple[str, NDArray[np.uint8]]:
    """Caption and images of a misclassified grasp."""
    table, frames = part.table, part.frames[i]()
    caption = (
        f"{table.objects[i]}, grasp {table.ids[i]}: a {CLASS_NAMES[table.label[i]]}, predicted "
        f"{part.probabilities[i]:.3f} likely to succeed; {table.force_n[i]:g} N at height "
        f"{table.z_mm[i]:g} mm"
    )
    return caption, side_by_side(
        [frames[k] for k in evenly(len(frames), MAX_FRAMES)], FRAME_WIDTH_PX
    )
