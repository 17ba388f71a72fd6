"""The gripper delivers another force than it is commanded to."""

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
        name="grip_force",
        weight=1.5,  # the force between the pads is hardly ever measured
        of_gripper=True,
        parameters=(
            Parameter(
                key="force_scale",
                unit="1",
                declared=1.0,
                nodes=(0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 1.6, 2.0),
                spread=0.2,  # a gripper's force is off by a fifth
                perturb=lambda factor: Perturbation(force_scale=factor),
                share=0.7,  # a wrong gain is more usual than a wrong zero
                prediction=Prediction.GRIP_FORCE,
                force_exponent=1,
                changes_force=True,
            ),
            Parameter(
                key="force_offset_n",
                unit="N",
                declared=0.0,
                nodes=tuple(0.25 * k for k in range(-16, 17)),
                spread=1.0,  # the friction of a gripper's own drive
                perturb=lambda offset_n: Perturbation(force_offset_n=offset_n),
                share=0.3,
                prediction=Prediction.EQUIVALENT_FORCE,
                changes_force=True,
            ),
        ),
        separated_by={
            "mass": "weigh the object, or measure the force between the pads; "
            "a second object tells too: the force is common to both",
            "friction": "measure the force between the pads, or grasp a second "
            "object of another surface: the force is common to both",
        },
    )
)
