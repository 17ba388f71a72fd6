"""What a trace says: statuses, failure modes, frames, and what perturbs them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacgen.physics import GraspSimulator, PhysicsSettings

from .conftest import GRAVITY_M_S2, LIFT_LOAD, SEQUENCE, block, dumbbell, grasp, hull_mesh


class TestOutcomes:
    def test_a_firm_grasp_succeeds(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block(), force_n=15.0)
        assert (trace.status, trace.label, trace.failure_mode) == ("executed", 1, "")
        assert trace.rise_mm == pytest.approx(180.0, abs=0.5)
        assert trace.margin is not None
        assert np.isnan(trace.margin.first_slip_time_s)
        assert trace.margin.first_slip_direction.tolist() == [0.0, 0.0]

    def test_a_weak_grasp_slides_down(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block(mass_kg=0.5), force_n=3.0)
        assert (trace.label, trace.failure_mode) == (0, "translational_slip")
        assert trace.rise_mm < 150.0
        assert trace.margin is not None
        weight_n = 0.5 * GRAVITY_M_S2
        load_n = weight_n * LIFT_LOAD
        closed_form = (2 * 0.5 * 3.0 - load_n) / weight_n
        assert trace.margin.translational == pytest.approx(closed_form, rel=2e-5)  # of the solver
        # The gripper goes up, so the object slides down its images.
        assert trace.margin.first_slip_direction == pytest.approx([0.0, 1.0], abs=0.02)
        assert 0.3 < trace.margin.first_slip_time_s < 1.5

    def test_an_off_centre_grasp_turns(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block(center_of_mass_offset_mm=(0, 20, 0)))
        assert (trace.label, trace.failure_mode) == (0, "rotational_slip")
        assert trace.turn_rad > 0.5
        assert trace.margin is not None
        assert trace.margin.translational > 0
        share = 0.3 * GRAVITY_M_S2 * LIFT_LOAD / (2 * 0.5 * 10.0)
        limit_n_mm = 2 * 2.0 * 10.0 * np.sqrt(1 - share**2)
        expected = limit_n_mm / (0.3 * GRAVITY_M_S2) - 20.0 * LIFT_LOAD
        assert trace.margin.rotational == pytest.approx(expected, abs=0.1)

    def test_gripping_beside_the_object_touches_nothing(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block(), y_mm=60.0)
        assert (trace.status, trace.label) == ("no_contact", -1)
        assert "the pads met with nothing between them" in trace.reason
        assert trace.frames == {"left": (), "right": ()}
        assert trace.object_pose.shape == (0, 7)

    @pytest.mark.parametrize(
        ("size_mm", "z_mm", "reason"),
        [
            ((120.0, 60.0, 100.0), 50.0, "wider there than the stroke of 110 mm"),
            ((60.0, 60.0, 300.0), 50.0, "too tall, grasp it higher"),
            ((60.0, 60.0, 100.0), 4.0, "into the table; grasp at z_mm = 9.5 or higher"),
        ],
    )
    def test_what_cannot_be_reached_says_why(
        self,
        simulator: GraspSimulator,
        size_mm: tuple[float, float, float],
        z_mm: float,
        reason: str,
    ) -> None:
        trace = grasp(simulator, block(size_mm=size_mm), z_mm=z_mm)
        assert (trace.status, trace.label) == ("unreachable", -1)
        assert reason in trace.reason

    def test_a_way_round_a_broad_middle_is_found(self, simulator: GraspSimulator) -> None:
        # Broader than the stroke in the middle, with a handle that can be gripped at y = 70 mm.
        parts = tuple(
            hull_mesh(np.array([[i, j, k] for i in x for j in y for k in (0.0, 60.0)]))
            for x, y in (((-70.0, 70.0), (-40.0, 40.0)), ((-20.0, 20.0), (40.0, 100.0)))
        )
        obj = replace(
            block(spinning_friction_mm=50.0),
            collision=parts,
            center_of_mass_mm=np.array([0.0, 50.0, 30.0]),
        )
        assert grasp(simulator, obj, z_mm=30.0).status == "unreachable"
        assert grasp(simulator, obj, y_mm=70.0, z_mm=30.0).label == 1

    def test_the_arm_knows_its_reach(self, arm_simulator: GraspSimulator) -> None:
        trace = grasp(arm_simulator, block(), x_mm=600.0)
        assert trace.status == "unreachable"
        assert "the arm does not reach x_mm = 600" in trace.reason

    @pytest.mark.slow
    def test_margins_and_labels_agree(self, simulator: GraspSimulator) -> None:
        for force_n in (2.0, 4.0, 8.0, 16.0):
            for y_mm in (0.0, 7.0, 16.0):
                trace = grasp(simulator, block(), force_n=force_n, y_mm=y_mm)
                assert trace.margin is not None
                margin = min(trace.margin.translational, trace.margin.rotational)
                assert abs(margin) > 0.05, "the grid should not hit the border"
                assert trace.label == (margin > 0)


class TestFrames:
    def test_the_gel_frame_looks_at_the_object(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block(), y_mm=5.0, z_mm=60.0)
        left, right = trace.frames["left"][0], trace.frames["right"][0]
        # Object points in the gel frame: y (rows) counts down from the pad's height, z out.
        for frame, side in ((left, -1.0), (right, 1.0)):
            on_face = np.array([side * 30.0, 5.0, 60.0, 1.0])
            assert frame.pose_gel_object @ on_face == pytest.approx([0, 0, 0, 1], abs=0.3)
            higher = np.array([side * 30.0, 5.0, 70.0, 1.0])
            assert (frame.pose_gel_object @ higher)[1] == pytest.approx(-10.0, abs=0.3)
            deeper = np.array([side * 20.0, 5.0, 60.0, 1.0])
            assert (frame.pose_gel_object @ deeper)[2] == pytest.approx(10.0, abs=0.3)
            rotation = frame.pose_gel_object[:3, :3]
            assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-9)
            assert np.linalg.det(rotation) == pytest.approx(1.0)
        # Columns run along world −y on the left pad, +y on the right one.
        aside = np.array([-30.0, 9.0, 60.0, 1.0])
        assert (left.pose_gel_object @ aside)[0] == pytest.approx(-4.0, abs=0.3)
        aside = np.array([30.0, 9.0, 60.0, 1.0])
        assert (right.pose_gel_object @ aside)[0] == pytest.approx(4.0, abs=0.3)

    @pytest.mark.parametrize("make", [block, dumbbell])
    def test_the_lifted_weight_shears_the_gels_down(
        self, simulator: GraspSimulator, make: object
    ) -> None:
        obj = make()  # type: ignore[operator]
        trace = grasp(simulator, obj, z_mm=30.0, force_n=12.0, frames=SEQUENCE)
        cruise = [k for k, frame in enumerate(trace.frames["left"]) if 1.7 < frame.time_s < 2.0]
        assert cruise
        for k in cruise:
            shear = sum(trace.frames[pad][k].force_shear_n for pad in ("left", "right"))
            assert shear == pytest.approx([0.0, obj.mass_kg * GRAVITY_M_S2], rel=0.02, abs=0.02)

    def test_the_pads_share_the_moment_of_an_off_centre_weight(
        self, simulator: GraspSimulator
    ) -> None:
        obj = block(center_of_mass_offset_mm=(0, 8, 0))
        trace = grasp(simulator, obj, frames=SEQUENCE)
        half_n_mm = obj.mass_kg * GRAVITY_M_S2 * 8.0 / 2
        for pad, sign in (("left", -1), ("right", 1)):
            held = [f.torsion_n_mm for f in trace.frames[pad] if 1.7 < f.time_s < 2.0]
            # The centre of mass is at +y, where the left pad's columns are negative: its weight
            # turns the left gel from y (down) towards x (left), against the sense x to y.
            assert held == pytest.approx([sign * half_n_mm] * len(held), rel=0.03)

    def test_a_sequence_starts_untouched_and_ends_on_time(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block(), frames=SEQUENCE)
        frames = trace.frames["left"]
        assert len(frames) == len(trace.object_pose) == 25
        times_s, planned_s = [f.time_s for f in frames], np.linspace(0, 3, 25)
        planned_s[trace.grasp_frame] = trace.grasp_time_s
        assert times_s == pytest.approx(planned_s, abs=0.002)
        assert frames[0].force_normal_n == 0.0
        assert trace.object_pose[0, :3] == pytest.approx([0, 0, 0], abs=0.02)
        assert trace.object_pose[-1, 2] == pytest.approx(180.0, abs=1.0)

    def test_only_the_pads_with_a_sensor_are_recorded(self, simulator: GraspSimulator) -> None:
        settings = PhysicsSettings(tactile_pads="right")
        assert set(grasp(simulator, block(), settings=settings).frames) == {"right"}


class TestPerturbations:
    def test_delivered_force(self, simulator: GraspSimulator) -> None:
        settings = PhysicsSettings(delivered_force_scale=0.8, delivered_force_offset_n=1.0)
        trace = grasp(simulator, block(), force_n=10.0, settings=settings)
        assert trace.frames["left"][0].force_normal_n == pytest.approx(9.0, rel=0.02)

    def test_height_offset(self, simulator: GraspSimulator) -> None:
        settings = PhysicsSettings(height_offset_mm=7.0)
        trace = grasp(simulator, block(), z_mm=50.0, settings=settings)
        assert trace.frames["left"][0].pose_gel_object[1, 3] == pytest.approx(57.0, abs=0.1)

    def test_pad_friction_scales_the_objects(self, simulator: GraspSimulator) -> None:
        # 2μF = 10 N against 5.9 N of weight; with half the friction 5 N.
        obj = block(mass_kg=0.6)
        assert grasp(simulator, obj).label == 1
        assert grasp(simulator, obj, settings=PhysicsSettings(pad_friction=0.5)).label == 0

    def test_a_soft_pad_gives_way_by_force_over_stiffness(self, simulator: GraspSimulator) -> None:
        rigid = grasp(simulator, block(), force_n=20.0)
        soft = grasp(
            simulator,
            block(),
            force_n=20.0,
            settings=PhysicsSettings(pad_stiffness_n_mm=20.0, tactile_pads="both"),
        )
        given_way = sum(
            rigid.frames[pad][0].pose_gel_object[2, 3] - soft.frames[pad][0].pose_gel_object[2, 3]
            for pad in ("left", "right")
        )
        assert given_way == pytest.approx(2 * 20.0 / 20.0, rel=0.1)
        assert soft.label == rigid.label == 1
