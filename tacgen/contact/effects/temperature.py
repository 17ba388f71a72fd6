"""Temperature: a warm gel is softer, and a warm gauge's zero moves."""

import numpy as np

from tacgen.contact.effects import base


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + linear·ΔT + quadratic·ΔT², a step about ΔT = step_at, a zero that moves with ΔT.

    Source of the step: a polymer softens within some degrees; Ferry 1980, Viscoelastic Properties
    of Polymers, ch. 11.
    """
    delta = np.nan_to_num(history.column("temperature_c") - p["reference_c"], nan=0.0)
    relative = delta * (p["linear_per_c"] + delta * p["quadratic_per_c2"])
    if p["step"] != 0.0:
        relative = relative + p["step"] * np.tanh((delta - p["step_at_c"]) / p["step_width_c"])
    return np.asarray(base.with_gain(load, relative) + (p["offset_n_per_c"] * delta)[:, None])


def _references(history: base.LoadHistory) -> dict[str, float]:
    known = history.column("temperature_c")
    known = known[np.isfinite(known)]
    return {"reference_c": float(known.mean()) if known.size else 0.0}


def _within_the_log(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    """Where some of the trials are on either side."""
    delta = history.column("temperature_c") - p["reference_c"]
    low, high = np.nanquantile(delta, [0.1, 0.9])
    return float(low), float(high)


def _width_bounds(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    """From a sharp step to one three times as wide as the temperatures spread: nearly a line."""
    spread = max(float(np.nanstd(history.column("temperature_c"))), 1e-6)
    return 0.2 * spread, 3.0 * spread


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    delta = history.column("temperature_c") - references["reference_c"]
    spread = max(float(np.nanstd(delta)), 1e-6)
    linear = {"linear_per_c": 0.05 / spread}
    return (
        base.variant("linear", [linear]),
        base.variant("quadratic", [linear, {"quadratic_per_c2": 0.05 / spread**2}]),
        base.variant("step", [{"step": 0.05}], {"step_at_c": 0.0, "step_width_c": spread}),
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
            base.amount("step", -0.9, 5.0),
            base.shape("step_at_c", -50.0, 50.0, 0.0, "°C", _within_the_log),
            base.shape("step_width_c", 0.1, 50.0, 1.0, "°C", _width_bounds),
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
