"""Drift: the compliance, or the gauge's zero, moves with the session's clock."""

import numpy as np

from tacgen.contact.effects import base

MIN_TRIALS = 6
"""With fewer, any sequence of trials drifts."""
EARLY_SHARE, EARLY_LEAD_IN_SE = 0.12, 1.0
"""Conditioning that is over in this part of the session is named unless drift leads by so much."""


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + linear·τ + quadratic·τ² + cubic·τ³ and a zero that moves by offset_n·τ.

    τ = (t − start)/span − ½ runs from −½ to ½ over the session that was fitted; beyond, the
    nearest end's value goes on for a quarter of a session and is then held.
    """
    tau = np.clip((history.time_s - p["start_s"]) / p["span_s"] - 0.5, -0.75, 0.75)
    relative = tau * (p["linear"] + tau * (p["quadratic"] + tau * p["cubic"]))
    return base.with_gain(load, relative) + (p["offset_n"] * tau)[:, None]


def _references(history: base.LoadHistory) -> dict[str, float]:
    if not history.n_samples:
        return {"start_s": 0.0, "span_s": 1.0}
    start = float(history.time_s.min())
    return {"start_s": start, "span_s": max(float(history.time_s.max()) - start, 1e-6)}


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    powers = [{name: 0.05} for name in ("linear", "quadratic", "cubic")]
    gains = [base.variant(next(iter(powers[k])), powers[: k + 1]) for k in range(3)]
    return (*gains, base.variant("zero, linear", [{"offset_n": 0.01 * history.normal_span_n}]))


def _or_conditioning(tie: base.Tie) -> base.FittedForm:
    """Name conditioning where a bent drift does no better than it.

    A drift of one sign needs no second or third power; conditioning that fits as well and is
    over early in the session, or beside a drift that would have to turn back, explains the bend.
    """
    drift = tie.found
    if drift.name != "drift" or len(drift.fitted) < 2:
        return drift
    early = min(tie.forms("conditioning"), key=lambda form: form.loss, default=drift)
    if early is drift:
        return drift
    lead = drift.lead_in_se(early)
    is_over = early.values["trials"] < EARLY_SHARE * tie.history.session_trials
    gains = is_over and lead < EARLY_LEAD_IN_SE
    return early if gains or (_turns_back(drift) and lead < tie.max_lead_in_se) else drift


def _turns_back(drift: base.FittedForm) -> bool:
    """Whether a drift takes back more than a tenth of its way within the session."""
    tau, p = np.linspace(-0.5, 0.5, 41), drift.values
    gain = tau * (p["linear"] + tau * (p["quadratic"] + tau * p["cubic"]))
    back = np.abs(np.diff(gain)).sum() - abs(gain[-1] - gain[0])
    return bool(back > 0.2 * np.ptp(gain))


base.register(
    base.Effect(
        name="drift",
        channel="normal",
        stage="gain",
        about="the compliance or the zero moves with session time",
        parameters=(
            base.amount("linear", -2.0, 5.0),
            base.amount("quadratic", -10.0, 10.0),
            base.amount("cubic", -20.0, 20.0),
            base.amount("offset_n", -20.0, 20.0, "N"),
            base.reference("start_s", "s", 0.0),
            base.reference("span_s", "s"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        kind="between trials",
        needs_session_clock=True,
        is_identifiable=lambda history: history.n_trials >= MIN_TRIALS,
        shown_against="time_s",
        separated_by={
            "conditioning": "let the gel rest in mid-session: conditioning comes back, drift "
            "does not",
            "temperature": "warm or cool the gel in mid-session",
            "time_s": "a longer session, with presses at even intervals",
        },
        tie_breaks={"conditioning": _or_conditioning},
        needs=("time_s",),
        in_simulation=False,
    )
)
