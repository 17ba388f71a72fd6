"""Shear coupling: pulling sideways changes the volume that the same normal force presses in."""

import numpy as np

from tacgen.contact.effects import base

CURVE = base.Curve("curve", (0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2))
LEAKED = base.Curve("leaked", (0.1, 0.2, 0.4, 0.6, 0.8, 1.0))
"""The share of |F_s| that is added, by its size."""
MIN_SHEAR_SHARE = 0.01
"""A shear force below this share of the normal one is the gauge's misalignment."""


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain by a power of |F_s|/F_n, by a power of |F_s|, and force leaking from |F_s|, x and y."""
    shear = history.shear_size_n
    pressed = np.maximum(history.normal_smooth_n, p["floor_n"])
    scaled = np.minimum(shear / pressed / p["ratio_reference"], 2.0)
    relative = p["ratio"] * scaled ** p["exponent"] + CURVE(scaled, p)
    if p["size"] != 0.0:
        relative = relative + p["size"] * (shear / p["reference_n"]) ** p["exponent"]
    share = p["leak"] + LEAKED(shear / p["reference_n"], p)
    leak = share * shear + history.force_shear_n @ np.array([p["leak_x"], p["leak_y"]])
    return np.asarray(base.with_gain(load, relative) + leak[:, None])


def _references(history: base.LoadHistory) -> dict[str, float]:
    floor = 0.05 * history.normal_span_n
    ratio = history.shear_size_n / np.maximum(history.normal_smooth_n, floor)
    high = float(np.quantile(ratio, 0.98)) if ratio.size else 1.0
    return {
        "floor_n": floor,
        "ratio_reference": max(high, 1e-3),
        "reference_n": history.shear_span_n,
    }


base.register(
    base.Effect(
        name="shear_coupling",
        channel="normal",
        stage="gain",
        about="shear changes the volume",
        parameters=(
            base.amount("ratio", -3.0, 5.0),
            base.amount("size", -3.0, 5.0),
            *(base.amount(name, -3.0, 3.0) for name in ("leak", "leak_x", "leak_y")),
            base.shape("exponent", 0.5, 4.0, 2.0),
            *CURVE.parameters,
            *LEAKED.parameters,
            base.reference("ratio_reference", "1"),
            base.reference("reference_n", "N"),
            base.reference("floor_n", "N"),
        ),
        apply=_apply,
        references=_references,
        variants=lambda history, references: (
            base.variant("ratio", [{"ratio": 0.05}], {"exponent": 1.0}),
            base.variant("ratio squared", [{"ratio": 0.05}], {"exponent": 2.0}),
            base.variant("shear", [{"size": 0.05}], {"exponent": 1.0}),
            base.variant("shear squared", [{"size": 0.05}], {"exponent": 2.0}),
            base.variant("added", [{"leak": 0.02}]),
            base.variant("leaking from x and y", [{"leak_x": 0.02}, {"leak_y": 0.02}]),
        ),
        needs=("force_shear_x_n", "force_shear_y_n"),
        is_identifiable=lambda h: h.shear_span_n > MIN_SHEAR_SHARE * h.normal_span_n,
        shown_against="shear_force",
    )
)
