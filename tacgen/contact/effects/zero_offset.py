"""Zero offset: the force gauge reads a little when nothing touches the gel."""

import numpy as np

from tacgen.contact.effects import base

AXES: dict[base.Channel, tuple[str, ...]] = {
    "normal": ("force_n",),
    "shear": ("force_x_n", "force_y_n"),
}

for _channel, _names in AXES.items():
    base.register(
        base.Effect(
            name="zero_offset",
            channel=_channel,
            stage="input",
            about="the force is off by a constant",
            parameters=tuple(base.amount(name, -50.0, 50.0, "N") for name in _names),
            apply=lambda load, history, p, names=_names: load + np.array([p[n] for n in names]),
            variants=lambda history, references, channel=_channel, names=_names: (
                base.variant("constant", [{n: 0.01 * history.span_n(channel)} for n in names]),
            ),
            in_simulation=False,
        )
    )
