"""What `tacgen sensors` lists, shows and adds."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tacgen.contact.gel import gel_map_mm
from tacgen.core import records
from tacgen.core.errors import RecipeError, TacgenError
from tacgen.core.files import atomic_path, refuse_existing, sha256_of
from tacgen.core.records import Mesh
from tacgen.core.resources import packaged, sensor_files, sensor_path
from tacgen.core.safe_io import read_rgb
from tacgen.core.sensors import load_sensor
from tacgen.optics.table import LookupTable, load_table
from tacgen.sensor.simulated import Sensor

COLUMNS = ("name", "px", "mm_per_px", "dome_mm", "markers", "error_grey", "colours from", "in")
FORCES_N = (2.0, 6.0, 12.0)
BALL_RADIUS_MM = 3.0


def sensor_rows() -> list[dict[str, Any]]:
    """One row a sensor; one that cannot be read has a ``problem`` in place of its figures."""
    rows = []
    shipped = (packaged("recipes") / "sensors").resolve()
    for name, path in sensor_files().items():
        row: dict[str, Any] = {"name": name}
        row["in"] = "tacgen" if path.resolve().parent == shipped else str(path)
        try:
            row |= sensor_facts(str(path))
        except TacgenError as error:
            row["problem"] = str(error)
        rows.append(row | {"name": name})
    return rows


def sensor_facts(name: str) -> dict[str, Any]:
    """The geometry of a sensor, and what its table says of itself.

    Raises ``RecipeError`` or ``TableError`` if the sensor or its table cannot be used.
    """
    sensor = load_sensor(name, needs_table=False)
    facts: dict[str, Any] = {
        "name": sensor.name,
        "file": str(sensor_path(name)),
        "width_px": sensor.width_px,
        "height_px": sensor.height_px,
        "mm_per_px": sensor.mm_per_px,
        "window_mm": [
            round(side * sensor.mm_per_px, 2) for side in (sensor.width_px, sensor.height_px)
        ],
        "gel_depth_mm": sensor.gel_depth_mm,
        "dome_radius_mm": sensor.dome_radius_mm,
        "markers": [sensor.markers.rows, sensor.markers.columns] if sensor.markers else None,
    }
    if not sensor.table:
        return facts | {"colors_from": "no table yet: `tacgen calibrate lookup` makes one"}
    table = load_table(sensor.table)
    facts |= {"table": sensor.table, "colors_from": table.origin}
    facts |= {
        key: table.provenance[key]
        for key in ("license", "date", "command", "note")
        if key in table.provenance
    }
    heldout = table.provenance.get("heldout", {})
    facts["error_grey"] = heldout.get("rmse_labels")
    facts["error_refined_grey"] = heldout.get("rmse_refined")
    facts["noise_grey"] = round(table.noise_grey, 2)
    facts["steepest_slope_deg"] = round(float(np.degrees(table.max_slope_rad)), 1)
    return facts


def rows_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a table for a terminal."""
    lines = [COLUMNS]
    for row in rows:
        if "problem" in row:
            lines.append((row["name"], *["–"] * 5, row["problem"].splitlines()[0], row["in"]))
            continue
        error = row.get("error_grey")
        lines.append(
            (
                row["name"],
                f"{row['width_px']}×{row['height_px']}",
                f"{row['mm_per_px']:.4g}",
                f"{row['dome_radius_mm']:g}" if row["dome_radius_mm"] else "flat",
                "×".join(map(str, row["markers"])) if row["markers"] else "none",
                "–" if error is None else f"{error:.2f}",
                row["colors_from"],
                row["in"],
            )
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = ["  ".join(map(str.ljust, line, widths)).rstrip() for line in lines]
    return "\n".join(text)


def facts_text(facts: Mapping[str, Any]) -> str:
    """The facts for a terminal, one a line."""
    lines = [str(facts["name"])]
    lines += [
        f"  {key.replace('_', ' ')}: {_plain(value)}"
        for key, value in facts.items()
        if key != "name" and value is not None
    ]
    return "\n".join(lines)


def _plain(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return " × ".join(map(str, value)) if isinstance(value, list) else str(value)


def write_picture(name: str, path: Path) -> None:
    """Write a PNG: the gel at rest and a ball pressed in by three forces.

    A picture ``<name>.press.jpg`` beside the sensor's YAML, a real press, is put beside them.
    """
    sensor = Sensor(name)
    ball = _ball(BALL_RADIUS_MM)
    frames = [sensor.render(ball, np.eye(4), force_n=force_n) for force_n in FORCES_N]
    shown = [("rendered: at rest", sensor.at_rest_rgb())]
    for force_n, frame in zip(FORCES_N, frames, strict=True):
        saturated = ", gel saturated" if frame.saturated else ""
        title = f"rendered: ball of {2 * BALL_RADIUS_MM:g} mm, {force_n:g} N{saturated}"
        shown.append((title, frame.rgb))
    real = sensor_path(name).with_name(f"{sensor_path(name).stem}.press.jpg")
    if real.is_file():
        shown.append(("a real press of this sensor", read_rgb(real)))
    figure = Figure(figsize=(3.4 * len(shown), 3.0), layout="constrained")
    canvas = FigureCanvasAgg(figure)
    for axis, (title, rgb) in zip(np.ravel(figure.subplots(1, len(shown))), shown, strict=True):
        axis.imshow(rgb)
        axis.set_title(title, fontsize=9)
        axis.set_axis_off()
    figure.suptitle(f"{name}: colours from {sensor_facts(name)['colors_from']}", fontsize=10)
    with atomic_path(path) as partial:
        canvas.print_figure(partial, format="png", dpi=100)


def _ball(radius_mm: float) -> Mesh:
    """A fine ball."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=6, radius=radius_mm)
    return Mesh(np.asarray(ball.vertices), np.asarray(ball.faces))


def add_sensor(
    table_path: Path,
    name: str,
    *,
    gel_depth_mm: float,
    dome_radius_mm: float | None,
    force: bool,
) -> Path:
    """Write ``recipes/sensors/<name>.yaml`` and its table into the folder one works in.

    ``dome_radius_mm`` None is that of the table's presses. Returns the YAML's path; raises a
    ``TacgenError`` if the name or the table cannot be used, or a sensor of the name is there.
    """
    if not name.isidentifier():
        msg = f"--name {name}: give letters, digits and _, such as my_gelsight"
        raise RecipeError(msg)
    table: LookupTable = load_table(table_path)
    folder = Path("recipes/sensors")
    description, copy = folder / f"{name}.yaml", folder / f"{name}.table.npz"
    refuse_existing(force, description, copy)
    stated = table.geometry.get("dome_radius_mm", 0.0)
    height, width = table.shape_px
    sensor = records.Sensor(
        name=name,
        height_px=height,
        width_px=width,
        mm_per_px=round(table.mm_per_px, 6),
        gel_depth_mm=gel_depth_mm,
        dome_radius_mm=float(stated if dome_radius_mm is None else dome_radius_mm),
        table=copy.name,
    )
    gel_map_mm(sensor)  # a dome that does not span the window is refused
    content = {key: value for key, value in asdict(sensor).items() if value not in (None, ())}
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(copy) as partial:
        shutil.copyfile(table_path, partial)
    head = f"# Colours from {table.origin}; table sha256 {sha256_of(copy)}\n"
    with atomic_path(description) as partial:
        partial.write_text(head + yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return description
