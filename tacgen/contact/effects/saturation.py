"""Saturation: there is a volume beyond which the sensor shows no more."""

import numpy as np

from tacgen.contact.effects import base

LIMITS = ((0.8, 20.0), (0.95, 20.0), (1.1, 20.0), (0.8, 6.0), (1.0, 6.0), (1.2, 6.0))
"""Limits, as shares of the span of the volume, and sharpnesses that a fit starts from."""


def _apply(
    volume: base.FloatArray, history: base.LoadHistory, p: base.Parameters
) -> base.FloatArray:
    """V / (1 + |V/limit|^sharpness)^(1/sharpness): the limit itself for a sharp one."""
    if not np.isfinite(p["limit_mm3"]):
        return volume.copy()
    return volume * base.limited(np.abs(volume) / p["limit_mm3"], p["sharpness"])


base.register(
    base.Effect(
        name="saturation",
        channel="normal",
        stage="output",
        about="the volume does not grow beyond a limit",
        parameters=(
            base.amount(
                "limit_mm3", 1e-6, np.inf, "mm3", np.inf, base.share_of("span_mm3", 0.4, 5.0)
            ),
            base.shape("sharpness", 3.0, 300.0, 6.0),
            base.reference("span_mm3", "mm3", of_response=True),
        ),
        apply=_apply,
        # A volume that is held is at no limit, though the force falls there.
        is_identifiable=lambda h: not (h.is_relaxing("normal") and h.is_hold("normal")),
        variants=lambda history, references: tuple(
            base.variant(
                f"limit at {share:g} of the range, sharpness {sharpness:g}",
                [{"limit_mm3": share * references["span_mm3"]}],
                {"sharpness": sharpness},
                scales=False,
            )
            for share, sharpness in LIMITS
        ),
    )
)
