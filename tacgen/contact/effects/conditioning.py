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
    """Gain 1 + amount·exp(−(n/trials)^stretch), n the number of trials before this one.

    Source
    ------
    Mullins 1969: a rubber softens over its first loadings and then settles.
    """
    n = np.maximum(history.trial - p["first_trial"], 0.0)
    return with_gain(load, p["amount"] * np.exp(-((n / p["trials"]) ** p["stretch"])))


def _references(history: LoadHistory) -> dict[str, float]:
    return {"first_trial": float(history.trial.min()) if history.n_samples else 0.0}


def _variants(history: LoadHistory, references: Parameters) -> tuple[Variant, ...]:
    single = [
        variant(f"over {trials:g} trials", [{"amount": 0.05}], {"trials": trials})
        for trials in (1.0, 2.5, 5.0)
    ]
    stretched = Variant(
        "stretched", ({"amount": 0.05},), ("amount", "trials"), {"trials": 1.5, "stretch": 0.6}
    )
    return (*single, stretched)


register(
    Effect(
        name="conditioning",
        channel="normal",
        stage="gain",
        about="the first presses differ",
        parameters=(
            amount("amount", -0.9, 5.0),
            shape("trials", 0.3, 20.0, 3.0, "trials"),
            shape("stretch", 0.3, 2.0, 1.0),
            reference("first_trial", "trial", 0.0),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
    )
)
