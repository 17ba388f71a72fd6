"""The object's centre of mass is not where it is declared."""

from __future__ import annotations

from tacgen.collection.perturbed import Perturbation
from tacgen.core.records import GraspObject
from tacgen.diagnose.grasps.hypotheses.registry import Hypothesis, Parameter, register


def _along(axis: str, nodes_mm: tuple[float, ...]) -> Parameter:
    key, column = f"center_of_mass_{axis}_mm", "xyz".index(axis)

    def within(grasped: GraspObject) -> tuple[float, float]:
        """How far the centre may move and stay inside the object, mm."""
        vertices_mm = grasped.surface.vertices_mm[:, column]
        center_mm = grasped.center_of_mass_mm[column]
        return vertices_mm.min() - center_mm, vertices_mm.max() - center_mm

    def shifted(offset_mm: float) -> Perturbation:
        return Perturbation(**{key: offset_mm})  # type: ignore[arg-type]

    return Parameter(
        key=key,
        unit="mm",
        declared=0.0,
        nodes=nodes_mm,
        spread=20.0,  # centres of mass are off by centimetres: contents lie on one side
        perturb=shifted,
        share=1 / 3,
        limits=within,
        sentence=f"along {axis} off by {{}} ± {{}} {{}}",
    )


_BALANCE = "balance the object on an edge"

register(
    Hypothesis(
        name="center_of_mass",
        weight=1.0,  # as usual as a wrong mass
        of_gripper=False,
        parameters=(
            _along("x", (-30.0, -15.0, 0.0, 15.0, 30.0)),
            # The lever between the pads and the centre lies along y: finer nodes.
            _along("y", (-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0)),
            _along("z", (-30.0, -15.0, 0.0, 15.0, 30.0)),
        ),
        separated_by={
            "mass": "weigh the object, and balance it on an edge",
            "friction": _BALANCE,
            "grip_force": _BALANCE,
            "spinning_friction": "grasp on both sides of the centre: a "
            "shift helps on one side and harms on the other",
        },
    )
)
