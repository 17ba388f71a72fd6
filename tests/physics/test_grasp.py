"""What a trace says: statuses, failure modes, frames, and that it depends on nothing else."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tacgen.errors import PhysicsError
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp
from tacgen.records import GraspConfig, GraspObject, Mesh

from .conftest import GRAVITY_M_S2, block, grasp, hull_mesh

SEQUENCE = FrameRequest("sequence", 25, 3.0)


def as_bytes(value: object) -> bytes:
    """Every number of a record, to the last bit."""
    if is_dataclass(value):
        return b"|".join(as_bytes(getattr(value, field.name)) for field in fields(value))
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, tuple):
        return b",".join(as_bytes(item) for item in value)
    if isinstance(value, dict):
        return b";".join(key.encode() + as_bytes(item) for key, item in value.items())
    if isinstance(value, float):
        return np.float64(value).tobytes()
    return repr(value).encode()


def dumbbell() -> GraspObject:
    """Two plates joined by a bar: three convex parts, concave as a whole."""

    def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Mesh:
        return hull_mesh(np.array([[i, j, k] for i in x for j in y for k in z]))

    parts = (
        box((-30, 30), (-40, -25), (0, 60)),
        box((-30, 30), (25, 40), (0, 60)),
        box((-10, 10), (-25, 25), (20, 40)),
    )
    return replace(
        block(mass_kg=0.2), collision=parts, center_of_mass_mm=np.array([0.0, 0.0, 30.0])
    )


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
        assert trace.margin.translational == pytest.approx((2 * 0.5 * 3.0 - weight_n) / weight_n)
        # The gripper goes up, so the object slides down its images.
        assert trace.margin.first_slip_direction == pytest.approx([0.0, 1.0], abs=0.02)
        assert 0.3 < trace.margin.first_slip_time_s < 1.5

    def test_an_off_centre_grasp_turns(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block(center_of_mass_offset_mm=(0, 20, 0)))
        assert (trace.label, trace.failure_mode) == (0, "rotational_slip")
        assert trace.turn_rad > 0.5
        assert trace.margin is not None
        assert trace.margin.translational > 0
        share = 0.3 * GRAVITY_M_S2 / (2 * 0.5 * 10.0)
        limit_n_mm = 2 * 2.0 * 10.0 * np.sqrt(1 - share**2)
        expected = limit_n_mm / (0.3 * GRAVITY_M_S2) - 20.0
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
        assert [f.time_s for f in frames] == pytest.approx(np.linspace(0, 3, 25), abs=0.002)
        assert frames[0].force_normal_n == 0.0
        assert trace.object_pose[0, :3] == pytest.approx([0, 0, 0], abs=0.02)
        assert trace.object_pose[-1, 2] == pytest.approx(180.0, abs=1.0)

    def test_the_single_frame_comes_before_the_lift(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block())
        assert trace.object_pose.shape == (1, 7)
        assert trace.object_pose[0, 2] == pytest.approx(0.0, abs=0.1)
        assert trace.label == 1

    def test_only_the_pads_with_a_sensor_are_recorded(self, simulator: GraspSimulator) -> None:
        settings = PhysicsSettings(tactile_pads="right")
        assert set(grasp(simulator, block(), settings=settings).frames) == {"right"}

    def test_records_cannot_be_written_to(self, simulator: GraspSimulator) -> None:
        trace = grasp(simulator, block())
        frame = trace.frames["left"][0]
        arrays = [trace.object_pose, frame.force_shear_n, frame.pose_gel_object]
        assert not any(array.flags.writeable for array in arrays)


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


class TestRepeatability:
    def test_a_grasp_does_not_remember_those_before_it(self) -> None:
        asked = [
            (block(), 8.0, FrameRequest()),
            (dumbbell(), 12.0, SEQUENCE),
            (block(center_of_mass_offset_mm=(0, 20, 0)), 10.0, FrameRequest()),
            (block(size_mm=(150, 60, 100)), 10.0, FrameRequest()),
            (block(), 2.0, SEQUENCE),
        ]

        def trace(simulator: GraspSimulator, k: int) -> bytes:
            obj, force_n, frames = asked[k]
            return as_bytes(
                grasp(simulator, obj, force_n=force_n, x_mm=2.0, z_mm=30.0, frames=frames)
            )

        fresh = []
        for k in range(len(asked)):
            with GraspSimulator() as simulator:
                fresh.append(trace(simulator, k))
        with GraspSimulator() as simulator:
            for k in (4, 0, 3, 1, 2, 0, 4, 2, 1):
                assert trace(simulator, k) == fresh[k], f"grasp {k} differs"

    def test_two_simulators_do_not_disturb_each_other(self) -> None:
        with GraspSimulator() as first:
            alone = as_bytes(grasp(first, block()))
            with GraspSimulator("ur5e_wsg50") as second:
                grasp(second, block(), force_n=3.0)
                assert as_bytes(grasp(first, block())) == alone

    @pytest.mark.slow
    def test_memory_does_not_grow(self) -> None:
        def resident_kb() -> int:
            return int(Path("/proc/self/statm").read_text().split()[1]) * 4

        if not Path("/proc/self/statm").exists():
            pytest.skip("needs /proc")
        with GraspSimulator() as simulator:
            for _ in range(20):
                grasp(simulator, dumbbell(), z_mm=30.0)
            before = resident_kb()
            for _ in range(60):
                grasp(simulator, dumbbell(), z_mm=30.0)
            # 10 kB a grasp would be 10 MB over a thousand; PyBullet itself keeps about 0.3 kB.
            assert resident_kb() - before < 60 * 10


class TestBadInput:
    @pytest.mark.parametrize(
        ("force_n", "words"),
        [
            (50.0, "force_n = 50 exceeds max_force_n = 40; lower it or raise max_force_n"),
            (0.0, "force_n = 0 is not a force to grip with; ask for more than 0 N"),
            (float("nan"), "force_n = nan is not a force to grip with"),
        ],
    )
    def test_forces_out_of_range(
        self, simulator: GraspSimulator, force_n: float, words: str
    ) -> None:
        with pytest.raises(PhysicsError) as caught:
            grasp(simulator, block(), force_n=force_n)
        assert words in str(caught.value)
        assert "grasp 0 of 'block'" in str(caught.value)

    def test_every_fault_of_an_object_is_named(self, simulator: GraspSimulator) -> None:
        broken = replace(
            block(),
            collision=(),
            mass_kg=-1.0,
            friction=-0.1,
            inertia_kg_mm2=np.diag([1.0, 1.0, 5.0]),
        )
        with pytest.raises(PhysicsError) as caught:
            grasp(simulator, broken)
        for words in (
            "has no collision part; add at least one convex part",
            "mass_kg = -1 is not above 0; weigh the object",
            "friction = -0.1 is negative",
            "principal moments 1, 1, 5, which no body has",
        ):
            assert words in str(caught.value)

    def test_every_fault_of_the_settings_is_named(self, simulator: GraspSimulator) -> None:
        settings = PhysicsSettings(
            time_step_s=0.0,
            hold_s=-1.0,
            success_rise_mm=200.0,
            pad_dome_radius_mm=5.0,
            contact_average_steps=0,
        )
        with pytest.raises(PhysicsError) as caught:
            grasp(
                simulator,
                block(),
                force_n=99.0,
                settings=settings,
                frames=FrameRequest("sequence", 0, -1.0),
            )
        for words in (
            "physics.time_step_s = 0 is not above 0; raise it",
            "physics.contact_average_steps = 0 is not above 0",
            "physics.hold_s = -1 is below 0; give 0 or more",
            "physics.success_rise_mm = 200 is not reached by lift_mm = 180; lift further",
            "physics.pad_dome_radius_mm = 5 cannot span the pad; give at least 20",
            "frames.count = 0 is below 1",
            "frames.span_s = -1 is not above 0",
            "force_n = 99 exceeds max_force_n = 40",
        ):
            assert words in str(caught.value)

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
        with pytest.raises(PhysicsError, match="known: wsg50, ur5e_wsg50"):
            GraspSimulator("panda")  # type: ignore[arg-type]

    def test_a_closed_simulator(self) -> None:
        with pytest.raises(PhysicsError, match="use it in a `with` block"):
            run_grasp(
                GraspSimulator(),
                block(),
                GraspConfig(0, "block", 5.0, 0.0, 0.0, 50.0),
                PhysicsSettings(),
                frames=FrameRequest(),
            )
