"""Export to the formats of other tools.

A format is a module of this folder, ``real_grasps`` that of ``--format real-grasps``. Its function
``write`` takes the dataset, the chosen grasps (a row each: index, object, label, split, …) and an
empty folder, and returns a few words on what it wrote; one that can do without images takes
``images`` too.
"""

import contextlib
import inspect
import json
from collections.abc import Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import pandas as pd
import yaml

from tacgen.core.errors import DatasetError, RecipeError, require_known
from tacgen.core.files import atomic_folder, disk_errors, write_text
from tacgen.core.records import LABEL_NOT_EXECUTED, Camera
from tacgen.core.resources import __version__
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import GraspSample
from tacgen.dataset.schema import SEGMENT_NAMES, SEGMENTS, SPLITS, T_WORLD_CAMERA, Field, K

_USUAL = ("lerobot", "images", "webdataset", "robomimic", "real-grasps")  # first in messages
_SIZES = ((1e3, "n<1K"), (1e4, "1K<n<10K"), (1e5, "10K<n<100K"), (1e6, "100K<n<1M"))
FORMATS = tuple(
    sorted(
        (module.name.replace("_", "-") for module in iter_modules(__path__)),
        key=lambda name: _USUAL.index(name) if name in _USUAL else len(_USUAL),
    )
)


def export_dataset(
    root: Path | str,
    out: Path | str,
    format_name: str,
    *,
    split: str | None = None,
    images: bool = True,
) -> dict[str, Any]:
    """Write executed grasps of the dataset in ``root`` to the new folder ``out``; what it wrote.

    ``split`` is ``train``, ``test`` or both; without ``images``, labels and forces are written,
    which suffice to calibrate friction.

    Raises ``DatasetError`` if the format or the split is not known, ``out`` exists, or no grasp is
    left to export.
    """
    require_known("--format", format_name, FORMATS, DatasetError)
    require_known("--split", split or "train", SPLITS, DatasetError)
    module = import_module(f"{__name__}.{format_name.replace('-', '_')}")
    writer = module.write
    if not images:
        if "images" not in inspect.signature(writer).parameters:
            msg = f"--no-images: {format_name} always holds images; use --format real-grasps"
            raise DatasetError(msg)
        writer = partial(writer, images=False)
    with disk_errors(Path(out)), atomic_folder(Path(out)) as folder:
        dataset = Dataset(root)
        grasps, not_executed = _chosen(dataset, split)
        content = writer(dataset, grasps, folder)
        if images and format_name != "real-grasps":
            content += _touch_note(dataset)
        about = f"# {content}\n\n{inspect.getdoc(module)}"
        write_text(folder / "README.md", _card(dataset, grasps, format_name, about))
    counts = {"grasps": len(grasps), "not_executed": not_executed}
    return {"folder": str(out), "format": format_name, **counts, "content": content}


def _touch_note(dataset: Dataset) -> str:
    """What there is of the touch beside the images, for the message."""
    depth = dataset.layout.find("depth_mm")
    said = "; depth of every frame"
    if depth is None:
        said = "; no depth, which the recipe did not keep"
    elif not depth.is_of_frames:
        said = "; depth of the moment of grasp alone, as the dataset has it"
    names = {"markers_mm": "the markers' motion", "force_field_n": "the force field"}
    said += "".join(f"; {names[name]}" for name in dataset.touch_names if name in names)
    return said + (f"; cameras {', '.join(dataset.cameras)}" if dataset.cameras else "")


def arrays_of(dataset: Dataset, sample: GraspSample) -> Iterator[tuple[str, Field, Any]]:
    """(pad or camera, field, values) of what is known of a grasp: its pads, then its cameras."""
    owners = {"pad": sample.pads, "camera": sample.cameras}
    for kind, named in owners.items():
        fields = [field for field in dataset.layout.fields if field.of == kind]
        for name, owner in named.items():
            found = ((name, field, field.value(owner)) for field in fields)
            yield from (one for one in found if one[2] is not None)


def write_camera_facts(dataset: Dataset, folder: Path) -> None:
    """Write what is known of each camera to ``cameras/<name>/camera.json``."""
    for camera in dataset.cameras.values():
        facts = json.dumps(camera_facts(camera), indent=1)
        write_text(folder / "cameras" / camera.name / "camera.json", facts)


def camera_facts(camera: Camera) -> dict[str, Any]:
    """What is known of a camera, as plain data."""
    return {
        "size_px": list(camera.shape_px),
        K: camera.k_px.tolist(),
        T_WORLD_CAMERA: camera.t_world_camera_mm.tolist(),
        SEGMENT_NAMES: list(SEGMENTS),
    }


def origin(dataset: Dataset) -> dict[str, Any]:
    """Of which sensor, calibration and recipe a dataset's images are, as plain data."""
    folder, recipe = DatasetFolder(dataset.root), dict[str, Any]()
    with contextlib.suppress(RecipeError):
        recipe = folder.recipe()
    return {
        **dataset.taken_with(),
        "mm_per_px": dataset.mm_per_px,
        "colors_from": folder.plan().get("colors_from", "not recorded"),
        "sha256": dataset.inputs,  # of the table, the contact law and all else, by role
        "recipe": recipe,
        "made_by": f"tacgen {__version__}",
    }


def _card(dataset: Dataset, grasps: pd.DataFrame, format_name: str, about: str) -> str:
    """A dataset card, with the header that Hugging Face's hub reads.

    Source: the hub's documentation, "Dataset Cards".
    """
    name, known = Path(dataset.root).resolve().name, origin(dataset)
    size = next((words for most, words in _SIZES if len(grasps) < most), _SIZES[-1][1])
    header: dict[str, Any] = {
        "pretty_name": name,
        "license": "unknown",
        "task_categories": ["robotics"],
        "tags": ["tactile", "grasping", "simulation", "tacgen", dataset.sensor],
        "size_categories": [size],
    }
    if format_name == "lerobot":
        header["tags"].insert(0, "LeRobot")
        files = [{"split": "train", "path": "data/*/*.parquet"}]
        header["configs"] = [{"config_name": "default", "data_files": files}]
    rows = {
        "sensor": dataset.sensor,
        "scale": f"{dataset.mm_per_px:g} mm a pixel",
        "colours from": known["colors_from"],
        "lookup table": f"sha256 `{known['sha256'].get('table', 'not recorded')}`",
        "contact law": f"sha256 `{known['sha256'].get('contact_law', 'the published one')}`",
        "successes": f"{int((grasps['label'] == 1).sum())} of {len(grasps)} grasps",
        "made by": known["made_by"],
    }
    lines = [f"| {key} | {value} |" for key, value in rows.items()]
    table = "\n".join(["| | |", "|---|---|", *lines])
    return f"---\n{yaml.safe_dump(header, sort_keys=False)}---\n\n{about}\n\n{table}\n"


def _chosen(dataset: Dataset, split: str | None) -> tuple[pd.DataFrame, int]:
    columns = dataset.columns().items()
    table = pd.DataFrame({name: values for name, values in columns if values.ndim == 1})
    if split is not None:
        table = table[table["split"] == split]
    executed = table[table["label"] != LABEL_NOT_EXECUTED]
    not_executed = len(table) - len(executed)
    if executed.empty:
        where = "" if split is None else f" of the {split} split"
        fix = "collect grasps that the gripper can reach"
        msg = f"{dataset.root}: no grasp{where} was executed, so nothing can be exported; {fix}"
        raise DatasetError(msg)
    return executed, not_executed
