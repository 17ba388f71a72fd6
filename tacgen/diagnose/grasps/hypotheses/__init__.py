"""What may be wrong with a simulated grasp: one module a hypothesis, one registry."""

from tacgen.diagnose.grasps.hypotheses.registry import (
    Candidate,
    Hypothesis,
    Parameter,
    Prediction,
    advice,
    candidates_for,
    load_hypotheses,
    register,
    registered,
    unregister,
)

load_hypotheses(__name__, __path__)

__all__ = [
    "Candidate",
    "Hypothesis",
    "Parameter",
    "Prediction",
    "advice",
    "candidates_for",
    "register",
    "registered",
    "unregister",
]
