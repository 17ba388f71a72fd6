"""Conditioning: the first presses on a rested gel differ from later ones."""

import numpy as np

from tacgen.contact.effects import base

MIN_TRIALS = 6
"""With fewer, the first trials are most of them."""


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + amount·(1 + tail·m)^(−1/tail), m = (n/trials)^power, n the trials before this one.

    At tail 0 that is exp(−m), at tail 1 it is 1/(1 + m); a power above 1 starts with a plateau.

    Source
    ------
    Mullins 1969: a rubber softens over its first loadings and then settles.
    """
    n = (np.maximum(history.trial - p["first_trial"], 0.0) / p["trials"]) ** p["power"]
    tail = p["tail"]
    faded = np.exp(-n) if tail < 1e-6 else (1.0 + tail * n) ** (-1.0 / tail)
    return base.with_gain(load, p["amount"] * faded)


def _references(history: base.LoadHistory) -> dict[str, float]:
    return {"first_trial": float(history.trial.min()) if history.n_samples else 0.0}


def _trials_bounds(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    """What goes on for more than a fifth of the session is a drift."""
    return 0.0, max(5.0, 0.22 * history.session_trials)


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    single = [
        base.variant(f"over {trials:g} trials", [{"amount": 0.05}], {"trials": trials})
        for trials in (1.0, 2.5, 5.0)
    ]
    tailed = [
        base.Variant(
            f"over {trials:g} trials, with a tail",
            ({"amount": 0.05},),
            ("amount", "trials", "tail"),
            {"trials": trials, "tail": 1.0},
        )
        for trials in (0.5, 1.5)
    ]
    plateau = base.Variant(
        "a plateau of 4 trials",
        ({"amount": 0.05},),
        ("amount", "trials"),
        {"trials": 4.0, "power": 2.5},
    )
    return (*single, *tailed, plateau)


base.register(
    base.Effect(
        name="conditioning",
        channel="normal",
        stage="gain",
        about="the first presses differ",
        parameters=(
            base.amount("amount", -0.9, 5.0),
            base.shape("trials", 0.3, 20.0, 3.0, "trials", _trials_bounds),
            base.shape("tail", 0.0, 20.0, 0.0),
            base.shape("power", 0.5, 4.0, 1.0),
            base.reference("first_trial", "trial", 0.0),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        kind="between trials",
        is_identifiable=lambda history: history.n_trials >= MIN_TRIALS,
        shown_against="trial",
    )
)
