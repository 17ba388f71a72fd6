"""Ball-press sets of other toolkits, written as the press folder that tacgen reads.

A press folder holds ``background.png``, one image a press, ``presses.csv`` and ``sensor.yaml``.
"""

import contextlib
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

from tacgen.core.errors import PressError, require_extra
from tacgen.core.files import atomic_folder, is_file, read_small_text
from tacgen.core.images import encode_png
from tacgen.core.progress import print_status
from tacgen.core.safe_io import check_archive, decode_rgb, read_rgb
from tacgen.core.types import BoolArray, FloatArray
from tacgen.presses.circles import find_circle
from tacgen.presses.lab_table import Table, read_table
from tacgen.presses.press_folder import COORDINATES, STAGE
from tacgen.presses.rules import IMAGES

GS_SDK_MM_PER_PX = 0.0634
"""GelSight Mini at 320 × 240 px, from gs_sdk's ``gsmini.yaml`` (called ``ppmm`` there)."""

Parts = tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ForeignPress:
    """One press of a foreign set; ``rgb`` (H, W, 3) uint8, places in pixels, y down."""

    name: str
    rgb: NDArray[np.uint8]
    columns: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class PressSet:
    """What a reader of a foreign format found; pictures are read as ``presses`` is run through."""

    background_rgb: NDArray[np.uint8]
    presses: Iterable[ForeignPress]
    mm_per_px: float
    n_rows: int
    notes: Parts = ()
    warnings: Parts = ()


@dataclass(frozen=True, slots=True)
class ImportedPresses:
    """How many presses were written, and what there is to know of them."""

    count: int
    notes: Parts
    warnings: Parts
    enough: bool  # for a table


def import_presses(
    format_name: str,
    source: Path,
    out: Path,
    *,
    mm_per_px: float | None = None,
    ball_radius_mm: float | None = None,
) -> ImportedPresses:
    """Write the presses of ``source`` as a press folder ``out``, whole or not at all.

    ``mm_per_px`` and ``ball_radius_mm`` replace what the files hold or lack.

    Raises ``PressError`` listing what the source lacks; nothing is written then.
    """
    found = PRESS_FORMATS[format_name](Path(source), mm_per_px, ball_radius_mm)
    rows: list[dict[str, Any]] = []
    taken: set[str] = set()
    with atomic_folder(out) as folder:
        for press in found.presses:
            file = _own_name(press.name, taken)
            (folder / file).write_bytes(encode_png(press.rgb))
            rows.append({**press.columns, "file": file})
        if not rows:
            lacks = f"no presses found in {found.n_rows} rows"
            why = (
                "; ".join(found.notes)
                or f"is it of the layout {format_name}? docs/howto/import_data.md shows it"
            )
            msg = f"{source}: {lacks}: {why}"
            raise PressError(msg)
        (folder / "background.png").write_bytes(encode_png(found.background_rgb))
        table = pd.DataFrame(rows)
        table.insert(0, "file", table.pop("file"))
        table.to_csv(folder / "presses.csv", index=False)
        sensor = {"name": Path(source).name, "mm_per_px": float(found.mm_per_px)}
        (folder / "sensor.yaml").write_text(yaml.safe_dump(sensor), encoding="utf-8")
    experiments = table["trial"].nunique() if "trial" in table else len(table)
    print_status(f"{found.n_rows} rows read, {len(rows)} pictures of {experiments} presses written")
    warnings = found.warnings
    enough = experiments >= IMAGES.min_presses
    if not enough:
        fix = "press all over the gel, and import all presses of a sensor at once"
        few = f"{experiments} press{'es are' if experiments > 1 else ' is'} too few for a table"
        warnings += (f"{few}, which needs at least {IMAGES.min_presses}, better 30: {fix}",)
    return ImportedPresses(len(rows), found.notes, warnings, enough)


def _own_name(name: str, taken: set[str]) -> str:
    """A file name for a press that no other press has; where two come to be alike, numbered."""
    own, number = name, 1
    # Some file systems hold capitals and small letters for the same.
    while own.lower() in taken or own.lower() == "background":
        number += 1
        own = f"{name}_{number}"
    taken.add(own.lower())
    return f"{own}.png"


def read_gs_sdk(source: Path, mm_per_px: float | None, ball_radius_mm: float | None) -> PressSet:
    """gs_sdk: ``catalog.csv``, ``background.png``, ``<press>/gelsight.png`` and ``label.npz``.

    Source: layout as read by gs_sdk's ``calibration/prepare_data.py``; the ball's diameter stands
    in ``catalog.csv``, centre (x, y) and radius of the contact, px, in ``label.npz``.
    """
    diameter = "diameter(mm)"
    catalog = _list(source / "catalog.csv", ("experiment_reldir", diameter), (diameter,))
    others = [name for name in catalog if name not in (diameter, "file", *COORDINATES)]

    def presses() -> Iterator[ForeignPress]:
        for row in catalog.to_dict("records"):
            folder = _inside(source, row["experiment_reldir"])
            radius_mm = ball_radius_mm or row[diameter] / 2
            columns: dict[str, Any] = {"radius_mm": radius_mm}
            if is_file(folder / "label.npz"):
                columns |= dict(zip(COORDINATES, _gs_sdk_label(folder / "label.npz"), strict=True))
            columns |= {name: row[name] for name in others}
            name = str(row["experiment_reldir"]).replace("/", "_")
            yield ForeignPress(name, _image(folder / "gelsight.png"), columns)

    notes = () if mm_per_px else (f"mm_per_px taken as {GS_SDK_MM_PER_PX} (gs_sdk's Mini)",)
    background = _image(source / "background.png")
    return PressSet(background, presses(), mm_per_px or GS_SDK_MM_PER_PX, len(catalog), notes)


def _gs_sdk_label(path: Path) -> list[float]:
    try:
        check_archive(path, IMAGES.max_about_bytes)
        with np.load(path, allow_pickle=False) as label:
            x, y = label["center"]
            return [float(value) for value in (x, y, label["radius"])]
    except (OSError, ValueError, KeyError, TypeError) as error:
        msg = f"{path}: is no label of a circle (center, radius): {error}; delete it or label anew"
        raise PressError(msg) from None


def read_py3dcal(source: Path, mm_per_px: float | None, ball_radius_mm: float | None) -> PressSet:
    """py3DCal: ``annotations.csv`` and ``metadata.json``, ``probe_images``, ``blank_images``.

    Source: layout as written by py3DCal's ``annotate`` and read by ``TactileSensorDataset``.
    ``x_px, y_px`` are the probe's place in the picture, ``x_mm, y_mm`` the stage's, from which they
    follow; some thirty pictures are taken at each. ``penetration_depth_mm`` is counted from the
    stage's own zero, in either direction, and not from the first touch. A contact's radius follows
    from it where it is less than the ball's radius and the pictures agree.
    """
    folder = source / "annotations"
    depth = "penetration_depth_mm"
    needed, numeric = ("img_name", "x_px", "y_px"), ("x_px", "y_px", depth, *STAGE)
    table = _list(folder / "annotations.csv", needed, numeric)
    known = _json(folder / "metadata.json", ("px_per_mm", "probe_radius_mm"))
    radius_mm = ball_radius_mm or known["probe_radius_mm"]
    depth_mm = np.abs(table.get(depth, pd.Series(np.nan, table.index)).to_numpy())
    notes = []
    unknown = int(np.isnan(depth_mm).sum())
    if unknown:
        notes.append(f"{unknown} rows have no {depth}: their circles will be found")
    touching = ~(depth_mm == 0)
    if not touching.all():
        notes.append(f"{(~touching).sum()} rows left out: {depth} is 0, so nothing touches")
    place = [table[name] for name in (*STAGE, "x_px", "y_px") if name in table]
    trial = np.unique(np.column_stack([*place, depth_mm]), axis=0, return_inverse=True)[1].ravel()
    beyond = touching & (depth_mm >= radius_mm)
    if beyond.any():
        why = f"{depth} is at least the ball's radius of {radius_mm:g} mm: circles will be found"
        notes.append(f"{beyond.sum()} contact radii left out: {why}")
    circle_px = np.full(len(table), np.nan)
    usable = touching & (depth_mm < radius_mm)
    contact_mm = np.sqrt((2 * radius_mm - depth_mm[usable]) * depth_mm[usable])
    circle_px[usable] = contact_mm * known["px_per_mm"]
    background = _image(source / "blank_images" / "blank.png")
    circles = np.column_stack([table["x_px"], table["y_px"], circle_px])
    paths = [_inside(source / "probe_images", name) for name in table["img_name"]]
    wrong, note = _contradicted(circles, trial, paths, background)
    circles[wrong] = np.nan
    notes += [note] if note else []
    others = [n for n in table if n not in ("img_name", "x_px", "y_px", "file", "trial")]

    def presses() -> Iterator[ForeignPress]:
        for k in np.nonzero(touching)[0].tolist():
            columns: dict[str, Any] = {"radius_mm": radius_mm}
            if np.isfinite(circles[k]).all():
                columns |= dict(zip(COORDINATES, circles[k].tolist(), strict=True))
            columns |= {"trial": trial[k], **{name: table[name].iloc[k] for name in others}}
            yield ForeignPress(paths[k].stem, _image(paths[k]), columns)

    scale = mm_per_px or 1.0 / known["px_per_mm"]
    return PressSet(background, presses(), scale, len(table), tuple(notes))


def _contradicted(
    circles: FloatArray, trial: NDArray[Any], paths: list[Path], background: NDArray[np.uint8]
) -> tuple[BoolArray, str]:
    """Which derived circles (N, 3), px, are not those that their pictures show, and a note on them.

    One picture of each trial is looked at; fewer trials than a table needs are not judged. Where
    most trials' are wrong, so is the rule that they were derived by, and all are.
    """
    wrong, ratios, checked = np.zeros(len(circles), bool), [], 0
    off = IMAGES.derived_off_share
    for one in np.unique(trial[np.isfinite(circles).all(axis=1)]):
        rows = trial == one
        x, y, radius = circles[np.argmax(rows)]
        seen = find_circle(_image(paths[int(np.argmax(rows))]), background)
        if seen.problem:
            continue
        checked += 1
        ratios.append(radius / seen.edge_px)
        apart = np.hypot(seen.center_px[0] - x, seen.center_px[1] - y)
        sized = 1 - off < ratios[-1] < 1 / (1 - off)
        wrong[rows] = not sized or apart > off * seen.edge_px
    if not wrong.any() or checked < IMAGES.min_presses:
        return np.zeros_like(wrong), ""
    share = len(np.unique(trial[wrong])) / checked
    median = f"at the median {np.median(ratios):.2f} times the radius seen in the picture"
    if share > 0.5:
        wrong[:] = True
        return wrong, f"circles computed from the depth are {median}: all left out, to be found"
    return (
        wrong,
        f"{share:.0%} of the circles computed from the depth are not where the pictures \
show them ({median}): left out, to be found",
    )


def read_9dtact(source: Path, mm_per_px: float | None, ball_radius_mm: float | None) -> PressSet:
    """9DTact: depth-calibration folders with ``rectify_crop_ref.png`` and ``…_sample.png``.

    Source: files as written by 9DTact's ``_2_Sensor_Calibration.py``: one reference and one ball
    press, rectified and cropped; the ball's radius and mm/px stand in its ``shape_config.yaml``,
    not here, so both must be given. ``source`` is one such folder or holds several of one sensor,
    whose references' median is the background. Raises ``PressError`` if there is none.
    """
    scale, radius_mm = _both_given(source, mm_per_px, ball_radius_mm)
    references = sorted(source.rglob("rectify_crop_ref.png"))
    if not references:
        msg = f"{source / 'rectify_crop_ref.png'}: missing, and in all folders below; is it 9DTact?"
        raise PressError(msg)
    rest = np.stack(_of_one_size([_image(path) for path in references], references))
    samples = [
        path for ref in references for path in sorted(ref.parent.glob("rectify_crop_sample*.png"))
    ]

    def presses() -> Iterator[ForeignPress]:
        for path in samples:
            parts = path.relative_to(source).with_suffix("").parts
            yield ForeignPress("_".join(parts), _image(path), {"radius_mm": radius_mm})

    one_colour = "9DTact shows depth as darkness, a table slopes as colours: see the held-out error"
    background = np.median(rest, axis=0).astype(np.uint8)
    return PressSet(background, presses(), scale, len(samples), (one_colour,))


def read_gelsight_mini_pretrain(
    source: Path, mm_per_px: float | None, ball_radius_mm: float | None
) -> PressSet:
    """gelsight-mini-pretrain: Parquet files with encoded images, indenters and forces.

    Source: the columns of the set's published schema (huggingface.co/datasets/yxma/
    gelsight-mini-pretrain); images as bytes or, as the ``datasets`` library writes them, as
    ``{bytes, path}``. Rows whose indenter is a sphere are taken. Sizes stand in ``indenter_param``,
    in a unit that is not stated. There is no background: the median of the pictures stands in for
    it. A ball's radius and mm/px must be given. Raises ``PressError`` without files or balls.
    """
    scale, radius_mm = _both_given(source, mm_per_px, ball_radius_mm)
    files = [source] if source.is_file() else sorted(source.rglob("*.parquet"))
    if not files:
        msg = f"{source}: no Parquet file; give the folder that holds the *.parquet shards"
        raise PressError(msg)
    table = pd.concat([_parquet_columns(file) for file in files], ignore_index=True)
    ball = table["indenter"].astype(str).str.contains("sphere|ball", case=False).to_numpy()
    if not ball.any():
        kinds = ", ".join(sorted(set(table["indenter"].astype(str)))[:6])
        msg = f"{source}: no row with a sphere as `indenter`, but {kinds}; only balls can be used"
        raise PressError(msg)
    notes = ["the background is the median of the pictures: presses in one place would spoil it"]
    if not ball.all():
        others = Counter(table.loc[~ball, "indenter"].astype(str)).most_common(6)
        listed = ", ".join(f"{name} ({count})" for name, count in others)
        notes.append(f"{(~ball).sum()} rows left out, whose indenter is no ball: {listed}")
    columns, about = _pretrain_columns(table[ball], radius_mm, source)
    notes += about
    row = np.nonzero(ball)[0]
    chosen = row[:: max(1, len(row) // IMAGES.background_pictures)]
    few = [*_parquet_images(files, chosen)]
    median = np.median(np.stack(_of_one_size(few, [source] * len(few))), axis=0)
    warnings: Parts = ()
    gels = columns[[n for n in ("source", "gel_variant", "domain") if n in columns]]
    if gels.columns.size and len(gels.drop_duplicates()) > 1:
        kinds = "; ".join(" ".join(map(str, kind)) for kind in gels.drop_duplicates().to_numpy())
        warnings = (f"presses of several gels ({kinds}): calibrate each by itself",)

    def presses() -> Iterator[ForeignPress]:
        pictures = zip(_parquet_images(files, row), columns.to_dict("records"), strict=True)
        for number, (rgb, record) in enumerate(pictures):
            yield ForeignPress(f"press_{number:05d}", rgb, record)

    background = np.rint(median).astype(np.uint8)
    return PressSet(background, presses(), scale, len(table), tuple(notes), warnings)


def _parquet_columns(file: Path) -> pd.DataFrame:
    """All columns but the pictures."""
    require_extra("parquet", f"{file}: reading Parquet needs", PressError)
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        names = pq.read_schema(file).names
        missing = [name for name in ("image", "indenter") if name not in names]
        if missing:
            msg = f"{file}: no column {' and '.join(missing)}; this is not gelsight-mini-pretrain"
            raise PressError(msg)
        return pd.read_parquet(file, columns=[name for name in names if name != "image"])
    except (OSError, pa.ArrowException, ValueError, LookupError, TypeError) as error:
        msg = f"{file}: cannot be read as Parquet: {error}; fetch it anew"
        raise PressError(msg) from None


def _parquet_images(files: list[Path], rows: NDArray[Any]) -> Iterator[NDArray[np.uint8]]:
    """Pictures of some rows, counted through all files, in their order; few are held at once."""
    import pyarrow as pa  # which _parquet_columns has asked for
    import pyarrow.parquet as pq

    wanted, row = set(rows.tolist()), 0
    for file in files:
        try:
            with pq.ParquetFile(file) as parquet:
                for batch in parquet.iter_batches(batch_size=32, columns=["image"]):
                    for image in batch.column(0):
                        if row in wanted:
                            where = f"{file}: the image of row {row}"
                            data = _encoded(image.as_py(), file.parent, where)
                            yield decode_rgb(data, where, PressError, kind_of=str(file))
                        row += 1
        except (OSError, pa.ArrowException) as error:
            msg = f"{file}: its pictures cannot be read: {error}; fetch it anew"
            raise PressError(msg) from None


def _encoded(value: Any, folder: Path, where: str) -> bytes:
    """The bytes of a picture that is stored as such, as a list of them, or as {bytes, path}."""
    if isinstance(value, Mapping):
        path = value.get("path")
        value = value.get("bytes")
        if value is None and path and is_file(_inside(folder, path)):
            value = _inside(folder, path).read_bytes()
    if isinstance(value, list):
        with contextlib.suppress(ValueError, TypeError):
            value = bytes(value)
    if not isinstance(value, bytes) or not value:
        msg = f"{where} is missing; drop the row"
        raise PressError(msg)
    return value


def _pretrain_columns(
    table: pd.DataFrame, radius_mm: float, source: Path
) -> tuple[pd.DataFrame, list[str]]:
    """Columns of ``presses.csv`` for rows of balls, and notes on what they were made from."""
    radii, notes = _pretrain_radii(table, radius_mm, source)
    columns = pd.DataFrame({"radius_mm": radii}, table.index)
    read = table[[name for name in ("f_x", "f_y", "f_z") if name in table]].astype(object)
    cells = read.where(read.notna(), "").astype(str)
    forces, problems = Table(source, cells, np.zeros(len(cells), np.int64)).with_numbers(cells)
    PressError.raise_if(problems)
    if "f_z" in forces and np.isfinite(forces["f_z"]).any():
        sign = -1.0 if np.nanmedian(forces["f_z"]) < 0 else 1.0
        columns["force_normal_n"] = sign * forces["f_z"]
        notes += ["force_normal_n is −f_z, which is negative in contact"] if sign < 0 else []
    for name, axis in (("f_x", "x"), ("f_y", "y")):
        if name in forces and np.isfinite(forces[name]).any():
            columns[f"force_shear_{axis}_n"] = forces[name]
    if "force_shear_x_n" in columns:
        notes.append("f_x, f_y are kept as they are: how their axes lie in the picture is unknown")
    used = ("f_x", "f_y", "f_z", "file", "image_format", "height", "width")
    for name in table:
        if name not in used and name not in columns and table[name].notna().any():
            columns[name] = table[name]
    return columns, notes


def _pretrain_radii(
    table: pd.DataFrame, radius_mm: float, source: Path
) -> tuple[FloatArray, list[str]]:
    """Radius of each ball (N,), mm, from ``indenter_param``; the given one tells its unit.

    Raises ``PressError`` where balls of several sizes do not follow from the given radius.
    """
    empty = pd.Series([""] * len(table), index=table.index)
    text = table.get("indenter_param", empty).fillna("").astype(str).str.strip()
    matches = [re.fullmatch(r"(\d+(?:\.\d+)?)\s*(?:mm)?", value) for value in text]
    sizes = np.array([float(match[1]) if match else np.nan for match in matches])
    given = f"--ball-radius-mm {radius_mm:g}"
    kinds = ", ".join(sorted(set(text), key=lambda value: (len(value), value)))
    for size in np.unique(sizes[np.isfinite(sizes)])[::-1]:
        for factor, meaning in ((0.5, "diameters"), (1.0, "radii")):
            if np.isfinite(sizes).all() and np.isclose(radius_mm, factor * size, rtol=0.01):
                return factor * sizes, [
                    f"indenter_param ({kinds}) holds {meaning} in mm, as {given} says of {size:g}"
                ]
    if len(set(text)) > 1:
        why = "and the given radius is neither that number nor its half for any of them"
        fix = "give the radius of the largest in mm"
        msg = f"{source}: balls of several sizes, indenter_param {kinds}, {why} ({given}); {fix}"
        raise PressError(msg)
    said = f"; indenter_param, the same for all, says {kinds}" if kinds else ""
    return np.full(len(table), radius_mm), [f"all balls have the given radius{said}"]


def _of_one_size(images: list[NDArray[np.uint8]], paths: list[Path]) -> list[NDArray[np.uint8]]:
    for image, path in zip(images, paths, strict=True):
        if image.shape != images[0].shape:
            (height, width), (rows, columns) = image.shape[:2], images[0].shape[:2]
            sizes = f"{width}×{height} and {columns}×{rows} px"
            msg = f"{path}: pictures of {sizes}; import those of one sensor and size at a time"
            raise PressError(msg)
    return images


def _both_given(
    source: Path, mm_per_px: float | None, ball_radius_mm: float | None
) -> tuple[float, float]:
    if mm_per_px is None or ball_radius_mm is None:
        fix = "give --mm-per-px and --ball-radius-mm (of several balls, that of the largest)"
        msg = f"{source}: states neither mm/px nor, in mm, the ball's radius; {fix}"
        raise PressError(msg)
    return mm_per_px, ball_radius_mm


PRESS_FORMATS: Mapping[str, Callable[[Path, float | None, float | None], PressSet]] = {
    "gs-sdk": read_gs_sdk,
    "py3dcal": read_py3dcal,
    "9dtact": read_9dtact,
    "gelsight-mini-pretrain": read_gelsight_mini_pretrain,
}


def _inside(folder: Path, name: object) -> Path:
    """What ``name`` is in ``folder``; raises ``PressError`` where it leads out of it."""
    path = Path(str(name))
    if path.is_absolute() or ".." in path.parts:
        msg = f"{folder}: {str(name)!r} leads out of it; name files of this set"
        raise PressError(msg)
    return folder / path


def _list(path: Path, needed: Parts, numeric: Parts) -> pd.DataFrame:
    """A list's cells as text, as ``read_table`` reads them, and some of its columns as numbers."""
    if not is_file(path):
        msg = f"{path}: cannot be read: no such file; is this the right folder?"
        raise PressError(msg)
    frame, problems = read_table(path).with_numbers(numeric)
    missing = [name for name in needed if name not in frame]
    if missing:
        problems = [f"{path}: no column {', '.join(missing)}; it has {', '.join(frame)}"]
    PressError.raise_if(problems)
    return frame


def _json(path: Path, needed: tuple[str, ...]) -> dict[str, float]:
    try:
        found = json.loads(read_small_text(path, IMAGES.max_about_bytes))
        numbers = {name: float(found[name]) for name in needed}
        if not all(0 < number < np.inf for number in numbers.values()):
            msg = "they must be positive"
            raise ValueError(msg)
        return numbers
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        msg = f"{path}: needs the numbers {', '.join(needed)}: {error}"
        raise PressError(msg) from None


def _image(path: Path) -> NDArray[np.uint8]:
    if not is_file(path):
        msg = f"{path}: missing; restore it or drop its row"
        raise PressError(msg)
    return read_rgb(path, PressError)
