"""Conditioning: the first presses on a rested gel differ from later ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tacgen.contact.effects.history import LoadHistory
from tacgen.contact.effects.registry import (
    Effect,
    Parameters,
    Variant,
    amount,
    reference,
    register,
    shape,
    variant,
)
from tacgen.contact.effects.shapes import with_gain


def _apply(load: NDArray[np.float64], history: LoadHistory, p: Parameters) -> NDArray[np.float64]:
    """Gain 1 + amount·(1 + tail·m)^(−1/tail), m = (n/trials)^power, n the trials before this one.

    At tail 0 that is exp(−m), at tail 1 it is 1/(1 + m); a power above 1 starts with a plateau.

    Source
    ------
    Mullins 1969: a rubber softens over its first loadings and then settles.
    """
    n = (np.maximum(history.trial - p["first_trial"], 0.0) / p["trials"]) ** p["power"]
    tail = p["tail"]
    faded = np.exp(-n) if tail < 1e-6 else (1.0 + tail * n) ** (-1.0 / tail)
    return with_gain(load, p["amount"] * faded)


def _references(history: LoadHistory) -> dict[str, float]:
    return {"first_trial": float(history.trial.min()) if history.n_samples else 0.0}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    single = [
        variant(f"over {trials:g} trials", [{"amount": 0.05}], {"trials": trials})
        for trials in (1.0, 2.5, 5.0)
    ]
    tailed = [
        Variant(
            f"over {trials:g} trials, with a tail",
            ({"amount": 0.05},),
            ("amount", "trials", "tail"),
            {"trials": trials, "tail": 1.0},
        )
        for trials in (0.5, 1.5)
    ]
    plateau = Variant(
        "a plateau of 4 trials",
        ({"amount": 0.05},),
        ("amount", "trials"),
        {"trials": 4.0, "power": 2.5},
    )
    return (*single, *tailed, plateau)


register(
    Effect(
        name="conditioning",
        channel="normal",
        stage="gain",
        about="the first presses differ",
        parameters=(
            amount("amount", -0.9, 5.0),
            shape("trials", 0.3, 20.0, 3.0, "trials"),
            shape("tail", 0.0, 20.0, 0.0),
            shape("power", 0.5, 4.0, 1.0),
            reference("first_trial", "trial", 0.0),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
    )
)
