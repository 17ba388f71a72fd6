"""What may be wrong with a simulated grasp: the hypotheses and their registry."""

from importlib import import_module
from pkgutil import iter_modules

from tacgen.diagnose.grasps.hypotheses.registry import (
    Candidate,
    Hypothesis,
    Parameter,
    Prediction,
    advice,
    candidates_for,
    register,
    registered,
)

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")

__all__ = [
    "Candidate",
    "Hypothesis",
    "Parameter",
    "Prediction",
    "advice",
    "candidates_for",
    "register",
    "registered",
]
