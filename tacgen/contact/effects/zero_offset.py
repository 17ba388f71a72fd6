"""Zero offset: the force gauge reads a little when nothing touches the gel."""

import numpy as np

from tacgen.contact.effects import base


def _normal(
    load: base.FloatArray, history: base.LoadHistory, p: base.Parameters
) -> base.FloatArray:
    return load + p["force_n"]


def _normal_variants(
    history: base.LoadHistory, references: base.Parameters
) -> tuple[base.Variant, ...]:
    return (base.variant("constant", [{"force_n": 0.01 * history.normal_span_n}]),)


def _shear(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    return load + np.array([p["force_x_n"], p["force_y_n"]])


def _shear_variants(
    history: base.LoadHistory, references: base.Parameters
) -> tuple[base.Variant, ...]:
    small = 0.01 * history.shear_span_n
    return (base.variant("constant", [{"force_x_n": small}, {"force_y_n": small}]),)


base.register(
    base.Effect(
        name="zero_offset",
        channel="normal",
        stage="input",
        about="the force is off by a constant",
        parameters=(base.amount("force_n", -50.0, 50.0, "N"),),
        apply=_normal,
        variants=_normal_variants,
        in_simulation=False,
    )
)
base.register(
    base.Effect(
        name="zero_offset",
        channel="shear",
        stage="input",
        about="the shear force is off by a constant",
        parameters=(
            base.amount("force_x_n", -50.0, 50.0, "N"),
            base.amount("force_y_n", -50.0, 50.0, "N"),
        ),
        apply=_shear,
        variants=_shear_variants,
        in_simulation=False,
    )
)
