"""Position: the gel gives more in one place than in another."""

import numpy as np

from tacgen.contact.effects import base

PLACE = ("x_mm", "y_mm")
TERMS = ("x", "y", "xx", "xy", "yy", "xxx", "xxy", "xyy", "yyy")


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + a polynomial of up to third degree, and r⁴, in u = x/extent and v = y/extent."""
    u = np.clip(history.column("x_mm") / p["extent_mm"], -1.2, 1.2)
    v = np.clip(history.column("y_mm") / p["extent_mm"], -1.2, 1.2)
    relative = p["rrrr"] * (u**2 + v**2) ** 2 + p["rr"] * (u**2 + v**2)
    for name in TERMS:
        if p[name] != 0.0:
            relative = relative + p[name] * u ** name.count("x") * v ** name.count("y")
    return base.with_gain(load, relative)


def _references(history: base.LoadHistory) -> dict[str, float]:
    """The largest finite |x| or |y|; 1 for an axis that has none above 0."""
    sizes = (np.abs(history.column(name)) for name in PLACE)
    return {
        "extent_mm": max(
            float(size.max(where=np.isfinite(size), initial=0.0)) or 1.0 for size in sizes
        )
    }


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    forms = {
        "along x": ("x",),
        "along y": ("y",),
        "plane": ("x", "y"),
        "from the centre out": ("rr",),
        "from the centre out, fourth degree": ("rr", "rrrr"),
        "second degree": TERMS[:5],
        "third degree": TERMS,
        "second degree and r⁴": (*TERMS[:5], "rrrr"),
    }
    return tuple(base.variant(k, [{name: 0.05} for name in names]) for k, names in forms.items())


base.register(
    base.Effect(
        name="position",
        channel="normal",
        stage="gain",
        about="the compliance depends on where the gel is touched",
        parameters=(
            *(base.amount(name, -5.0, 5.0) for name in (*TERMS, "rr", "rrrr")),
            base.reference("extent_mm", "mm"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=PLACE,
        is_identifiable=lambda history: any(base.varies(history.column(n)) for n in PLACE),
        shown_against="x_mm",
        separated_by={"geometry": "press every ball at the same places"},
    )
)
