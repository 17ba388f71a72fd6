"""Zero offset: the force gauge reads a little when nothing touches the gel."""

import numpy as np

from tacgen.contact.effects import base


def _register(channel: base.Channel, names: tuple[str, ...]) -> None:
    base.register(
        base.Effect(
            name="zero_offset",
            channel=channel,
            stage="input",
            about="the force is off by a constant",
            parameters=tuple(base.amount(name, -50.0, 50.0, "N") for name in names),
            apply=lambda load, history, p: load + np.array([p[name] for name in names]),
            variants=lambda history, references: (
                base.variant("constant", [{n: 0.01 * history.span_n(channel)} for n in names]),
            ),
            in_simulation=False,
        )
    )


_register("normal", ("force_n",))
_register("shear", ("force_x_n", "force_y_n"))
