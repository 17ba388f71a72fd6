"""Temperature: a warm gel is softer, and a warm gauge's zero moves."""

import numpy as np

from tacgen.contact.effects import base


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + linear·ΔT + quadratic·ΔT² and a zero that moves by offset·ΔT."""
    delta = np.nan_to_num(history.column("temperature_c") - p["reference_c"], nan=0.0)
    relative = delta * (p["linear_per_c"] + delta * p["quadratic_per_c2"])
    return np.asarray(base.with_gain(load, relative) + (p["offset_n_per_c"] * delta)[:, None])


def _references(history: base.LoadHistory) -> dict[str, float]:
    known = history.column("temperature_c")
    known = known[np.isfinite(known)]
    return {"reference_c": float(known.mean()) if known.size else 0.0}


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    delta = history.column("temperature_c") - references["reference_c"]
    spread = max(float(np.nanstd(delta)), 1e-6)
    linear = {"linear_per_c": 0.05 / spread}
    return (
        base.variant("linear", [linear]),
        base.variant("quadratic", [linear, {"quadratic_per_c2": 0.05 / spread**2}]),
        base.variant("zero", [{"offset_n_per_c": 0.01 * history.normal_span_n / spread}]),
    )


base.register(
    base.Effect(
        name="temperature",
        channel="normal",
        stage="gain",
        is_of_trials=True,
        about="the compliance or the zero follows the temperature",
        parameters=(
            base.amount("linear_per_c", -1.0, 1.0, "1/°C"),
            base.amount("quadratic_per_c2", -1.0, 1.0, "1/°C²"),
            base.amount("offset_n_per_c", -10.0, 10.0, "N/°C"),
            base.reference("reference_c", "°C", 20.0),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=("temperature_c",),
        is_identifiable=lambda history: base.varies(history.column("temperature_c")),
        shown_against="temperature_c",
    )
)
