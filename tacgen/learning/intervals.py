"""95 % intervals of accuracies over several seeds, and of gaps between objects' accuracies."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from tacgen.learning.scores import wilson_interval


def _of_seeds(values: Sequence[float]) -> float:
    """Half of Student's interval of a mean over seeds; 0 of one seed."""
    k = len(values)
    if k == 1:
        return 0.0
    return float(student.ppf(0.975, k - 1)) * float(np.std(values, ddof=1)) / math.sqrt(k)


ScoresByObject = Mapping[str, Mapping[str, float]]
"""By object ``accuracy`` and ``n``, the grasps that it was found on."""


def over_seeds(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The results of one row's seeds as one: mean accuracies with ``interval_over_seeds``.

    ``seeds`` are the accuracies, ``notes`` those of all; what else is in a result is that of the
    first seed.
    """
    names = results[0]["by_object"]
    parts = {name: mean_scores([one["by_object"][name] for one in results]) for name in names}
    seeds = [result["accuracy"] for result in results]
    found = _mean_gap(results) if "sim_to_real_gap" in results[0] else {}
    if "without_touch" in results[0]:
        found["without_touch"] = _mean_gain([one["without_touch"] for one in results])
    found["notes"] = list(dict.fromkeys(n for one in results for n in one.get("notes", ())))
    return dict(results[0]) | mean_scores(results) | found | {"by_object": parts, "seeds": seeds}


def _mean_gain(by_seed: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The mean scores of trees that see the command alone, and the gain over them, of all seeds."""
    gain = float(np.mean([one["gain"] for one in by_seed]))
    interval = _widened(by_seed, "gain", "gain_interval")
    return mean_scores(by_seed) | {"gain": gain, "gain_interval": interval}


def _mean_gap(results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    names = ("sim_accuracy", "real_accuracy", "sim_to_real_gap")
    means = {name: float(np.mean([one[name] for one in results])) for name in names}
    return means | {"gap_interval": _widened(results, "sim_to_real_gap", "gap_interval")}


def _widened(results: Sequence[Mapping[str, Any]], name: str, interval: str) -> list[float]:
    """The interval of a difference's mean over seeds: of other grasps, and of other seeds."""
    values = [one[name] for one in results]
    mean, of_seeds = float(np.mean(values)), _of_seeds(values)
    low, high = np.mean([one[interval] for one in results], axis=0).tolist()
    return [mean - math.hypot(mean - low, of_seeds), mean + math.hypot(high - mean, of_seeds)]


def mean_scores(scores: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Means of what several networks score on the same grasps, with ``interval_over_seeds``."""
    accuracies, n = [one["accuracy"] for one in scores], min(one["n"] for one in scores)
    means = {
        name: None if None in found else float(np.mean(found))
        for name in ("accuracy", "balanced_accuracy", "auroc", "ece")
        if (found := [one[name] for one in scores if name in one])
    }
    return means | {"accuracy_interval": list(interval_over_seeds(accuracies, n)), "n": n}


def interval_over_seeds(accuracies: Sequence[float], n: int) -> tuple[float, float]:
    """Interval of the accuracy of a network of any seed on any grasps.

    ``accuracies`` are those of several seeds on the same ``n`` grasps. The grasps are a sample
    (Wilson's interval of the mean), and so are the seeds (Student's interval of the mean); the
    distances of both from the mean are added in squares, as independent errors are. One seed alone
    tells nothing of the others: then the interval is that of the grasps.
    """
    mean = float(np.mean(accuracies))
    low, high = wilson_interval(mean * n, n)
    of_seeds = _of_seeds(accuracies)
    return (
        max(0.0, mean - math.hypot(mean - low, of_seeds)),
        min(1.0, mean + math.hypot(high - mean, of_seeds)),
    )


def paired_gain(
    right: NDArray[np.bool_], other: NDArray[np.bool_]
) -> tuple[float, tuple[float, float]]:
    """How much more often one predicts right than the other on the same grasps (N,), with 95 %.

    Source: Agresti & Min 2005, *Simple improved confidence intervals for comparing matched
    proportions*, Statistics in Medicine 24, section 3: Wald's interval after half a grasp has been
    added to each of the four cells, so that it never shrinks to a point.
    """
    n, more = len(right) + 2, int((right & ~other).sum()) + 0.5
    fewer = int((other & ~right).sum()) + 0.5
    middle = (more - fewer) / n
    half = float(norm.ppf(0.975)) * math.sqrt(more + fewer - (more - fewer) ** 2 / n) / n
    return float(right.mean() - other.mean()), (middle - half, middle + half)


def standardised_gap(
    simulated: ScoresByObject, real: ScoresByObject
) -> tuple[float, float, tuple[float, float]]:
    """Accuracy on simulated and on real grasps, and the interval of their difference.

    Each object that both sides have weighs the same, however many grasps it has on either side.

    Source: Zou & Donner 2008, *Construction of confidence limits about effect measures*, Statistics
    in Medicine 27, Eq. 9, for a sum of proportions with Wilson's intervals; of one object this is
    Newcombe's interval of a difference (1998, method 10). Unlike a bootstrap's, it does not shrink
    to a point where all grasps of an object are right.
    """
    shared = sorted(set(simulated) & set(real))
    accuracy, on_real = (
        float(np.mean([side[name]["accuracy"] for name in shared])) for side in (simulated, real)
    )
    below = above = 0.0
    for name in shared:
        p, (low, high) = _with_interval(simulated[name])
        q, (q_low, q_high) = _with_interval(real[name])
        below += (p - low) ** 2 + (q_high - q) ** 2
        above += (high - p) ** 2 + (q - q_low) ** 2
    gap, below, above = accuracy - on_real, math.sqrt(below), math.sqrt(above)
    return accuracy, on_real, (gap - below / len(shared), gap + above / len(shared))


def _with_interval(scores: Mapping[str, float]) -> tuple[float, tuple[float, float]]:
    n = int(scores["n"])
    return scores["accuracy"], wilson_interval(scores["accuracy"] * n, n)
