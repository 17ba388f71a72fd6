"""Stiffening: the compliance changes with the load, either way."""

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
from tacgen.contact.effects.shapes import power_shape, with_gain


def _apply(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """Compliance 1 + amount·b + curvature·b², b the power shape of |F| / reference.

    Source
    ------
    A finite layer under a ball and a hyperelastic gel both bend V(F) by a power of the load;
    Johnson 1985, Contact Mechanics, §5.8.
    """
    bend = power_shape(np.abs(load[:, 0]) / p["reference_n"], p["exponent"])
    return with_gain(load, p["amount"] * bend + p["curvature"] * bend**2)


def _references(history: LoadHistory) -> dict[str, float]:
    return {"reference_n": history.normal_span_n}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    single = [
        variant(f"power {exponent:g}", [{"amount": 0.05}], {"exponent": exponent})
        for exponent in (-0.2, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0)
    ]
    curved = [
        variant(
            f"power {exponent:g}, curved",
            [{"amount": 0.05}, {"curvature": 0.05}],
            {"exponent": exponent},
            fit_shapes=False,
        )
        for exponent in (0.5, 1.0)
    ]
    return (*single, *curved)


register(
    Effect(
        name="stiffening",
        channel="normal",
        stage="elastic",
        about="the compliance changes with the load",
        parameters=(
            amount("amount", -3.0, 5.0),
            amount("curvature", -5.0, 5.0),
            shape("exponent", -0.4, 5.0, 1.0),
            reference("reference_n", "N"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
    )
)
