"""Hysteresis: at the same load the gel is deformed otherwise on the way back, however slow."""

from functools import partial

import numpy as np

from tacgen.contact.effects import base, kernels

SPREAD = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Widths of the Prandtl-Ishlinskii operator's plays, as shares of its largest."""
PLAY_WIDTHS = (0.02, 0.05, 0.1, 0.18, 0.3, 0.5, 0.8)
"""Half-widths of the plays that correct a form, as shares of the log's span."""
PLAYS = base.free_amounts("play", len(PLAY_WIDTHS))
KEPT = base.Curve("kept", (0.0, 0.2, 0.4, 0.6, 0.8, 1.0))
RETURN = base.Curve("return", (0.0, 0.2, 0.4, 0.6, 0.8))
"""Of the share of the peak that is gone: what a correction adds there, as a share of the peak; of
the trial's peak so far, and of the peak since contact, which a gel that is let go forgets."""
FREE = (*KEPT.parameters, *RETURN.parameters)
MIN_UNLOADING_SHARE = 0.02  # rows of unloading that a log must have for a way back to show


def _apply(
    load: base.FloatArray, history: base.LoadHistory, p: base.Parameters, channel: base.Channel
) -> base.FloatArray:
    """Load plus what the way back adds.

    With P the load at its peak so far: ``residual``·(P − F) at any time, ``loop``·F(1 − |F|/|P|)
    and ``jump``·F while unloading; ``play``·(F − play operator of width ``width_n``) and
    ``friction``·(Dahl friction of that width) turn round with the direction, and ``spread`` is
    the play with widths spread evenly up to ``width_n``. Corrections are plays with an
    amount each, and P times a curve of 1 − F/P: of what a gel keeps of its peak load.

    Source: Visintin 1994, Differential Models of Hysteresis, ch. III: play, Prandtl-Ishlinskii.
    """
    peak_row, unloading = history.reversal(channel)
    peak = load[peak_row]
    below = _below(load, peak)
    result = load + p["residual"] * (peak - load) * below
    back = unloading[:, None] * load
    if p["loop"] != 0.0:
        size = np.linalg.norm(peak, axis=1) + 1e-9
        share = np.clip(np.linalg.norm(load, axis=1) / size, 0.0, 1.0)
        result = result + p["loop"] * back * (1.0 - share)[:, None]
    if p["jump"] != 0.0:
        result = result + p["jump"] * back
    if any(p[one.name] != 0.0 for one in FREE):
        for curve, top in (KEPT, peak), (RETURN, load[history.peak_since_contact(channel)]):
            gone = 1.0 - (load * top).sum(axis=1) / ((top**2).sum(axis=1) + 1e-18)
            result = result + curve(gone, p)[:, None] * top * _below(load, top)
    for axis in range(load.shape[1]):
        values = np.ascontiguousarray(load[:, axis])
        for width_n, size in (
            (p["width_n"], p["play"]),
            *((one * p["width_n"], p["spread"] / len(SPREAD)) for one in SPREAD),
            *((w * p["span_n"], p[one.name]) for w, one in zip(PLAY_WIDTHS, PLAYS, strict=True)),
        ):
            if size != 0.0:
                lagging = kernels.play(values, history.starts, width_n)
                result[:, axis] += size * (values - lagging)
        if p["friction"] != 0.0:
            smooth = history.smooth(values)
            rubbing = kernels.dahl(smooth, history.starts, p["width_n"])
            result[:, axis] += p["friction"] * rubbing
    return result


def _below(load: base.FloatArray, peak: base.FloatArray) -> base.FloatArray:
    """0 at the peak, where noise alone separates the two, rising to 1 a little below it."""
    size = np.linalg.norm(peak, axis=1, keepdims=True) + 1e-9
    gap = np.linalg.norm(peak - load, axis=1, keepdims=True) / size
    return np.asarray(np.clip(gap / 0.05, 0.0, 1.0))


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    widths = {
        ("play", "play of {:g} of the load"): (0.05, 0.2),
        ("spread", "plays up to {:g} of the load"): (0.3, 0.6, 1.0),
        ("friction", "friction over {:g} of the load"): (0.04, 0.1, 0.25),
    }
    return (
        base.variant("residual", [{"residual": 0.05}]),
        base.variant("loop", [{"loop": 0.05}]),
        base.variant("jump", [{"jump": 0.05}]),
        base.variant("residual and loop", [{"residual": 0.05}, {"loop": 0.05}]),
        base.variant("loop and jump", [{"loop": 0.05}, {"jump": 0.05}]),
        *(
            base.variant(label.format(one), [{name: 0.05}], {"width_n": one * references["span_n"]})
            for (name, label), shares in widths.items()
            for one in shares
        ),
    )


def _register(channel: base.Channel) -> None:
    base.register(
        base.Effect(
            name="hysteresis",
            channel=channel,
            stage="memory",
            about="the way back differs from the way in",
            parameters=(
                base.amount("residual", -1.0, 3.0),
                base.amount("loop", -1.0, 3.0),
                base.amount("jump", -1.0, 3.0),
                base.amount("play", -3.0, 3.0),
                base.amount("spread", -3.0, 3.0),
                base.amount("friction", -3.0, 3.0),
                *PLAYS,
                *FREE,
                base.shape("width_n", 1e-4, 1e3, 1.0, "N", base.share_of("span_n", 0.01, 1.2)),
                base.reference("span_n", "N"),
            ),
            apply=partial(_apply, channel=channel),
            references=lambda history: {"span_n": history.span_n(channel)},
            variants=_variants,
            is_identifiable=lambda history: bool(
                history.reversal(channel)[1].mean() > MIN_UNLOADING_SHARE
            ),
        )
    )


for _channel in base.CHANNELS:
    _register(_channel)
