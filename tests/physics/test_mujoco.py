"""The same grasps in MuJoCo: closed forms, repeatability, and life without PyBullet."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import trimesh

from tacgen.core.errors import PhysicsError
from tacgen.core.records import GraspObject
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings

from .conftest import GRAVITY_M_S2, block, dumbbell, grasp, hull_mesh
from .test_closed_forms import mass_is_lifted
from .test_repeatability import as_bytes

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = PhysicsSettings(engine="mujoco", tactile_pads="both")
FRICTIONS = (0.2, 0.4, 0.8)


@pytest.fixture(scope="module")
def simulator() -> Iterator[GraspSimulator]:
    with GraspSimulator("wsg50", "mujoco") as opened:
        yield opened


def solid(shape: str) -> GraspObject:
    """A cylinder of 256 sections on its base, or a ball, of 0.3 kg."""
    if shape == "cylinder":
        mesh = trimesh.creation.cylinder(radius=33.0, height=100.0, sections=256)
    else:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=25.0)
    mesh.apply_translation([0.0, 0.0, -mesh.bounds[0, 2]])
    part = hull_mesh(mesh.vertices)
    return replace(
        block(),
        surface=part,
        collision=(part,),
        center_of_mass_mm=mesh.center_mass,
        inertia_kg_mm2=mesh.moment_inertia * 0.3 / mesh.mass,
    )


class TestClosedForms:
    @pytest.mark.slow
    @pytest.mark.parametrize("friction", FRICTIONS)
    def test_two_fingers_hold_what_coulomb_allows(
        self, simulator: GraspSimulator, friction: float
    ) -> None:
        lifted = mass_is_lifted(simulator, friction, SETTINGS)
        assert lifted(0.97)
        assert not lifted(1.03)

    @pytest.mark.slow
    @pytest.mark.parametrize("friction", FRICTIONS)
    @pytest.mark.parametrize("shape", ["cylinder", "ball"])
    def test_round_objects_hold_from_the_same_force(
        self, simulator: GraspSimulator, shape: str, friction: float
    ) -> None:
        obj = replace(solid(shape), friction=friction)
        least_n = obj.mass_kg * GRAVITY_M_S2 / (2 * friction)
        height_mm = float(obj.center_of_mass_mm[2])

        def label(ratio: float) -> int:
            force_n = ratio * least_n
            return grasp(simulator, obj, force_n=force_n, z_mm=height_mm, settings=SETTINGS).label

        assert label(0.97) == 0
        assert label(1.03) == 1

    @pytest.mark.slow
    @pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
    def test_an_off_centre_grasp_turns_where_the_patch_gives_way(
        self, simulator: GraspSimulator, share: float
    ) -> None:
        """m g d = 2 s F √(1 − share²), as of PyBullet; here a patch turns and slides at once."""
        friction, force_n, spinning_mm = 0.5, 20.0, 2.0
        weight_n = share * 2 * friction * force_n
        limit_mm = 2 * spinning_mm * force_n * (1 - share**2) ** 0.5 / weight_n

        def label(ratio: float) -> int:
            obj = block(
                mass_kg=weight_n / GRAVITY_M_S2,
                friction=friction,
                spinning_friction_mm=spinning_mm,
                center_of_mass_offset_mm=(0.0, ratio * limit_mm, 0.0),
            )
            return grasp(simulator, obj, force_n=force_n, settings=SETTINGS).label

        assert label(0.95) == 1
        assert label(1.05) == 0

    @pytest.mark.parametrize("force_n", [2.0, 12.0, 40.0])
    def test_each_pad_presses_with_the_commanded_force(
        self, simulator: GraspSimulator, force_n: float
    ) -> None:
        sequence = FrameRequest("sequence", 16, 3.0)
        trace = grasp(
            simulator, block(mass_kg=0.1), force_n=force_n, x_mm=2.0, settings=SETTINGS,
            frames=sequence,
        )  # fmt: skip
        for pad in ("left", "right"):
            held = [f.force_normal_n for f in trace.frames[pad] if f.time_s > 0.5]
            assert held == pytest.approx([force_n] * len(held), rel=0.02)

    def test_a_light_block_in_a_strong_grip_does_not_creep(self, simulator: GraspSimulator) -> None:
        obj = block(mass_kg=0.002, size_mm=(30.0, 30.0, 30.0))
        trace = grasp(simulator, obj, force_n=20.0, z_mm=15.0, settings=SETTINGS)
        assert trace.rise_mm == pytest.approx(180.0, abs=0.05)
        assert trace.turn_rad < 1e-3
        # Both pads together sink in by 2 × 20 N / (1000 N/mm), less than 0.1 mm.
        poses = [trace.frames[pad][0].pose_gel_object[2, 3] for pad in ("left", "right")]
        assert poses == pytest.approx([15.0, 15.0], abs=0.1)

    def test_a_soft_pad_sinks_in_by_force_over_stiffness(self, simulator: GraspSimulator) -> None:
        soft = replace(SETTINGS, pad_stiffness_n_mm=40.0)
        rigid, given = (
            grasp(simulator, block(), force_n=20.0, settings=one).frames for one in (SETTINGS, soft)
        )
        sunk_mm = sum(
            rigid[pad][0].pose_gel_object[2, 3] - given[pad][0].pose_gel_object[2, 3]
            for pad in ("left", "right")
        )
        assert sunk_mm == pytest.approx(2 * 20.0 / 40.0, rel=0.1)


class TestEngine:
    def test_a_grasp_does_not_remember_those_before_it(self, simulator: GraspSimulator) -> None:
        first = as_bytes(grasp(simulator, dumbbell(), z_mm=30.0, settings=SETTINGS))
        grasp(simulator, block(), force_n=2.0, settings=SETTINGS)
        assert as_bytes(grasp(simulator, dumbbell(), z_mm=30.0, settings=SETTINGS)) == first

    def test_reasons_are_those_of_pybullet(self, simulator: GraspSimulator) -> None:
        broad = grasp(simulator, block(size_mm=(150.0, 60.0, 100.0)), settings=SETTINGS)
        assert (broad.status, broad.label) == ("unreachable", -1)
        assert "wider there than the stroke of 110 mm" in broad.reason
        beside = grasp(simulator, block(), y_mm=70.0, settings=SETTINGS)
        assert (beside.status, beside.label) == ("no_contact", -1)
        assert beside.reason == "the pads met with nothing between them"

    def test_the_arm_is_refused(self) -> None:
        with pytest.raises(
            PhysicsError, match=r"has no robot 'ur5e_wsg50'; set `robot: \{name: ws"
        ):
            GraspSimulator("ur5e_wsg50", "mujoco")

    def test_settings_of_another_engine_are_refused(self, simulator: GraspSimulator) -> None:
        with pytest.raises(PhysicsError, match="ask for the engine 'pybullet', the simulator has"):
            grasp(simulator, block(), settings=PhysicsSettings())

    def test_an_unknown_engine(self) -> None:
        with pytest.raises(PhysicsError, match="known: auto, pybullet, mujoco"):
            GraspSimulator("wsg50", "bullet")  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize(("missing", "engine", "code"), [
    ("pybullet", "mujoco", 0), ("pybullet", "auto", 0), ("pybullet", "pybullet", 2),
    ("mujoco", "mujoco", 2),
])  # fmt: skip
def test_collect_needs_its_own_engine_alone(
    missing: str, engine: str, code: int, tmp_path: Path
) -> None:
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / f"{missing}.py").write_text("raise ImportError('hidden')\n")
    (tmp_path / "recipe.yaml").write_text(
        "name: one\nobjects: [golf_ball]\ngrid: {sample: 1}\n"
        f"physics: {{engine: {engine}}}\nsensor: gelsight_mini\n"
    )
    path = os.pathsep.join([str(tmp_path / "hidden"), str(ROOT)])
    result = subprocess.run(
        [sys.executable, "-m", "tacgen", "collect", "recipe.yaml", "--out", "data"],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert result.returncode == code, result.stderr
    if code:
        assert "pip install" in result.stderr
        assert f"physics: {{engine: {'mujoco' if engine == 'pybullet' else 'pybullet'}}}" in (
            result.stderr
        )
    else:
        assert list((tmp_path / "data" / "shards").glob("*.h5"))
