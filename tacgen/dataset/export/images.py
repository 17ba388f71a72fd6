"""Export to PNG images and CSV tables, with depth and the figures of each frame."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.images import encode_png
from tacgen.dataset.export import arrays_of, real_grasps, write_camera_facts
from tacgen.dataset.export.real_grasps import grasp_id, pad_suffix
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import frame_columns, frame_flags
from tacgen.dataset.schema import REST, Field


def write(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write PNG images and ``grasps.csv``, with depth and forces of every pad.

    ``images/<grasp_id>/<k>.png`` are the first pad's frames, ``contact/<grasp_id>.csv`` the forces
    of its frames. Where the dataset has them, ``depth/<grasp_id>.npy`` is its indentation in mm,
    (T, H, W), or (H, W) at the moment of grasp, ``markers/<grasp_id>.npy`` (T, M, 2) the motion of
    the markers from ``markers/rest_mm.npy`` (M, 2), ``force_field/<grasp_id>.npy`` (T, rows,
    columns, 3) the force in N on each cell; all float32. Those of another pad stand in
    ``images_<pad>``, ``contact_<pad>`` and so on. What a camera sees is in ``cameras/<name>``:
    ``rgb/<grasp_id>/<k>.png``, ``segmentation/<grasp_id>/<k>.png`` (``0.png`` alone where only the
    moment of grasp is kept), ``depth_mm/<grasp_id>.npy``, and its intrinsics and pose in
    ``camera.json``.
    """
    real_grasps.write(dataset, grasps, folder)
    for index in map(int, grasps["index"]):
        sample, name = dataset.read(index), grasp_id(index)
        for pad_name, pad in sample.pads.items():
            suffix = pad_suffix(dataset, pad_name)
            contact = folder / f"contact{suffix}"
            contact.mkdir(exist_ok=True)
            times = {"time_s": dataset.times_s(index)}
            flags = {flag: held.astype(int) for flag, held in frame_flags(pad).items()}
            forces = pd.DataFrame(times | frame_columns(pad) | flags)
            forces.to_csv(contact / f"{name}.csv", index=False)
        for owner, field, values in arrays_of(dataset, sample):
            if field.of == "camera":
                _write_seen(folder / "cameras" / owner / field.name, name, field, values)
            elif field.image and not field.noisy:
                stem = field.name.rpartition("_")[0]
                place = folder / f"{stem}{pad_suffix(dataset, owner)}"
                place.mkdir(exist_ok=True)
                np.save(place / f"{name}.npy", np.asarray(values, np.float32))
                if field.rest:
                    np.save(place / f"{REST}.npy", dataset.marker_rest_mm(owner))
    write_camera_facts(dataset, folder)
    pads = "" if len(dataset.pads) == 1 else f", {' and '.join(dataset.pads)} pad apart"
    return f"{len(grasps)} grasps as PNG and CSV{pads}"


def _write_seen(place: Path, name: str, field: Field, values: NDArray[Any]) -> None:
    """What a camera saw of a grasp: images as PNG, its depth as an array."""
    if field.dtype != "uint8":
        place.mkdir(parents=True, exist_ok=True)
        np.save(place / f"{name}.npy", values)
        return
    (place / name).mkdir(parents=True)
    for k, image in enumerate(values if field.is_of_frames else [values]):
        (place / name / f"{k}.png").write_bytes(encode_png(image))
