"""Saturation: there is a volume beyond which the sensor shows no more."""

import numpy as np

from tacgen.contact.effects import base


def _apply(
    volume: base.FloatArray, history: base.LoadHistory, p: base.Parameters
) -> base.FloatArray:
    """V / (1 + |V/limit|^sharpness)^(1/sharpness): the limit itself for a sharp one."""
    if not np.isfinite(p["limit_mm3"]):
        return volume.copy()
    ratio = np.maximum(np.abs(volume) / p["limit_mm3"], 1e-12)
    sharpness = p["sharpness"]
    damp = np.exp(-np.logaddexp(0.0, sharpness * np.log(ratio)) / sharpness)
    return volume * damp


def _limit_bounds(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    return 0.4 * p["span_mm3"], 5.0 * p["span_mm3"]


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    """Limits are shares of the span of the volume."""
    span = references["span_mm3"]
    return tuple(
        base.variant(
            f"limit at {share:g} of the range, sharpness {sharpness:g}",
            [{"limit_mm3": share * span}],
            {"sharpness": sharpness},
            scales=False,
        )
        for share, sharpness in (
            (0.8, 20.0),
            (0.95, 20.0),
            (0.8, 6.0),
            (1.0, 6.0),
            (1.0, 2.5),
            (1.4, 2.5),
        )
    )


base.register(
    base.Effect(
        name="saturation",
        channel="normal",
        stage="output",
        about="the volume does not grow beyond a limit",
        parameters=(
            base.amount("limit_mm3", 1e-6, np.inf, "mm3", np.inf, _limit_bounds),
            base.shape("sharpness", 1.5, 60.0, 6.0),
            base.reference("span_mm3", "mm3", of_response=True),
        ),
        apply=_apply,
        variants=_variants,
    )
)
