"""Drift: the compliance, or the gauge's zero, moves with the session's clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects.history import LoadHistory
from tacgen.contact.effects.registry import (
    Effect,
    Parameters,
    Variant,
    amount,
    reference,
    register,
    variant,
)
from tacgen.contact.effects.shapes import with_gain


def _apply(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """Gain 1 + linear·τ + quadratic·τ² + cubic·τ³ and a zero that moves by offset_n·τ.

    τ = (t − start)/span − ½ runs from −½ to ½ over the session that was fitted; beyond, the
    nearest end's value goes on for a quarter of a session and is then held.
    """
    tau = np.clip((history.time_s - p["start_s"]) / p["span_s"] - 0.5, -0.75, 0.75)
    relative = tau * (p["linear"] + tau * (p["quadratic"] + tau * p["cubic"]))
    return with_gain(load, relative) + (p["offset_n"] * tau)[:, None]


def _references(history: LoadHistory) -> dict[str, float]:
    if not history.n_samples:
        return {"start_s": 0.0, "span_s": 1.0}
    start = float(history.time_s.min())
    return {"start_s": start, "span_s": max(float(history.time_s.max()) - start, 1e-6)}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    linear, quadratic, cubic = {"linear": 0.05}, {"quadratic": 0.05}, {"cubic": 0.05}
    return (
        variant("linear", [linear]),
        variant("quadratic", [linear, quadratic]),
        variant("cubic", [linear, quadratic, cubic]),
        variant("zero, linear", [{"offset_n": 0.01 * history.normal_span_n}]),
    )


register(
    Effect(
        name="drift",
        channel="normal",
        stage="gain",
        about="the compliance or the zero moves with session time",
        parameters=(
            amount("linear", -2.0, 5.0),
            amount("quadratic", -10.0, 10.0),
            amount("cubic", -20.0, 20.0),
            amount("offset_n", -20.0, 20.0, "N"),
            reference("start_s", "s", 0.0),
            reference("span_s", "s"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=("time_s",),
        in_simulation=False,
    )
)
