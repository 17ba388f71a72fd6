"""Creep: the gel goes on yielding while the load stays."""

from functools import partial

import numpy as np

from tacgen.contact.effects import base

FREE_RECOVERING, FREE_HELD = base.free_amounts("recovering", 6), base.free_amounts("held", 6)
TERMS = (("amount", "tau_s"), ("amount_2", "tau_2_s"))
LONGEST_TAU, LONGEST_CARRIED = 5.0, 50.0  # in durations of a trial
LEAST_CARRIED = 0.2  # τ in pauses between trials: of faster ones nothing is left
N_CHAIN, CHAIN_REACH = 16, 100.0  # terms of a power of time, the slowest of so many ``longest_s``


def _apply(
    load: base.FloatArray, history: base.LoadHistory, p: base.Parameters, channel: base.Channel
) -> base.FloatArray:
    """Load plus one or two Prony terms, and corrections.

    A term adds amount·∫(1 − exp(−(t − s)/τ)) dF(s), which recovers as slowly as it grew, from the
    start of the trial, or with ``carried`` 1 from that of the session; with ``recovery`` 0 it adds
    amount·F(t)(1 − exp(−t/τ)), which is gone with the load, t since the trial's load first stood
    above a twentieth of ``span_n``, or with ``since_press`` 1 its normal force above one of
    ``press_span_n``; in between, a share of each. Corrections are
    amounts of each kind for six τ at even ratios from ``shortest_s`` to ``longest_s``. A power of
    time recovers too: a chain of terms that yields power_amount by ``longest_s``.

    Source: Ferry 1980, Viscoelastic Properties of Polymers, ch. 3: the generalised Kelvin chain;
    Cole & Cole 1941, J. Chem. Phys. 9: the spectrum of a power of time that ends at τ.
    """
    recovery = p["recovery"]
    begins: base.Channel = "normal" if p["since_press"] == 1.0 else channel
    span = "press_span_n" if p["since_press"] == 1.0 else "span_n"
    terms = [(p[tau], recovery * p[one], (1.0 - recovery) * p[one]) for one, tau in TERMS]
    free = [
        (p[one.name], p[other.name]) for one, other in zip(FREE_RECOVERING, FREE_HELD, strict=True)
    ]
    if any(map(any, free)):
        taus = np.geomspace(p["shortest_s"], p["longest_s"], len(free))
        terms += [(tau, *amounts) for tau, amounts in zip(taus, free, strict=True)]
    if p["power_amount"] != 0.0:
        terms += _chain(p)
    result = load.copy()
    for tau, recovering, with_load in terms:
        if recovering != 0.0:
            result += recovering * history.low_pass(load, tau)
            if p["carried"] != 0.0:
                result += p["carried"] * recovering * history.left_over(channel, tau)
        if with_load != 0.0:
            grown = -np.expm1(-history.time_since_contact_s(begins, p[span]) / tau)
            result += with_load * load * grown[:, None]
    return result


def _chain(p: base.Parameters) -> list[tuple[float, float, float]]:
    """Terms (τ, amount, 0) of 1 − E(−(t / ends_s)^power), E being Mittag-Leffler's function."""
    taus = np.geomspace(p["shortest_s"], CHAIN_REACH * p["longest_s"], N_CHAIN)
    ratio = (taus / p["ends_s"]) ** p["power"]
    spectrum = 1.0 / (ratio + 1.0 / ratio + 2.0 * np.cos(np.pi * p["power"]))
    yielded = spectrum @ -np.expm1(-p["longest_s"] / taus)
    return [
        (tau, p["power_amount"] * one / yielded, 0.0)
        for tau, one in zip(taus.tolist(), spectrum.tolist(), strict=True)
    ]


def _tau_bounds(
    history: base.LoadHistory, p: base.Parameters, channel: base.Channel
) -> tuple[float, float]:
    """Slower than sampling and faster than some trials: else it is no creep that a log shows.

    What is carried from trial to trial shows over the session.
    """
    longest = LONGEST_CARRIED if p["carried"] == 1.0 else LONGEST_TAU
    fastest_s = history.once(("creep", channel), lambda: _fastest_s(history, channel))
    return fastest_s, longest * history.trial_duration_s


def _fastest_s(history: base.LoadHistory, channel: base.Channel) -> float:
    """Four sampling periods; and but for holds, which may be much longer, 2 % of a trial.

    In a hold, samples may lie dense where the gel creeps fastest: at its start.
    """
    if not history.is_hold(channel):
        return max(4.0 * history.sample_period_s, 0.02 * history.trial_duration_s)
    times = [np.unique(one) for one in np.split(history.time_in_trial_s, history.starts[1:-1])]
    return max(float(np.median([one[:5][-1] for one in times])), 1e-3)


def _amount_bounds(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    """A passive gel yields further under a load, at every τ; terms of both signs are a delay.

    Source: Ferry 1980, ch. 3: no retardation spectrum is negative.
    """
    return 0.0, 10.0


def _references(history: base.LoadHistory, channel: base.Channel) -> dict[str, float]:
    return {
        "shortest_s": history.sample_period_s,
        "longest_s": LONGEST_TAU * history.trial_duration_s,
        "span_n": history.span_n(channel),
        "press_span_n": history.normal_span_n,
    }


def _variants(
    history: base.LoadHistory, references: base.Parameters, channel: base.Channel
) -> tuple[base.Variant, ...]:
    duration = max(history.trial_duration_s, 4 * history.sample_period_s)
    taus = [share * duration for share in (0.04, 0.1, 0.25, 0.6, 1.5)]
    pair = {"tau_s": 0.08 * duration, "tau_2_s": 0.5 * duration}
    if history.is_hold(channel):
        taus = np.geomspace(2.0 * _fastest_s(history, channel), 1.5 * duration, 6).tolist()
        pair = {"tau_s": taus[1], "tau_2_s": taus[4]}
    recovering, held = {"recovery": 1.0}, {"recovery": 0.0}
    kinds = [("recovering", recovering, taus), ("with the load", held, taus)]
    if channel == "shear":
        kinds.append(("with the load, since the press", {**held, "since_press": 1.0}, taus))
    if history.pause_s < LONGEST_TAU * duration:
        slow = [tau for tau in (*taus, 6.0 * duration) if tau > LEAST_CARRIED * history.pause_s]
        kinds.append(("recovering between presses too", {**recovering, "carried": 1.0}, slow))
    single = [
        base.variant(
            f"{kind}, tau {tau:.3g} s",
            [{"amount": 0.05}],
            {"tau_s": tau, **shape},
            fitted=("tau_s",),
        )
        for kind, shape, own in kinds
        for tau in own
    ]
    double = [
        base.variant(
            f"two terms, {kind}",
            [{"amount": 0.05}, {"amount_2": 0.05}],
            {**pair, **shape},
            fitted=("tau_s", "tau_2_s"),
        )
        for kind, shape, _ in kinds
    ]
    endless = CHAIN_REACH * references["longest_s"]
    powers = [
        base.variant(label, [{"power_amount": 0.2}], {"power": 0.3, "ends_s": ends_s}, fitted=free)
        for label, ends_s, free in (
            ("a power of time", endless, ("power",)),
            ("a power of time that ends", duration, ("power", "ends_s")),
        )
    ]
    return (*single, *double, *powers)


for _channel in base.CHANNELS:
    base.register(
        base.Effect(
            name="creep",
            channel=_channel,
            stage="memory",
            about="the gel goes on yielding under a held load",
            parameters=(
                base.amount("amount", -0.9, 10.0, bounds=_amount_bounds),
                base.amount("amount_2", -0.9, 10.0, bounds=_amount_bounds),
                base.shape("tau_s", 1e-3, 1e5, 1.0, "s", partial(_tau_bounds, channel=_channel)),
                base.shape("tau_2_s", 1e-3, 1e5, 10.0, "s", partial(_tau_bounds, channel=_channel)),
                base.shape("recovery", 0.0, 1.0, 1.0),
                base.shape("carried", 0.0, 1.0, 0.0),
                base.shape("since_press", 0.0, 1.0, 0.0),
                base.amount("power_amount", 0.0, 20.0),
                base.shape("power", 0.02, 0.95, 0.3),
                base.shape("ends_s", 1e-3, 1e7, 1.0, "s", partial(_tau_bounds, channel=_channel)),
                *FREE_RECOVERING,
                *FREE_HELD,
                base.reference("shortest_s", "s"),
                base.reference("longest_s", "s"),
                base.reference("span_n", "N"),
                base.reference("press_span_n", "N"),
            ),
            apply=partial(_apply, channel=_channel),
            variants=partial(_variants, channel=_channel),
            references=partial(_references, channel=_channel),
            shown_against="time_in_trial_s",
            separated_by={
                "latency": "hold the load for several seconds: creep goes on, a delay is over",
                "hysteresis": "unload at two speeds: hysteresis does not depend on it",
            },
        )
    )
