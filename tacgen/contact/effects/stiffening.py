"""Stiffening: the compliance changes with the load, either way."""

import numpy as np

from tacgen.contact.effects import base

CURVE = base.Curve("curve", (0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0))


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Compliance 1 + amount·b + curvature·b², b the power shape of |F| / reference.

    Source: A finite layer under a ball and a hyperelastic gel both bend V(F) by a power of the
    load; Johnson 1985, Contact Mechanics, §5.8.
    """
    bend = base.power_shape(np.abs(load[:, 0]) / p["reference_n"], p["exponent"])
    relative = p["amount"] * bend + p["curvature"] * bend**2
    return base.with_gain(load, relative + CURVE(np.abs(load[:, 0]) / p["reference_n"], p))


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    amount, curvature = {"amount": 0.05}, {"curvature": 0.05}
    single = [
        base.variant(f"power {exponent:g}", [amount], {"exponent": exponent})
        for exponent in (-0.2, 0.6, 1.5, 3.0)
    ]
    curved = [
        base.variant(f"power {e:g}, curved", [amount, curvature], {"exponent": e}, fitted=())
        for e in (0.5, 1.0)
    ]
    return (*single, *curved)


base.register(
    base.Effect(
        name="stiffening",
        channel="normal",
        stage="elastic",
        about="the compliance changes with the load",
        parameters=(
            base.amount("amount", -3.0, 5.0),
            base.amount("curvature", -5.0, 5.0),
            *CURVE.parameters,
            base.shape("exponent", -0.4, 3.0, 1.0),
            base.reference("reference_n", "N"),
        ),
        apply=_apply,
        references=lambda history: {"reference_n": history.normal_span_n},
        variants=_variants,
        separated_by={
            "saturation": "press harder: a limit stays, stiffening goes on",
            "zero_offset": "record some seconds without contact",
            "geometry": "press every ball with the same range of forces",
        },
    )
)
