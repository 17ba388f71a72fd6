"""Synthetic datasets that a network can learn: a firm grasp leaves a brighter, larger patch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

from tacgen.core.records import GraspConfig, Sensor
from tacgen.dataset import DatasetFolder, DatasetSpec, GraspSample, PadSample
from tacgen.learning.training_recipe import TrainRecipe

SENSOR = Sensor("gelsight", height_px=48, width_px=64, mm_per_px=0.3, gel_depth_mm=2.0)
REFERENCE = np.full((*SENSOR.shape_px, 3), (90, 110, 130), np.uint8)


def make_spec(n_grasps: int = 40, n_frames: int = 3, **changes: object) -> DatasetSpec:
    given: dict[str, Any] = {
        "recipe": {"name": "toy", "seed": 3, "objects": ["can", "cup"]},
        "recipe_sha256": "ab" * 32,
        "calibration": {"table": "cd" * 32},
        "sensor": SENSOR,
        "pads": ("left",),
        "time_s": tuple(np.linspace(0, 1, n_frames)),
        "n_grasps": n_grasps,
        "shard_size": 16,
        "reference_rgb": REFERENCE,
    }
    return DatasetSpec(**(given | changes))


def tactile_frames(label: int, n_frames: int, rng: np.random.Generator) -> np.ndarray:
    """A patch on the gel that grows over the frames, large and bright for a success."""
    height, width = SENSOR.shape_px
    y, x = np.mgrid[:height, :width]
    cy, cx = height / 2 + rng.uniform(-4, 4), width / 2 + rng.uniform(-4, 4)
    radius = 14 if label else 6
    patch = np.hypot(y - cy, x - cx) < radius
    frames = np.repeat(REFERENCE[None].astype(float), n_frames, axis=0)
    for k in range(n_frames):
        frames[k][patch] += (60 if label else 25) * (k + 1) / n_frames
    return np.clip(frames + rng.normal(0, 2, frames.shape), 0, 255).astype(np.uint8)


def make_sample(index: int, spec: DatasetSpec) -> GraspSample:
    """The outcome follows from the index; every ninth could not be executed."""
    rng = np.random.default_rng(index)
    frames = len(spec.time_s)
    name = spec.recipe["objects"][index % len(spec.recipe["objects"])]
    config = GraspConfig(index, name, 4.0 + index % 7, 0.5 * index, -1.0, 40.0 + index % 3)
    split = "test" if index % 4 == 3 or index % 8 == 2 else "train"
    if index % 9 == 8:
        return GraspSample(
            config=config, seed=index, split=split,
            status="unreachable", label=-1, reason="too far",
        )  # fmt: skip
    label = int(rng.random() < 0.5)
    force_n = np.linspace(0, config.force_n, frames)
    felt = PadSample(
        rgb=tactile_frames(label, frames, rng),
        force_normal_n=force_n,
        force_shear_n=np.zeros((frames, 2)),
        indentation_mm=0.1 * force_n,
    )
    return GraspSample(
        config=config,
        seed=index,
        split=split,
        status="executed",
        label=label,
        failure_mode="" if label else "translational_slip",
        pads=dict.fromkeys(spec.pads, felt),
        object_pose=np.zeros((frames, 7)),
        grasp_frame=frames - 1,
    )


def collect(
    root: Path, spec: DatasetSpec, make: Callable[[int, DatasetSpec], Any] = make_sample
) -> Path:
    folder = DatasetFolder(root)
    folder.prepare(spec)
    for shard in range(spec.n_shards):
        with folder.claim(shard) as mine:
            assert mine
            folder.write_shard(shard, (make(i, spec) for i in spec.shard_range(shard)), spec)
    folder.merge()
    return root


def recipe_of(kind: str = "single", **changes: dict[str, Any]) -> TrainRecipe:
    """A recipe small enough for a test."""
    given: dict[str, Any] = {
        "name": "toy",
        "model": {"kind": kind, "weights": "none"},
        "input": {"size_px": [32, 40]},
        "training": {"epochs": 2, "learning_rate": 1e-3},
        "per_object": False,
    }
    for section, values in changes.items():
        old = given.get(section)
        given[section] = {**old, **values} if isinstance(old, dict) else values
    return TrainRecipe.model_validate(given)


def write_real(folder: Path, n: int = 8, n_frames: int = 3, background: bool = True) -> Path:
    """A folder of real grasps of the same look, made with other random numbers."""
    rows = []
    for i in range(n):
        rng = np.random.default_rng(1000 + i)
        label = i % 2
        images = folder / "images" / f"g{i:02d}"
        images.mkdir(parents=True)
        for k, frame in enumerate(tactile_frames(label, n_frames, rng)):
            cv2.imwrite(str(images / f"{k}.png"), frame[..., ::-1])
        rows.append((f"g{i:02d}", "can" if i % 4 < 2 else "cup", 5.0 + i, 0.0, 0.0, 40.0, label))
    names = ["grasp_id", "object", "force_n", "x_mm", "y_mm", "z_mm", "label"]
    pd.DataFrame(rows, columns=names).to_csv(folder / "grasps.csv", index=False)
    if background:
        cv2.imwrite(str(folder / "background.png"), REFERENCE[..., ::-1])
    return folder


@pytest.fixture(scope="module")
def small_backbone() -> Iterator[None]:
    """ResNet-18 with narrow layers, one a stage: for tests of what goes on around the network."""
    from tacgen.learning import backbone, networks  # slow to import; studies' tests need none

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backbone, "WIDTHS", [16, 16, 16, 32])
        patch.setattr(backbone, "DEPTHS", [1, 1, 1, 1])
        patch.setattr(networks, "FEATURES", 32)
        yield


@pytest.fixture(scope="session")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of 40 grasps of two objects, three frames each. Do not change it."""
    return collect(tmp_path_factory.mktemp("toy") / "data", make_spec())
