"""Networks that see marker motion and force field beside the image."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.messages import refused

torch = pytest.importorskip("torch")

from typer.testing import CliRunner  # noqa: E402

import tacgen  # noqa: E402
from tacgen.cli import app  # noqa: E402
from tacgen.core.errors import DatasetError, LearningError, RecipeError  # noqa: E402
from tacgen.dataset import Dataset  # noqa: E402
from tacgen.dataset.export import export_dataset  # noqa: E402
from tacgen.learning.evaluate import evaluate  # noqa: E402
from tacgen.learning.grasps import SimulatedGrasps  # noqa: E402
from tacgen.learning.network_input import (  # noqa: E402
    InputSpec,
    TouchInput,
    one_of,
    read_touch,
    touch_input,
    touch_to_network,
    with_touch_scale,
)
from tacgen.learning.networks import TouchedImages, build_network  # noqa: E402
from tacgen.learning.train import train  # noqa: E402
from tacgen.learning.training_recipe import TrainRecipe, load_train_recipe  # noqa: E402

from .conftest import (  # noqa: E402
    REFERENCE,
    SENSOR,
    collect,
    make_sample,
    make_spec,
    recipe_of,
    write_real,
)

REST_MM = np.array([[x, y] for y in (-2.0, 2.0) for x in (-3.0, 0.0, 3.0)])
SHAPE = (3, 4)
TOUCH = {"marker_rest_mm": REST_MM, "force_field": SHAPE}
BOTH = ("image", "markers", "force_field")


def only_by_touch(index, spec):
    """A grasp whose images tell nothing: markers and force field hold the outcome."""
    sample = make_sample(index, spec)
    if not sample.pads:
        return sample
    rng = np.random.default_rng(500 + index)
    (pad,) = sample.pads.values()
    n_frames, sign = len(pad.rgb), 2 * sample.label - 1
    images = REFERENCE + rng.integers(-2, 3, (n_frames, *SENSOR.shape_px, 3))
    moved_mm = rng.normal([0.1 * sign, 0.0], 0.02, (n_frames, len(REST_MM), 2))
    field_n = np.abs(rng.normal(0.5, 0.05, (n_frames, *SHAPE, 3)))
    field_n[..., 0] *= sign
    touched = replace(pad, rgb=images.astype(np.uint8), markers_mm=moved_mm, force_field_n=field_n)
    return replace(sample, pads=dict.fromkeys(sample.pads, touched))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    spec = make_spec(**TOUCH)
    return collect(tmp_path_factory.mktemp("touch") / "data", spec, only_by_touch)


def spec_of(*names, kind="single", n_frames=1):
    shapes = {"markers": (6, 2), "force_field": (*SHAPE, 3)}
    touch = tuple(TouchInput(name, shapes[name]) for name in names)
    return InputSpec(kind, (32, 40), n_frames, "raw", SENSOR.shape_px, touch=touch)


def test_scales_make_each_component_one_in_the_mean_square(data):
    source = SimulatedGrasps(data)
    spec = spec_of("markers", "force_field")
    rows = range(len(source.table))
    found = [read_touch(source, row, spec) for row in rows]
    spec = with_touch_scale(spec, found)
    inputs = np.concatenate([touch_to_network(one, spec) for one in found])
    assert inputs.shape == (len(source.table), 12 + 36)
    for part, size in ((inputs[:, :12], 2), (inputs[:, 12:], 3)):
        squares = (part.reshape(-1, size) ** 2).mean(axis=0)
        np.testing.assert_allclose(squares, 1.0, rtol=1e-4)
    moment = int(source.table.grasp_frame[0])
    stored = source.dataset.touch(int(source.table.ids[0]), "markers_mm", None, moment)
    np.testing.assert_allclose(inputs[0, :12], (stored / spec.touch[0].scale).ravel(), rtol=1e-5)


@pytest.mark.parametrize("kind", ["single", "sequence"])
def test_the_touch_of_one_grasp_changes_its_logits_alone(kind, small_backbone):
    torch.manual_seed(0)
    frames = 1 if kind == "single" else 3
    network = build_network(kind, touch=(12, 36)).eval()
    images, touch = torch.randn(2, frames, 3, 32, 40), torch.randn(2, frames, 48)
    with torch.inference_mode():
        before = network(TouchedImages(images, touch))
        touch[1, -1, 40] += 5.0  # of the second channel
        after = network(TouchedImages(images, touch))
    assert before.shape == (2, 2)
    torch.testing.assert_close(after[0], before[0])
    assert not torch.allclose(after[1], before[1])


@pytest.mark.parametrize("channels", [["markers"], ["image", "image"], [], ["image", "sound"]])
def test_channels_that_are_none_are_refused(channels, tmp_path):
    path = tmp_path / "t.yaml"
    path.write_text(f"name: t\nkind: train\ninput: {{channels: {json.dumps(channels)}}}\n")
    with refused(RecipeError):
        load_train_recipe(path)


def test_the_order_of_channels_does_not_matter():
    both = recipe_of(input={"channels": ["markers", "image"]})
    assert both.resolved()["input"]["channels"] == ["image", "markers"]
    assert TrainRecipe.model_validate(both.resolved()) == both


@pytest.fixture(scope="module")
def run(data, tmp_path_factory, small_backbone):
    out = tmp_path_factory.mktemp("run") / "run"
    recipe = recipe_of(input={"channels": list(BOTH)}, training={"epochs": 12})
    train(recipe, data, out)
    return out


@pytest.mark.slow
@pytest.mark.usefixtures("small_backbone")
def test_it_learns_what_the_images_do_not_tell(run, data):
    assert evaluate(run, data=data)["accuracy"] == 1.0


@pytest.mark.slow
@pytest.mark.usefixtures("small_backbone")
def test_the_predictor_takes_it_and_says_what_is_missing(run, data):
    dataset = Dataset(data)
    columns = dataset.columns()
    rows = np.flatnonzero((columns["split"] == "test") & (columns["label"] >= 0))
    index, moment = columns["index"][rows], columns["grasp_frame"][rows]
    pairs = list(zip(map(int, index), map(int, moment), strict=True))
    images = [dataset.rgb(i, None, k) for i, k in pairs]
    touch = {
        name: [dataset.touch(i, name, None, k) for i, k in pairs]
        for name in ("markers_mm", "force_field_n")
    }
    predictor = tacgen.Predictor(run)
    found = predictor.predict(images, touch)
    assert ((found >= 0.5) == (columns["label"][rows] == 1)).all()
    with refused(LearningError):
        predictor.predict(images)
    touch["markers_mm"][0] = touch["markers_mm"][0][:3]
    with refused(LearningError):
        predictor.predict(images, touch)


@pytest.mark.slow
@pytest.mark.usefixtures("small_backbone")
def test_data_without_it_or_of_another_shape_is_refused(run, toy, tmp_path):
    with refused(DatasetError):
        evaluate(run, data=toy)
    with refused(DatasetError):
        train(recipe_of(input={"channels": ["image", "force_field"]}), toy, tmp_path / "run")
    spec = make_spec(**(TOUCH | {"force_field": (2, 2)}))

    def coarser(index, spec):
        sample = only_by_touch(index, spec)
        pads = {
            name: replace(pad, force_field_n=pad.force_field_n[:, :2, :2])
            for name, pad in sample.pads.items()
        }
        return replace(sample, pads=pads)

    other = collect(tmp_path / "other", spec, coarser)
    with refused(LearningError):
        evaluate(run, data=other)


@pytest.mark.slow
@pytest.mark.usefixtures("small_backbone")
def test_a_folder_of_pictures_and_the_command_say_what_they_lack(run, data, tmp_path):
    export_dataset(data, tmp_path / "real", "real-grasps", split="test")
    with refused(LearningError):
        evaluate(run, real=tmp_path / "real")
    image = next((tmp_path / "real/images").glob("*/0.png"))
    result = CliRunner().invoke(app, ["predict", str(run), str(image)])
    assert isinstance(result.exception, LearningError)
    assert "also sees markers_mm" in str(result.exception)


def by_command(index, spec):
    """A grasp whose images tell nothing: the force that was commanded decides its outcome."""
    sample = only_by_touch(index, spec)
    if not sample.pads:
        return sample
    firm = sample.config.force_n > 6.5
    mode = "" if firm else "translational_slip"
    return replace(sample, label=int(firm), failure_mode=mode)


@pytest.fixture(scope="module")
def commanded(tmp_path_factory):
    spec = make_spec(120, **TOUCH)
    return collect(tmp_path_factory.mktemp("told") / "data", spec, by_command)


def test_what_was_commanded_is_centred_and_scaled_and_the_object_is_one_of_the_training_s(
    commanded,
):
    source = SimulatedGrasps(commanded)
    names = source.table.object_names()
    touch = (touch_input(source, "commanded"), touch_input(source, "object", names))
    spec = replace(spec_of(), touch=touch)
    found = [read_touch(source, row, spec) for row in range(len(source.table))]
    np.testing.assert_array_equal([one[0][0] for one in found], source.table.commanded())
    spec = with_touch_scale(spec, found)
    inputs = np.concatenate([touch_to_network(one, spec) for one in found])
    assert inputs.shape == (len(source.table), 5 + 2)
    np.testing.assert_allclose(inputs[:, :5].mean(axis=0), 0.0, atol=1e-5)
    varies = source.table.commanded().std(axis=0) > 0
    np.testing.assert_allclose(inputs[:, :5].std(axis=0), varies, atol=1e-5)
    is_can = source.table.objects == "can"
    assert np.ptp(inputs[is_can, 5]) == 0.0
    assert (inputs[is_can, 5] > 0).all()
    assert (inputs[is_can, 6] == 0).all()


def test_a_new_object_is_none_of_the_training_s():
    np.testing.assert_array_equal(one_of(("can", "cup"), "mug", 3), np.zeros((3, 2)))
    np.testing.assert_array_equal(one_of(("can", "cup"), "cup", 2), [[0, 1], [0, 1]])


@pytest.mark.slow
@pytest.mark.usefixtures("small_backbone")
@pytest.mark.parametrize("kind", ["single", "sequence"])
def test_a_network_learns_from_what_was_commanded_and_the_predictor_takes_it(
    kind, commanded, tmp_path
):
    channels = ["touch", "commanded", "object"]
    training = {"epochs": 30, "learning_rate": 3e-3}
    recipe = recipe_of(kind, input={"channels": channels, "until": "outcome"}, training=training)
    train(recipe, commanded, tmp_path / "run")
    result = evaluate(tmp_path / "run", data=commanded)
    assert result["accuracy"] >= 0.8  # of 40 grasps; by chance once in 10 000 times
    assert result["without_touch"]["accuracy"] >= 0.9
    source = SimulatedGrasps(commanded)
    rows = np.flatnonzero(source.table.split == "test")
    frames = [range(3) if kind == "sequence" else [int(source.table.grasp_frame[k])] for k in rows]
    images = [source.frames(int(k), one) for k, one in zip(rows, frames, strict=True)]
    touch = {
        "commanded": list(source.table.commanded()[rows]),
        "object": source.table.objects[rows].tolist(),
    }
    given = images if kind == "sequence" else [one[0] for one in images]
    found = tacgen.Predictor(tmp_path / "run").predict(given, touch)
    wrong = ((found >= 0.5) != (source.table.label[rows] == 1)).sum()
    assert wrong == len(result["misclassified"])
    unknown = np.array(touch["commanded"])
    unknown[0, 1] = np.nan
    with refused(LearningError):
        tacgen.Predictor(tmp_path / "run").predict(given, touch | {"commanded": list(unknown)})


@pytest.mark.slow
@pytest.mark.usefixtures("small_backbone")
def test_grasps_that_do_not_tell_what_was_commanded_are_not_compared_with_it(commanded, tmp_path):
    real = write_real(tmp_path / "real")
    told = pd.read_csv(real / "grasps.csv")
    told.drop(columns=["force_n", "y_mm"]).to_csv(real / "grasps.csv", index=False)
    for channels in (["touch"], ["touch", "commanded"]):
        run = tmp_path / "_".join(channels)
        recipe = recipe_of("single", input={"channels": channels}, training={"epochs": 1})
        train(recipe, commanded, run)
    assert "without_touch" not in evaluate(tmp_path / "touch", real=real)
    with refused(LearningError):
        evaluate(tmp_path / "touch_commanded", real=real)
