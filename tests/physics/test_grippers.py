"""Grippers are YAML files: one that no line of the package names grasps in both engines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from tacgen.collection.recipe import load_recipe
from tacgen.core.errors import PhysicsError, RecipeError
from tacgen.core.resources import gripper_path, packaged
from tacgen.physics import PhysicsSettings
from tacgen.physics.gripper import load_gripper
from tacgen.physics.settings import EngineName
from tests.messages import refused

from .conftest import GRAVITY_M_S2, LIFT_LOAD, SEQUENCE, block, grasp, opened

SHIPPED = sorted(path.stem for path in (packaged("recipes") / "grippers").glob("*.yaml"))
FRANKA = "franka_digit"


def written(folder: Path, **changes: object) -> Path:
    """The shipped WSG-50 with changes, as a user's file."""
    given = yaml.safe_load(gripper_path("wsg50").read_text())
    path = folder / "recipes" / "grippers" / "wsg50.yaml"
    path.parent.mkdir(parents=True)
    path.write_text(yaml.safe_dump(given | changes))
    return path


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_grippers_can_be_read(name: str) -> None:
    gripper = load_gripper(gripper_path(name))
    assert gripper.name == name
    for pad in gripper.sides.values():
        assert np.linalg.det(pad.gel_axes) == pytest.approx(1.0)
    # The palm stands on the fingers, whose boxes lie behind the pads' surface.
    palm = gripper.hand.box
    tops_mm = [box.center_mm[2] + box.size_mm[2] / 2 for box in gripper.finger.boxes]
    assert max(tops_mm) == pytest.approx(palm.center_mm[2] - palm.size_mm[2] / 2)
    fronts_mm = [box.center_mm[0] - box.size_mm[0] / 2 for box in gripper.finger.boxes]
    assert min(fronts_mm) == gripper.pad.depth_mm


@pytest.mark.parametrize("robot", [FRANKA, f"ur5e_{FRANKA}"])
def test_another_gripper_holds_what_coulomb_allows(robot: str, engine: EngineName) -> None:
    with opened(robot, engine) as simulator:
        for ratio, label in ((0.97, 1), (1.03, 0)):
            obj = block(size_mm=(50.0, 50.0, 60.0), mass_kg=ratio * 10.0 / GRAVITY_M_S2)
            trace = grasp(simulator, obj, force_n=10.0, z_mm=35.0, frames=SEQUENCE)
            assert (trace.status, trace.label) == ("executed", label)
            assert trace.margin is not None
            assert trace.margin.friction_ratio == pytest.approx(1 / ratio / LIFT_LOAD, rel=0.005)
        left = trace.frames["left"][0].pose_gel_object
        # Its pads open to 80 mm less the clearance that the approach leaves.
        assert (left @ [-25.0, 0.0, 35.0, 1.0])[:3] == pytest.approx([0, 0, 8.0], abs=0.3)


def test_what_another_gripper_cannot_reach(engine: EngineName) -> None:
    with opened(FRANKA, engine) as simulator:
        broad = grasp(simulator, block(size_mm=(85.0, 50.0, 60.0)), z_mm=35.0)
        assert "wider there than the stroke of 80 mm" in broad.reason
        # 45 mm from the pads' centre to the hand.
        tall = grasp(simulator, block(size_mm=(50.0, 50.0, 100.0)), z_mm=50.0)
        assert "the palm meets the object" in tall.reason
        assert grasp(simulator, block(size_mm=(50.0, 50.0, 90.0)), z_mm=50.0).label == 1


def test_a_recipe_names_its_gripper(tmp_path: Path) -> None:
    path = tmp_path / "recipe.yaml"
    path.write_text(f"name: one\nobjects: [golf_ball]\nrobot: {{name: ur5e_{FRANKA}}}\n")
    recipe = load_recipe(path)
    assert recipe.robot.spec().gripper.name == FRANKA
    # Half of its continuous grasping force of 70 N.
    assert recipe.physics_settings.max_force_n == recipe.resolved()["robot"]["max_force_n"] == 35.0
    path.write_text("name: one\nobjects: [golf_ball]\nrobot: {name: ur5e_frankadigit}\n")
    with refused(RecipeError):
        load_recipe(path)


@pytest.mark.parametrize("change", [
    {"stroke_mm": -5},
    {"stroke": 5},
    {"pads": {"left": {"side": 1, "gel_x": [0, 1, 0], "gel_y": [0, 0, -1]},
               "right": {"side": 1, "gel_x": [0, 1, 0], "gel_y": [0, 0, -1]}}},
    {"pads": {"left": {"side": -1, "gel_x": [0, 1, 0], "gel_y": [0, 0, -1]},
               "right": {"side": 1, "gel_x": [0, 1, 0], "gel_y": [0, 0, -1]}}},
])  # fmt: skip
def test_a_wrong_file_says_what_and_where(change: dict, tmp_path: Path) -> None:
    path = written(tmp_path, **change)
    with refused(RecipeError):
        load_gripper(path)


def test_a_dome_narrower_than_the_pad_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, engine: EngineName
) -> None:
    written(tmp_path, pad={"width_mm": 50.0, "height_mm": 19.0, "depth_mm": 6.0})
    monkeypatch.chdir(tmp_path)
    settings = PhysicsSettings(pad_dome_radius_mm=27.0)
    with opened("wsg50", engine) as simulator:
        assert grasp(simulator, block(), force_n=15.0).label == 1
        with refused(PhysicsError):
            grasp(simulator, block(), settings=settings)
