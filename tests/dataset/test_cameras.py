"""Cameras in a dataset: written, checked, read back, refused where damaged, and exported."""

import io
import json
import re
import shutil
import tarfile

import cv2
import h5py
import numpy as np
import pytest

from tacgen.core.errors import DatasetError
from tacgen.core.records import Camera
from tacgen.dataset import Dataset, DatasetFolder
from tacgen.dataset.export import FORMATS, export_dataset
from tacgen.dataset.gallery import write_gallery
from tacgen.dataset.grasp_page import write_grasp_page
from tacgen.dataset.schema import SEGMENTS
from tacgen.dataset.summary import summarize, summary_text, write_card
from tacgen.dataset.verify import verify
from tests.messages import refused

from .conftest import collect_toy, make_sample, make_spec, vouch_for

K = np.array([[30.0, 0, 9.5], [0, 30.0, 7.5], [0, 0, 1]])
POSE = np.array([[1.0, 0, 0, 5], [0, -1, 0, -7], [0, 0, -1, 400], [0, 0, 0, 1]])
CAMERAS = (Camera("left", 16, 20, K, POSE), Camera("top", 12, 12, K, np.eye(4)))
SPECS = {
    frames: make_spec(pads=("left", "right"), cameras=CAMERAS, camera_frames=frames == "all")
    for frames in ("grasp", "all")
}
NAMES = ("rgb", "depth_mm", "segmentation")


@pytest.fixture(scope="module", params=SPECS)
def frames(request):
    return request.param


@pytest.fixture(scope="module")
def dataset(frames, tmp_path_factory):
    folder = collect_toy(tmp_path_factory.mktemp("cameras") / "data", SPECS[frames])
    folder.merge()
    return Dataset(folder.root)


def lead(frames):
    return (3,) if frames == "all" else ()


def test_what_was_seen_is_read_back_with_the_camera(dataset, frames):
    assert not verify(dataset.root, decode=True).problems
    assert list(dataset.cameras) == ["left", "top"]
    np.testing.assert_array_equal(dataset.cameras["left"].k_px, K)
    np.testing.assert_array_equal(dataset.cameras["left"].t_world_camera_mm, POSE)
    assert dataset.views == tuple(f"camera/{c}/{name}" for c in ("left", "top") for name in NAMES)
    for index in (0, 6):
        found, there = dataset.read(index), make_sample(index, SPECS[frames])
        for camera in CAMERAS:
            for name in NAMES:
                value = getattr(there.cameras[camera.name], name)
                assert value.shape[: len(lead(frames)) + 2] == (*lead(frames), *camera.shape_px)
                np.testing.assert_array_equal(getattr(found.cameras[camera.name], name), value)
                whole = f"camera/{camera.name}/{name}"
                np.testing.assert_array_equal(dataset[index][whole], value)
                moment = value[1] if frames == "all" else value  # the moment is frame 1
                np.testing.assert_array_equal(dataset.view(index, whole, 1), moment)
    assert not dataset.view(4, "camera/top/depth_mm").any()  # not executed
    assert dataset.read(4).cameras == {}


def test_torch_gives_cameras_beside_the_touch(dataset, frames):
    torch = pytest.importorskip("torch")
    channels = ("rgb", *(f"camera/left/{name}" for name in NAMES))
    sample = dataset.torch(channels=channels)[1]
    there = make_sample(1, SPECS[frames]).cameras["left"]
    rgb, depth_mm, ids = (
        getattr(there, name)[1] if frames == "all" else getattr(there, name) for name in NAMES
    )
    assert sample["rgb"].shape == (2, 3, 24, 32)  # of both pads; the camera is one
    expected = np.moveaxis(rgb, -1, 0) / np.float32(255)
    np.testing.assert_allclose(sample["camera/left/rgb"].numpy(), expected, rtol=1e-6)
    np.testing.assert_array_equal(sample["camera/left/depth_mm"].numpy(), depth_mm)
    assert sample["camera/left/segmentation"].dtype == torch.int64
    np.testing.assert_array_equal(sample["camera/left/segmentation"].numpy(), ids)
    with refused(DatasetError):
        dataset.torch(channels=("camera/lift/rgb",))
    if frames == "grasp":
        with refused(DatasetError):
            dataset.view(0, "camera/left/rgb", 2)


def test_summary_card_and_pages_show_it(dataset, frames, tmp_path):
    found = summarize(dataset.root)["arrays"]["camera/top/depth_mm"]
    assert found["shape"] == [*lead(frames), 12, 12]
    assert found["raw_bytes"] == 4 * 144 * (3 if frames == "all" else 1)
    assert "camera/left/rgb" in summary_text(summarize(dataset.root))
    card = write_card(dataset.root).read_text()
    shape = ("N, T, " if frames == "all" else "N, ") + "left height, left width, 3"
    assert f"| `/camera/left/rgb` | {shape} | uint8 | grey level | camera |" in card
    gallery = write_gallery(dataset.root).read_text()
    assert gallery.count("what a camera sees at the moment of grasp") == 2 * 8  # of 8 executed
    write_grasp_page(dataset.root, 0, tmp_path / "grasp.html")
    page = (tmp_path / "grasp.html").read_text()
    told = "images of the camera left" if frames == "all" else "camera left: colours, depth"
    assert told in page
    assert page.count("Cameras at the moment of grasp") == (frames == "grasp")


def test_a_dataset_without_cameras_says_so(toy):
    plain = Dataset(toy.root)
    assert (plain.views, dict(plain.cameras), plain.read(0).cameras) == ((), {}, {})
    with refused(DatasetError):
        plain.view(0, "camera/a/rgb")
    with h5py.File(toy.shard_path(0)) as file:
        assert "cameras" not in file.attrs
        assert "camera" not in file


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A dataset to damage copies of."""
    folder = collect_toy(tmp_path_factory.mktemp("sound") / "data", SPECS["grasp"])
    folder.merge()
    return folder.root


def _without_intrinsics(file):
    del file["camera/left/rgb"].attrs["K"]


def _with_a_strange_name(file):
    file.attrs["cameras"] = np.bytes_(b"left,../../top")


def _with_one_named_twice(file):
    file.attrs["cameras"] = np.bytes_(b"left,left")


def _without_an_array(file):
    del file["camera/left/rgb"]


def _without_any(file):
    del file["camera"]


def _of_another_size(file):
    rgb = file["camera/top/rgb"]
    del file["camera/top/rgb"]
    file.create_dataset("camera/top/rgb", rgb.shape[:-1], np.uint8)


def _with_a_number_without_a_name(file):
    ids = file["camera/top/segmentation"]
    ids[0] = np.full(ids.shape[1:], len(SEGMENTS), np.uint8)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_without_intrinsics, r"camera/left/rgb has no attributes K \(3, 3\) and T_world_camera"),
        (_with_a_strange_name, "are not names"),
        (_with_one_named_twice, "not all different"),
        (_without_an_array, "/camera/left/rgb is missing"),
        (_without_any, "/camera/left/depth_mm is missing"),
        (_of_another_size, "camera/top/rgb"),
        (_with_a_number_without_a_name, "segmentation: the image .* has a number without a name"),
    ],
)
def test_a_damaged_shard_is_reported(tmp_path, sound, damage, message):
    toy = DatasetFolder(shutil.copytree(sound, tmp_path / "data"))
    with h5py.File(toy.shard_path(0), "r+") as file:
        damage(file)
    vouch_for(toy, 0)
    problems = [one.reason for one in verify(toy.root, decode=True).problems]
    assert len(problems) >= 1
    assert any(re.search(message, text) for text in problems), problems


def _png(content):
    image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    return image if image.ndim == 2 else image[..., ::-1]


def test_every_export_holds_it_where_it_has_a_place(dataset, frames, tmp_path):
    pytest.importorskip("pyarrow")
    said = {
        name: export_dataset(dataset.root, tmp_path / name, name)["content"] for name in FORMATS
    }
    for name in set(FORMATS) - {"real-grasps"}:
        assert "cameras left, top" in said[name]
    there, is_all = make_sample(1, SPECS[frames]).cameras["left"], frames == "all"
    rgb = there.rgb if is_all else there.rgb[None]
    ids = there.segmentation if is_all else there.segmentation[None]

    images = tmp_path / "images/cameras/left"
    for k in range(len(rgb)):
        stored = _png((images / f"rgb/g00001/{k}.png").read_bytes())
        np.testing.assert_array_equal(stored, rgb[k])
        stored = _png((images / f"segmentation/g00001/{k}.png").read_bytes())
        np.testing.assert_array_equal(stored, ids[k])
    np.testing.assert_array_equal(np.load(images / "depth_mm/g00001.npy"), there.depth_mm)
    facts = json.loads((images / "camera.json").read_text())
    assert (facts["K"], facts["T_world_camera"]) == (K.tolist(), POSE.tolist())
    assert facts["names"] == list(SEGMENTS)

    with tarfile.open(tmp_path / "webdataset/grasps-000000.tar") as archive:
        read = {name: archive.extractfile(name).read() for name in archive.getnames()}
    for k in range(len(rgb)):
        np.testing.assert_array_equal(_png(read[f"g00001.camera.left.{k}.png"]), rgb[k])
    for name in NAMES[1:]:
        stored = np.load(io.BytesIO(read[f"g00001.camera.left.{name}.npy"]))
        np.testing.assert_array_equal(stored, getattr(there, name))
    assert json.loads(read["g00001.json"])["cameras"]["left"] == facts

    with h5py.File(tmp_path / "robomimic/grasps.hdf5") as file:
        assert json.loads(file["data"].attrs["camera_left"]) == facts
        for name in NAMES:
            place = f"obs/camera_left_{name}" if is_all else f"camera_left_{name}"
            stored = file[f"data/demo_1/{place}"][:]
            np.testing.assert_array_equal(stored, getattr(there, name))


def test_lerobot_has_a_feature_of_each_camera_that_saw_every_frame(dataset, frames, tmp_path):
    pytest.importorskip("pyarrow")
    import pandas as pd

    export_dataset(dataset.root, tmp_path / "out", "lerobot")
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    table = pd.read_parquet(tmp_path / "out/data/chunk-000/file-000.parquet")
    episodes = pd.read_parquet(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet")
    episode = episodes.iloc[2]
    there = make_sample(int(episode["grasp_index"]), SPECS[frames]).cameras["top"]
    name, arrays = "observation.images.camera_top", tmp_path / "out/cameras/top"
    assert (name in info["features"]) == (frames == "all")
    if frames == "all":
        feature = info["features"][name]
        assert (feature["dtype"], feature["shape"]) == ("image", [12, 12, 3])
        assert feature["info"]["K"] == K.tolist()
        rows = table.iloc[episode["dataset_from_index"] : episode["dataset_to_index"]]
        for k, stored in enumerate(rows[name]):
            np.testing.assert_array_equal(_png(stored["bytes"]), there.rgb[k])
        stats = json.loads((tmp_path / "out/meta/stats.json").read_text())
        assert np.shape(stats[name]["mean"]) == (3, 1, 1)
    kept = NAMES[1:] if frames == "all" else NAMES
    assert sorted(path.name for path in arrays.iterdir() if path.is_dir()) == sorted(kept)
    for one in kept:
        stored = np.load(arrays / one / f"episode_{int(episode['episode_index']):06d}.npy")
        np.testing.assert_array_equal(stored, getattr(there, one))
    assert json.loads((arrays / "camera.json").read_text())["T_world_camera"] == np.eye(4).tolist()
