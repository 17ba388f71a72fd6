"""Results as the lines that a person reads in a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


def training_lines(summary: Mapping[str, Any]) -> Iterator[str]:
    """One line a model, and what all started from."""
    for name, model in summary["models"].items():
        scores = model["validation"]
        yield (
            f"{name}: best epoch {model['best_epoch']} of {model['epochs']}, validation accuracy "
            f"{scores['accuracy']:.3f} (balanced {scores['balanced_accuracy']:.3f}, "
            f"n = {scores['n']}), {model['epoch_s']:.1f} s an epoch, "
            f"loader {model['loader_share']:.1%}"
        )
    origins = sorted({model["weights"] for model in summary["models"].values()})
    yield f"first weights of the backbone: {', '.join(origins)}"


def evaluation_lines(result: Mapping[str, Any]) -> Iterator[str]:
    """The scores overall and by object, and the sim-to-real gap where both sides are known."""
    yield _score_line(tested_on(result), result)
    for name, scores in result["by_object"].items():
        yield _score_line(f"  {name}", scores)
    if "sim_to_real_gap" in result:
        gap = "gap to the other simulation" if result["stand_in"] else "sim-to-real gap"
        yield (
            f"{gap}: {result['sim_to_real_gap']:+.3f} "
            f"(accuracy {result['sim_accuracy']:.3f} on simulated test grasps)"
        )
    yield result["weights_note"]


def tested_on(result: Mapping[str, Any]) -> str:
    """What kind of grasps a result was measured on; a stand-in for reality is called so."""
    if result["source"] == "sim":
        return "simulated"
    return "another simulation, standing in for reality" if result["stand_in"] else "real"


def _score_line(name: str, scores: Mapping[str, Any]) -> str:
    lo, hi = scores["accuracy_interval"]
    auroc = "–" if scores["auroc"] is None else f"{scores['auroc']:.3f}"
    return (
        f"{name}: accuracy {scores['accuracy']:.3f} [{lo:.3f}, {hi:.3f}], balanced "
        f"{scores['balanced_accuracy']:.3f}, AUROC {auroc}, ECE {scores['ece']:.3f}, "
        f"n = {scores['n']}"
    )
