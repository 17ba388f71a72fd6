"""Latency: the camera's clock and the gauge's are apart, or one of them lags."""

import numpy as np

from tacgen.contact.effects import base, kernels

STEPS = (-2, -1, 1, 2, 3, 4)
"""Delays of the load that correct a form, in samples of the log."""
ECHOES = base.free_amounts("echo", len(STEPS))


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """F(t − delay), then a first-order lag, or samples that software smooths.

    Corrections are shares of the load so many samples before or after, in the place of as much of
    the load itself: together any short response to an impulse.
    """
    times, starts = history.time_s, history.starts
    values = np.ascontiguousarray(load[:, 0])
    if p["delay_s"] != 0.0:
        values = kernels.delayed(values, times, starts, p["delay_s"])
    if p["lag_s"] > 0.0:
        values = kernels.low_pass(values, times, starts, p["lag_s"], False)
    if p["smoothing_s"] > 0.0:
        values = kernels.smoothed(values, times, starts, p["smoothing_s"])
    for steps, echo in zip(STEPS, ECHOES, strict=True):
        if p[echo.name] != 0.0:
            then = kernels.delayed(load[:, 0], times, starts, steps * p["sample_s"])
            values = values + p[echo.name] * (then - load[:, 0])
    return values[:, None]


def _references(history: base.LoadHistory) -> dict[str, float]:
    return {"sample_s": history.sample_period_s}


def _bounds(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    reach_s = max(0.2 * history.trial_duration_s, 4 * history.sample_period_s)
    return -reach_s, reach_s


base.register(
    base.Effect(
        name="latency",
        channel="normal",
        stage="input",
        about="the volume comes later (or earlier) than the force",
        parameters=(
            base.amount("delay_s", -2.0, 2.0, "s", bounds=_bounds),
            base.amount("lag_s", 0.0, 2.0, "s", bounds=_bounds),
            base.amount("smoothing_s", 0.0, 2.0, "s", bounds=_bounds),
            base.reference("sample_s", "s"),
            *ECHOES,
        ),
        references=_references,
        apply=_apply,
        variants=lambda history, references: (
            # Small: from sample to sample the force is a line, of other slopes before and after.
            base.variant("delay", [{"delay_s": 0.1 * history.sample_period_s}]),
            base.variant("lead", [{"delay_s": -0.1 * history.sample_period_s}]),
            base.variant("first-order lag", [{"lag_s": history.sample_period_s}]),
            base.variant("smoothed samples", [{"smoothing_s": 0.3 * history.sample_period_s}]),
            base.variant(
                "delay and lag",
                [{"delay_s": history.sample_period_s}, {"lag_s": history.sample_period_s}],
            ),
        ),
        in_simulation=False,
        shown_against="load_rate",
        separated_by={"hysteresis": "load and unload at two speeds: a delay grows with it"},
    )
)
