"""The moment of grasp is the physics' own: whatever frames are kept, and whatever comes later."""

import json
import tarfile

import numpy as np
import pandas as pd
import pytest

from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import collect
from tacgen.core.records import ContactFrame
from tacgen.dataset import Dataset
from tacgen.dataset.export import export_dataset
from tacgen.dataset.samples import frame_times_s
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings
from tests.physics.conftest import block, grasp
from tests.small_world import SHORT_LIFT, write_world

ENGINES = ("pybullet", "mujoco")
REQUESTS = (
    FrameRequest("sequence", 24, 3.0),
    FrameRequest("sequence", 5, 3.0),
    FrameRequest("sequence", 2, 3.0),
    FrameRequest("sequence", 6, 0.3),  # ends before the moment of grasp
)


def same(one: ContactFrame, other: ContactFrame) -> bool:
    values = [
        np.hstack([f.time_s, f.force_normal_n, f.force_shear_n, f.torsion_n_mm])
        for f in (one, other)
    ]
    return np.array_equal(*values) and np.array_equal(one.pose_gel_object, other.pose_gel_object)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("force_n", "label"), [(8.0, 1), (1.5, 0)])
def test_every_mode_has_the_same_frame_at_the_moment_of_grasp(engine, force_n, label):
    obj, settings = block(mass_kg=0.3, friction=0.5), PhysicsSettings(engine=engine, **SHORT_LIFT)
    with GraspSimulator("wsg50", engine) as simulator:
        single, *sequences = (
            grasp(simulator, obj, force_n=force_n, settings=settings, frames=request)
            for request in (FrameRequest(), *REQUESTS)
        )
    assert single.label == label
    (wanted,) = single.frames["left"]
    assert wanted.time_s == pytest.approx(single.grasp_time_s)
    assert wanted.force_normal_n == pytest.approx(force_n, rel=0.02)
    for trace, request in zip(sequences, REQUESTS, strict=True):
        frames = trace.frames["left"]
        assert same(frames[trace.grasp_frame], wanted)
        assert trace.grasp_time_s == single.grasp_time_s
        assert len(frames) == len(trace.object_pose) == request.count
        times_s = np.array([frame.time_s for frame in frames])
        assert (np.diff(times_s) > 0).all()
        # The gel is at rest in the first, and every other is at its own time.
        assert (times_s[0], frames[0].force_normal_n) == (0.0, 0.0)
        planned_s = np.linspace(0.0, request.span_s, request.count)
        stored_s = frame_times_s(planned_s, trace.grasp_frame, trace.grasp_time_s)
        np.testing.assert_allclose(times_s, stored_s, atol=settings.time_step_s)


UNTIL_LIFT = (
    FrameRequest("sequence", 8, 1.0, "lift"),
    FrameRequest("sequence", 4, 3.0, "lift"),
    FrameRequest("sequence", 3, 0.3, "lift"),  # 0.3 s are over before the lift
    FrameRequest("sequence", 1, 3.0, "lift"),
)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_frames_until_the_lift_show_nothing_of_it_and_change_nothing(engine):
    obj, settings = block(mass_kg=0.3, friction=0.5), PhysicsSettings(engine=engine)
    with GraspSimulator("wsg50", engine) as simulator:
        whole, *traces = (
            grasp(simulator, obj, force_n=1.5, settings=settings, frames=request)
            for request in (REQUESTS[0], *UNTIL_LIFT)
        )
    # A failure: of the whole sequence the gel is empty in the last frame.
    assert whole.label == 0
    assert whole.frames["left"][-1].force_normal_n < 0.1 * 1.5
    start_s = whole.grasp_time_s + settings.hold_s
    assert whole.lift_start_time_s == pytest.approx(start_s, abs=settings.time_step_s)
    assert start_s < whole.outcome_time_s <= whole.lift_end_time_s
    for trace, request in zip(traces, UNTIL_LIFT, strict=True):
        names = ("rise_mm", "turn_rad", "lift_start_time_s", "lift_end_time_s", "outcome_time_s")
        for name in names:
            assert getattr(trace, name) == getattr(whole, name)
        frames = trace.frames["left"]
        assert len(frames) == request.count
        assert frames[-1].time_s == pytest.approx(whole.lift_start_time_s)
        assert frames[-1].force_normal_n == pytest.approx(1.5, rel=0.02)
        if request.count > 1:
            grasped = whole.frames["left"][whole.grasp_frame]
            assert same(frames[trace.grasp_frame], grasped)
            planned_s = np.linspace(0.0, request.span_s, request.count)
            moments = trace.grasp_frame, trace.grasp_time_s, trace.lift_start_time_s
            times_s = [frame.time_s for frame in frames]
            np.testing.assert_allclose(
                times_s, frame_times_s(planned_s, *moments), atol=settings.time_step_s
            )


def test_phases_and_the_end_of_the_frames_are_kept_in_the_shard(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frames = "{mode: sequence, count: 4, until: lift}"
    recipe = load_recipe(
        write_world(tmp_path, frames=frames, grid="{force_n: [3, 25], y_mm: 0, z_mm: 90}")
    )
    collect(recipe, tmp_path / "data")
    data = Dataset(tmp_path / "data")
    columns = data.columns(contact=True)
    assert (data.until, data.taken_with()["until"]) == ("lift", "lift")
    for row, (grasp_s, start_s, outcome_s, end_s) in enumerate(
        zip(
            *(columns[f"{name}_time_s"] for name in ("grasp", "lift_start", "outcome", "lift_end")),
            strict=True,
        )
    ):
        assert grasp_s < start_s < outcome_s <= end_s
        assert data.times_s(row).tolist() == [0, grasp_s, start_s, start_s]
        assert columns["force_normal_n"][row, 1:].min() > 0
    assert columns["label"].tolist() == [0, 1]
    assert columns["outcome_time_s"][1] == columns["lift_end_time_s"][1]
    assert "end at the start of the lift" in (tmp_path / "data" / "README.md").read_text()


@pytest.mark.slow
def test_a_dataset_states_the_moment_and_uses_it_everywhere(tmp_path, monkeypatch):
    """Of a sequence, the frame of the moment is the image, depth and force of a single one."""
    monkeypatch.chdir(tmp_path)
    sections = {
        "grid": "{force_n: [3, 25, 0.4], y_mm: [0], z_mm: [60, 500]}",
        "optics": "{noise: false}",
        "dataset": "{shard_size: 2, depth: true}",
    }
    found = {}
    for mode in ("single", "sequence"):
        frames = f"{{mode: {mode}, count: 14}}"
        recipe = load_recipe(write_world(tmp_path, frames=frames, **sections))
        collect(recipe, tmp_path / mode, progress=False)
        found[mode] = Dataset(tmp_path / mode)
    single, sequence = found.values()
    columns = sequence.columns()
    executed = columns["index"][columns["label"] >= 0]
    assert 0 < len(executed) < len(sequence)
    assert np.isnan(columns["grasp_time_s"]).tolist() == (columns["label"] < 0).tolist()
    for index in map(int, executed):
        one, other = single.read(index), sequence.read(index)
        frame = other.grasp_frame
        assert one.grasp_time_s == other.grasp_time_s
        assert sequence.times_s(index)[frame] == single.times_s(index)[0] == one.grasp_time_s
        np.testing.assert_array_equal(one.pads["left"].rgb[0], other.pads["left"].rgb[frame])
        np.testing.assert_array_equal(one.pads["left"].depth_mm, other.pads["left"].depth_mm)
        forces_n = [s.pads["left"].force_normal_n[k] for s, k in ((one, 0), (other, frame))]
        assert forces_n[0] == forces_n[1]
        # Of frames 0.23 s apart the one before the moment, which comes after 0.25 s.
        assert sequence.time_s[frame] <= one.grasp_time_s
    for name in ("images", "webdataset", "lerobot", "robomimic"):
        export_dataset(sequence.root, tmp_path / name, name)
    first, row = int(executed[0]), sequence.read(int(executed[0]))
    table = pd.read_csv(tmp_path / f"images/contact/g{first:05d}.csv")
    np.testing.assert_allclose(table["time_s"], sequence.times_s(first))
    with tarfile.open(tmp_path / "webdataset/grasps-000000.tar") as archive:
        about = json.loads(archive.extractfile(f"g{first:05d}.json").read())
    assert (about["grasp_frame"], about["grasp_time_s"]) == (row.grasp_frame, row.grasp_time_s)
    torch = pytest.importorskip("torch")
    images, _ = sequence.torch(frames="grasp")[0]
    expected = single.torch(frames="grasp")[0][0]
    assert torch.equal(images, expected)
