"""The pages that a person looks at after a training or an evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tacgen.learning.figures import confusion_figure, curves, reliability_figure, strip
from tacgen.learning.predictions import Predictions
from tacgen.learning.scores import reliability, tested_on
from tacgen.learning.training_recipe import TrainRecipe
from tacgen.report import (
    Section,
    figure_section,
    image_section,
    table_section,
    text_section,
    write_page,
)

MAX_MISJUDGED = 24
_ABOUT_CURVES = (
    "Training: the network that learns, on the way. "
    "Validation: the mean of its weights, which is kept."
)
_SCORES = ("accuracy", "95 % interval", "balanced", "AUROC", "ECE", "n")


def write_training_report(
    path: Path,
    recipe: TrainRecipe,
    name: str,
    metrics: Sequence[Mapping[str, Any]],
    result: Mapping[str, Any],
) -> None:
    """Curves, the confusion matrix on the validation grasps, and what the model started from."""
    facts = [
        ("network", recipe.model.kind),
        ("objects", ", ".join(result["objects"])),
        ("pre-trained weights", started_from(result["weights"])),
        ("grasps to learn from", result["grasps_fit"]),
        ("of these successes", result["successes_fit"]),
        ("grasps to choose the best epoch", result["grasps_validation"]),
        ("best epoch", result["best_epoch"]),
        ("weights averaged over about so many epochs", recipe.training.average_epochs),
        ("seconds an epoch (median)", result["epoch_s"]),
        ("share of the loader (median)", result["loader_share"]),
        ("seconds to decode the images once", result["decode_s"]),
    ]
    sections = [
        table_section("What was trained", ("", ""), facts),
        figure_section("Curves", curves(metrics, result["best_epoch"]), _ABOUT_CURVES),
        figure_section(
            "Validation grasps",
            confusion_figure(result["validation"]["confusion"]),
            "These chose the best epoch, so they flatter it; the test grasps are for tacgen eval.",
        ),
        table_section(
            "Scores on the validation grasps", _SCORES, [score_row(result["validation"])]
        ),
    ]
    write_page(path, f"Training: {name}", sections, summary=recipe.description)


def write_evaluation_report(
    path: Path, result: Mapping[str, Any], predictions: Sequence[Predictions]
) -> None:
    """Scores overall and in parts, calibration, and the grasps that were misjudged."""
    labels, probabilities = Predictions.joined(predictions)
    sections = [
        _overview(result),
        table_section(
            "By object", ("object", *_SCORES), _rows(result["by_object"]), result["auroc_note"]
        ),
        table_section("By force", ("force, N", *_SCORES), _rows(result["by_force_n"])),
        table_section("By height", ("height of the pad, mm", *_SCORES), _rows(result["by_z_mm"])),
        figure_section("Confusion", confusion_figure(result["confusion"])),
        figure_section(
            "Calibration",
            reliability_figure(reliability(labels, probabilities)),
            f"Expected calibration error {result['ece']:.3f}.",
        ),
        *_misjudged(predictions),
    ]
    title = "Evaluation on simulated grasps" if result["source"] == "sim" else "Evaluation"
    write_page(path, title, sections, summary=result["data"])


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


def _rows(parts: Mapping[str, Mapping[str, Any]]) -> list[tuple[object, ...]]:
    return [(name, *score_row(scores)) for name, scores in parts.items()]


def _overview(result: Mapping[str, Any]) -> Section:
    rows: list[tuple[object, ...]] = [(tested_on(result), *score_row(result))]
    note = f"Pre-trained weights: {started_from(result['weights'])}."
    gap = result.get("sim_to_real_gap")
    if gap is not None:
        note += (
            f" On simulated test grasps the accuracy was {result['sim_accuracy']:.3f}: "
            f"a gap of {gap:+.3f}."
        )
    notes = " ".join([note, *result["notes"]])
    return table_section("Overall", ("source", *_SCORES), rows, notes)


def _misjudged(predictions: Sequence[Predictions]) -> list[Section]:
    wrong = sorted(
        ((part, i) for part in predictions for i in part.wrong()),
        key=lambda found: -abs(found[0].probabilities[found[1]] - 0.5),
    )
    if not wrong:
        return [text_section("Misjudged grasps", "None.")]
    sections = [
        text_section(
            "Misjudged grasps",
            f"{len(wrong)} in all; the most certain {min(len(wrong), MAX_MISJUDGED)} are shown.",
        )
    ]
    for part, i in wrong[:MAX_MISJUDGED]:
        table = part.table
        truth = "success" if table.label[i] else "failure"
        sections.append(
            image_section(
                f"{table.objects[i]}, grasp {table.ids[i]}",
                strip(part.frames(i)),
                f"A {truth}, judged {part.probabilities[i]:.3f} likely to succeed; "
                f"{table.force_n[i]:g} N at height {table.z_mm[i]:g} mm.",
            )
        )
    return sections
