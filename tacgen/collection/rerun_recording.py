"""One grasp of a dataset as a recording for the Rerun viewer (the extra ``view``)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tacgen.collection.grid import grown_plan
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import load_recipe
from tacgen.collection.scene import finger_boxes, pad_distances_mm, pose_matrix
from tacgen.contact.gel import gel_map_mm, pixel_centers_mm
from tacgen.core.errors import DatasetError, require_extra
from tacgen.core.files import atomic_path
from tacgen.core.records import PADS, GraspConfig, GraspTrace
from tacgen.core.sensors import load_sensor
from tacgen.core.types import pose
from tacgen.dataset import DatasetFolder, GraspSample
from tacgen.dataset.reader import Dataset
from tacgen.physics.gripper import GripperSpec

EYE_MM = (120.0, -180.0, 90.0)  # from the pads' centre: object and fingers fill the view
FORCES = ("normal_n", "shear_x_n", "shear_y_n")
GEL_POINTS = 96  # of the drawn gel along its longer side: a finer grid looks the same


def write_recording(root: Path, index: int, path: Path) -> None:
    """Write the grasp of an index in the recipe's grid as ``.rrd``: lengths in mm, forces in N.

    Images and forces are the dataset's. It does not hold where the gripper and the gels were: for
    that the grasp is simulated again, with the dataset's recipe.

    Raises ``DatasetError`` if Rerun is not installed or there is no such executed grasp.
    """
    require_extra("view", "--rerun needs", DatasetError)
    import rerun as rr

    dataset = Dataset(root, partial=True)
    sample = dataset.read(index)
    if not sample.pads:
        msg = f"{root}: grasp {index} was not executed ({sample.reason or sample.status})"
        raise DatasetError(msg)
    folder = DatasetFolder(root)
    recipe = load_recipe(folder.recipe_path)
    with GraspPipeline(recipe) as pipeline:
        grasp = pipeline.simulate(grown_plan(recipe, folder.grids()).grasps[index])
        imprints = {pad: pipeline.render(grasp, pad)[1] for pad in sample.pads}
    if grasp.trace.status != "executed":
        msg = f"{root}: grasp {index} cannot be simulated again ({grasp.trace.reason})"
        raise DatasetError(msg)

    sensor = load_sensor(recipe.sensor)
    every = max(1, max(sensor.shape_px) // GEL_POINTS)
    x_mm, y_mm = np.meshgrid(*(axis[::every] for axis in pixel_centers_mm(sensor)))
    rest_mm, triangles = gel_map_mm(sensor)[::every, ::every], _grid_triangles(*x_mm.shape)
    gripper = pipeline.simulator.robot.gripper
    surface = grasp.grasped.surface
    mesh = rr.Mesh3D(
        vertex_positions=surface.vertices_mm,
        triangle_indices=surface.faces,
        vertex_normals=trimesh.Trimesh(surface.vertices_mm, surface.faces).vertex_normals,
        albedo_factor=grasp.grasped.color_rgb,
    )
    with atomic_path(path) as partial, rr.RecordingStream("tacgen") as stream:
        stream.save(
            partial,
            default_blueprint=_layout(grasp.config, list(imprints), list(dataset.cameras)),
        )
        stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        stream.log("scene/object", mesh, static=True)
        for finger in PADS:
            stream.log(f"scene/{finger}/finger", _drawn_finger(gripper, finger), static=True)
        _log_cameras(stream, dataset)
        for k, time_s in enumerate(dataset.times_s(index)):
            stream.set_time("time", duration=float(time_s))
            _log_views(stream, sample, k)
            poses = {f"scene/{pad}": _gel_pose(gripper, grasp.trace, k, pad) for pad in PADS}
            poses["scene/object"] = pose_matrix(grasp.trace.object_pose[k])
            for pad, found in imprints.items():
                stored = sample.pads[pad]
                depth_mm = found[k].depth_map_mm(sensor)[::every, ::every]
                points_mm = np.stack([x_mm, y_mm, rest_mm - depth_mm], axis=-1).reshape(-1, 3)
                colors = stored.rgb[k][::every, ::every].reshape(-1, 3)
                gel = rr.Mesh3D(
                    vertex_positions=points_mm, triangle_indices=triangles, vertex_colors=colors
                )
                stream.log(f"scene/{pad}/gel", gel)
                stream.log(f"images/{pad}", rr.Image(stored.rgb[k]))
                forces_n = [stored.force_normal_n[k], *stored.force_shear_n[k]]
                for name, force_n in zip(FORCES, forces_n, strict=True):
                    stream.log(f"forces/{pad}/{name}", rr.Scalars(force_n))
            for name, at in poses.items():
                stream.log(name, rr.Transform3D(translation=at[:3, 3], mat3x3=at[:3, :3]))


def _gel_pose(gripper: GripperSpec, trace: GraspTrace, frame: int, pad: str) -> NDArray[np.float64]:
    """Where a pad's gel is in the world in a frame of an executed grasp."""
    assert trace.gripper_pose is not None
    side = gripper.side(pad)
    place_mm = (side.side * pad_distances_mm(trace, frame)[pad], 0.0, 0.0)
    in_gripper = pose(side.gel_axes, place_mm)
    return np.asarray(pose_matrix(trace.gripper_pose[frame]) @ in_gripper)


def _drawn_finger(gripper: GripperSpec, pad: str) -> Any:
    """Boxes in the frame of its gel."""
    import rerun as rr

    sizes, centers, colors, _ = zip(*finger_boxes(gripper, pad), strict=True)
    axes = gripper.side(pad).gel_axes
    in_gel = {"sizes": sizes @ np.abs(axes), "centers": centers @ axes}
    return rr.Boxes3D(**in_gel, colors=colors, fill_mode="solid")


def _log_cameras(stream: Any, dataset: Dataset) -> None:
    """Where each camera is, and how it sees."""
    import rerun as rr

    for camera in dataset.cameras.values():
        at, place = camera.t_world_camera_mm, f"scene/camera_{camera.name}"
        placed = rr.Transform3D(translation=at[:3, 3], mat3x3=at[:3, :3])
        stream.log(place, placed, static=True)
        pinhole = rr.Pinhole(
            image_from_camera=camera.k_px,
            resolution=[camera.width_px, camera.height_px],
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=60.0,
        )
        stream.log(place, pinhole, static=True)


def _log_views(stream: Any, sample: GraspSample, frame: int) -> None:
    """What each camera saw in a frame, as far as the dataset has it."""
    import rerun as rr

    for name, seen in sample.cameras.items():
        rgb, depth_mm = seen.rgb, seen.depth_mm
        if rgb.ndim == 4:
            rgb, depth_mm = rgb[frame], depth_mm[frame]
        elif frame != sample.grasp_frame:
            continue
        stream.log(f"scene/camera_{name}/rgb", rr.Image(rgb))
        stream.log(f"scene/camera_{name}/depth", rr.DepthImage(depth_mm, meter=1.0))  # in mm


def _layout(config: GraspConfig, pads: Sequence[str], cameras: Sequence[str]) -> Any:
    """The scene beside the images and the forces."""
    import rerun.blueprint as rrb

    center_mm = np.array([config.x_mm, config.y_mm, config.z_mm])
    eye = rrb.EyeControls3D(position=center_mm + EYE_MM, look_target=center_mm)
    pictures = [f"images/{pad}" for pad in pads] + [f"scene/camera_{name}/rgb" for name in cameras]
    views: list[Any] = [
        rrb.Spatial3DView(origin="scene", eye_controls=eye),
        rrb.Vertical(*(rrb.Spatial2DView(origin=place) for place in pictures)),
        rrb.TimeSeriesView(origin="forces"),
    ]
    return rrb.Blueprint(rrb.Horizontal(*views, column_shares=[2, 1, 1]), collapse_panels=True)


def _grid_triangles(n_rows: int, n_columns: int) -> NDArray[np.int64]:
    """Two triangles for each cell of a grid of points in rows, (n, 3)."""
    points = np.arange(n_rows * n_columns).reshape(n_rows, n_columns)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    return np.stack([a, b, c, b, d, c], axis=-1).reshape(-1, 3)
