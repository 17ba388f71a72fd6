"""Saturation: there is a volume beyond which the sensor shows no more."""

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
    shape,
    variant,
)


def _apply(volume: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """V / (1 + |V/limit|^sharpness)^(1/sharpness): the limit itself for a sharp one."""
    if not np.isfinite(p["limit_mm3"]):
        return volume.copy()
    ratio = np.maximum(np.abs(volume) / p["limit_mm3"], 1e-12)
    sharpness = p["sharpness"]
    damp = np.exp(-np.logaddexp(0.0, sharpness * np.log(ratio)) / sharpness)
    return volume * damp


def _references(history: LoadHistory) -> dict[str, float]:
    return {}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    """Limits are shares of the largest volume, which the fit knows as ``span_mm3``."""
    span = references["span_mm3"]
    return tuple(
        variant(
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


register(
    Effect(
        name="saturation",
        channel="normal",
        stage="output",
        about="the volume does not grow beyond a limit",
        parameters=(
            amount("limit_mm3", 1e-6, np.inf, "mm3", identity=np.inf),
            shape("sharpness", 1.5, 60.0, 6.0),
            reference("span_mm3", "mm3"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
    )
)
