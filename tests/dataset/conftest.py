"""Small synthetic grasps: no physics, but every array a real dataset has."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tacgen.core.files import sha256_of, sha256_of_content
from tacgen.core.records import Camera, GraspConfig, Sensor, SlipMargin
from tacgen.dataset import CameraSample, DatasetFolder, DatasetSpec, GraspSample, PadSample

SENSOR = Sensor("gelsight", height_px=24, width_px=32, mm_per_px=0.5, gel_depth_mm=2.0)


RECIPE = {"name": "toy", "seed": 3, "physics": {"time_step_s": 0.004}, "objects": ["can"]}


TOUCH = {
    "depth_of_frames": True,
    "marker_rest_mm": np.array([[x, y] for y in (-1.0, 1.0) for x in (-2.0, 0.0, 2.0)]),
    "force_field": (3, 4),
}
"""What a spec keeps of the touch, all of it."""


def make_spec(**changes: object) -> DatasetSpec:
    height, width = SENSOR.shape_px
    recipe = changes.get("recipe", RECIPE)
    given: dict = {
        "recipe": recipe,
        "recipe_sha256": sha256_of_content(recipe),
        "calibration": {"table": "cd" * 32},
        "sensor": SENSOR,
        "pads": ("left",),
        "time_s": (0.0, 0.5, 1.0),
        "n_grasps": 10,
        "shard_size": 4,
        "reference_rgb": np.full((height, width, 3), 100, np.uint8),
        "picture_px": (12, 16),
    }
    return DatasetSpec(**(given | changes))


def make_sample(index: int, spec: DatasetSpec) -> GraspSample:
    """A grasp whose numbers all follow from its index; every fifth one could not be executed."""
    rng = np.random.default_rng(index)
    frames, (height, width) = len(spec.time_s), spec.sensor.shape_px
    config = GraspConfig(index, "can" if index % 2 else "cup", 5.0 + index, 0.5 * index, -1.0, 40.0)
    split = "test" if index % 4 == 3 else "train"
    if index % 5 == 4:
        return GraspSample(
            config=config, seed=77 + index, split=split,
            status="unreachable", label=-1, reason="too far away",
        )  # fmt: skip
    label = int(index % 3 > 0)
    force_n = np.linspace(0, config.force_n, frames)
    pads = {
        pad: PadSample(
            rgb=rng.integers(90, 110, (frames, height, width, 3), dtype=np.uint8),
            force_normal_n=force_n,
            force_shear_n=np.stack([0.1 * force_n, -0.2 * force_n], axis=1),
            indentation_mm=0.05 * force_n,
            **_touch(spec, force_n, rng),
        )
        for pad in spec.pads
    }
    return GraspSample(
        config=config,
        seed=77 + index,
        split=split,
        status="executed",
        label=label,
        failure_mode="" if label else ("translational_slip", "rotational_slip")[index % 2],
        pads=pads,
        object_pose=np.tile([0, 0, 10.0 * index, 0, 0, 0, 1.0], (frames, 1)),
        rise_mm=180.0 * label,
        turn_rad=0.01,
        label_confidence=0.5 + 0.04 * index,
        margin=SlipMargin(0.5 if label else -0.5, 1.0, np.nan if label else 1.5, np.zeros(2)),
        grasp_frame=1,
        picture=rng.integers(0, 255, (*spec.picture_px, 3), dtype=np.uint8)
        if spec.picture_px
        else None,
        cameras={one.name: _seen(one, spec, rng) for one in spec.cameras},
    )


def _seen(camera: Camera, spec: DatasetSpec, rng: np.random.Generator) -> CameraSample:
    """What a camera sees: noise, of the moment of grasp or of every frame."""
    shape = (len(spec.time_s), *camera.shape_px) if spec.camera_frames else camera.shape_px
    return CameraSample(
        rng.integers(0, 256, (*shape, 3), dtype=np.uint8),
        rng.uniform(200, 900, shape).astype(np.float32),
        rng.integers(0, 8, shape, dtype=np.uint8),
    )


def _touch(spec: DatasetSpec, force_n: np.ndarray, rng: np.random.Generator) -> dict:
    """What the spec keeps of the touch; of frame k all is k times that of frame 1."""
    grows = np.arange(len(force_n))
    found = {}
    if spec.depth or spec.depth_of_frames:
        depth_mm = np.full(spec.sensor.shape_px, 0.25, np.float16)
        found["depth_mm"] = np.stack([k * depth_mm for k in grows])
        if not spec.depth_of_frames:
            found["depth_mm"] = depth_mm
    if spec.marker_rest_mm is not None:
        moved_mm = rng.normal(0, 0.1, spec.marker_rest_mm.shape)
        found["markers_mm"] = np.stack([k * moved_mm for k in grows]).astype(np.float32)
    if spec.force_field is not None:
        share = rng.dirichlet(np.ones(np.prod(spec.force_field))).reshape(spec.force_field)
        force = np.stack([0.1 * force_n, -0.2 * force_n, force_n], axis=1)
        field_n = share[None, :, :, None] * force[:, None, None]
        found["force_field_n"] = field_n.astype(np.float32)
    return found


def collect_toy(
    root: Path, spec: DatasetSpec, shards: tuple[int, ...] | None = None
) -> DatasetFolder:
    """Write ``shards`` (all of them by default) of synthetic grasps."""
    folder = DatasetFolder(root)
    folder.prepare(spec)
    for shard in range(spec.n_shards) if shards is None else shards:
        with folder.claim(shard) as mine:
            assert mine
            folder.write_shard(shard, (make_sample(i, spec) for i in spec.shard_range(shard)), spec)
    return folder


def vouch_for(toy, shard: int) -> None:
    """Give a shard that was tampered with the hash and size of what it is now."""
    path = toy.line_path(shard)
    line = json.loads(path.read_text())
    line |= {
        "sha256": sha256_of(toy.shard_path(shard)),
        "bytes": toy.shard_path(shard).stat().st_size,
    }
    path.write_text(json.dumps(line))
    toy.merge()


@pytest.fixture
def spec() -> DatasetSpec:
    return make_spec()


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished dataset of ten grasps in three shards, merged. Do not change it."""
    folder = collect_toy(tmp_path_factory.mktemp("finished") / "toy", make_spec())
    folder.merge()
    return folder.root


@pytest.fixture
def toy(tmp_path: Path, finished: Path) -> DatasetFolder:
    """A copy of it of one's own."""
    return DatasetFolder(shutil.copytree(finished, tmp_path / "toy"))
