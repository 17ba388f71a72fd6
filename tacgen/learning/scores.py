"""How good predictions are: figures for a table, each with what it can and cannot say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

CALIBRATION_BINS = 10


@dataclass(frozen=True, slots=True)
class ReliabilityBin:
    """Grasps whose predicted probability of success lies in [lo, hi)."""

    lo: float
    hi: float
    n: int
    predicted: float
    succeeded: float


def wilson_interval(n_right: int, n: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval for a proportion of which ``n_right`` of ``n`` were seen.

    Source
    ------
    E. B. Wilson, *Probable inference, the law of succession, and statistical inference*, 1927.
    """
    if n == 0:
        return 0.0, 1.0
    z = float(norm.ppf(0.5 + confidence / 2))
    share = n_right / n
    middle = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    # Rounding must not put the share itself outside.
    return max(0.0, min(share, middle - half)), min(1.0, max(share, middle + half))


def reliability(
    labels: NDArray[np.int64], probabilities: NDArray[np.float64], bins: int = CALIBRATION_BINS
) -> list[ReliabilityBin]:
    """Predicted probability against what came true, in bins of equal width; empty ones left out."""
    places = np.minimum((probabilities * bins).astype(np.int64), bins - 1)
    found = []
    for place in np.unique(places):
        inside = places == place
        found.append(
            ReliabilityBin(
                lo=float(place / bins),
                hi=float((place + 1) / bins),
                n=int(inside.sum()),
                predicted=float(probabilities[inside].mean()),
                succeeded=float(labels[inside].mean()),
            )
        )
    return found


def expected_calibration_error(
    labels: NDArray[np.int64], probabilities: NDArray[np.float64]
) -> float:
    """Mean distance between predicted and true success rate over ten bins, weighed by count.

    Source
    ------
    Guo et al. 2017, *On calibration of modern neural networks*, Eq. 3, applied to the
    probability of success.
    """
    found = reliability(labels, probabilities)
    return sum(b.n * abs(b.predicted - b.succeeded) for b in found) / max(len(labels), 1)


def score(labels: NDArray[np.int64], probabilities: NDArray[np.float64]) -> dict[str, Any]:
    """All figures of some predictions.

    Parameters
    ----------
    labels : (N,) int
        1 success, 0 failure.
    probabilities : (N,) float
        Predicted probability of success; 0.5 and above counts as success.

    Returns
    -------
    dict
        ``accuracy`` with ``accuracy_interval`` (Wilson, 95 %), ``balanced_accuracy``, ``auroc``
        (None where only one class is there), ``ece``, ``confusion`` ([[failures judged failure,
        judged success], [successes judged failure, judged success]]), ``n``.
    """
    from sklearn.metrics import accuracy_score, confusion_matrix, roc_auc_score

    judged = (probabilities >= 0.5).astype(np.int64)
    confusion = confusion_matrix(labels, judged, labels=[0, 1])
    present = confusion.sum(axis=1) > 0
    recall = confusion.diagonal()[present] / confusion.sum(axis=1)[present]
    n_right = int(confusion.trace())
    return {
        "accuracy": float(accuracy_score(labels, judged)),
        "accuracy_interval": list(wilson_interval(n_right, len(labels))),
        "balanced_accuracy": float(recall.mean()),
        "auroc": float(roc_auc_score(labels, probabilities)) if present.all() else None,
        "ece": expected_calibration_error(labels, probabilities),
        "confusion": confusion.tolist(),
        "n": len(labels),
    }
