"""Geometry: the compliance depends on the indenter, against the claim of V = k F."""

import numpy as np

from tacgen.contact.effects import base


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + amount·b + curvature·b², b the power shape of radius / reference.

    An indenter without a radius has its own ``gain_<indenter>`` instead.
    """
    radius = _radius(history)
    bend = np.nan_to_num(base.power_shape(radius / p["reference_mm"], p["exponent"]), nan=0.0)
    relative = p["amount"] * bend + p["curvature"] * bend**2
    gains = {name[5:]: value for name, value in p.items() if name.startswith("gain_")}
    if gains and history.has("indenter"):
        indenter = history.text("indenter")
        for name, value in gains.items():
            relative = np.where(indenter == name, value, relative)
    return base.with_gain(load, relative)


def _radius(history: base.LoadHistory) -> base.FloatArray:
    if history.has("radius_mm"):
        return history.column("radius_mm")
    return np.full(history.n_samples, np.nan)


def _references(history: base.LoadHistory) -> dict[str, float]:
    radius = _radius(history)
    known = radius[np.isfinite(radius) & (radius > 0)]
    return {"reference_mm": float(np.exp(np.log(known).mean())) if known.size else 1.0}


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    radius = _radius(history)
    sizes = np.unique(radius[np.isfinite(radius)])
    variants: list[base.Variant] = []
    own = [{f"gain_{name}": 0.05} for name in _indenters_without_radius(history, radius)]
    if own and not sizes.size:
        own = own[1:]
    if sizes.size >= 2:
        variants += [
            base.variant(
                f"power {e:g}", [{"amount": 0.05}, *own], {"exponent": e}, fit_shapes=False
            )
            for e in (-1.0, 0.0, 1.0)
        ]
    if sizes.size >= 3:
        variants.append(
            base.variant(
                "curved",
                [{"amount": 0.05}, {"curvature": 0.05}, *own],
                {"exponent": 0.0},
                fit_shapes=False,
            )
        )
    if own and sizes.size < 2:
        variants.append(base.variant("by indenter", own))
    return tuple(variants)


def _indenters_without_radius(
    history: base.LoadHistory, radius: base.FloatArray
) -> tuple[str, ...]:
    if not history.has("indenter"):
        return ()
    return tuple(np.unique(history.text("indenter")[~np.isfinite(radius)]))


base.register(
    base.Effect(
        name="geometry",
        channel="normal",
        stage="gain",
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
        kind="between trials",
        per_indenter=True,
        shown_against="radius_mm",
        separated_by={"saturation": "press every ball with the same range of forces"},
    )
)
