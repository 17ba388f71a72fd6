"""The pads hold the object better or worse than declared, torsion included."""

from __future__ import annotations

from tacgen.collection.perturbed import Perturbation
from tacgen.diagnose.grasps.hypotheses.registry import (
    Hypothesis,
    Parameter,
    Prediction,
    register,
)

register(
    Hypothesis(
        name="friction",
        weight=0.7,  # calibrated before, on labels of the same kind (``tacgen friction``)
        of_gripper=False,
        parameters=(
            Parameter(
                key="friction_factor",
                unit="1",
                declared=1.0,
                nodes=(0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 1.6, 2.0),
                spread=0.5,  # a worn or dusty gel
                perturb=lambda factor: Perturbation(friction_factor=factor),
                prediction=Prediction.CLOSED_FORM_FORCE,
                force_exponent=1,
                figure=("friction", "1"),
            ),
        ),
    )
)
