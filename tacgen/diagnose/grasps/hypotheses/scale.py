"""The object is larger or smaller than its mesh."""

from __future__ import annotations

from tacgen.collection.perturbed import Perturbation
from tacgen.diagnose.grasps.hypotheses.registry import Hypothesis, Parameter, register

register(
    Hypothesis(
        name="scale",
        weight=0.3,  # rarely decides a grasp
        of_gripper=False,
        parameters=(
            Parameter(
                key="object_scale",
                unit="1",
                declared=1.0,
                nodes=(0.95, 1.0, 1.05),
                spread=0.05,  # a scanned mesh is off by a few per cent
                perturb=lambda factor: Perturbation(object_scale=factor),
            ),
        ),
    )
)
