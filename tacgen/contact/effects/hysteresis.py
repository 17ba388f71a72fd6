"""Hysteresis: at the same load the gel is deformed otherwise on the way back, however slow."""

from functools import partial

import numpy as np

from tacgen.contact.effects import base

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


def _apply(
    load: base.FloatArray, history: base.LoadHistory, p: base.Parameters, channel: base.Channel
) -> base.FloatArray:
    """Load plus what the way back adds.

    With P the load at its peak so far: ``residual``·(P − F) at any time, ``loop``·F(1 − |F|/|P|)
    and ``jump``·F while unloading. With the direction turn round ``play``·(F − play operator of
    width ``width_n``), ``spread``, the same with widths spread evenly up to ``width_n``,
    ``friction``·(Dahl friction of that width), and ``rubbing``, the same in proportion to |F|:
    of each axis or, where ``isotropic`` is 1, of the vector. Corrections are plays with an
    amount each, and P times a curve of 1 − F/P: of what a gel keeps of its peak load.

    Source: Visintin 1994, Differential Models of Hysteresis, ch. III: play, Prandtl-Ishlinskii.
    """
    isotropic = p["isotropic"] == 1.0
    peak, unloading = history.peak_load(load, channel, p["span_n"])
    result = load.copy()
    if p["residual"] != 0.0:
        result += p["residual"] * (peak - load) * _below(load, peak)
    if p["loop"] != 0.0:
        share = np.clip(_size(load) / (_size(peak) + 1e-9), 0.0, 1.0)
        result += (p["loop"] * unloading * (1.0 - share))[:, None] * load
    if p["jump"] != 0.0:
        result += (p["jump"] * unloading)[:, None] * load
    if any(p[one.name] != 0.0 for one in FREE):
        since_contact = history.peak_since_contact(load, channel, p["span_n"])
        for curve, top in (KEPT, peak), (RETURN, since_contact):
            gone = 1.0 - _dot(load, top) / (_dot(top, top) + 1e-18)
            result += curve(gone, p)[:, None] * top * _below(load, top)
    for width_n, size in (
        (p["width_n"], p["play"]),
        *((one * p["width_n"], p["spread"] / len(SPREAD)) for one in SPREAD),
        *((w * p["span_n"], p[one.name]) for w, one in zip(PLAY_WIDTHS, PLAYS, strict=True)),
    ):
        if size != 0.0:
            result += size * (load - history.play(load, width_n, isotropic))
    if p["friction"] != 0.0 or p["rubbing"] != 0.0:
        friction_n = history.dahl(load, p["width_n"], isotropic)
        share = p["friction"] + p["rubbing"] * _size(load)[:, None] / p["width_n"]
        result += share * friction_n
    return result


def _dot(a: base.FloatArray, b: base.FloatArray) -> base.FloatArray:
    """Scalar products (N,) of vectors (N, C): several times as fast as a sum along short rows."""
    return np.asarray(np.einsum("nc,nc->n", a, b))


def _size(vectors: base.FloatArray) -> base.FloatArray:
    return np.asarray(np.sqrt(_dot(vectors, vectors)))


def _below(load: base.FloatArray, peak: base.FloatArray) -> base.FloatArray:
    """0 (N, 1) at the peak, where noise alone separates the two, to 1 a little below it."""
    gap = _size(peak - load) / (_size(peak) + 1e-9)
    return np.clip(gap / 0.05, 0.0, 1.0)[:, None]


def _more_on_the_way_back(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    """A passive gel gives back no more work than it took: its volume follows the load.

    One that is ahead of the load is read at another time: a latency.
    Source: Krasnosel'skii & Pokrovskii 1989, Systems with Hysteresis: loops that dissipate.
    """
    return 0.0, np.inf


def _less_on_the_way_in(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    """The same of what is taken from the way in."""
    return -np.inf, 0.0


def _variants(
    history: base.LoadHistory, references: base.Parameters, channel: base.Channel
) -> tuple[base.Variant, ...]:
    widths = {
        ("play", "play of {:g} of the load"): (0.05, 0.2),
        ("spread", "sum of plays, up to {:g} of the load wide"): (0.3, 0.6, 1.0),
        ("friction", "friction over {:g} of the load"): (0.04, 0.1, 0.25),
        ("rubbing", "friction in proportion to the load, over {:g} of it"): (0.1, 0.25),
    }
    # Of a vector there are two kinds; along one axis they are the same.
    kinds = {"": 0.0, ", in any direction": 1.0} if channel == "shear" else {"": 0.0}
    return (
        base.variant("residual", [{"residual": 0.05}]),
        base.variant("loop", [{"loop": 0.05}]),
        base.variant("jump", [{"jump": 0.05}]),
        base.variant("residual and loop", [{"residual": 0.05}, {"loop": 0.05}]),
        base.variant("loop and jump", [{"loop": 0.05}, {"jump": 0.05}]),
        *(
            base.variant(
                label.format(one) + kind,
                [{name: 0.05}],
                {"width_n": one * references["span_n"], "isotropic": isotropic},
                fitted=("width_n",),
            )
            for (name, label), shares in widths.items()
            for one in shares
            for kind, isotropic in kinds.items()
        ),
    )


def _register(channel: base.Channel) -> None:
    # Shear has no latency: there a motion ahead of the force has no other name.
    is_bounded = channel == "normal"
    more_on_the_way_back = _more_on_the_way_back if is_bounded else None
    less_on_the_way_in = _less_on_the_way_in if is_bounded else None
    base.register(
        base.Effect(
            name="hysteresis",
            channel=channel,
            stage="memory",
            about="the way back differs from the way in",
            parameters=(
                base.amount("residual", -1.0, 3.0, bounds=more_on_the_way_back),
                base.amount("loop", -1.0, 3.0, bounds=more_on_the_way_back),
                base.amount("jump", -1.0, 3.0, bounds=more_on_the_way_back),
                base.amount("play", -3.0, 3.0, bounds=less_on_the_way_in),
                base.amount("spread", -3.0, 3.0, bounds=less_on_the_way_in),
                base.amount("friction", -3.0, 3.0, bounds=less_on_the_way_in),
                base.amount("rubbing", -1.0, 1.0, bounds=less_on_the_way_in),
                *PLAYS,
                *FREE,
                base.shape("width_n", 1e-4, 1e3, 1.0, "N", base.share_of("span_n", 0.01, 1.2)),
                base.shape("isotropic", 0.0, 1.0, 0.0),
                base.reference("span_n", "N"),
            ),
            apply=partial(_apply, channel=channel),
            references=lambda history: {"span_n": history.span_n(channel)},
            variants=partial(_variants, channel=channel),
            is_identifiable=lambda history: history.is_unloaded(channel),
        )
    )


for _channel in base.CHANNELS:
    _register(_channel)
