"""Export to the LeRobot dataset format v3.0, images as PNG inside the Parquet files.

Each executed grasp becomes an episode of T frames; the episodes of the train split come first.
Source: the format of huggingface/lerobot at ``codebase_version`` v3.0 (``meta/info.json``,
``meta/stats.json``, ``meta/tasks.parquet``, ``meta/episodes``, ``data``).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from tacgen.core.images import encode_png
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import GraspSample
from tacgen.dataset.schema import SPLITS

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_GREY = np.arange(256) / 255.0


def image_stats(histogram: NDArray[np.int64], n_frames: int) -> dict[str, Any]:
    """Statistics (C, 1, 1) of images in [0, 1], exact, from the counts of grey levels (C, 256)."""
    share = histogram / histogram.sum(axis=1, keepdims=True)
    mean = share @ _GREY
    seen = histogram > 0
    below = np.cumsum(share, axis=1)
    found = {
        "min": _GREY[seen.argmax(axis=1)],
        "max": _GREY[255 - seen[:, ::-1].argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(0.0, share @ _GREY**2 - mean**2)),
    }
    for name, level in QUANTILES.items():
        found[name] = _GREY[(below >= level - 1e-12).argmax(axis=1)]
    return {key: v.reshape(-1, 1, 1).tolist() for key, v in found.items()} | {"count": [n_frames]}


def vector_stats(rows: NDArray[np.float64]) -> dict[str, Any]:
    """Statistics (n,) of vectors (T, n), component by component."""
    found = {name: getattr(rows, name)(axis=0) for name in ("min", "max", "mean", "std")}
    found |= {name: np.quantile(rows, level, axis=0) for name, level in QUANTILES.items()}
    return {name: values.tolist() for name, values in found.items()} | {"count": [len(rows)]}


def _histogram(images: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Counts of grey levels (C, 256) of images (T, H, W, C)."""
    channels = np.moveaxis(images, -1, 0).reshape(images.shape[-1], -1)
    return np.stack([np.bincount(channel, minlength=256) for channel in channels])


def arrow_schema(features: Mapping[str, Mapping[str, Any]]) -> pa.Schema:
    """The Arrow schema, with the note by which Hugging Face's datasets knows the images."""
    fields: list[pa.Field] = []
    described: dict[str, dict[str, Any]] = {}
    for name, feature in features.items():
        length, dtype = feature["shape"][0], feature["dtype"]
        if dtype == "image":
            kind: pa.DataType = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
            described[name] = {"_type": "Image"}
        elif length == 1:
            kind = pa.from_numpy_dtype(dtype)
            described[name] = {"dtype": dtype, "_type": "Value"}
        else:
            kind = pa.list_(pa.from_numpy_dtype(dtype), length)
            value = {"dtype": dtype, "_type": "Value"}
            described[name] = {"feature": value, "length": length, "_type": "Sequence"}
        fields.append(pa.field(name, kind))
    note = json.dumps({"info": {"features": described}})
    return pa.schema(fields, metadata={"huggingface": note})


def episode_table(
    values: Mapping[str, NDArray[Any]], features: Mapping[str, Mapping[str, Any]], schema: pa.Schema
) -> pa.Table:
    """One episode as a table: ``values`` holds (T, …) of every feature."""
    columns = []
    for field_ in schema:
        array = values[field_.name]
        if features[field_.name]["dtype"] == "image":
            rows: list[Any] = [{"bytes": encode_png(rgb), "path": None} for rgb in array]
        else:
            rows = array.astype(features[field_.name]["dtype"]).tolist()
        columns.append(pa.array(rows, type=field_.type))
    return pa.Table.from_arrays(columns, schema=schema)


CODEBASE_VERSION = "v3.0"
CHUNKS_SIZE, DATA_FILES_SIZE_MB, VIDEO_FILES_SIZE_MB = 1000, 100, 200
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-000/file-000.parquet"
ACTION = ("force_n", "x_mm", "y_mm", "z_mm", "yaw_rad")
POSE = ("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")
CONTACT_STATE = ("force_normal_n", "force_shear_x_n", "force_shear_y_n", "indentation_mm")
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


def write_lerobot(dataset: Dataset, grasps: pd.DataFrame, folder: Path) -> str:
    """Write each of the chosen grasps as an episode."""
    n_episodes = _Export(dataset, grasps, folder).run()
    return f"{n_episodes} episodes in LeRobot's format {CODEBASE_VERSION}"


@dataclass(slots=True)
class _DataFile:
    """The Parquet file that is being written, and where it stands among the others."""

    root: Path
    schema: pa.Schema
    number: int = -1
    size: int = 0
    writer: pq.ParquetWriter | None = None

    def write(self, table: pa.Table) -> tuple[int, int]:
        """Append one episode as one row group; (chunk index, file index) of where it went."""
        if self.writer is None or self.size + table.nbytes > DATA_FILES_SIZE_MB << 20:
            self.close()
            self.number, self.size = self.number + 1, 0
            path = self.root / DATA_PATH.format(
                chunk_index=self.number // CHUNKS_SIZE, file_index=self.number % CHUNKS_SIZE
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            self.writer = pq.ParquetWriter(path, self.schema, compression="snappy")
        self.writer.write_table(table)
        self.size += table.nbytes
        return self.number // CHUNKS_SIZE, self.number % CHUNKS_SIZE

    def close(self) -> None:
        """Finish the file, if there is one."""
        if self.writer is not None:
            self.writer.close()
            self.writer = None


@dataclass(slots=True)
class _Export:
    """One run of the export."""

    dataset: Dataset
    grasps: pd.DataFrame
    root: Path
    tasks: dict[str, int] = field(default_factory=dict)
    episodes: list[dict[str, Any]] = field(default_factory=list)
    parts: dict[str, list[Any]] = field(default_factory=dict)

    def run(self) -> int:
        """Write everything; the number of episodes."""
        features = self._features()
        split = self.grasps["split"]
        order = [int(i) for name in SPLITS for i in self.grasps["index"][split == name]]
        data = _DataFile(self.root, arrow_schema(features))
        first_frame = 0
        try:
            for episode, index in enumerate(order):
                first_frame += self._write_episode(
                    data, features, self.dataset.read(index), episode, first_frame
                )
        finally:
            data.close()
        n_train = int((split == "train").sum())
        self._write_meta(features, len(order), n_train, first_frame)
        return len(order)

    def _features(self) -> dict[str, dict[str, Any]]:
        data, (height, width) = self.dataset, self.dataset.shape_px
        names = ["height", "width", "channels"]
        images = {
            f"observation.images.{self._image_name(pad)}": {
                "dtype": "image",
                "shape": [height, width, 3],
                "names": list(names),
            }
            for pad in data.pads
        }
        prefixes = [""] if len(data.pads) == 1 else [f"{pad}." for pad in data.pads]
        vectors = {
            "observation.state": [prefix + name for prefix in prefixes for name in CONTACT_STATE],
            "observation.environment_state": list(POSE),
            "action": list(ACTION),
        }
        return (
            images
            | {
                name: {"dtype": "float32", "shape": [len(axes)], "names": axes}
                for name, axes in vectors.items()
            }
            | {
                name: {"dtype": dtype, "shape": [1], "names": None}
                for name, dtype in _SCALARS.items()
            }
        )

    def _image_name(self, pad: str) -> str:
        pads = self.dataset.pads
        return self.dataset.sensor if len(pads) == 1 else f"{self.dataset.sensor}_{pad}"

    @property
    def fps(self) -> int:
        """Frames a second as a whole number, which the format asks for."""
        time_s = self.dataset.time_s
        span_s = float(time_s[-1] - time_s[0])
        return max(1, round((len(time_s) - 1) / span_s)) if span_s > 0 else 1

    def _write_episode(
        self,
        data: _DataFile,
        features: Mapping[str, Mapping[str, Any]],
        sample: GraspSample,
        episode: int,
        first_frame: int,
    ) -> int:
        """Write one grasp; its number of frames."""
        n_frames = self.dataset.n_frames
        name = sample.config.object.replace("_", " ")
        task = self.tasks.setdefault(f"Grasp the {name} and lift it.", len(self.tasks))
        values = self._values(sample) | {
            "timestamp": np.arange(n_frames) / self.fps,
            "frame_index": np.arange(n_frames),
            "episode_index": np.full(n_frames, episode),
            "index": np.arange(first_frame, first_frame + n_frames),
            "task_index": np.full(n_frames, task),
        }
        stats: dict[str, dict[str, Any]] = {}
        for key, array in values.items():
            part: NDArray[Any]
            if array.dtype == np.uint8:
                part = _histogram(array)
                stats[key] = image_stats(part, n_frames)
            else:
                part = np.asarray(array, np.float64).reshape(n_frames, -1)
                stats[key] = vector_stats(part)
            self.parts.setdefault(key, []).append(part)
        for pad, frames in sample.pads.items():
            if frames.depth_mm is not None:
                # One map a grasp, at its moment of grasp: no feature of the frames.
                place = self.root / "depth_mm"
                place.mkdir(parents=True, exist_ok=True)
                np.save(place / f"episode_{episode:06d}_{pad}.npy", frames.depth_mm)
        chunk, number = data.write(episode_table(values, features, data.schema))
        self.episodes.append(
            {
                "episode_index": episode,
                "tasks": [f"Grasp the {name} and lift it."],
                "length": n_frames,
                "data/chunk_index": chunk,
                "data/file_index": number,
                "dataset_from_index": first_frame,
                "dataset_to_index": first_frame + n_frames,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                "grasp_index": sample.config.index,
                "split": sample.split,
                "failure_mode": sample.failure_mode,
            }
            | {f"stats/{key}/{k}": v for key, s in stats.items() for k, v in s.items()}
        )
        return n_frames

    def _values(self, sample: GraspSample) -> dict[str, NDArray[Any]]:
        """What a grasp contributes to each feature, (T, …)."""
        n_frames = self.dataset.n_frames
        contact = [
            np.column_stack([pad.force_normal_n, pad.force_shear_n, pad.indentation_mm])
            for pad in sample.pads.values()
        ]
        images: dict[str, NDArray[Any]] = {
            f"observation.images.{self._image_name(name)}": pad.rgb
            for name, pad in sample.pads.items()
        }
        last = np.arange(n_frames) == n_frames - 1
        asked = [getattr(sample.config, name) for name in ACTION]
        return images | {
            "observation.state": np.concatenate(contact, axis=1),
            "observation.environment_state": np.asarray(sample.object_pose),
            "action": np.tile(asked, (n_frames, 1)),
            "label": np.full(n_frames, sample.label),
            "time_s": self.dataset.time_s,
            "next.done": last,
            "next.success": last & (sample.label == 1),
        }

    def _write_meta(
        self,
        features: Mapping[str, Mapping[str, Any]],
        n_episodes: int,
        n_train: int,
        n_frames: int,
    ) -> None:
        sides = {"train": (0, n_train), "test": (n_train, n_episodes)}
        info = {
            "codebase_version": CODEBASE_VERSION,
            "robot_type": "wsg50",
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
            "features": features,
        }
        meta = self.root / "meta"
        (meta / "episodes" / "chunk-000").mkdir(parents=True)
        (meta / "info.json").write_text(json.dumps(info, indent=4), encoding="utf-8")
        stats = {
            key: image_stats(np.sum(parts, axis=0), n_frames)
            if features[key]["dtype"] == "image"
            else vector_stats(np.concatenate(parts))
            for key, parts in self.parts.items()
        }
        (meta / "stats.json").write_text(json.dumps(stats, indent=4), encoding="utf-8")
        tasks = pd.DataFrame(
            {"task_index": list(self.tasks.values())}, index=pd.Index(self.tasks, name="task")
        )
        tasks.to_parquet(meta / "tasks.parquet")
        pq.write_table(pa.Table.from_pylist(self.episodes), self.root / EPISODES_PATH)
