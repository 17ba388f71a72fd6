"""The pads hold a larger or smaller moment about the contact normal than declared."""

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
        name="spinning_friction",
        weight=0.3,  # rarely decides a grasp by itself
        of_gripper=False,
        parameters=(
            Parameter(
                key="spinning_friction_factor",
                unit="1",
                declared=1.0,
                nodes=(0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0),
                spread=0.4,  # set by a patch that nobody measures
                perturb=lambda factor: Perturbation(spinning_friction_factor=factor),
                prediction=Prediction.CLOSED_FORM_TORSION,
                figure=("spinning_friction_mm", "mm"),
            ),
        ),
    )
)
