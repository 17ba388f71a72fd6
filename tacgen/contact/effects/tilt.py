"""Tilt: a press that meets the gel askew needs another force for the same volume."""

import numpy as np

from tacgen.contact.effects import base

TILT = ("tilt_x", "tilt_y")


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + amount·w + square·w² + x·u + y·v, (u, v) = tilt / reference and w their length."""
    u, v = (history.column(name) / p["reference"] for name in TILT)
    w = np.hypot(u, v)
    relative = w * (p["amount"] + w * p["square"]) + p["x"] * u + p["y"] * v
    return base.with_gain(load, relative)


def _references(history: base.LoadHistory) -> dict[str, float]:
    """The largest finite length of the tilt, in the log's unit; 1 if there is none above 0."""
    length = np.hypot(*(history.column(name) for name in TILT))
    return {"reference": float(length.max(where=np.isfinite(length), initial=0.0)) or 1.0}


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    forms = {
        "whichever way": ("amount",),
        "whichever way, squared": ("square",),
        "along x": ("x",),
        "along y": ("y",),
        "to one side": ("x", "y"),
    }
    return tuple(
        base.variant(label, [{name: 0.05} for name in names]) for label, names in forms.items()
    )


base.register(
    base.Effect(
        name="tilt",
        channel="normal",
        stage="gain",
        is_of_trials=True,
        about="the compliance depends on how far the indenter is tilted against the gel",
        parameters=(
            *(base.amount(name, -5.0, 5.0) for name in ("amount", "square", "x", "y")),
            base.reference("reference", "1"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=TILT,
        is_identifiable=lambda history: any(base.varies(history.column(n)) for n in TILT),
        shown_against="tilt",
        separated_by={"position": "press askew, each way, at one place"},
    )
)
