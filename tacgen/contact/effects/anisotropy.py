"""Anisotropy: the gel gives more along one direction, or the gauge is turned to the camera."""

import numpy as np

from tacgen.contact.effects import base


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Load times a symmetric traceless stretch, after a turn by ``rotation_rad``."""
    cos, sin = np.cos(p["rotation_rad"]), np.sin(p["rotation_rad"])
    turn = np.array([[cos, -sin], [sin, cos]])
    stretch = np.array([[1.0 + p["along_x"], p["diagonal"]], [p["diagonal"], 1.0 - p["along_x"]]])
    return np.asarray(load @ (stretch @ turn).T)


base.register(
    base.Effect(
        name="anisotropy",
        channel="shear",
        stage="gain",
        about="the shear compliance depends on the direction",
        parameters=(
            base.amount("along_x", -0.9, 0.9),
            base.amount("diagonal", -0.9, 0.9),
            base.amount("rotation_rad", -np.pi, np.pi, "rad"),
        ),
        apply=_apply,
        variants=lambda history, references: (
            base.variant("along the axes", [{"along_x": 0.05}]),
            base.variant("along any direction", [{"along_x": 0.05}, {"diagonal": 0.05}]),
            base.variant("turned", [{"rotation_rad": 0.02}]),
            base.variant(
                "turned, any direction",
                [{"along_x": 0.05}, {"diagonal": 0.05}, {"rotation_rad": 0.02}],
            ),
        ),
        shown_against="shear_direction",
    )
)
