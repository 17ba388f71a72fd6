"""The object is heavier or lighter than declared: a container is full or half empty."""

from __future__ import annotations

from tacgen.collection.perturbed import Perturbation
from tacgen.diagnose.grasps.hypotheses.registry import (
    Hypothesis,
    Parameter,
    Prediction,
    register,
)

_FORCE_FACTORS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 1.6, 2.0)

register(
    Hypothesis(
        name="mass",
        weight=1.0,  # objects are weighed, containers are not weighed again
        of_gripper=False,
        parameters=(
            Parameter(
                key="mass_factor",
                unit="1",
                declared=1.0,
                # Mass and force grow by one factor without any change of motion.
                nodes=tuple(1 / factor for factor in reversed(_FORCE_FACTORS)),
                spread=0.4,
                perturb=lambda factor: Perturbation(mass_factor=factor),
                prediction=Prediction.EQUIVALENT_FORCE,
                force_exponent=-1,
                figure=("mass_kg", "kg"),
            ),
        ),
        separated_by={"friction": "weigh the object"},
    )
)
