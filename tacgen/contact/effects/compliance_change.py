"""Compliance change: a part of the gel, of the session, or an indenter has another compliance."""

from tacgen.contact.effects import base


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + amount: over a whole log it is k itself."""
    return load * (1.0 + p["amount"])


for _channel in base.CHANNELS:
    base.register(
        base.Effect(
            name="compliance_change",
            channel=_channel,
            stage="gain",
            is_local=True,
            about="the compliance differs in a part of the log",
            parameters=(base.amount("amount", -0.9, 5.0),),
            apply=_apply,
            variants=lambda history, references: (base.variant("gain", [{"amount": 0.05}]),),
            separated_by={
                "position": "press more places near the border of the region",
                "drift": "press the same place again and again after the change",
                "geometry": "press with more indenters",
            },
        )
    )
