"""Latency: the camera's clock and the gauge's are apart, or one of them lags."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects import kernels
from tacgen.contact.effects.history import LoadHistory
from tacgen.contact.effects.registry import (
    Effect,
    Parameters,
    Variant,
    amount,
    no_references,
    register,
    variant,
)


def _apply(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """The load that the volume answers to: F(t − delay), then a first-order lag."""
    times, starts = history.time_s, history.starts
    values = np.ascontiguousarray(load[:, 0])
    if p["delay_s"] != 0.0:
        values = kernels.delayed(values, times, starts, p["delay_s"])
    if p["lag_s"] > 0.0:
        values = kernels.low_pass(values, times, starts, p["lag_s"], False)
    return values[:, None]


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    period = history.sample_period_s
    return (
        variant("lead or delay", [{"delay_s": period}]),
        variant("first-order lag", [{"lag_s": period}]),
        variant("delay and lag", [{"delay_s": period}, {"lag_s": period}]),
    )


register(
    Effect(
        name="latency",
        channel="normal",
        stage="input",
        about="the volume comes later (or earlier) than the force",
        parameters=(
            amount("delay_s", -2.0, 2.0, "s"),
            amount("lag_s", 0.0, 2.0, "s"),
        ),
        apply=_apply,
        references=no_references,
        variants=_variants,
        in_simulation=False,
    )
)
