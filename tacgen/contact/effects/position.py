"""Position: the gel gives more in one place than in another."""

import numpy as np

from tacgen.contact.effects import base

PLACE = ("x_mm", "y_mm")
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


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + a polynomial of up to third degree, and r⁴, in u = x/extent and v = y/extent."""
    u = np.clip(history.column("x_mm") / p["extent_mm"], -1.2, 1.2)
    v = np.clip(history.column("y_mm") / p["extent_mm"], -1.2, 1.2)
    relative = p["rrrr"] * (u**2 + v**2) ** 2 + p["rr"] * (u**2 + v**2)
    for name, i, j in TERMS:
        if p[name] != 0.0:
            relative = relative + p[name] * u**i * v**j
    return base.with_gain(load, relative)


def _references(history: base.LoadHistory) -> dict[str, float]:
    extents = [_extent_mm(history.column(name)) for name in PLACE]
    return {"extent_mm": max(extents)}


def _extent_mm(values: base.FloatArray) -> float:
    """Largest finite |value|; 1 where there is none above 0."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max()) if finite.size and finite.max() > 0 else 1.0


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    linear = [{"x": 0.05}, {"y": 0.05}]
    square = [{"xx": 0.05}, {"xy": 0.05}, {"yy": 0.05}]
    cubic = [{"xxx": 0.05}, {"xxy": 0.05}, {"xyy": 0.05}, {"yyy": 0.05}]
    return (
        base.variant("along x", [{"x": 0.05}]),
        base.variant("along y", [{"y": 0.05}]),
        base.variant("plane", linear),
        base.variant("from the centre out", [{"rr": 0.05}]),
        base.variant("from the centre out, fourth degree", [{"rr": 0.05}, {"rrrr": 0.05}]),
        base.variant("second degree", [*linear, *square]),
        base.variant("third degree", [*linear, *square, *cubic]),
        base.variant("second degree and r⁴", [*linear, *square, {"rrrr": 0.05}]),
    )


base.register(
    base.Effect(
        name="position",
        channel="normal",
        stage="gain",
        about="the compliance depends on where the gel is touched",
        parameters=(
            *(base.amount(name, -5.0, 5.0) for name, _, _ in TERMS),
            base.amount("rr", -5.0, 5.0),
            base.amount("rrrr", -5.0, 5.0),
            base.reference("extent_mm", "mm"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=PLACE,
        kind="between trials",
        is_identifiable=lambda history: any(base.varies(history.column(n)) for n in PLACE),
        shown_against="x_mm",
        separated_by={"geometry": "press every ball at the same places"},
    )
)
