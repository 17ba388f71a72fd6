"""Geometry: the compliance depends on the indenter, against the claim of V = k F."""

import numpy as np

from tacgen.contact.effects import base

MOST_INDENTERS = 12  # each with a compliance of its own


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + amount·b + curvature·b², b the power shape of radius / reference.

    An indenter without a radius, or each, has its own ``gain_<indenter>`` instead.
    """
    radius = _radius(history)
    bend = np.nan_to_num(base.power_shape(radius / p["reference_mm"], p["exponent"]), nan=0.0)
    relative = p["amount"] * bend + p["curvature"] * bend**2
    for name, value in p.items():
        if name.startswith("gain_") and history.has("indenter"):
            relative = np.where(history.is_text("indenter", name[5:]), value, relative)
    return base.with_gain(load, relative)


def _radius(history: base.LoadHistory) -> base.FloatArray:
    known = history.has("radius_mm")
    return history.column("radius_mm") if known else np.full(history.n_samples, np.nan)


def _references(history: base.LoadHistory) -> dict[str, float]:
    radius = _radius(history)
    known = radius[np.isfinite(radius) & (radius > 0)]
    return {"reference_mm": float(np.exp(np.log(known).mean())) if known.size else 1.0}


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    radius = _radius(history)
    sizes = np.unique(radius[np.isfinite(radius)]).size
    names, own = list[str](), list[dict[str, float]]()
    if history.has("indenter"):
        text = history.text("indenter")
        names = np.unique(text).tolist()
        own = [{f"gain_{name}": 0.05} for name in np.unique(text[~np.isfinite(radius)])]
    if sizes < 2:
        own = own if sizes else own[1:]
        return (base.variant("by indenter", own),) if own else ()
    amount = {"amount": 0.05}
    forms = [(f"power {e:g}", [amount, *own], e) for e in (-1.0, 0.0, 1.0)]
    if sizes >= 3:
        forms.append(("curved", [amount, {"curvature": 0.05}, *own], 0.0))
    if 3 < len(names) <= MOST_INDENTERS:
        forms.append(("by indenter", [{f"gain_{name}": 0.05} for name in names[1:]], 0.0))
    return tuple(
        base.variant(name, probes, {"exponent": e}, fitted=()) for name, probes, e in forms
    )


base.register(
    base.Effect(
        name="geometry",
        channel="normal",
        stage="gain",
        is_of_trials=True,
        about="the compliance depends on the indenter's size",
        parameters=(
            base.amount("amount", -3.0, 5.0),
            base.amount("curvature", -5.0, 5.0),
            base.shape("exponent", -2.0, 3.0, 1.0),
            base.reference("reference_mm", "mm"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        per_indenter=True,
        shown_against="radius_mm",
        separated_by={"saturation": "press every ball with the same range of forces"},
    )
)
