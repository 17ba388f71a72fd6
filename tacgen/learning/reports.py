"""The pages of a training and of an evaluation."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.images import evenly, side_by_side
from tacgen.learning.predictions import Predictions
from tacgen.learning.scores import beside, gap_text, reliability, tested_on
from tacgen.learning.training_recipe import TrainRecipe
from tacgen.report import figures as plots
from tacgen.report.page import write_page

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
    summary = (
        f"Validation accuracy {validation['accuracy']:.3f} at epoch {result['best_epoch']}, kept "
        f"(n = {validation['n']}). {recipe.description}".strip()
    )
    write_page(
        path,
        f"Training: {name}",
        summary=summary,
        template="training.html",
        made_by="train",
        recipe=recipe,
        result=result,
        lowest_loss_epoch=min(metrics, key=lambda line: line["validation_loss"])["epoch"],
        curves=plots.training_curves(metrics, result["best_epoch"]),
        confusion=plots.confusion(np.asarray(validation["confusion"]), CLASS_NAMES, CLASS_NAMES),
        score_header=SCORE_HEADER,
        score_row=score_row,
        started_from=started_from,
    )


def write_evaluation_report(
    path: Path, result: Mapping[str, Any], predictions: Sequence[Predictions]
) -> None:
    """Scores overall and in parts, calibration, and the grasps that were misclassified."""
    wrong = [(part, i) for part in predictions for i in part.wrong()]
    wrong.sort(key=lambda one: -abs(one[0].probabilities[one[1]] - 0.5))
    lo, hi = result["accuracy_interval"]
    write_page(
        path,
        "Evaluation on simulated grasps" if result["source"] == "sim" else "Evaluation",
        summary=f"Accuracy {result['accuracy']:.3f} ({lo:.3f} to {hi:.3f}) on {result['n']} grasps "
        f"({tested_on(result)}): {result['data']}",
        template="evaluation.html",
        made_by="eval",
        result=result,
        confusion=plots.confusion(np.asarray(result["confusion"]), CLASS_NAMES, CLASS_NAMES),
        calibration=plots.reliability_diagram(reliability(*Predictions.joined(predictions))),
        tested_on=tested_on(result),
        beside=beside(result),
        gap_text=gap_text,
        n_wrong=len(wrong),
        wrong=[_strip(part, i) for part, i in wrong[:MAX_SHOWN]],
        score_header=SCORE_HEADER,
        score_row=score_row,
        started_from=started_from,
    )


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
