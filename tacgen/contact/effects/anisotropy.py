"""Anisotropy: the gel gives more along one direction, or the gauge is turned to the camera."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects.history import LoadHistory
from tacgen.contact.effects.registry import (
    Effect,
    Parameters,
    Variant,
    amount,
    no_references,
    register,
    variant,
)


def _apply(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """Load times a symmetric traceless stretch, after a turn by ``rotation_rad``."""
    cos, sin = np.cos(p["rotation_rad"]), np.sin(p["rotation_rad"])
    turn = np.array([[cos, -sin], [sin, cos]])
    stretch = np.array([[1.0 + p["along_x"], p["diagonal"]], [p["diagonal"], 1.0 - p["along_x"]]])
    return load @ (stretch @ turn).T


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    return (
        variant("along the axes", [{"along_x": 0.05}]),
        variant("along any direction", [{"along_x": 0.05}, {"diagonal": 0.05}]),
        variant("turned", [{"rotation_rad": 0.02}]),
        variant(
            "turned, any direction", [{"along_x": 0.05}, {"diagonal": 0.05}, {"rotation_rad": 0.02}]
        ),
    )


register(
    Effect(
        name="anisotropy",
        channel="shear",
        stage="gain",
        about="the shear compliance depends on the direction",
        parameters=(
            amount("along_x", -0.9, 0.9),
            amount("diagonal", -0.9, 0.9),
            amount("rotation_rad", -np.pi, np.pi, "rad"),
        ),
        apply=_apply,
        references=no_references,
        variants=_variants,
    )
)
