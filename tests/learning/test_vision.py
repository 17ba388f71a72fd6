"""Networks that see a camera: alone, or beside the touch."""

from dataclasses import replace

import numpy as np
import pytest

from tests.messages import refused

torch = pytest.importorskip("torch")

import tacgen  # noqa: E402
from tacgen.core.errors import DatasetError, LearningError, RecipeError  # noqa: E402
from tacgen.core.records import Camera  # noqa: E402
from tacgen.dataset import CameraSample, Dataset  # noqa: E402
from tacgen.dataset.export import export_dataset  # noqa: E402
from tacgen.learning.evaluate import evaluate  # noqa: E402
from tacgen.learning.grasps import SimulatedGrasps  # noqa: E402
from tacgen.learning.network_input import (  # noqa: E402
    InputSpec,
    VisionInput,
    read_input,
    to_network,
    with_normalisation,
)
from tacgen.learning.networks import build_network  # noqa: E402
from tacgen.learning.train import train  # noqa: E402
from tacgen.learning.training_recipe import load_train_recipe  # noqa: E402

from .conftest import REFERENCE, SENSOR, collect, make_sample, make_spec, recipe_of  # noqa: E402

K = np.array([[50.0, 0, 24.5], [0, 50.0, 19.5], [0, 0, 1]])
CAMERAS = tuple(Camera(name, 40, 50, K, np.eye(4)) for name in ("front", "top"))


def only_by_sight(index, spec):
    """A grasp whose tactile images tell nothing: the front camera's hold the outcome."""
    sample = make_sample(index, spec)
    if not sample.pads:
        return sample
    rng = np.random.default_rng(700 + index)
    (pad,) = sample.pads.values()
    n = len(pad.rgb)
    images = REFERENCE + rng.integers(-2, 3, (n, *SENSOR.shape_px, 3))
    pads = dict.fromkeys(sample.pads, replace(pad, rgb=images.astype(np.uint8)))
    cameras = {}
    for camera in spec.cameras:
        level = 150 + 60 * (2 * sample.label - 1) * (camera.name == "front")
        rgb = (level + rng.integers(-9, 10, (n, *camera.shape_px, 3))).astype(np.uint8)
        depth_mm = np.full((n, *camera.shape_px), 400, np.float32)
        seen = (rgb, depth_mm, np.zeros((n, *camera.shape_px), np.uint8))
        if not spec.camera_frames:
            seen = tuple(one[sample.grasp_frame] for one in seen)
        cameras[camera.name] = CameraSample(*seen)
    return replace(sample, pads=pads, cameras=cameras)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    spec = make_spec(80, cameras=CAMERAS, camera_frames=True)
    return collect(tmp_path_factory.mktemp("sight") / "data", spec, only_by_sight)


def spec_of(kind="single", n_frames=1, **given):
    vision = VisionInput.of(CAMERAS[0])
    found = InputSpec(kind, (32, 40), n_frames, "difference", SENSOR.shape_px, vision=vision)
    return replace(found, **given)


def test_the_colours_of_a_camera_follow_those_of_the_sensor(data):
    source = SimulatedGrasps(data)
    both, alone = spec_of(), spec_of(sees_touch=False)
    for row in range(3):
        index, moment = int(source.table.ids[row]), int(source.table.grasp_frame[row])
        frames = read_input(source, row, both)
        assert frames.shape == (1, 32, 40, 6)
        np.testing.assert_array_equal(
            frames[..., :3], read_input(source, row, spec_of(vision=None))
        )
        np.testing.assert_array_equal(frames[..., 3:], read_input(source, row, alone))
        seen = source.dataset.view(index, "camera/front/rgb", moment)
        assert abs(frames[..., 3:].mean() - seen.mean()) < 0.5


def test_the_gel_at_rest_is_taken_from_the_sensors_images_alone():
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 255, (4, 1, 32, 40, 6), dtype=np.uint8)
    rest = np.full((32, 40, 3), 90, np.uint8)
    found = to_network(frames, rest, spec_of(mean=(0.0,) * 6, std=(1.0,) * 6))
    np.testing.assert_array_equal(found[..., :3], frames[..., :3].astype(np.float32) - 90)
    np.testing.assert_array_equal(found[..., 3:], frames[..., 3:])
    alone = spec_of(sees_touch=False)
    np.testing.assert_array_equal(to_network(frames[..., 3:], None, alone), frames[..., 3:])
    spec = with_normalisation(spec_of(), list(frames), rest)
    scaled = to_network(frames, rest, spec).reshape(-1, 6)
    np.testing.assert_allclose(scaled.mean(axis=0), 0, atol=1e-5)
    np.testing.assert_allclose(scaled.std(axis=0), 1, atol=1e-5)


@pytest.mark.parametrize("kind", ["single", "sequence"])
def test_each_image_has_a_backbone_of_its_own(kind, small_backbone):
    torch.manual_seed(0)
    network = build_network(kind, n_images=2).eval()
    images = torch.randn(2, 1 if kind == "single" else 3, 6, 32, 40)
    with torch.inference_mode():
        before = network(images)
        images[1, -1, 4] += 3.0  # of the camera
        after = network(images)
    torch.testing.assert_close(after[0], before[0])
    assert not torch.allclose(after[1], before[1])


def test_touch_is_the_image_in_a_recipe_and_its_hash():
    plain = recipe_of()
    assert recipe_of(input={"channels": ["touch"]}).sha256() == plain.sha256()
    both = recipe_of(input={"channels": ["vision", "touch"]})
    assert both.resolved()["input"]["channels"] == ["image", "vision"]


@pytest.mark.parametrize(
    "line",
    [
        "channels: [touch, image]",
        "channels: [markers]",
        "camera: front",
    ],
)
def test_channels_that_are_none_are_refused(line, tmp_path):
    path = tmp_path / "t.yaml"
    path.write_text(f"name: t\ninput: {{{line}}}\n")
    with refused(RecipeError):
        load_train_recipe(path)


def trained(data, out, *channels, kind="single", **given):
    recipe = recipe_of(kind, input={"channels": list(channels), **given}, training={"epochs": 12})
    train(recipe, data, out)
    return out


@pytest.mark.slow
@pytest.mark.usefixtures("small_backbone")
@pytest.mark.parametrize("channels", [("vision",), ("touch", "vision")])
def test_it_learns_what_the_touch_does_not_tell(data, tmp_path, channels):
    run = trained(data, tmp_path / "run", *channels)
    assert evaluate(run, data=data)["accuracy"] == 1.0
    assert evaluate(run, data=data, controls=True)["controls"]["constant images"]["accuracy"] < 0.95
    dataset = Dataset(data)
    columns = dataset.columns()
    rows = np.flatnonzero((columns["split"] == "test") & (columns["label"] >= 0))
    pairs = [(int(columns["index"][row]), int(columns["grasp_frame"][row])) for row in rows]
    touch = [dataset.rgb(i, None, k) for i, k in pairs]
    vision = [dataset.view(i, "camera/front/rgb", k) for i, k in pairs]
    predictor = tacgen.Predictor(run)
    given = {"vision": vision} if len(channels) == 2 else {}
    found = predictor.predict(touch if given else vision, **given)
    assert ((found >= 0.5) == (columns["label"][rows] == 1)).all()
    if given:
        with refused(LearningError):
            predictor.predict(touch)
        with refused(LearningError):
            predictor.predict(touch, vision=touch)


@pytest.mark.slow
@pytest.mark.usefixtures("small_backbone")
def test_what_lacks_the_camera_or_has_it_elsewhere_is_said(data, toy, tmp_path):
    run = trained(data, tmp_path / "run", "touch", "vision", kind="sequence", until="outcome")
    assert evaluate(run, data=data)["accuracy"] > 0.9
    with refused(LearningError):
        evaluate(run, data=toy)
    moment = collect(tmp_path / "moment", make_spec(cameras=CAMERAS), only_by_sight)
    with refused(DatasetError):
        evaluate(run, data=moment)
    export_dataset(data, tmp_path / "real", "real-grasps", split="test")
    with refused(LearningError):
        evaluate(run, real=tmp_path / "real")
    moved = np.eye(4)
    moved[0, 3] = 50.0
    cameras = tuple(replace(one, t_world_camera_mm=moved) for one in CAMERAS)
    spec = make_spec(cameras=cameras, camera_frames=True)
    other = collect(tmp_path / "moved", spec, only_by_sight)
    notes = evaluate(run, data=other)["notes"]
    assert any("camera 'front' is not placed as in training" in one for one in notes)
    larger = tuple(replace(one, height_px=48) for one in CAMERAS)
    spec = make_spec(cameras=larger, camera_frames=True)
    with refused(LearningError):
        evaluate(run, data=collect(tmp_path / "larger", spec, only_by_sight))
