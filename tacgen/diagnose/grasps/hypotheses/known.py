"""The hypotheses that a diagnosis of grasps compares; a further one is a further module here."""

from typing import Any

from tacgen.collection.perturbed import Perturbation
from tacgen.core.records import GraspObject
from tacgen.diagnose.grasps.hypotheses.registry import (
    Hypothesis,
    HypothesisParameter,
    Prediction,
    register,
)

FORCE_FACTORS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, 1.6, 2.0)
"""On the grip force: to three deviations of its prior, closer together near 1."""
BALANCE = "balance the object on an edge"


def number(key: str, **options: Any) -> HypothesisParameter:
    """A parameter that is the field ``key`` of ``Perturbation``."""

    def perturb(value: Any) -> Perturbation:
        return Perturbation(**{key: value})

    return HypothesisParameter(key=key, perturb=perturb, **options)


def factor(
    key: str, nodes: tuple[float, ...], spread: float, **options: Any
) -> HypothesisParameter:
    """A factor on what is declared."""
    return number(key, unit="1", declared=1.0, nodes=nodes, spread=spread, **options)


def shift(
    key: str, unit: str, nodes: tuple[float, ...], spread: float, **options: Any
) -> HypothesisParameter:
    """A difference from what is declared."""
    return number(key, unit=unit, declared=0.0, nodes=nodes, spread=spread, **options)


def center_of_mass(axis: str, nodes_mm: tuple[float, ...]) -> HypothesisParameter:
    """The centre of mass's shift along an axis of the object, within the object."""
    column = "xyz".index(axis)

    def limits_mm(grasped: GraspObject) -> tuple[float, float]:
        along_mm = grasped.surface.vertices_mm[:, column] - grasped.center_of_mass_mm[column]
        return along_mm.min(), along_mm.max()

    return shift(
        f"center_of_mass_{axis}_mm",
        "mm",
        nodes_mm,
        20.0,  # centres of mass are off by centimetres: contents lie on one side
        share=1 / 3,
        limits=limits_mm,
        sentence=f"along {axis} off by {{}} ± {{}} {{}}",
    )


register(
    Hypothesis(
        name="grip_force",
        weight=1.5,  # the force between the pads is hardly ever measured
        of_gripper=True,
        parameters=(
            factor(
                "force_scale",
                FORCE_FACTORS,
                0.2,  # a gripper's force is off by a fifth
                share=0.7,  # a wrong gain is more usual than a wrong zero
                prediction=Prediction.FORCE,
                changes_force=True,
            ),
            shift(
                "force_offset_n",
                "N",
                tuple(0.25 * k for k in range(-16, 17)),
                1.0,  # the friction of a gripper's own drive
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
register(
    Hypothesis(
        name="mass",  # a container is full or half empty
        weight=1.0,  # objects are weighed, containers are not weighed again
        of_gripper=False,
        parameters=(
            factor(
                "mass_factor",
                tuple(1 / one for one in reversed(FORCE_FACTORS)),
                0.4,
                prediction=Prediction.MASS,
                figure=("mass_kg", "kg"),
            ),
        ),
        separated_by={"friction": "weigh the object"},
    )
)
register(
    Hypothesis(
        name="center_of_mass",
        weight=1.0,  # as usual as a wrong mass
        of_gripper=False,
        parameters=(
            center_of_mass("x", (-30.0, -15.0, 0.0, 15.0, 30.0)),
            # The lever between the pads and the centre lies along y: finer nodes.
            center_of_mass("y", tuple(7.5 * k for k in range(-4, 5))),
            center_of_mass("z", (-30.0, -15.0, 0.0, 15.0, 30.0)),
        ),
        separated_by={
            "mass": "weigh the object, and balance it on an edge",
            "friction": BALANCE,
            "grip_force": BALANCE,
            "spinning_friction": "grasp on both sides of the centre: a "
            "shift helps on one side and harms on the other",
        },
    )
)
register(
    Hypothesis(
        name="friction",
        weight=0.7,  # calibrated before, on labels of the same kind (``tacgen friction``)
        of_gripper=False,
        parameters=(
            factor(
                "friction_factor",
                FORCE_FACTORS,
                0.5,  # a worn or dusty gel
                prediction=Prediction.FRICTION,
                figure=("friction", "1"),
            ),
        ),
    )
)
register(
    Hypothesis(
        name="spinning_friction",  # the moment about the contact normal that the pads hold
        weight=0.3,  # rarely decides a grasp by itself
        of_gripper=False,
        parameters=(
            factor(
                "spinning_friction_factor",
                (0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0),
                0.4,  # set by a patch that nobody measures
                prediction=Prediction.TORSION,
            ),
        ),
    )
)

# The following rarely decide a grasp.
register(
    Hypothesis(
        name="scale",
        weight=0.3,
        of_gripper=False,
        # A scanned mesh is off by a few per cent.
        parameters=(factor("object_scale", (0.95, 1.0, 1.05), 0.05),),
    )
)
register(
    Hypothesis(
        name="height_offset",
        weight=0.3,
        of_gripper=True,
        # A robot's table is known to a few millimetres.
        parameters=(shift("height_offset_mm", "mm", (-4.0, 0.0, 4.0), 3.0),),
        separated_by={"scale": "measure the object and the height of the pads"},
    )
)
register(
    Hypothesis(
        name="compliance",
        weight=0.3,
        of_gripper=True,
        # A gel of 2 mm gives about so much under a dome.
        parameters=(shift("compliance_mm_per_n", "mm/N", (0.0, 0.1), 0.1),),
    )
)
