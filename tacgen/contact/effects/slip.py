"""Slip: as the shear force nears the friction limit the patch creeps loose from its rim."""

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
from tacgen.contact.effects.shapes import with_gain


def load_ratio(history: LoadHistory, floor_n: float) -> NDArray[np.float64]:
    """|F_s| / F_n (N,), with F_n no less than ``floor_n``."""
    return history.shear_size_n / np.maximum(history.normal_smooth_n, floor_n)


def mindlin_factor(fraction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Growth of the tangential displacement at F_s = fraction·μF_n over the stuck contact.

    Source
    ------
    Cattaneo 1938; Mindlin 1949: s = (3μF_n/16Ga)(1 − (1 − F_s/μF_n)^(2/3)).
    """
    q = np.clip(fraction, 1e-6, 1.0)
    return (1.0 - (1.0 - q) ** (2.0 / 3.0)) / (2.0 / 3.0 * q)


def _apply(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """Mindlin's growth below μ, then a power of the ratio, and a limit of the force that acts."""
    ratio = load_ratio(history, p["floor_n"])
    relative = p["amount"] * np.minimum(ratio / p["ratio_reference"], 2.0) ** p["exponent"]
    if p["mindlin"] != 0.0:
        relative = relative + p["mindlin"] * (mindlin_factor(ratio / p["mu"]) - 1.0)
    if np.isfinite(p["gross_mu"]):
        relative = (1.0 + relative) * np.minimum(1.0, p["gross_mu"] / np.maximum(ratio, 1e-9)) - 1.0
    return with_gain(load, relative)


def _references(history: LoadHistory) -> dict[str, float]:
    floor = 0.05 * history.normal_span_n
    ratio = load_ratio(history, floor)
    pressed = ratio[history.normal_smooth_n > 2 * floor]
    high = float(np.quantile(pressed, 0.98)) if pressed.size else 1.0
    return {"floor_n": floor, "ratio_reference": max(high, 1e-3)}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    high = references["ratio_reference"]
    powers = [
        variant(f"power {exponent:g}", [{"amount": 0.05}], {"exponent": exponent})
        for exponent in (1.0, 2.0, 4.0, 8.0)
    ]
    mindlin = [
        variant(f"Mindlin, mu {scale:g} of the range", [{"mindlin": 0.5}], {"mu": scale * high})
        for scale in (1.0, 1.3, 2.0)
    ]
    gross = [
        variant(f"gross slip at {scale:g}", [{"gross_mu": scale * high}], scales=False)
        for scale in (0.6, 0.8, 0.95)
    ]
    return (*powers, *mindlin, *gross)


register(
    Effect(
        name="slip",
        channel="shear",
        stage="elastic",
        about="the shear motion grows as the shear force nears the friction limit",
        parameters=(
            amount("amount", -3.0, 10.0),
            shape("exponent", 0.5, 12.0, 2.0),
            amount("mindlin", -3.0, 10.0),
            shape("mu", 0.01, 10.0, 1.0),
            amount("gross_mu", 0.01, np.inf, identity=np.inf),
            reference("ratio_reference", "1"),
            reference("floor_n", "N"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=("force_shear_x_n", "force_shear_y_n"),
    )
)
