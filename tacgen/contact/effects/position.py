"""Position: the gel gives more in one place than in another."""

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
    variant,
)
from tacgen.contact.effects.shapes import finite_extent, with_gain

TERMS: tuple[tuple[str, int, int], ...] = (
    ("x", 1, 0),
    ("y", 0, 1),
    ("xx", 2, 0),
    ("xy", 1, 1),
    ("yy", 0, 2),
    ("xxx", 3, 0),
    ("xxy", 2, 1),
    ("xyy", 1, 2),
    ("yyy", 0, 3),
)


def _apply(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """Gain 1 + a polynomial of up to third degree, and r⁴, in u = x/extent and v = y/extent."""
    u = np.clip(history.column("x_mm") / p["extent_mm"], -1.2, 1.2)
    v = np.clip(history.column("y_mm") / p["extent_mm"], -1.2, 1.2)
    relative = p["rrrr"] * (u**2 + v**2) ** 2 + p["rr"] * (u**2 + v**2)
    for name, i, j in TERMS:
        if p[name] != 0.0:
            relative = relative + p[name] * u**i * v**j
    return with_gain(load, relative)


def _references(history: LoadHistory) -> dict[str, float]:
    extents = [finite_extent(history.column(name)) for name in ("x_mm", "y_mm")]
    return {"extent_mm": max(extents)}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    linear = [{"x": 0.05}, {"y": 0.05}]
    square = [{"xx": 0.05}, {"xy": 0.05}, {"yy": 0.05}]
    cubic = [{"xxx": 0.05}, {"xxy": 0.05}, {"xyy": 0.05}, {"yyy": 0.05}]
    return (
        variant("along x", [{"x": 0.05}]),
        variant("along y", [{"y": 0.05}]),
        variant("plane", linear),
        variant("from the centre out", [{"rr": 0.05}]),
        variant("from the centre out, fourth degree", [{"rr": 0.05}, {"rrrr": 0.05}]),
        variant("second degree", [*linear, *square]),
        variant("third degree", [*linear, *square, *cubic]),
        variant("second degree and r⁴", [*linear, *square, {"rrrr": 0.05}]),
    )


register(
    Effect(
        name="position",
        channel="normal",
        stage="gain",
        about="the compliance depends on where the gel is touched",
        parameters=(
            *(amount(name, -5.0, 5.0) for name, _, _ in TERMS),
            amount("rr", -5.0, 5.0),
            amount("rrrr", -5.0, 5.0),
            reference("extent_mm", "mm"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=("x_mm", "y_mm"),
    )
)
