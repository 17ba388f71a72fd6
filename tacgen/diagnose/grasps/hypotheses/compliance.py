"""The pads are softer than declared."""

from __future__ import annotations

from tacgen.collection.perturbed import Perturbation
from tacgen.diagnose.grasps.hypotheses.registry import Hypothesis, Parameter, register

register(
    Hypothesis(
        name="compliance",
        weight=0.3,  # rarely decides a grasp
        of_gripper=True,
        parameters=(
            Parameter(
                key="compliance_mm_per_n",
                unit="mm/N",
                declared=0.0,
                nodes=(0.0, 0.1),
                spread=0.1,  # a gel of 2 mm gives about so much under a dome
                perturb=lambda added_mm_per_n: Perturbation(compliance_mm_per_n=added_mm_per_n),
            ),
        ),
    )
)
