"""Zero offset: the force gauge reads a little when nothing touches the gel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects.history import LoadHistory
from tacgen.contact.effects.registry import (
    Effect,
    Parameters,
    Variant,
    amount,
    no_references,
    register,
    variant,
)


def _normal(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    return load + p["force_n"]


def _normal_variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    return (variant("constant", [{"force_n": 0.01 * history.normal_span_n}]),)


def _shear(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    return load + np.array([p["force_x_n"], p["force_y_n"]])


def _shear_variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    small = 0.01 * history.shear_span_n
    return (variant("constant", [{"force_x_n": small}, {"force_y_n": small}]),)


register(
    Effect(
        name="zero_offset",
        channel="normal",
        stage="input",
        about="the force is off by a constant",
        parameters=(amount("force_n", -50.0, 50.0, "N"),),
        apply=_normal,
        references=no_references,
        variants=_normal_variants,
        in_simulation=False,
    )
)
register(
    Effect(
        name="zero_offset",
        channel="shear",
        stage="input",
        about="the shear force is off by a constant",
        parameters=(
            amount("force_x_n", -50.0, 50.0, "N"),
            amount("force_y_n", -50.0, 50.0, "N"),
        ),
        apply=_shear,
        references=no_references,
        variants=_shear_variants,
        in_simulation=False,
    )
)
