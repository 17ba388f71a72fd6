"""Slip: as the shear force nears the friction limit the patch creeps loose from its rim."""

import numpy as np

from tacgen.contact.effects import base

CURVE = base.Curve("curve", (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2))


def load_ratio(history: base.LoadHistory, floor_n: float) -> base.FloatArray:
    """|F_s| / F_n (N,), with F_n no less than ``floor_n``."""
    return history.shear_size_n / np.maximum(history.normal_smooth_n, floor_n)


def mindlin_factor(fraction: base.FloatArray) -> base.FloatArray:
    """Growth of the tangential displacement at F_s = fraction·μF_n over the stuck contact.

    Source: Cattaneo 1938; Mindlin 1949: s = (3μF_n/16Ga)(1 − (1 − F_s/μF_n)^(2/3)).
    """
    q = np.clip(fraction, 1e-6, 1.0)
    return (1.0 - (1.0 - q) ** (2.0 / 3.0)) / (2.0 / 3.0 * q)


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Mindlin's growth below μ, then a power of the ratio, and a limit of the force that acts."""
    ratio = load_ratio(history, p["floor_n"])
    relative = p["amount"] * np.minimum(ratio / p["ratio_reference"], 2.0) ** p["exponent"]
    relative = relative + CURVE(ratio / p["ratio_reference"], p)
    if p["mindlin"] != 0.0:
        relative = relative + p["mindlin"] * (mindlin_factor(ratio / p["mu"]) - 1.0)
    if np.isfinite(p["gross_mu"]):
        relative = (1.0 + relative) * np.minimum(1.0, p["gross_mu"] / np.maximum(ratio, 1e-9)) - 1.0
    return base.with_gain(load, relative)


def _references(history: base.LoadHistory) -> dict[str, float]:
    floor = 0.05 * history.normal_span_n
    ratio = load_ratio(history, floor)
    pressed = ratio[history.normal_smooth_n > 2 * floor]
    high = float(np.quantile(pressed, 0.98)) if pressed.size else 1.0
    return {"floor_n": floor, "ratio_reference": max(high, 1e-3)}


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    high = references["ratio_reference"]
    powers = [
        base.variant(f"power {exponent:g}", [{"amount": 0.05}], {"exponent": exponent})
        for exponent in (1.0, 2.0, 4.0, 8.0)
    ]
    mindlin = [
        base.variant(
            f"Mindlin, mu {scale:g} of the range", [{"mindlin": 0.5}], {"mu": scale * high}
        )
        for scale in (1.0, 1.3, 2.0)
    ]
    gross = [
        base.variant(f"gross slip at {scale:g}", [{"gross_mu": scale * high}], scales=False)
        for scale in (0.6, 0.8, 0.95)
    ]
    return (*powers, *mindlin, *gross)


base.register(
    base.Effect(
        name="slip",
        channel="shear",
        stage="elastic",
        about="the shear motion grows as the shear force nears the friction limit",
        parameters=(
            base.amount("amount", -3.0, 10.0),
            base.shape("exponent", 0.5, 12.0, 2.0),
            base.amount("mindlin", -3.0, 10.0),
            base.shape("mu", 0.01, 10.0, 1.0),
            base.amount(
                "gross_mu", 0.01, np.inf, "1", np.inf, base.share_of("ratio_reference", 0.2, 4.0)
            ),
            *CURVE.parameters,
            base.reference("ratio_reference", "1"),
            base.reference("floor_n", "N"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=("force_shear_x_n", "force_shear_y_n"),
        separated_by={
            "normal_coupling": "the same shear at several normal forces",
            "creep": "hold the shear force for several seconds",
        },
    )
)
