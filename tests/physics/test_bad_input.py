"""What cannot be simulated is refused in words that tell the mend; extremes stay sane."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from tacgen.core.errors import PhysicsError
from tacgen.core.records import GraspConfig
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp
from tests.messages import refused

from .conftest import block, grasp


class TestBadInput:
    @pytest.mark.parametrize(
        "force_n",
        [
            50.0,
            0.0,
            float("nan"),
        ],
    )
    def test_forces_out_of_range(self, simulator: GraspSimulator, force_n: float) -> None:
        with refused(PhysicsError):
            grasp(simulator, block(), force_n=force_n)

    def test_every_fault_of_the_settings_is_named(self) -> None:
        with pytest.raises(ValidationError) as caught:
            PhysicsSettings(
                time_step_s=0.0, hold_s=-1.0, pad_dome_radius_mm=5.0, contact_average_steps=0
            )
        found = {error["loc"][0]: error["msg"] for error in caught.value.errors()}
        assert set(found) == {
            "time_step_s",
            "hold_s",
            "pad_dome_radius_mm",
            "contact_average_steps",
        }
        assert found["pad_dome_radius_mm"].endswith("greater than or equal to 20")
        with refused(ValidationError):
            PhysicsSettings(success_rise_mm=200.0)

    def test_a_force_beyond_the_gripper(self, simulator: GraspSimulator) -> None:
        with refused(PhysicsError):
            grasp(simulator, block(), force_n=99.0)

    def test_a_force_that_never_arrives(self, simulator: GraspSimulator) -> None:
        settings = PhysicsSettings(delivered_force_offset_n=-20.0)
        trace = grasp(simulator, block(), force_n=10.0, settings=settings)
        assert trace.status == "no_contact"
        assert "no force is delivered" in trace.reason

    @pytest.mark.parametrize(
        ("friction", "mass_kg", "force_n", "label"),
        [(0.0, 0.3, 40.0, 0), (1.0, 0.002, 40.0, 1), (1.0, 6.0, 40.0, 1), (1.0, 9.0, 40.0, 0)],
    )
    def test_extremes_stay_sane(
        self,
        simulator: GraspSimulator,
        friction: float,
        mass_kg: float,
        force_n: float,
        label: int,
    ) -> None:
        obj = block(friction=friction, mass_kg=mass_kg)
        trace = grasp(simulator, obj, force_n=force_n)
        assert (trace.status, trace.label) == ("executed", label)
        assert trace.rise_mm == pytest.approx(180.0 * label, abs=1.0)

    def test_an_unknown_robot(self) -> None:
        with refused(PhysicsError):
            GraspSimulator("panda")

    def test_a_closed_simulator(self) -> None:
        pytest.importorskip("pybullet")
        with refused(PhysicsError):
            run_grasp(
                GraspSimulator(engine="pybullet"),
                block(),
                GraspConfig(0, "block", 5.0, 0.0, 0.0, 50.0),
                PhysicsSettings(),
                frames=FrameRequest(),
            )
