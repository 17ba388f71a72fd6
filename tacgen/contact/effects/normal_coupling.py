"""Normal coupling: the shear compliance changes with the normal load."""

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
    """Compliance 1 + amount·b, b the power shape of F_n / reference.

    Source
    ------
    Mindlin 1949: tangential compliance goes as 1/contact radius, hence as F_n^(−1/3) for a ball.
    """
    ratio = np.maximum(history.normal_smooth_n, 0.05 * p["reference_n"]) / p["reference_n"]
    return with_gain(load, p["amount"] * power_shape(ratio, p["exponent"]))


def _references(history: LoadHistory) -> dict[str, float]:
    return {"reference_n": history.normal_span_n}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    return tuple(
        variant(f"power {exponent:g}", [{"amount": 0.05}], {"exponent": exponent})
        for exponent in (-1.0, -0.33, 0.3, 1.0, 2.0)
    )


register(
    Effect(
        name="normal_coupling",
        channel="shear",
        stage="elastic",
        about="the shear compliance changes with the normal load",
        parameters=(
            amount("amount", -3.0, 5.0),
            shape("exponent", -2.0, 4.0, 1.0),
            reference("reference_n", "N"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=("force_normal_n",),
    )
)
