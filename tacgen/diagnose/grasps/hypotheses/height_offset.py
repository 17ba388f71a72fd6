"""The table is not where it is declared: pads close higher or lower on the object."""

from __future__ import annotations

from tacgen.collection.perturbed import Perturbation
from tacgen.diagnose.grasps.hypotheses.registry import Hypothesis, Parameter, register

register(
    Hypothesis(
        name="height_offset",
        weight=0.3,  # rarely decides a grasp
        of_gripper=True,
        parameters=(
            Parameter(
                key="height_offset_mm",
                unit="mm",
                declared=0.0,
                nodes=(-4.0, 0.0, 4.0),
                spread=3.0,  # a robot's table is known to a few millimetres
                perturb=lambda offset_mm: Perturbation(height_offset_mm=offset_mm),
            ),
        ),
        separated_by={"scale": "measure the object and the height of the pads"},
    )
)
