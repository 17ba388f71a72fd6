"""Slip: as the shear force nears the friction limit the patch creeps loose from its rim."""

import numpy as np

from tacgen.contact.effects import base

CURVE = base.Curve("curve", (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2))
_NO_FORCE_N = 1e-9  # where nothing is pressed, nothing is dragged


def mindlin_factor(fraction: base.FloatArray) -> base.FloatArray:
    """Growth of the tangential displacement at F_s = fraction·μF_n over the stuck contact.

    Source: Cattaneo 1938; Mindlin 1949: s = (3μF_n/16Ga)(1 − (1 − F_s/μF_n)^(2/3)).
    """
    q = np.clip(fraction, 1e-6, 1.0)
    return (1.0 - (1.0 - q) ** (2.0 / 3.0)) / (2.0 / 3.0 * q)


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Mindlin's growth below μ, then a power of the ratio, and a limit of what then moves.

    The ratio is that of the load, with all that has crept, and the normal force: unsmoothed, since
    a limit that is smoothed is too low at a peak.
    """
    size, normal = np.hypot(*load.T), history.force_normal_n
    ratio = size / np.maximum(normal, p["floor_n"])
    relative = p["amount"] * np.minimum(ratio / p["ratio_reference"], 2.0) ** p["exponent"]
    relative = relative + CURVE(ratio / p["ratio_reference"], p)
    if p["mindlin"] != 0.0:
        relative = relative + p["mindlin"] * (mindlin_factor(ratio / p["mu"]) - 1.0)
    if np.isfinite(p["gross_mu"]):
        limit_n = p["gross_mu"] * np.maximum(normal, _NO_FORCE_N)
        moves = np.maximum(1.0 + relative, 0.0)
        relative = moves * base.limited(moves * size / limit_n, p["sharpness"]) - 1.0
    return base.with_gain(load, relative)


def _references(history: base.LoadHistory) -> dict[str, float]:
    floor = 0.05 * history.normal_span_n
    pressed = history.normal_smooth_n > 2 * floor
    ratio = history.shear_size_n[pressed] / history.normal_smooth_n[pressed]
    high = float(np.quantile(ratio, 0.98)) if ratio.size else 1.0
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
        base.variant(
            f"gross slip at {scale:g}, sharpness {sharpness:g}",
            [{"gross_mu": scale * high}],
            {"sharpness": sharpness},
            scales=False,
        )
        for scale, sharpness in ((0.6, 20.0), (0.8, 20.0), (0.95, 20.0), (0.8, 3.0), (1.2, 3.0))
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
            base.shape("sharpness", 1.5, 300.0, 300.0),
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
