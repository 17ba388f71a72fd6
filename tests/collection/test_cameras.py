"""Cameras of a recipe: where they are, what they see of a grasp, and what is refused."""

import math
from dataclasses import replace
from typing import get_args

import h5py
import numpy as np
import pytest

import tacgen
from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.collection.run import collect
from tacgen.collection.scene import cameras_of, pose_matrix, scene_solids
from tacgen.core.errors import DatasetError, RecipeError
from tacgen.core.records import PADS
from tacgen.dataset import Dataset
from tacgen.dataset.schema import SEGMENTS
from tacgen.dataset.summary import summarize, validity_lines
from tacgen.dataset.verify import verify
from tacgen.physics.settings import EngineName
from tests.messages import refused
from tests.small_world import write_world

FRONT = "{name: front, look_at: {from_mm: [300, -300, 200], to_mm: [0, 0, 80]}}"
TOP = (
    "{name: top, size_px: [60, 90], fov_deg: 60, look_at: {from_mm: [0, 0, 600], to_mm: [0, 0, 0]}}"
)


TIMES = {
    "frames": "{mode: sequence, count: 4}",
    "grid": "{force_n: [3, 25], y_mm: [0], z_mm: [90]}",
}


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def camera_of(**given):
    recipe = Recipe.model_validate(
        {"name": "c", "objects": ["cup"], "scene": {"cameras": [{"name": "c", **given}]}}
    )
    (camera,) = cameras_of(recipe)
    return camera


def looking(from_mm, to_mm, **given):
    return camera_of(look_at={"from_mm": from_mm, "to_mm": to_mm}, **given)


def projected(camera, point_mm):
    """Column, row and depth of a point in the world, by the stated intrinsics and pose."""
    seen = np.linalg.inv(camera.t_world_camera_mm) @ [*point_mm, 1.0]
    return *(camera.k_px @ seen[:3] / seen[2])[:2], seen[2]


def test_the_point_that_is_looked_at_is_in_the_middle_with_z_upwards():
    camera = looking([300, -200, 250], [10, 20, 40], size_px=[96, 128])
    column, row, depth_mm = projected(camera, [10, 20, 40])
    assert (column, row) == pytest.approx((63.5, 47.5))
    assert depth_mm == pytest.approx(math.dist([300, -200, 250], [10, 20, 40]))
    above = projected(camera, [10, 20, 60])
    assert above[0] == pytest.approx(63.5)
    assert above[1] < row
    assert np.linalg.det(camera.t_world_camera_mm[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize("nearly", [0.0, 1e-4])
def test_straight_down_the_upper_side_is_world_y(nearly):
    camera = looking([0, -nearly, 500], [0, 0, 0], size_px=[100, 100])
    right, up = projected(camera, [50, 0, 0]), projected(camera, [0, 50, 0])
    assert right[0] > 60
    assert right[1] == pytest.approx(49.5, abs=1e-3)
    assert up[1] < 40
    assert up[0] == pytest.approx(49.5, abs=1e-3)


def test_the_edges_of_the_picture_are_at_the_angle_of_view():
    """Half the picture is tan(fov / 2) of the distance, from edge to edge of the outer pixels."""
    camera = looking([0, -400, 100], [0, 0, 100], size_px=[90, 160], fov_deg=50)
    half_mm = 400 * math.tan(math.radians(25))
    assert projected(camera, [0, 0, 100 + half_mm])[1] == pytest.approx(-0.5, abs=1e-4)
    assert projected(camera, [0, 0, 100 - half_mm])[1] == pytest.approx(89.5, abs=1e-4)
    wide_mm = half_mm * 160 / 90
    assert projected(camera, [wide_mm, 0, 100])[0] == pytest.approx(159.5, abs=1e-4)


def _pose(rotation, place=(0, 0, 300), last=(0, 0, 0, 1)):
    rows = [[*map(float, row), float(x)] for row, x in zip(rotation, place, strict=True)]
    return [*rows, list(last)]


DOWN = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
BAD = {
    "{name: a}": "is placed by one of `look_at` and `pose`",
    f"{{name: a, pose: {_pose(DOWN)}, look_at: {{from_mm: [0, 0, 9], to_mm: [0, 0, 0]}}}}": "one",
    f"{{name: a, pose: {_pose([[1, 0, 0], [0, -1, 0.2], [0, 0, -1]])}}}": "axes are 1, 1, 1.02",
    f"{{name: a, pose: {_pose([[1, 0, 0], [0, 1, 0], [0, 0, -1]])}}}": "pose is no .* mirrors",
    f"{{name: a, pose: {_pose(DOWN, last=(0, 0, 1, 1))}}}": r"pose has the last row",
    f"{{name: a, pose: {_pose(DOWN)[:3]}}}": "pose",
    "{name: a, look_at: {from_mm: [1, 2, 3], to_mm: [1, 2, 3]}}": "to_mm is where the camera is",
    "{name: a, look_at: {from_mm: [300, 0, -40], to_mm: [0, 0, 3]}}": "40 mm below the table's top",
    "{name: a, look_at: {from_mm: [300, 0, 0], to_mm: [0, 0, 3]}}": "is 0 mm below the table's top",
    "{name: a, look_at: {from_mm: [0, 0, 90], to_mm: [0, 0, 0]}}": "is inside 'sugar_box'",
    "{name: 'a/b', look_at: {from_mm: [300, 0, 90], to_mm: [0, 0, 0]}}": r"name.*must match",
    "{name: a, size_px: [96, 4000], look_at: {from_mm: [300, 0, 90], to_mm: [0, 0, 0]}}": "2048",
    "{name: a, size_px: [4, 40], look_at: {from_mm: [300, 0, 90], to_mm: [0, 0, 0]}}": "at least 8",
    "{name: a, fov_deg: 170, look_at: {from_mm: [300, 0, 90], to_mm: [0, 0, 0]}}": "at most 150",
    f"{FRONT}, {FRONT}": "'front' is given twice",
    ", ".join(FRONT.replace("front", f"c{k}") for k in range(9)): "at most 8",
}


@pytest.mark.parametrize("cameras", BAD)
def test_a_camera_that_cannot_be_is_refused_with_one_message(tmp_path, cameras):
    path = write_world(tmp_path, scene=f"{{cameras: [{cameras}]}}")
    with refused(RecipeError):
        load_recipe(path)


@pytest.mark.parametrize("engine", get_args(EngineName))
@pytest.mark.parametrize("robot", ["wsg50", "ur5e_wsg50"])
def test_pads_are_drawn_where_their_gels_press(tmp_path, engine, robot):
    """By the gripper's pose and opening as by the object's pose and what each gel sees of it."""
    pytest.importorskip(engine)
    path = write_world(
        tmp_path,
        robot=f"{{name: {robot}, tactile_pads: both}}",
        frames="{mode: sequence, count: 3}",
        physics=f"{{engine: {engine}, lift_mm: 40, success_rise_mm: 30}}",
        grid="{force_n: [25], y_mm: [0], z_mm: [90], yaw_rad: [0.3]}",
    )
    recipe = load_recipe(path)
    with GraspPipeline(recipe) as pipeline:
        grasp = pipeline.simulate(plan_recipe(recipe)[0])
        gripper = pipeline.simulator.robot.gripper
    trace = grasp.trace
    assert trace.status == "executed"
    for k in range(3):
        gripper_in_world = pose_matrix(trace.gripper_pose[k])
        for pad, distance_mm in zip(PADS, trace.pad_distance_mm[k], strict=True):
            object_in_gel = trace.frames[pad][k].pose_gel_object
            gel = pose_matrix(trace.object_pose[k]) @ np.linalg.inv(object_in_gel)
            side = gripper.side(pad).side
            place_mm = gripper_in_world @ [side * distance_mm, 0, 0, 1]
            np.testing.assert_allclose(place_mm, gel[:, 3], atol=1e-6)
            # The pad's box begins there and lies behind it, away from the object.
            number = SEGMENTS.index(f"{pad} pad")
            solids = scene_solids(grasp.grasped, trace, k, gripper)
            (drawn,) = [one.vertices_mm for one in solids if one.segment == number]
            along_mm = (drawn - gel[:3, 3]) @ gel[:3, 2]
            assert along_mm.max() == pytest.approx(0, abs=1e-6)
            assert along_mm.min() == pytest.approx(-gripper.pad.depth_mm, abs=1e-6)


def test_fingers_that_lost_their_object_meet_and_go_no_farther(tmp_path):
    recipe = load_recipe(write_world(tmp_path, **TIMES))
    with GraspPipeline(recipe) as pipeline:
        grasp = pipeline.simulate(plan_recipe(recipe)[0])
        gripper = pipeline.simulator.robot.gripper
    trace = replace(grasp.trace, pad_distance_mm=np.full((4, 2), -25.0))
    gripper_in_world = pose_matrix(trace.gripper_pose[3])
    for pad in PADS:
        number = SEGMENTS.index(f"{pad} pad")
        (drawn,) = [
            one.vertices_mm
            for one in scene_solids(grasp.grasped, trace, 3, gripper)
            if one.segment == number
        ]
        along_mm = (drawn - gripper_in_world[:3, 3]) @ gripper_in_world[:3, 0]
        outward_mm = gripper.side(pad).side * along_mm
        assert outward_mm.min() == pytest.approx(0.0, abs=1e-6)
        assert outward_mm.max() == pytest.approx(gripper.pad.depth_mm, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("engine", get_args(EngineName))
def test_a_dataset_holds_what_the_cameras_see(tmp_path, engine):
    pytest.importorskip(engine)
    sections = TIMES | {"physics": f"{{engine: {engine}, lift_mm: 40, success_rise_mm: 30}}"}
    data = {}
    for frames in ("all", "grasp"):
        scene = f"{{cameras: [{FRONT}, {TOP}], frames: {frames}}}"
        recipe = load_recipe(write_world(tmp_path, scene=scene, **sections))
        tacgen.collect(recipe, tmp_path / frames)
        assert not verify(tmp_path / frames, decode=True).problems
        data[frames] = Dataset(tmp_path / frames)
    every, moment = data["all"], data["grasp"]
    assert set(every.cameras) == {"front", "top"}
    assert every.cameras["top"].shape_px == (60, 90)
    with h5py.File(every.root / every.lines[0].file) as file:
        seen = file["/camera/front"]
        assert seen["rgb"].shape == (2, 4, 96, 128, 3)
        assert (seen["depth_mm"].dtype, seen["depth_mm"].attrs["unit"]) == (np.float32, "mm")
        assert seen["segmentation"].attrs["names"].decode().split(",") == list(SEGMENTS)
        np.testing.assert_array_equal(seen["rgb"].attrs["K"], every.cameras["front"].k_px)
        pose = seen["depth_mm"].attrs["T_world_camera"]
        np.testing.assert_array_equal(pose[:3, 3], [300, -300, 200])
    for index in map(int, every.indices):
        sample, k = every.read(index), every.read(index).grasp_frame
        for name in every.views:
            whole = every.view(index, name)
            np.testing.assert_array_equal(moment.view(index, name), whole[k])
            np.testing.assert_array_equal(moment.view(index, name, k), whole[k])
            np.testing.assert_array_equal(moment[index][name], whole[k])
        with refused(DatasetError):
            moment.view(index, "camera/top/rgb", k + 1)
        # The object is where its pose says: the middle of its pixels, and their depth.
        for j in (k, 3):
            camera = every.cameras["front"]
            box_mm = sample.object_pose[j, :3] + (0, 0, 87)  # a sugar box of 175 mm
            column, row, depth_mm = projected(camera, box_mm)
            seen = np.argwhere(sample.cameras["front"].segmentation[j] == SEGMENTS.index("object"))
            assert np.abs(seen.mean(axis=0) - (row, column)).max() < 8
            depths_mm = sample.cameras["front"].depth_mm[j][tuple(seen.T)]
            assert abs(np.median(depths_mm) - depth_mm) < 40
    # Seen from above, before the lift, the table around is 600 mm away at every pixel.
    table = every.read(0).cameras["top"]
    is_table = table.segmentation[0] == SEGMENTS.index("table")
    assert is_table.mean() > 0.5
    assert (table.depth_mm[0][is_table] == 600).all()


@pytest.mark.slow
def test_a_camera_that_looks_away_is_told(tmp_path):
    away = "{name: away, look_at: {from_mm: [300, -300, 200], to_mm: [600, -600, 200]}}"
    path = write_world(
        tmp_path,
        grid="{force_n: [25], y_mm: [0], z_mm: [90]}",
        scene=f"{{cameras: [{FRONT}, {away}]}}",
    )
    collect(load_recipe(path), tmp_path / "out", progress=False)
    (line,) = validity_lines(summarize(tmp_path / "out"))
    fix = "correct its pose or look_at"
    assert line == f"camera away shows the object nowhere in the first shard; {fix}"
