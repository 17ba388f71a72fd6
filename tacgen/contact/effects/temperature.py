"""Temperature: a warm gel is softer, and a warm gauge's zero moves."""

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
from tacgen.contact.effects.shapes import finite_mean, with_gain


def _apply(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """Gain 1 + linear·ΔT + quadratic·ΔT² and a zero that moves by offset·ΔT."""
    delta = np.nan_to_num(history.column("temperature_c") - p["reference_c"], nan=0.0)
    relative = delta * (p["linear_per_c"] + delta * p["quadratic_per_c2"])
    return with_gain(load, relative) + (p["offset_n_per_c"] * delta)[:, None]


def _references(history: LoadHistory) -> dict[str, float]:
    return {"reference_c": finite_mean(history.column("temperature_c"))}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    delta = history.column("temperature_c") - references["reference_c"]
    spread = max(float(np.nanstd(delta)), 1e-6)
    linear = {"linear_per_c": 0.05 / spread}
    return (
        variant("linear", [linear]),
        variant("quadratic", [linear, {"quadratic_per_c2": 0.05 / spread**2}]),
        variant("zero", [{"offset_n_per_c": 0.01 * history.normal_span_n / spread}]),
    )


register(
    Effect(
        name="temperature",
        channel="normal",
        stage="gain",
        about="the compliance or the zero follows the temperature",
        parameters=(
            amount("linear_per_c", -1.0, 1.0, "1/°C"),
            amount("quadratic_per_c2", -1.0, 1.0, "1/°C²"),
            amount("offset_n_per_c", -10.0, 10.0, "N/°C"),
            reference("reference_c", "°C", 20.0),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=("temperature_c",),
    )
)
