"""How good predictions are: the scores, and the lines of text that report them."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import norm

SAME_IMPRINT = 0.9
"""Correlation of the last frame's imprint with that at the moment of grasp: with less the object is
gone, or has slipped or turned. Chosen on ``paper_table``'s scissors and strawberry."""
THE_RULE = f"holds while the imprint is that of the grasp (correlation above {SAME_IMPRINT:g})"
CALIBRATION_BINS = 10  # as usual for the expected calibration error; twelve grasps a bin of 120


def wilson_interval(n_right: float, n: int) -> tuple[float, float]:
    """95 % confidence interval of a proportion of which ``n_right`` of ``n`` were observed.

    ``n_right`` may be a mean over several trials.

    Source: E. B. Wilson, *Probable inference, the law of succession, and statistical inference*,
    1927.
    """
    if n == 0:
        return 0.0, 1.0
    share, z2_n = n_right / n, float(norm.ppf(0.975)) ** 2 / n
    middle = (share + z2_n / 2) / (1 + z2_n)
    half = math.sqrt(z2_n * (share * (1 - share) + z2_n / 4)) / (1 + z2_n)
    # The share is one end where it is 0 or 1, whatever rounding makes of it.
    return max(0.0, min(middle - half, share)), min(1.0, max(middle + half, share))


def reliability(labels: NDArray[np.int64], probabilities: NDArray[np.float64]) -> pd.DataFrame:
    """Predicted probability against the true rate, in ten bins of equal width that hold grasps.

    A row is the ``n`` grasps whose probability lies in [``lo``, ``hi``), with the means of what was
    ``predicted`` and of what ``succeeded``.
    """
    places = np.minimum((probabilities * CALIBRATION_BINS).astype(int), CALIBRATION_BINS - 1)
    table = pd.DataFrame({"n": 1, "predicted": probabilities, "succeeded": labels})
    found = table.groupby(places).agg({"n": "size", "predicted": "mean", "succeeded": "mean"})
    bins = found.index.to_numpy()
    return found.assign(lo=bins / CALIBRATION_BINS, hi=(bins + 1) / CALIBRATION_BINS)


def expected_calibration_error(
    labels: NDArray[np.int64], probabilities: NDArray[np.float64]
) -> float:
    """Mean distance between predicted and true success rate over ten bins, weighed by count.

    Source: Guo et al. 2017, *On calibration of modern neural networks*, Eq. 3, applied to the
    probability of success.
    """
    found = reliability(labels, probabilities)
    off = (found["predicted"] - found["succeeded"]).abs()
    return float((found["n"] * off).sum() / max(len(labels), 1))


def score(
    labels: NDArray[np.int64],
    probabilities: NDArray[np.float64],
    prior: float | NDArray[np.float64] = 0.5,
) -> dict[str, Any]:
    """All scores of some predictions: labels (N,) and probabilities (N,) of success.

    ``accuracy`` with ``accuracy_interval`` (Wilson, 95 %), ``balanced_accuracy``, ``auroc`` (None
    where only one class is there), ``ece``, ``confusion`` (rows: true failure, success; columns:
    predicted failure, success), ``n``. A probability of 0.5 counts as success; for the balanced
    accuracy, which weighs both outcomes alike, one of ``prior``, the share of successes that the
    probabilities were calibrated to.
    """
    from sklearn.metrics import confusion_matrix, roc_auc_score

    predicted = (probabilities >= 0.5).astype(np.int64)
    confusion = confusion_matrix(labels, predicted, labels=[0, 1])
    present = confusion.sum(axis=1) > 0
    evenly = confusion_matrix(labels, (probabilities >= prior).astype(np.int64), labels=[0, 1])
    recall = evenly.diagonal()[present] / evenly.sum(axis=1)[present]
    n_right = int(confusion.trace())
    return {
        "accuracy": n_right / len(labels),
        "accuracy_interval": list(wilson_interval(n_right, len(labels))),
        "balanced_accuracy": float(recall.mean()),
        "auroc": float(roc_auc_score(labels, probabilities)) if present.all() else None,
        "ece": expected_calibration_error(labels, probabilities),
        "confusion": confusion.tolist(),
        "n": len(labels),
    }


def training_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """One line a model, and the pre-trained weights of all."""
    for name, model in summary["models"].items():
        scores = model["validation"]
        yield (
            f"{name}: kept epoch {model['best_epoch']} of {model['epochs']}, validation accuracy "
            f"{scores['accuracy']:.3f} (balanced {scores['balanced_accuracy']:.3f}, "
            f"n = {scores['n']}), {model['epoch_s']:.1f} s an epoch"
        )
    origins = sorted({model["weights"] for model in summary["models"].values()})
    yield f"pre-trained weights: {', '.join(origins)}; frames: {summary['frames_seen']}"


def evaluation_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """The scores overall and by object, and the sim-to-real gap where it is known."""
    yield _score_line(tested_on(result), result)
    for name, scores in result["by_object"].items():
        yield _score_line(f"  {name}", scores)
    yield f"frames that the network saw: {result['frames_seen']}"
    for name, scores in beside(result).items():
        yield _score_line(name, scores)
    if "sim_to_real_gap" in result:
        gap = "gap to the other simulation" if result["real_is_simulated"] else "sim-to-real gap"
        yield f"{gap}: {gap_text(result)}"
    yield result["weights_note"]


def beside(result: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """The scores to compare a network's with, by name: the rule's, and the controls'."""
    found = {f"control, {name}": scores for name, scores in result.get("controls", {}).items()}
    if "without_touch" in result:
        found = {"trees that see only what was commanded": result["without_touch"], **found}
    if "same_imprint_rule" in result:
        return {f"rule: {THE_RULE}": result["same_imprint_rule"], **found}
    return found


def gap_text(result: Mapping[str, Any]) -> str:
    """The gap between two sources with its interval, and the objects that are not in it."""
    lo, hi = result["gap_interval"]
    missing = [
        f"; {side}: no {', '.join(names)}" for side, names in result["gap_missing"].items() if names
    ]
    return (
        f"{result['sim_to_real_gap']:+.3f} [{lo:+.3f}, {hi:+.3f}] (accuracy "
        f"{result['sim_accuracy']:.3f} on simulated, {result['real_accuracy']:.3f} on these "
        f"grasps; each of {', '.join(result['gap_objects'])} weighs the same{''.join(missing)})"
    )


def tested_on(result: Mapping[str, Any]) -> str:
    """What kind of grasps a result was measured on."""
    if result["source"] == "sim":
        return "simulated"
    return "another simulation, NOT real" if result["real_is_simulated"] else "real"


def _score_line(name: str, scores: Mapping[str, Any]) -> str:
    lo, hi = scores["accuracy_interval"]
    auroc = "–" if scores["auroc"] is None else f"{scores['auroc']:.3f}"
    return (
        f"{name}: accuracy {scores['accuracy']:.3f} [{lo:.3f}, {hi:.3f}], balanced "
        f"{scores['balanced_accuracy']:.3f}, AUROC {auroc}, ECE {scores['ece']:.3f}, "
        f"n = {scores['n']}"
    )
