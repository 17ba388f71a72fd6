"""Normal coupling: the shear compliance changes with the normal load."""

import numpy as np

from tacgen.contact.effects import base

CURVE = base.Curve("curve", (0.05, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0))


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Compliance 1 + amount·b, b the power shape of F_n / reference.

    Source: Mindlin 1949: tangential compliance goes as 1/contact radius, hence as F_n^(−1/3) for a
    ball.
    """
    ratio = np.maximum(history.normal_smooth_n, 0.05 * p["reference_n"]) / p["reference_n"]
    bend = base.power_shape(ratio, p["exponent"])
    return base.with_gain(load, p["amount"] * bend + CURVE(ratio, p))


base.register(
    base.Effect(
        name="normal_coupling",
        channel="shear",
        stage="gain",
        about="the shear compliance changes with the normal load",
        parameters=(
            base.amount("amount", -3.0, 5.0),
            base.shape("exponent", -2.0, 4.0, 1.0),
            *CURVE.parameters,
            base.reference("reference_n", "N"),
        ),
        apply=_apply,
        references=lambda history: {"reference_n": history.normal_span_n},
        variants=lambda history, references: tuple(
            base.variant(f"power {exponent:g}", [{"amount": 0.05}], {"exponent": exponent})
            for exponent in (-1.0, -0.33, 0.3, 1.0, 2.0)
        ),
        shown_against="force_normal_n",
    )
)
