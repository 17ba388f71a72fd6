"""Conditioning: the first presses on a rested gel differ from later ones."""

import numpy as np

from tacgen.contact.effects import base

CURVE = base.Curve("after", (0.0, 1.0, 2.0, 4.0, 8.0, 16.0))  # over the presses before
MIN_TRIALS = 6  # with fewer, the first trials are most of them


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + amount·(1 + tail·m)^(−1/tail), m = (n/trials)^power, n the trials before this one.

    At tail 0 that is exp(−m), at tail 1 it is 1/(1 + m); a power above 1 starts with a plateau.

    Source: Mullins 1969: a rubber softens over its first loadings and then settles.
    """
    n = (np.maximum(history.trial - p["first_trial"], 0.0) / p["trials"]) ** p["power"]
    tail = p["tail"]
    faded = np.exp(-n) if tail < 1e-6 else (1.0 + tail * n) ** (-1.0 / tail)
    relative = p["amount"] * faded + CURVE(history.trial - p["first_trial"], p)
    return base.with_gain(load, relative)


def _trials_bounds(history: base.LoadHistory, p: base.Parameters) -> tuple[float, float]:
    """What a tenth of is left after half of the session is a drift."""
    # Trials by their numbers, those that are held out included.
    half = 0.5 * (float(np.ptp(history.trial)) + 1.0)
    return 0.0, max(5.0, half * float(np.log(10.0)) ** (-1.0 / p["power"]))


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    forms: list[tuple[str, dict[str, float], tuple[str, ...]]] = [
        *((f"over {n:g} trials", {"trials": n}, ("trials",)) for n in (1.0, 2.5, 5.0)),
        *(
            (f"over {n:g} trials, with a tail", {"trials": n, "tail": 1.0}, ("trials", "tail"))
            for n in (0.5, 1.5)
        ),
        *(
            (f"a plateau of {n:g} trials", {"trials": n, "power": 2.5}, ("trials", "power"))
            for n in (4.0, 8.0)
        ),
    ]
    return tuple(
        base.variant(label, [{"amount": 0.05}], shapes, fitted=fitted)
        for label, shapes, fitted in forms
    )


base.register(
    base.Effect(
        name="conditioning",
        channel="normal",
        stage="gain",
        is_of_trials=True,
        about="the first presses differ",
        parameters=(
            base.amount("amount", -0.9, 5.0),
            base.shape("trials", 0.3, 20.0, 3.0, "trials", _trials_bounds),
            base.shape("tail", 0.0, 20.0, 0.0),
            base.shape("power", 0.5, 4.0, 1.0),
            *CURVE.parameters,
            base.reference("first_trial", "trial", 0.0),
        ),
        apply=_apply,
        references=lambda history: {
            "first_trial": float(history.trial.min()) if history.n_samples else 0.0
        },
        variants=_variants,
        is_identifiable=lambda history: history.n_trials >= MIN_TRIALS,
        shown_against="trial",
    )
)
