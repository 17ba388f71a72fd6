"""Pictures of the documentation, made by tacgen itself: docs/figures/*.png, each under 100 kB.

``python -m docs.make_pictures NAME=PRESSES ...`` draws held-out presses of the real sensors alone;
names and presses as in ``scripts.make_default_tables``.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from PIL import Image

import tacgen
from scripts.make_default_tables import heldout_score, made_small
from scripts.make_default_tables import real_presses as real_presses_of
from tacgen.calibrate.lookup.score import PressRenderer, press_model_of
from tacgen.calibrate.lookup.table_fit import calibrate
from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe
from tacgen.contact.gap import gap_map
from tacgen.core.images import difference, side_by_side
from tacgen.core.records import Mesh, frozen_array
from tacgen.core.resources import object_folders
from tacgen.learning.network_input import augmented
from tacgen.learning.training_recipe import Augmentation
from tacgen.objects import load_object
from tacgen.objects.picture import seen_from
from tacgen.optics.deform import deform

FIGURES = Path(__file__).parent / "figures"
SHOWN = (0.25, 0.5, 0.9)
"""Shares of the held-out presses, from the smallest error on, at which pictures are shown."""
MAX_KB = 100


def main() -> None:
    """Write every picture."""
    FIGURES.mkdir(exist_ok=True)
    for draw in (grasp, objects, press, stages, frames, reading, augmentation):
        print(save(draw(), FIGURES / f"{draw.__name__}.png"))  # noqa: T201


def real_presses(given: Sequence[str]) -> str:
    """Real presses, the rendered ones by tables fitted without them, and 3 × the difference."""
    columns = []
    for pair in given:
        name, _, path = pair.partition("=")
        found = calibrate(real_presses_of(name, Path(path)))
        presses, scored = found.presses.presses, heldout_score(found).presses
        order = sorted(range(len(presses)), key=lambda k: scored[k].rmse("refined"))
        strips = []
        for k in (order[round(share * (len(order) - 1))] for share in SHOWN):
            table = made_small(found.fold_tables[found.folds[k]])
            renderer = PressRenderer(table, press_model_of(table, presses))
            made = renderer.picture(scored[k].refined_mm, float(presses.ball_radius_mm[k]))
            row = [presses.images[k], made, difference(presses.images[k], made, 3.0)]
            text = f"{presses.names[k]}: {scored[k].rmse('refined'):.1f} grey levels"
            strips.append((text, side_by_side(row)))
        columns.append((name, strips))
    widths = [strips[0][1].shape[1] / strips[0][1].shape[0] for _, strips in columns]
    figure = Figure(figsize=(1.25 * sum(widths), 1.42 * len(SHOWN) + 0.3), layout="constrained")
    grid = figure.subplots(len(SHOWN), len(columns), squeeze=False, width_ratios=widths)
    for axes, (name, strips) in zip(grid.T, columns, strict=True):
        for axis, (text, strip) in zip(axes, strips, strict=True):
            axis.imshow(strip, interpolation="lanczos")
            axis.set_title(text, fontsize=7)
            axis.set_axis_off()
        axes[0].set_title(f"{name}: real | rendered | 3 × difference\n{strips[0][0]}", fontsize=8)
    buffer, file = io.BytesIO(), FIGURES / "real_presses.webp"
    FigureCanvasAgg(figure).print_figure(buffer, format="png", dpi=110)
    Image.open(buffer).convert("RGB").save(file, quality=88)
    return f"{file.name}: {file.stat().st_size / 1000:.0f} kB"


def grasp() -> Figure:
    """A grasp of a golf ball: the scene, and the image at five forces."""
    recipe = Recipe.model_validate(
        {
            "name": "picture",
            "objects": ["golf_ball"],
            "grid": {"force_n": [1, 3, 6, 12, 24], "y_mm": 2, "z_mm": 21},
            "sensor": "gelsight",
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
        axis.imshow(seen_from(shown.surface, shown.color_rgb, 35.0, 25.0))
        axis.set_title(name, fontsize=7)
        axis.set_axis_off()
    return figure


def press() -> Figure:
    """A ball pressed into three sensors with 5 N: image and depth."""
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


def stages() -> Figure:
    """A tilted ring pressed into a GelSight Mini: the maps from gap to image."""
    sensor = tacgen.Sensor("gelsight", shadows=True)
    ring = trimesh.creation.annulus(r_min=2.0, r_max=4.0, height=3.0)
    pose = trimesh.transformations.rotation_matrix(np.radians(15.0), (1, 0, 0))
    frame = sensor.render(ring, pose, force_n=4.0)
    gap_mm = gap_map(ring.vertices, ring.faces, pose, sensor.description)
    gap_mm = gap_mm - gap_mm.min()
    surface_mm = deform(frame.depth_mm, sensor.description.mm_per_px)
    figure = Figure(figsize=(11.0, 2.4), layout="constrained")
    axes = figure.subplots(1, 4)
    maps = {
        "gap (mm)": np.where(gap_mm < 4, gap_mm, np.nan),
        "indentation (mm)": frame.depth_mm,
        "deformation (mm)": surface_mm,
    }
    for axis, (title, values) in zip(axes[:3], maps.items(), strict=True):
        figure.colorbar(axis.imshow(values, cmap="viridis"), ax=axis, shrink=0.8)
        axis.set_title(title, fontsize=9)
    axes[3].imshow(frame.rgb)
    axes[3].set_title("image", fontsize=9)
    for axis in axes:
        axis.set_axis_off()
    return figure


def frames() -> Figure:
    """Axes of the world, seen from above, and of the gel on its image."""
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    world, gel = figure.subplots(1, 2)
    world.add_patch(Circle((0, 0), 20, color="0.85"))
    for side in (-1, 1):
        world.add_patch(Rectangle((side * 24 - 4, -8), 8, 16, color="tab:blue"))
        world.annotate("", (side * 21, 14), (side * 33, 14), arrowprops={"arrowstyle": "->"})
    world.text(
        0, -32, "from above; at yaw_rad 0 the fingers close along x", ha="center", fontsize=8
    )
    _axes(world, 16.0, "x_mm", "y_mm")
    world.set(xlim=(-42, 42), ylim=(-36, 26), aspect="equal", title="world (z up)")
    ball = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
    gel.imshow(tacgen.Sensor("gelsight").render(ball, np.eye(4), force_n=3.0).rgb,
               extent=(-9.28, 9.28, 6.96, -6.96))  # fmt: skip
    _axes(gel, 4.0, "x: columns", "y: rows")
    gel.set_title("gel (z out of the gel)")
    for axis in (world, gel):
        axis.set_axis_off()
    return figure


def _axes(axis: Axes, length: float, x_name: str, y_name: str) -> None:
    for end, name in (((length, 0), x_name), ((0, length), y_name)):
        axis.annotate("", end, (0, 0), arrowprops={"arrowstyle": "->", "color": "red", "lw": 2})
        axis.text(1.05 * end[0] + 0.02 * length, 1.15 * end[1], name, color="red", fontsize=8)


def reading() -> Figure:
    """The image of a hexagonal nut's face, and the depth that is read from it."""
    nut = trimesh.creation.cylinder(radius=3.0, height=4.0, sections=6)
    sensor = tacgen.Sensor("gelsight")
    image = sensor.render(nut, np.eye(4), force_n=2.0)
    found = tacgen.read_image(image.rgb, sensor)
    figure = Figure(figsize=(9.0, 2.6), layout="constrained")
    axes = figure.subplots(1, 3)
    axes[0].imshow(image.rgb)
    axes[0].set_title("image, 2 N", fontsize=9)
    at_least = "at least " if found.lower_bound else ""
    text = f"read: {at_least}{found.force_n[2]:.2f} ± {found.force_stderr_n[2]:.2f} N"
    for axis, depth_mm, title in ((axes[1], image.depth_mm, "true depth (mm)"),
                                  (axes[2], found.depth_mm, text)):  # fmt: skip
        shown = axis.imshow(depth_mm, vmin=0, vmax=float(image.depth_mm.max()))
        figure.colorbar(shown, ax=axis, shrink=0.8)
        axis.set_title(title, fontsize=9)
    for axis in axes:
        axis.set_axis_off()
    return figure


def augmentation() -> Figure:
    """A training image, and what five epochs see of it."""
    sensor, rng = tacgen.Sensor("gelsight"), np.random.default_rng(0)
    ball = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
    size = (80, 60)
    images = [sensor.render(ball, np.eye(4), force_n=3.0).rgb, sensor.at_rest_rgb()]
    small = (cv2.resize(rgb, size, interpolation=cv2.INTER_AREA) for rgb in images)
    image, rest = (np.asarray(rgb, np.uint8) for rgb in small)
    figure = Figure(figsize=(9.0, 1.5), layout="constrained")
    for k, axis in enumerate(figure.subplots(1, 6)):
        shown = image if not k else augmented(image[None], rest, Augmentation(on=True), rng)[0]
        axis.imshow(shown)
        axis.set_title("as simulated" if not k else f"epoch {k}", fontsize=8)
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
    if sys.argv[1:]:
        print(real_presses(sys.argv[1:]))  # noqa: T201
    else:
        main()
