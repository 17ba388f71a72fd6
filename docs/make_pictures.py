"""Pictures of the documentation, made by tacgen itself: docs/figures/*.png, each under 100 kB."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

import tacgen
from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe
from tacgen.core.records import Mesh, frozen_array
from tacgen.core.resources import object_folders
from tacgen.objects import load_object
from tacgen.objects.shading import shaded_view

FIGURES = Path(__file__).parent / "figures"
MAX_KB = 100


def main() -> None:
    """Write every picture."""
    FIGURES.mkdir(exist_ok=True)
    for name, figure in (("grasp", grasp()), ("objects", objects()), ("press", press())):
        print(save(figure, FIGURES / f"{name}.png"))  # noqa: T201


def grasp() -> Figure:
    """A grasp of a golf ball: the scene, and the image at five forces."""
    recipe = Recipe.model_validate(
        {
            "name": "picture",
            "objects": ["golf_ball"],
            "grid": {"force_n": [1, 3, 6, 12, 24], "y_mm": 2, "z_mm": 21},
            "sensor": "gelsight_mini",
            "optics": {"shadows": True, "noise": False},
        }
    )
    with GraspPipeline(recipe) as pipeline:
        samples = [pipeline.sample(planned) for planned in plan_recipe(recipe)]
    figure = Figure(figsize=(9.6, 2.0), layout="constrained")
    axes = figure.subplots(1, 6)
    axes[0].imshow(samples[0].picture)
    axes[0].set_title("simulated grasp", fontsize=9)
    for axis, sample in zip(axes[1:], samples, strict=True):
        axis.imshow(sample.pads["left"].rgb[0])
        axis.set_title(f"{sample.config.force_n:g} N", fontsize=9)
    for axis in axes:
        axis.set_axis_off()
    return figure


def objects() -> Figure:
    """The shipped objects."""
    names = list(object_folders())
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    for axis, name in zip(figure.subplots(2, 6).flat, names, strict=False):
        shown = load_object(name)
        view = shaded_view(shown.surface, shown.color_rgb, azimuth_deg=35.0, elevation_deg=25.0)
        axis.imshow(view)
        axis.set_title(name, fontsize=7)
        axis.set_axis_off()
    return figure


def press() -> Figure:
    """A ball pressed into three sensors with 5 N: image and depth."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=6, radius=4.0)
    mesh = Mesh(frozen_array(ball.vertices), frozen_array(ball.faces, np.int32))
    pose = np.eye(4)
    pose[2, 3] = 20.0
    figure = Figure(figsize=(7.2, 4.2), layout="constrained")
    axes = figure.subplots(2, 3)
    for column, name in zip(axes.T, ("gelsight", "gelsight_mini", "digit"), strict=True):
        frame = tacgen.Sensor(name, shadows=True).render(
            (mesh.vertices_mm, mesh.faces), pose, force_n=5.0
        )
        column[0].imshow(frame.rgb)
        column[0].set_title(f"{name}, 5 N", fontsize=9)
        shown = column[1].imshow(frame.depth_mm, cmap="viridis")
        figure.colorbar(shown, ax=column[1], label="depth (mm)", shrink=0.8)
        for axis in column:
            axis.set_axis_off()
    return figure


def save(figure: Figure, path: Path) -> str:
    """Write a figure; returns its size."""
    buffer = io.BytesIO()
    FigureCanvasAgg(figure).print_figure(buffer, format="png", dpi=100)
    Image.open(buffer).convert("RGB").save(path, optimize=True)
    size_kb = path.stat().st_size / 1000
    if size_kb > MAX_KB:
        msg = f"{path}: {size_kb:.0f} kB, more than {MAX_KB}; make it smaller"
        raise ValueError(msg)
    return f"{path.name}: {size_kb:.0f} kB"


if __name__ == "__main__":
    main()
