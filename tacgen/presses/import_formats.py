"""Ball-press sets of other toolkits, written as the press folder that tacgen reads.

A press folder holds ``background.png``, one image a press, ``presses.csv`` and ``sensor.yaml``.
"""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

from tacgen.core.columns import csv_problem
from tacgen.core.errors import PressError
from tacgen.core.files import atomic_folder
from tacgen.core.images import encode_png
from tacgen.core.optional_dependencies import require_extra
from tacgen.core.safe_io import check_archive, read_rgb
from tacgen.presses.press_folder import COORDINATES

GS_SDK_MM_PER_PX = 0.0634
"""GelSight Mini at 320 × 240 px, from gs_sdk's ``gsmini.yaml`` (called ``ppmm`` there)."""
MAX_BACKGROUND_PICTURES = 101
"""Pictures whose median stands in for a background: more change no grey level."""


@dataclass(frozen=True, slots=True)
class Press:
    """One press of a foreign set; ``rgb`` (H, W, 3) uint8, places in pixels, y down."""

    name: str
    rgb: NDArray[np.uint8]
    columns: Mapping[str, float | str]


@dataclass(frozen=True, slots=True)
class PressSet:
    """What a reader of a foreign format found."""

    background_rgb: NDArray[np.uint8]
    presses: tuple[Press, ...]
    mm_per_px: float
    notes: tuple[str, ...] = ()


def import_presses(
    format_name: str,
    source: Path,
    out: Path,
    *,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
) -> PressSet:
    """Write the presses of ``source`` as a press folder ``out``, whole or not at all.

    ``mm_per_px`` and ``ball_radius_mm`` replace what the files hold or lack.

    Raises ``PressError`` listing what the source lacks; nothing is written then.
    """
    found = PRESS_FORMATS[format_name](Path(source), mm_per_px, ball_radius_mm)
    if not found.presses:
        msg = f"{source}: no presses found; see `docs/import.md` for the layout of {format_name}"
        raise PressError(msg)
    with atomic_folder(out) as folder:
        (folder / "background.png").write_bytes(encode_png(found.background_rgb))
        rows = []
        for press in found.presses:
            file = f"{press.name}.png"
            (folder / file).write_bytes(encode_png(press.rgb))
            rows.append({"file": file, **press.columns})
        pd.DataFrame(rows).to_csv(folder / "presses.csv", index=False)
        sensor = {"name": Path(source).name, "mm_per_px": float(found.mm_per_px)}
        (folder / "sensor.yaml").write_text(yaml.safe_dump(sensor), encoding="utf-8")
    return found


def read_gs_sdk(source: Path, mm_per_px: float | None, _: float | None) -> PressSet:
    """gs_sdk: ``catalog.csv``, ``background.png``, ``<press>/gelsight.png`` and ``label.npz``.

    Source: layout as read by gs_sdk's ``calibration/prepare_data.py``; the ball's diameter stands
    in ``catalog.csv``, centre (x, y) and radius of the contact, px, in ``label.npz``.
    """
    catalog = _table(source / "catalog.csv", ("experiment_reldir", "diameter(mm)"))
    presses = []
    for row in catalog.to_dict("records"):
        folder = source / str(row["experiment_reldir"])
        columns: dict[str, float | str] = {"radius_mm": float(row["diameter(mm)"]) / 2}
        if (folder / "label.npz").is_file():
            check_archive(folder / "label.npz")
            with np.load(folder / "label.npz") as label:
                values = [*label["center"], label["radius"]]
            columns |= {name: float(value) for name, value in zip(COORDINATES, values, strict=True)}
        name = str(row["experiment_reldir"]).replace("/", "_")
        presses.append(Press(name, _image(folder / "gelsight.png"), columns))
    notes = () if mm_per_px else (f"mm_per_px taken as {GS_SDK_MM_PER_PX} (gs_sdk's Mini)",)
    background = _image(source / "background.png")
    return PressSet(background, tuple(presses), mm_per_px or GS_SDK_MM_PER_PX, notes)


def read_py3dcal(source: Path, mm_per_px: float | None, ball_radius_mm: float | None) -> PressSet:
    """py3DCal: ``annotations.csv`` and ``metadata.json``, ``probe_images``, ``blank_images``.

    Source: layout as read by py3DCal's ``TactileSensorDataset``. ``x_px, y_px`` are the probe's
    place in the picture; the radius of the contact follows from ``penetration_depth_mm``.
    """
    folder = source / "annotations"
    table = _table(folder / "annotations.csv", ("img_name", "x_px", "y_px"))
    known = _json(folder / "metadata.json", ("px_per_mm", "probe_radius_mm"))
    radius_mm = ball_radius_mm or known["probe_radius_mm"]
    presses = []
    for row in table.to_dict("records"):
        depth_mm = float(row.get("penetration_depth_mm", np.nan))
        if not depth_mm > 0:
            continue
        contact_mm = np.sqrt(max(radius_mm**2 - (radius_mm - depth_mm) ** 2, 0.0))
        columns = {
            "radius_mm": radius_mm,
            "center_x_px": float(row["x_px"]),
            "center_y_px": float(row["y_px"]),
            "contact_radius_px": contact_mm * known["px_per_mm"],
        }
        path = source / "probe_images" / str(row["img_name"])
        presses.append(Press(path.stem, _image(path), columns))
    scale = mm_per_px or 1.0 / known["px_per_mm"]
    return PressSet(_image(source / "blank_images" / "blank.png"), tuple(presses), scale)


def read_9dtact(source: Path, mm_per_px: float | None, ball_radius_mm: float | None) -> PressSet:
    """9DTact: a depth-calibration folder with ``rectify_crop_ref.png`` and ``…_sample.png``.

    Source: files as written by 9DTact's ``_2_Sensor_Calibration.py``: one reference and one ball
    press, rectified and cropped; the ball's radius and mm/px stand in its ``shape_config.yaml``,
    not here, so both must be given.
    """
    scale, radius_mm = _both_given(source, mm_per_px, ball_radius_mm)
    samples = sorted(source.glob("rectify_crop_sample*.png"))
    presses = tuple(Press(path.stem, _image(path), {"radius_mm": radius_mm}) for path in samples)
    return PressSet(_image(source / "rectify_crop_ref.png"), presses, scale)


def read_gelsight_mini_pretrain(
    source: Path, mm_per_px: float | None, ball_radius_mm: float | None
) -> PressSet:
    """gelsight-mini-pretrain: Parquet files with encoded images, indenters and forces.

    Source: the columns of the set's published schema (``image``, ``indenter``, ``indenter_param``,
    ``f_x``, ``f_y``, ``f_z``). Rows whose indenter is a sphere are taken. There is no background:
    the median of the pictures stands in for it. The ball's radius and mm/px must be given.
    """
    scale, radius_mm = _both_given(source, mm_per_px, ball_radius_mm)
    presses = tuple(_parquet_presses(source, radius_mm))
    if not presses:
        msg = f"{source}: no row with a sphere as `indenter`; only ball presses can be imported"
        raise PressError(msg)
    step = max(1, len(presses) // MAX_BACKGROUND_PICTURES)
    median = np.median(np.stack([press.rgb for press in presses[::step]]), axis=0)
    notes = ("the background is the median of the pictures: presses in one place would spoil it",)
    return PressSet(median.astype(np.uint8), presses, scale, notes)


def _both_given(
    source: Path, mm_per_px: float | None, ball_radius_mm: float | None
) -> tuple[float, float]:
    if mm_per_px is None or ball_radius_mm is None:
        fix = "give --mm-per-px and --ball-radius-mm"
        msg = f"{source}: states neither mm/px nor the ball's radius; {fix}"
        raise PressError(msg)
    return mm_per_px, ball_radius_mm


def _parquet_presses(source: Path, radius_mm: float) -> Iterator[Press]:
    files = [source] if source.is_file() else sorted(source.glob("*.parquet"))
    if not files:
        msg = f"{source}: no Parquet file; give the folder that holds the *.parquet shards"
        raise PressError(msg)
    number = 0
    for file in files:
        require_extra("parquet", f"{file}: reading Parquet needs", PressError)
        table = pd.read_parquet(file)
        missing = [name for name in ("image", "indenter") if name not in table]
        if missing:
            msg = f"{file}: no column {' and '.join(missing)}; this is not gelsight-mini-pretrain"
            raise PressError(msg)
        balls = table[table["indenter"].astype(str).str.contains("sphere|ball", case=False)]
        for row in balls.to_dict("records"):
            image = cv2.imdecode(np.frombuffer(row["image"], np.uint8), cv2.IMREAD_COLOR)
            if image is None:
                msg = f"{file}: an image of row {number} cannot be decoded; drop the row"
                raise PressError(msg)
            columns: dict[str, float | str] = {"radius_mm": radius_mm}
            if np.isfinite(float(row.get("f_z", np.nan))):
                columns["force_normal_n"] = abs(float(row["f_z"]))
            yield Press(f"press_{number:05d}", np.asarray(image[..., ::-1], np.uint8), columns)
            number += 1


PRESS_FORMATS: Mapping[str, Callable[[Path, float | None, float | None], PressSet]] = {
    "gs-sdk": read_gs_sdk,
    "py3dcal": read_py3dcal,
    "9dtact": read_9dtact,
    "gelsight-mini-pretrain": read_gelsight_mini_pretrain,
}


def _table(path: Path, needed: tuple[str, ...]) -> pd.DataFrame:
    try:
        table = pd.read_csv(path, skipinitialspace=True)
    except (OSError, ValueError) as error:
        msg = f"{path}: cannot be read: {csv_problem(error)}; is this the right folder?"
        raise PressError(msg) from None
    missing = [name for name in needed if name not in table]
    if missing:
        msg = f"{path}: no column {', '.join(missing)}; it has {', '.join(map(str, table))}"
        raise PressError(msg)
    return table


def _json(path: Path, needed: tuple[str, ...]) -> dict[str, float]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return {name: float(found[name]) for name in needed}
    except (OSError, ValueError, KeyError, TypeError) as error:
        msg = f"{path}: needs the numbers {', '.join(needed)}: {error}"
        raise PressError(msg) from None


def _image(path: Path) -> NDArray[np.uint8]:
    if not path.is_file():
        msg = f"{path}: missing; restore it or drop its row"
        raise PressError(msg)
    return read_rgb(path, PressError)
