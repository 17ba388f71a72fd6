"""Zero offset: the gauge, or the gel's picture, reads a little when nothing touches the gel."""

import numpy as np

from tacgen.contact.effects import base


def _register(
    channel: base.Channel, forces: tuple[str, ...], responses: tuple[str, ...], unit: str
) -> None:
    base.register(
        base.Effect(
            name="zero_offset",
            channel=channel,
            stage="input",
            about="the force is off by a constant, or what is measured of the gel",
            parameters=(
                *(base.amount(name, -50.0, 50.0, "N") for name in forces),
                # Without further effects the same as a force; beside slip or saturation not.
                *(base.amount(name, -10.0, 10.0, unit) for name in responses),
            ),
            apply=lambda load, history, p: load + np.array([p[name] for name in forces]),
            apply_at_end=lambda response, history, p: (
                response + np.array([p[name] for name in responses])
            ),
            variants=lambda history, references: (
                base.variant("constant", [{n: 0.01 * history.span_n(channel)} for n in forces]),
                base.variant(
                    "of the gel's picture too",
                    [{n: 0.01} for n in responses],
                    dict.fromkeys(forces, 0.0),
                ),
            ),
            in_simulation=False,
        )
    )


_register("normal", ("force_n",), ("volume_mm3",), "mm3")
_register("shear", ("force_x_n", "force_y_n"), ("motion_x_mm", "motion_y_mm"), "mm")
