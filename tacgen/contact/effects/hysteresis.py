"""Hysteresis: at the same load the gel is deformed otherwise on the way back, however slow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects import kernels
from tacgen.contact.effects.history import LoadHistory
from tacgen.contact.effects.registry import (
    Channel,
    Effect,
    Parameters,
    Variant,
    amount,
    reference,
    register,
    shape,
    variant,
)

SPREAD = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Widths of the Prandtl-Ishlinskii operator's plays, as shares of its largest."""


def _apply(
    load: NDArray[np.float64], history: LoadHistory, p: Parameters, channel: Channel
) -> NDArray[np.float64]:
    """Load plus what the way back adds.

    With P the load at its peak so far: ``residual``·(P − F) at any time, ``loop``·F(1 − |F|/|P|)
    and ``jump``·F while unloading; ``play``·(F − play operator of width ``width_n``) and
    ``friction``·(Dahl friction of that width) turn round with the direction, and ``spread`` is
    the play with widths spread evenly up to ``width_n``.

    Source
    ------
    Visintin 1994, Differential Models of Hysteresis, ch. III: play, Prandtl-Ishlinskii.
    """
    peak_row, unloading = history.reversal(channel)
    peak = load[peak_row]
    result = load + p["residual"] * (peak - load) * _below(load, peak)
    back = unloading[:, None] * load
    if p["loop"] != 0.0:
        size = np.linalg.norm(peak, axis=1) + 1e-9
        share = np.clip(np.linalg.norm(load, axis=1) / size, 0.0, 1.0)
        result = result + p["loop"] * back * (1.0 - share)[:, None]
    if p["jump"] != 0.0:
        result = result + p["jump"] * back
    for axis in range(load.shape[1]):
        values = np.ascontiguousarray(load[:, axis])
        if p["play"] != 0.0:
            lagging = kernels.play(values, history.starts, p["width_n"])
            result[:, axis] += p["play"] * (values - lagging)
        if p["spread"] != 0.0:
            for share in SPREAD:
                lagging = kernels.play(values, history.starts, share * p["width_n"])
                result[:, axis] += p["spread"] / len(SPREAD) * (values - lagging)
        if p["friction"] != 0.0:
            smooth = kernels.moving_mean(values, history.starts, 2)
            rubbing = kernels.dahl(smooth, history.starts, p["width_n"])
            result[:, axis] += p["friction"] * rubbing
    return result


def _below(load: NDArray[np.float64], peak: NDArray[np.float64]) -> NDArray[np.float64]:
    """0 at the peak, where noise alone separates the two, rising to 1 a little below it."""
    size = np.linalg.norm(peak, axis=1, keepdims=True) + 1e-9
    gap = np.linalg.norm(peak - load, axis=1, keepdims=True) / size
    return np.clip(gap / 0.05, 0.0, 1.0)


def _apply_normal(
    load: NDArray[np.float64], history: LoadHistory, p: Parameters
) -> NDArray[np.float64]:
    return _apply(load, history, p, "normal")


def _apply_shear(
    load: NDArray[np.float64], history: LoadHistory, p: Parameters
) -> NDArray[np.float64]:
    return _apply(load, history, p, "shear")


def _variants(span_n: float) -> tuple[Variant, ...]:
    plays = [
        variant(f"play of {share:g} of the load", [{"play": 0.05}], {"width_n": share * span_n})
        for share in (0.05, 0.2)
    ]
    plays += [
        variant(
            f"plays up to {share:g} of the load", [{"spread": 0.05}], {"width_n": share * span_n}
        )
        for share in (0.3, 0.6, 1.0)
    ]
    frictions = [
        variant(
            f"friction over {share:g} of the load",
            [{"friction": 0.05}],
            {"width_n": share * span_n},
        )
        for share in (0.04, 0.1, 0.25)
    ]
    return (
        variant("residual", [{"residual": 0.05}]),
        variant("loop", [{"loop": 0.05}]),
        variant("jump", [{"jump": 0.05}]),
        variant("residual and loop", [{"residual": 0.05}, {"loop": 0.05}]),
        variant("loop and jump", [{"loop": 0.05}, {"jump": 0.05}]),
        *plays,
        *frictions,
    )


def _normal_variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    return _variants(history.normal_span_n)


def _shear_variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    return _variants(history.shear_span_n)


def _normal_references(history: LoadHistory) -> dict[str, float]:
    return {"span_n": history.normal_span_n}


def _shear_references(history: LoadHistory) -> dict[str, float]:
    return {"span_n": history.shear_span_n}


_PARAMETERS = (
    amount("residual", -1.0, 3.0),
    amount("loop", -1.0, 3.0),
    amount("jump", -1.0, 3.0),
    amount("play", -3.0, 3.0),
    amount("spread", -3.0, 3.0),
    amount("friction", -3.0, 3.0),
    shape("width_n", 1e-4, 1e3, 1.0, "N"),
    reference("span_n", "N"),
)

register(
    Effect(
        name="hysteresis",
        channel="normal",
        stage="memory",
        about="the way back differs from the way in",
        parameters=_PARAMETERS,
        apply=_apply_normal,
        references=_normal_references,
        variants=_normal_variants,
    )
)
register(
    Effect(
        name="hysteresis",
        channel="shear",
        stage="memory",
        about="the way back differs from the way in",
        parameters=_PARAMETERS,
        apply=_apply_shear,
        references=_shear_references,
        variants=_shear_variants,
    )
)
