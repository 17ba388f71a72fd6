"""Drift: the compliance, or the gauge's zero, moves with the session's clock."""

import numpy as np

from tacgen.contact.effects import base

CURVE = base.Curve("curve", (-0.5, -0.3, -0.1, 0.1, 0.3, 0.5))
MIN_TRIALS = 6  # with fewer, any sequence of trials drifts


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + linear·τ + quadratic·τ² + cubic·τ³ and a zero that moves by offset_n·τ.

    Or the gain settles, as what warms up does: 1 + settling·(1 − exp(−(τ + ½)/over)).

    τ = (t − start)/span − ½ runs from −½ to ½ over the session that was fitted; beyond, the
    nearest end's value goes on for a quarter of a session and is then held.
    """
    tau = np.clip((history.time_s - p["start_s"]) / p["span_s"] - 0.5, -0.75, 0.75)
    relative = tau * (p["linear"] + tau * (p["quadratic"] + tau * p["cubic"]))
    if p["settling"] != 0.0:
        relative = relative - p["settling"] * np.expm1(-np.maximum(tau + 0.5, 0.0) / p["over"])
    relative = relative + CURVE(tau, p)
    return np.asarray(base.with_gain(load, relative) + (p["offset_n"] * tau)[:, None])


def _references(history: base.LoadHistory) -> dict[str, float]:
    if not history.n_samples:
        return {"start_s": 0.0, "span_s": 1.0}
    start = float(history.time_s.min())
    return {"start_s": start, "span_s": max(float(history.time_s.max()) - start, 1e-6)}


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    powers = [{name: 0.05} for name in ("linear", "quadratic", "cubic")]
    gains = [base.variant(next(iter(powers[k])), powers[: k + 1]) for k in range(3)]
    gains.append(base.variant("settling", [{"settling": 0.05}], {"over": 0.3}))
    return (*gains, base.variant("zero, linear", [{"offset_n": 0.01 * history.normal_span_n}]))


base.register(
    base.Effect(
        name="drift",
        channel="normal",
        stage="gain",
        is_of_trials=True,
        about="the compliance or the zero moves with session time",
        parameters=(
            base.amount("linear", -2.0, 5.0),
            base.amount("quadratic", -10.0, 10.0),
            base.amount("cubic", -20.0, 20.0),
            base.amount("settling", -0.9, 5.0),
            base.shape("over", 0.15, 2.0, 0.3),
            base.amount("offset_n", -20.0, 20.0, "N"),
            *CURVE.parameters,
            base.reference("start_s", "s", 0.0),
            base.reference("span_s", "s"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs_session_clock=True,
        is_identifiable=lambda history: history.n_trials >= MIN_TRIALS,
        shown_against="time_s",
        separated_by={
            "conditioning": "let the gel rest in mid-session: conditioning comes back, drift "
            "does not",
            "temperature": "warm or cool the gel in mid-session",
            "time_s": "a longer session, with presses at even intervals",
        },
        needs=("time_s",),
        in_simulation=False,
    )
)
