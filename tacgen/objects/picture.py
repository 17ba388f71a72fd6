"""A picture of an object: how it looks, and the relief that a pad meets."""

import itertools
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.core.files import atomic_path
from tacgen.core.images import evenly
from tacgen.core.records import GraspObject, Mesh
from tacgen.objects.pinhole import Solid, camera_around, pinhole_view
from tacgen.objects.shading import depth_view, view_axes

WINDOW_PX, MM_PER_PX = (480, 640), 0.0295  # the window of the default sensor
PICTURE_PX = (480, 480)
VIEWS = (("from the front", 35.0, 25.0), ("as the pad comes", 0.0, 0.0), ("from above", 0.0, 89.9))
TOPPLES = ("as in its file: it topples", 35.0, 10.0)


def write_picture(obj: GraspObject, path: Path, toppled_from: Mesh | None = None) -> None:
    """Write a PNG: three views of the object and the relief at up to three of its grasps.

    ``toppled_from`` is the surface as its file had it, if it has been rested since.
    """
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    for axis, (title, azimuth, elevation) in zip(axes[0], VIEWS, strict=True):
        surface = obj.surface
        if axis is axes[0, -1] and toppled_from is not None:
            surface, (title, azimuth, elevation) = toppled_from, TOPPLES
        axis.imshow(seen_from(surface, obj.color_rgb, azimuth, elevation))
        axis.set_title(title)
        axis.set_axis_off()
    places = list(itertools.product(obj.grasp_ranges["y_mm"], obj.grasp_ranges["z_mm"]))
    half_y, half_z = (side * MM_PER_PX / 2 for side in reversed(WINDOW_PX))
    for axis in axes[1, len(places) :]:
        axis.set_axis_off()
    for axis, k in zip(axes[1], evenly(len(places), 3), strict=False):
        y, z = places[k]
        axis.imshow(relief(obj, y, z), extent=(y - half_y, y + half_y, z - half_z, z + half_z))
        axis.set(xlabel="y (mm)", ylabel="z (mm)", title=f"relief at y = {y:g}, z = {z:g} mm")
    figure.suptitle(
        f"{obj.name}: {1000 * obj.mass_kg:g} g, friction {obj.friction:g}, "
        f"{len(obj.surface.faces)} triangles, {len(obj.collision)} convex part(s)"
    )
    with atomic_path(path) as partial:
        canvas.print_figure(partial, format="png", dpi=100)


def seen_from(
    surface: Mesh, color_rgb: tuple[int, int, int], azimuth_deg: float, elevation_deg: float
) -> NDArray[np.uint8]:
    """A picture (H, W, 3) of a surface from a direction, on white."""
    camera = camera_around(surface.vertices_mm, PICTURE_PX, azimuth_deg, elevation_deg)
    return pinhole_view(camera, [Solid(surface.vertices_mm, surface.faces, color_rgb)])[0]


def relief(obj: GraspObject, y_mm: float, z_mm: float) -> NDArray[np.uint8]:
    """What lies in the sensor's window from +x, lit from the upper left, as grey (H, W, 3)."""
    depth, _ = depth_view(
        obj.surface, view_axes(0.0, 0.0), np.array([0.0, y_mm, z_mm]), WINDOW_PX, MM_PER_PX
    )
    seen = np.isfinite(depth)
    if not seen.any():
        return np.full((*WINDOW_PX, 3), 255, dtype=np.uint8)
    nearest = depth[seen].max()
    # The gel reaches little deeper than 1.5 mm behind the first touch.
    depth = np.maximum(np.where(seen, depth, -np.inf), nearest - 1.5)
    down, right = np.gradient(depth, MM_PER_PX)
    shade = 150 + np.clip(150 * (right + down), -110, 90) + 30 * (depth - nearest)
    return np.repeat(np.clip(shade, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
