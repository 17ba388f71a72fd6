"""Export to the LeRobot dataset format v3.0, images as PNG inside the Parquet files.

Each executed grasp becomes an episode of T frames; the episodes of the train split come first.
Markers and force field are ``observation.markers_mm`` (M, 2), whose places at rest stand in the
feature's ``info``, and ``observation.force_field_n`` (rows, columns, 3); of two pads
``observation.<pad>.…``. A camera that saw every frame is ``observation.images.camera_<name>``, its
intrinsics and pose in the feature's ``info``; its depth and segments, and one that saw the moment
of grasp alone, are arrays an episode in ``cameras/<name>``. ``meta/tacgen.json`` has the sensor,
the hashes of its table and contact law, the recipe, and which arrays are depth maps.
Source: the format of huggingface/lerobot at ``codebase_version`` v3.0 (``meta/info.json``,
``meta/stats.json``, ``meta/tasks.parquet``, ``meta/episodes``, ``data``).
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError, require_extra
from tacgen.core.images import encode_png
from tacgen.core.records import AXES
from tacgen.dataset.export import arrays_of, camera_facts, origin, write_camera_facts
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import GraspSample, frame_columns, frame_flags
from tacgen.dataset.schema import FLAG_FIELDS, REST, SPLITS, STATE_FIELDS

require_extra("parquet", "--format lerobot needs", DatasetError)
import pyarrow as pa  # noqa: E402
import pyarrow.parquet as pq  # noqa: E402

CODEBASE_VERSION = "v3.0"
CHUNKS_SIZE, DATA_FILES_SIZE_MB, VIDEO_FILES_SIZE_MB = 1000, 100, 200
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
DEPTH = "is_depth_map"  # LeRobot's own mark; its features without it are no depth
POSE = ("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
CONTACT_STATE = tuple(name for field in STATE_FIELDS for name in field.column_names)
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_GREY = np.arange(256) / 255.0
_SCALARS = {
    "label": "int64",
    "time_s": "float32",
    "next.done": "bool",
    "next.success": "bool",
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}

Features = Mapping[str, Mapping[str, Any]]


def write(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write each of the chosen grasps as an episode."""
    features = _features(dataset)
    export = _Export(dataset, folder, features, _schema(features))
    split = grasps["split"]
    try:
        for index in [int(i) for name in SPLITS for i in grasps["index"][split == name]]:
            export.write_episode(dataset.read(index))
    finally:
        if export.writer is not None:
            export.writer.close()
    export.write_meta(int((split == "train").sum()))
    said = f"{len(export.episodes)} episodes in LeRobot's format {CODEBASE_VERSION}"
    if export.off_s > 1e-3:
        said += (
            f": its timestamps are frame_index / fps with fps = {export.fps:.4g}, up to "
            f"{export.off_s:.3f} s off the times at which frames were taken, which are in time_s"
        )
    return said


def _image_name(dataset: Dataset, pad: str) -> str:
    suffix = "" if len(dataset.pads) == 1 else f"_{pad}"
    return f"observation.images.{dataset.sensor}{suffix}"


def _camera_names(dataset: Dataset) -> dict[str, str]:
    """The feature of each camera that saw every frame."""
    is_of_frames = any(field.is_of_frames for field in dataset.layout.of_cameras)
    return {name: f"observation.images.camera_{name}" for name in dataset.cameras if is_of_frames}


def _prefixes(dataset: Dataset) -> dict[str, str]:
    """What names of a pad begin with, by pad."""
    return {pad: "" if len(dataset.pads) == 1 else f"{pad}." for pad in dataset.pads}


def _touch_names(dataset: Dataset, pad: str) -> dict[str, str]:
    """The features of what the dataset keeps of the touch in every frame, but the depth."""
    fields = (f for f in dataset.layout.of_pads if f.image and f.name != "depth_mm")
    return {field.name: f"observation.{_prefixes(dataset)[pad]}{field.name}" for field in fields}


def _features(dataset: Dataset) -> dict[str, dict[str, Any]]:
    prefixes = list(_prefixes(dataset).values())
    vectors = {
        "observation.state": [prefix + name for prefix in prefixes for name in CONTACT_STATE],
        "observation.environment_state": list(POSE),
        "action": list(AXES),
    }
    shape, names = [*dataset.shape_px, 3], ["height", "width", "channels"]
    image = {"dtype": "image", "shape": shape, "names": names}
    found: dict[str, dict[str, Any]] = {_image_name(dataset, pad): image for pad in dataset.pads}
    for camera, feature in _camera_names(dataset).items():
        facts = camera_facts(dataset.cameras[camera])
        shape = [*dataset.cameras[camera].shape_px, 3]
        found[feature] = {"dtype": "image", "shape": shape, "names": names, "info": facts}
    for name, axes in vectors.items():
        found[name] = {"dtype": "float32", "shape": [len(axes)], "names": axes}
    for pad in dataset.pads:
        for name, feature in _touch_names(dataset, pad).items():
            is_markers = name == "markers_mm"
            found[feature] = {
                "dtype": "float32",
                "shape": list(dataset.touch(int(dataset.indices[0]), name, pad, 0).shape),
                "names": ["marker", "axis"] if is_markers else ["row", "column", "axis"],
            }
            if is_markers:
                found[feature]["info"] = {REST: dataset.marker_rest_mm(pad).tolist()}
    flags = [f.name for f in FLAG_FIELDS if f in dataset.layout.fields]
    named = {prefix + flag: "bool" for prefix in prefixes for flag in flags}
    for name, dtype in (_SCALARS | named).items():
        found[name] = {"dtype": dtype, "shape": [1], "names": None}
    return found


def _schema(features: Features) -> pa.Schema:
    """The Arrow schema, with the note by which Hugging Face's datasets knows the images."""
    fields: list[pa.Field] = []
    described: dict[str, dict[str, Any]] = {}
    for name, feature in features.items():
        shape, dtype = feature["shape"], feature["dtype"]
        if dtype == "image":
            kind: pa.DataType = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
            described[name] = {"_type": "Image"}
        elif len(shape) > 1:
            kind = pa.from_numpy_dtype(dtype)
            for _ in shape:
                kind = pa.list_(kind)
            described[name] = {"_type": f"Array{len(shape)}D", "shape": shape, "dtype": dtype}
        else:
            kind, described[name] = pa.from_numpy_dtype(dtype), {"dtype": dtype, "_type": "Value"}
            if shape[0] > 1:
                kind, value = pa.list_(kind, shape[0]), described[name]
                described[name] = {"feature": value, "length": shape[0], "_type": "Sequence"}
        fields.append(pa.field(name, kind))
    note = json.dumps({"info": {"features": described}})
    return pa.schema(fields, metadata={"huggingface": note})


def _part(values: NDArray[Any]) -> NDArray[Any]:
    """What the statistics need of (T, …): rows (T, n), or of images counts of levels (C, 256)."""
    if values.dtype != np.uint8:
        kept = np.float32 if values.ndim > 2 else np.float64  # of fields all are kept at once
        return np.asarray(values, kept).reshape(len(values), -1)
    channels = np.moveaxis(values, -1, 0).reshape(values.shape[-1], -1)
    return np.stack([np.bincount(channel, minlength=256) for channel in channels])


def _stats(
    parts: Sequence[NDArray[Any]], n_frames: int, feature: Mapping[str, Any]
) -> dict[str, Any]:
    """Statistics of a feature's shape; of images in [0, 1] (C, 1, 1), exact, from counts."""
    if feature["dtype"] == "image":
        histogram = np.sum(parts, axis=0)
        share = histogram / histogram.sum(axis=1, keepdims=True)
        mean, seen, below = share @ _GREY, histogram > 0, np.cumsum(share, axis=1)
        found = {
            "min": _GREY[seen.argmax(axis=1)],
            "max": _GREY[255 - seen[:, ::-1].argmax(axis=1)],
            "mean": mean,
            "std": np.sqrt(np.maximum(0.0, share @ _GREY**2 - mean**2)),
        }
        levels = QUANTILES.items()
        found |= {name: _GREY[(below >= q - 1e-12).argmax(axis=1)] for name, q in levels}
        found = {name: values.reshape(-1, 1, 1) for name, values in found.items()}
    else:
        rows = np.concatenate(parts)
        found = {name: getattr(rows, name)(axis=0) for name in ("min", "max", "mean", "std")}
        found |= {name: np.quantile(rows, level, axis=0) for name, level in QUANTILES.items()}
        found = {name: values.reshape(feature["shape"]) for name, values in found.items()}
    return {name: values.tolist() for name, values in found.items()} | {"count": [n_frames]}


@dataclass(slots=True)
class _Export:
    """One run of the export; ``writer`` is of the Parquet file that is being written."""

    dataset: Dataset
    root: Path
    features: Features
    schema: pa.Schema
    tasks: dict[str, int] = field(default_factory=dict)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    parts: dict[str, list[Any]] = field(default_factory=dict)
    writer: pq.ParquetWriter | None = None
    file: int = -1
    file_bytes: int = 0
    off_s: float = 0.0  # between timestamps and the frames' own times, at most

    @property
    def fps(self) -> float:
        """Frames a second, of which the format demands timestamp = frame_index / fps.

        LeRobot's own recordings have whole numbers, but it only divides by this one; where the
        frames are not so many a second it is the number that they are.
        """
        time_s = self.dataset.time_s
        span_s = float(time_s[-1] - time_s[0])
        rate = (len(time_s) - 1) / span_s if span_s > 0 else 1.0
        return round(rate) if abs(rate - round(rate)) < 1e-6 * rate else rate

    def write_episode(self, sample: GraspSample) -> None:
        """Write one grasp."""
        n_frames, episode = self.dataset.n_frames, len(self.episodes)
        first = episode * n_frames
        text = f"Grasp the {sample.config.object.replace('_', ' ')} and lift it."
        task = self.tasks.setdefault(text, len(self.tasks))
        stamps = np.arange(n_frames) / self.fps
        times_s = self.dataset.times_s(sample.config.index)
        self.off_s = max(self.off_s, float(np.abs(times_s - times_s[0] - stamps).max()))
        values = self._values(sample) | {
            "timestamp": stamps,
            "frame_index": np.arange(n_frames),
            "episode_index": np.full(n_frames, episode),
            "index": np.arange(first, first + n_frames),
            "task_index": np.full(n_frames, task),
        }
        stats: dict[str, Any] = {}
        for key, array in values.items():
            part = _part(array)
            self.parts.setdefault(key, []).append(part)
            found = _stats([part], n_frames, self.features[key])
            stats |= {f"stats/{key}/{name}": value for name, value in found.items()}
        in_frames = _camera_names(self.dataset)
        for owner, one, seen in arrays_of(self.dataset, sample):
            # Grey levels have no room for depth: beside the frames, as an array an episode.
            name = f"cameras/{owner}/{one.name}/episode_{episode:06d}"
            is_beside = one.name != "rgb" or owner not in in_frames
            if one.of == "pad":
                name = f"{one.name}/episode_{episode:06d}_{owner}"
                is_beside = one.name == "depth_mm"
            if is_beside:
                place = self.root / f"{name}.npy"
                place.parent.mkdir(parents=True, exist_ok=True)
                np.save(place, seen)
        self._write_frames(values)
        about = {
            "episode_index": episode,
            "tasks": [text],
            "length": n_frames,
            "data/chunk_index": self.file // CHUNKS_SIZE,
            "data/file_index": self.file % CHUNKS_SIZE,
            "dataset_from_index": first,
            "dataset_to_index": first + n_frames,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "grasp_index": sample.config.index,
            "grasp_frame": sample.grasp_frame,
            "grasp_time_s": sample.grasp_time_s,
            "split": sample.split,
            "failure_mode": sample.failure_mode,
        }
        self.episodes.append(about | stats)

    def _values(self, sample: GraspSample) -> dict[str, NDArray[Any]]:
        n_frames, pads = self.dataset.n_frames, sample.pads.items()
        contact = [np.column_stack(list(frame_columns(pad).values())) for _, pad in pads]
        last = np.arange(n_frames) == n_frames - 1
        asked = [getattr(sample.config, name) for name in AXES]
        prefixes = _prefixes(self.dataset)
        flags = {
            prefixes[name] + flag: held
            for name, pad in pads
            for flag, held in frame_flags(pad).items()
        }
        images = {_image_name(self.dataset, name): pad.rgb for name, pad in pads}
        features = _camera_names(self.dataset).items()
        images |= {feature: sample.cameras[name].rgb for name, feature in features}
        touch = {
            feature: getattr(pad, field)
            for name, pad in pads
            for field, feature in _touch_names(self.dataset, name).items()
        }
        return (
            images
            | touch
            | flags
            | {
                "observation.state": np.concatenate(contact, axis=1),
                "observation.environment_state": np.asarray(sample.object_pose),
                "action": np.tile(asked, (n_frames, 1)),
                "label": np.full(n_frames, sample.label),
                "time_s": self.dataset.times_s(sample.config.index),
                "next.done": last,
                "next.success": last & (sample.label == 1),
            }
        )

    def _write_frames(self, values: Mapping[str, NDArray[Any]]) -> None:
        """Append an episode as one row group, to a new file where the last one is full."""
        columns = []
        for column in self.schema:
            array, dtype = values[column.name], self.features[column.name]["dtype"]
            if dtype == "image":
                rows: list[Any] = [{"bytes": encode_png(rgb), "path": None} for rgb in array]
            else:
                rows = array.astype(dtype).tolist()
            columns.append(pa.array(rows, type=column.type))
        table = pa.Table.from_arrays(columns, schema=self.schema)
        if self.writer is None or self.file_bytes + table.nbytes > DATA_FILES_SIZE_MB << 20:
            if self.writer is not None:
                self.writer.close()
            self.file, self.file_bytes = self.file + 1, 0
            chunk, number = divmod(self.file, CHUNKS_SIZE)
            path = self.root / DATA_PATH.format(chunk_index=chunk, file_index=number)
            path.parent.mkdir(parents=True, exist_ok=True)
            self.writer = pq.ParquetWriter(path, self.schema, compression="snappy")
        self.writer.write_table(table)
        self.file_bytes += table.nbytes

    def _about(self) -> dict[str, Any]:
        """What the images are of, and the depth maps beside them."""
        depth = self.dataset.layout.find("depth_mm")
        beside = {} if depth is None else {"depth_mm/episode_*_<pad>.npy": depth.description}
        for one in self.dataset.layout.of_cameras if self.dataset.cameras else ():
            if one.name == "depth_mm":
                beside["cameras/<name>/depth_mm/episode_*.npy"] = one.description
        marked = {
            path: {DEPTH: True, "unit": "mm", "description": text} for path, text in beside.items()
        }
        return origin(self.dataset) | {"arrays": marked}

    def write_meta(self, n_train: int) -> None:
        """Write the folder ``meta``; the first ``n_train`` episodes are the train split."""
        n_episodes = len(self.episodes)
        n_frames = n_episodes * self.dataset.n_frames
        sides = {"train": (0, n_train), "test": (n_train, n_episodes)}
        info = {
            "codebase_version": CODEBASE_VERSION,
            "robot_type": self.dataset.robot,
            "total_episodes": n_episodes,
            "total_frames": n_frames,
            "total_tasks": len(self.tasks),
            "chunks_size": CHUNKS_SIZE,
            "data_files_size_in_mb": DATA_FILES_SIZE_MB,
            "video_files_size_in_mb": VIDEO_FILES_SIZE_MB,
            "fps": self.fps,
            "splits": {name: f"{a}:{b}" for name, (a, b) in sides.items() if b > a},
            "data_path": DATA_PATH,
            "video_path": None,
            "features": self.features,
        }
        stats = {
            key: _stats(parts, n_frames, self.features[key]) for key, parts in self.parts.items()
        }
        write_camera_facts(self.dataset, self.root)
        meta = self.root / "meta"
        episodes = meta / "episodes/chunk-000/file-000.parquet"
        episodes.parent.mkdir(parents=True)
        (meta / "tacgen.json").write_text(json.dumps(self._about(), indent=4), encoding="utf-8")
        (meta / "info.json").write_text(json.dumps(info, indent=4), encoding="utf-8")
        (meta / "stats.json").write_text(json.dumps(stats, indent=4), encoding="utf-8")
        tasks = pd.Index(self.tasks, name="task")
        pd.DataFrame({"task_index": list(self.tasks.values())}, index=tasks).to_parquet(
            meta / "tasks.parquet"
        )
        pq.write_table(pa.Table.from_pylist(self.episodes), episodes)
