"""Labels, margins, bodies and the world, without a whole grasp."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from tacgen.core.errors import PhysicsError
from tacgen.core.records import PADS, Mesh
from tacgen.core.types import FloatArray, inverse, pose, rotation_of
from tacgen.physics import GraspSimulator, PhysicsSettings
from tacgen.physics.contacts import Contacts, contacts_of
from tacgen.physics.engine import TABLE, GripperTarget
from tacgen.physics.gripper import outline_of
from tacgen.physics.margins import TorsionLimit, grasp_capacity, slip_margin, torsion_factor
from tacgen.physics.outcome import Motion, failure_mode, first_slip, label_of
from tacgen.physics.pybullet_import import require_numpy
from tacgen.physics.world import ball_of, principal_axes
from tests.messages import refused

from .conftest import GRAVITY_M_S2, block

SETTINGS = PhysicsSettings()
X_AXIS = np.array([1.0, 0.0, 0.0])


def motion(slide_mm: list[float], turn_rad: list[float], *, drift_mm: float = 0.0) -> Motion:
    count = len(slide_mm)
    down = np.stack([np.full(count, drift_mm), np.array(slide_mm)], axis=1)
    return Motion(
        time_s=np.arange(count, dtype=np.float64) * 0.5,
        rise_mm=180.0 - np.array(slide_mm),
        turn_rad=np.array(turn_rad),
        slide_mm=down,
        center_slide_mm=np.stack([np.linspace(0, 3, count), np.linspace(0, 4, count)], axis=1),
    )


class TestLabels:
    @pytest.mark.parametrize(
        ("rise_mm", "turn_rad", "label"),
        [(150.0, 0.0999, 1), (149.99, 0.0, 0), (180.0, 0.1, 0), (180.0, 0.0, 1)],
    )
    def test_the_limits_are_15_cm_and_a_tenth_of_a_radian(
        self, rise_mm: float, turn_rad: float, label: int
    ) -> None:
        assert label_of(rise_mm, turn_rad, SETTINGS) == label

    def test_the_limit_passed_first_names_the_failure(self) -> None:
        dropped = motion([0, 20, 40, 180], [0, 0.02, 0.05, 2.0])
        assert failure_mode(dropped, SETTINGS) == "translational_slip"
        swung = motion([0, 2, 20, 40], [0, 0.2, 0.9, 1.4])
        assert failure_mode(swung, SETTINGS) == "rotational_slip"

    def test_the_first_slip_has_a_time_and_a_direction(self) -> None:
        time_s, direction = first_slip(motion([0, 0.2, 0.8, 3], [0, 0, 0, 0]), SETTINGS)
        assert time_s == 1.0
        assert direction == pytest.approx([0.0, 1.0])
        # Turning about the pad: the direction is where the centre of mass goes.
        time_s, direction = first_slip(motion([0, 0, 0, 0], [0, 0.02, 0.1, 0.2]), SETTINGS)
        assert time_s == 0.5
        assert direction == pytest.approx([0.6, 0.8])
        time_s, direction = first_slip(motion([0, 0, 0, 0.1], [0, 0, 0, 0.001]), SETTINGS)
        assert np.isnan(time_s)
        assert direction.tolist() == [0.0, 0.0]


def pad_contacts(point_m: FloatArray, normal: FloatArray, normal_force_n: FloatArray) -> Contacts:
    parts = np.full(len(point_m), "left")
    return Contacts(parts, point_m, normal, normal_force_n, normal_force_n[:, None] * normal)


def flat_pads(force_n: float) -> tuple[Contacts, ...]:
    return tuple(
        pad_contacts(
            point_m=np.array([[side * 0.03, 0.0, 0.05]]),
            normal=np.array([[-side, 0.0, 0.0]]),
            normal_force_n=np.array([force_n]),
        )
        for side in (-1.0, 1.0)
    )


def holding(
    pads: tuple[Contacts, ...], spinning_friction_mm: float
) -> list[tuple[Contacts, TorsionLimit]]:
    return [(pad, lambda share: spinning_friction_mm * torsion_factor(share)) for pad in pads]


class TestMargins:
    def test_flat_pads_have_the_textbook_limits(self) -> None:
        capacity = grasp_capacity(
            holding(flat_pads(10.0), 2.0),
            closing_axis=X_AXIS,
            center_of_mass_m=np.array([0.004, 0.012, 0.02]),
            weight_n=0.3 * GRAVITY_M_S2,
            friction=0.5,
            success_turn_rad=0.1,
        )
        weight_n = 0.3 * GRAVITY_M_S2
        assert capacity.friction_limit_n == pytest.approx(2 * 0.5 * 10)
        assert capacity.tangential_load_n == pytest.approx(weight_n)
        # Only the offset across the closing axis and across gravity turns the object.
        assert capacity.moment_n_mm == pytest.approx(weight_n * 12.0)
        share = weight_n / 10.0
        assert capacity.torsion_limit_n_mm == pytest.approx(40.0 * np.sqrt(1 - share**2))
        margin = slip_margin(capacity, 0.3, float("nan"), np.zeros(2))
        # Without the weight's share of the friction the pads hold 2 mm for each newton.
        assert margin.whole_torsion_ratio == pytest.approx(40.0 / (weight_n * 12.0))
        assert margin.translational == pytest.approx((10 - weight_n) / weight_n)

    @pytest.mark.parametrize(("height_mm", "lever_mm"), [(-30.0, 10.5), (0.0, 12.0), (30.0, 12.0)])
    def test_what_hangs_below_the_pads_is_caught_again(
        self, height_mm: float, lever_mm: float
    ) -> None:
        """The mean over 0.1 rad of the lever of a mass 12 mm beside the pads and so much above."""
        for side in (-1.0, 1.0):
            capacity = grasp_capacity(
                holding(flat_pads(10.0), 2.0),
                closing_axis=X_AXIS,
                center_of_mass_m=np.array([0.004, side * 0.012, 0.05 + height_mm / 1000]),
                weight_n=0.3 * GRAVITY_M_S2,
                friction=0.5,
                success_turn_rad=0.1,
            )
            weight_n = 0.3 * GRAVITY_M_S2
            assert capacity.swing_moment_n_mm == pytest.approx(weight_n * lever_mm)
            margin = slip_margin(capacity, 0.3, float("nan"), np.zeros(2))
            assert margin.swing_moment_share == pytest.approx(lever_mm / 12.0)

    def test_slanted_faces_carry_weight_or_add_to_it(self) -> None:
        def load_n(tilt_rad: float) -> float:
            pads = tuple(
                replace(
                    pad,
                    normal=np.array([[pad.normal[0, 0] * np.cos(tilt_rad), 0.0, np.sin(tilt_rad)]]),
                )
                for pad in flat_pads(10.0)
            )
            return grasp_capacity(
                holding(pads, 0.0),
                closing_axis=X_AXIS,
                center_of_mass_m=np.array([0.0, 0.0, 0.05]),
                weight_n=0.5 * GRAVITY_M_S2,
                friction=0.5,
                success_turn_rad=0.1,
            ).tangential_load_n

        weight_n = 0.5 * GRAVITY_M_S2
        assert load_n(0.1) == pytest.approx(weight_n - 20 * np.sin(0.1))
        assert load_n(-0.1) == pytest.approx(weight_n + 20 * np.sin(0.1))

    def test_spread_contact_points_resist_turning_by_friction(self) -> None:
        radius_m = 0.006
        pads = tuple(
            pad_contacts(
                point_m=np.array(
                    [[x, radius_m, 0.05], [x, -radius_m, 0.05], [x, 0, 0.056], [x, 0, 0.044]]
                ),
                normal=np.tile([[-np.sign(x), 0.0, 0.0]], (4, 1)),
                normal_force_n=np.full(4, 2.5),
            )
            for x in (-0.03, 0.03)
        )
        capacity = grasp_capacity(
            holding(pads, 0.0),
            closing_axis=X_AXIS,
            center_of_mass_m=np.array([0.0, 0.0, 0.05]),
            weight_n=1e-6 * GRAVITY_M_S2,
            friction=0.5,
            success_turn_rad=0.1,
        )
        assert capacity.torsion_limit_n_mm == pytest.approx(0.5 * 20 * 6.0)


class TestBodies:
    def test_principal_axes_diagonalise(self) -> None:
        rng = np.random.default_rng(1)
        raw = rng.normal(size=(3, 3))
        inertia = raw @ raw.T + np.eye(3)
        moments, axes = principal_axes(inertia)
        assert axes @ np.diag(moments) @ axes.T == pytest.approx(inertia)
        assert np.linalg.det(axes) == pytest.approx(1.0)

    def test_the_body_stands_where_the_object_says(self, simulator: GraspSimulator) -> None:
        obj = block(yaw_rad=0.4, center_of_mass_offset_mm=(3.0, -4.0, 7.0))
        body, _ = simulator.world.build(obj, SETTINGS, 1.0)
        position, quaternion = body.inertial_position()
        assert np.array(position) * 1000 == pytest.approx(obj.center_of_mass_mm, abs=1e-4)
        moments, axes = principal_axes(obj.inertia_kg_mm2)
        inertial = pose(axes, obj.center_of_mass_mm / 1000)
        frame = pose(rotation_of(quaternion), position) @ inverse(inertial)
        assert frame == pytest.approx(np.eye(4), abs=1e-6)
        assert body.principal_moments_kg_m2 * 1e6 == pytest.approx(moments, rel=1e-6)

    def test_pybullet_holds_the_moments_of_inertia(self, bullet_world: Any) -> None:
        obj = block(yaw_rad=0.4)
        body, _ = bullet_world.build(obj, SETTINGS, 1.0)
        held = bullet_world.bullet.getDynamicsInfo(body.body, -1)
        moments, _ = principal_axes(obj.inertia_kg_mm2)
        assert np.array(held[2]) * 1e6 == pytest.approx(moments, rel=1e-6)


class TestWorld:
    def test_surfaces_are_where_the_geometry_says(self, simulator: GraspSimulator) -> None:
        """No collision margin between the table, the object and the pads.

        MuJoCo's rigid pads begin to press farther out by 1.5 μ v b over their stiffness for each
        kilogram, the force that keeps a sliding touch (b of 100 1/s, 2.4 time steps).
        """
        _, robot = simulator.world.build(block(), SETTINGS, 1.0)
        robot.place(GripperTarget(0.0, 0.0, 0.05, 0.0))
        robot.fingers.place(0.0)
        near_m = dict(simulator.world.distances(0.1))
        out_m = 0.0
        if simulator.engine == "mujoco":
            slide_m_s = 1.5 * block().friction * SETTINGS.lift_speed_mm_s / 1000
            out_m = slide_m_s * 100.0 * (2.4 * SETTINGS.time_step_s) ** 2
        for pad in PADS:
            # A convex distance in MuJoCo is as exact as its solver's tolerance of 1 µm.
            assert near_m[outline_of(pad)] == pytest.approx(0.055 - 0.030 - out_m, abs=2e-6)
            (touch,) = simulator.world.touches(pad, 0.1)
            assert touch.gap_m == pytest.approx(0.055 - 0.030, abs=2e-6)
            assert touch.normal == pytest.approx([1.0 if pad == "left" else -1.0, 0, 0], abs=1e-6)

    def test_a_resting_object_presses_the_table_with_its_weight(
        self, simulator: GraspSimulator
    ) -> None:
        _, robot = simulator.world.build(block(mass_kg=0.4), SETTINGS, 1.0)
        robot.place(GripperTarget(0.0, 0.0, 0.3, 0.0))
        robot.prepare_lift(0.0)
        simulator.world.step(480)
        contacts = contacts_of(simulator.world.contacts())
        weight_n = 0.4 * GRAVITY_M_S2
        assert contacts.force_n.sum(axis=0) == pytest.approx([0, 0, weight_n], abs=1e-3)
        assert set(contacts.part) == {TABLE}

    def test_a_pybullet_without_numpy_is_refused_with_the_mend(self) -> None:
        without = SimpleNamespace(isNumpyEnabled=lambda: 0)
        with refused(PhysicsError):
            require_numpy(without)  # type: ignore[arg-type]


@pytest.mark.parametrize("center_mm", [(0.0, 0.0, 0.0), (3.0, -2.0, 21.0)])
@pytest.mark.parametrize("subdivisions", [2, 3])
def test_the_hull_of_a_ball_is_a_ball(center_mm, subdivisions):
    solid = trimesh.creation.icosphere(subdivisions=subdivisions, radius=21.0)
    center, radius = ball_of(Mesh(solid.vertices + center_mm, np.asarray(solid.faces, np.int32)))
    np.testing.assert_allclose(center, center_mm, atol=1e-9)
    assert radius == pytest.approx(21.0, abs=1e-9)


@pytest.mark.parametrize(
    "solid",
    [
        trimesh.creation.box((20.0, 20.0, 20.0)),  # its corners lie on a sphere too
        trimesh.creation.icosahedron(),
        trimesh.creation.capsule(height=5.0, radius=20.0),
        trimesh.creation.icosphere(subdivisions=3).apply_scale((20.0, 20.0, 20.4)),
    ],
)
def test_what_is_no_ball_keeps_its_hull(solid):
    assert ball_of(Mesh(solid.vertices, np.asarray(solid.faces, np.int32))) is None
