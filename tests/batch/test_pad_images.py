"""Images that ``collect`` has drawn on a device: those of the pad, and what a dataset says."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
import yaml

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import Recipe
from tacgen.collection.run import prepare
from tacgen.contact.gel_response import GelLoad
from tacgen.contact.indenter import Imprint
from tacgen.core.errors import DatasetError, SensorError
from tacgen.core.sensors import load_sensor
from tacgen.dataset import DatasetFolder
from tacgen.optics import load_table
from tacgen.sensor.simulated import as_mesh
from tacgen.sensor.tactile_pad import TactilePad

BALL = as_mesh(trimesh.creation.icosphere(subdivisions=4, radius=4.0))


def imprints_of(pad):
    """A gel at rest, pressed and sheared, held still, and left again."""
    found = [Imprint()]
    for volume_mm3, at_mm, pull in ((4.0, 0.0, 0.0), (20.0, 2.0, 0.5), (20.0, 2.0, 1.0)):
        pose = trimesh.transformations.translation_matrix((at_mm, -1.0, 0.0))
        load = GelLoad(volume_mm3, shear_sum_mm=(pull, 0.0), k_s_mm_per_n=1.0,
                       force_n=(pull, 0.0, volume_mm3 / 5))  # fmt: skip
        found.append(pad.press(BALL, pose, load, found[-1]))
    return [*found, found[-1], Imprint()]


@pytest.mark.parametrize(
    ("drawn", "effects"),
    [({}, {}), ({"shadows": True, "markers": True}, {}), ({}, {"skirt": {"width": 3.0}})],
)
def test_images_are_those_of_the_pad(drawn, effects):
    pytest.importorskip("warp")
    from tacgen.batch.pad_images import PadImages

    sensor = load_sensor("gelsight_mini")
    pad = TactilePad(sensor, replace(load_table(sensor.table), effects=effects), **drawn)
    imprints = imprints_of(pad)
    on_device = PadImages(pad, 4, "warp:cpu")  # in two batches
    for seed in (None, 5):
        rngs = [None if seed is None else np.random.default_rng(seed) for _ in range(2)]
        expected = np.stack([pad.image(one, rng=rngs[0]) for one in imprints]).astype(int)
        images = on_device.images(imprints, rngs[1])
        assert np.abs(images - expected).max() <= 1
        assert np.abs(images - expected).mean() <= 0.05
        assert np.abs(expected[3] - expected[0]).max() > 20  # there is something to see


def recipe_of(**optics):
    sections = {"objects": ["sugar_box"], "grid": {"force_n": [5.0, 9.0]}, "optics": optics}
    return Recipe.model_validate({"name": "drawn", "sensor": "gelsight_mini", **sections})


def test_a_device_is_part_of_the_recipe():
    assert recipe_of(device="none").sha256() == recipe_of().sha256()
    assert recipe_of(device="cpu").sha256() == recipe_of().sha256()
    assert recipe_of(device="cuda").sha256() != recipe_of().sha256()


def test_without_a_gpu_auto_is_none_and_says_so(monkeypatch, capsys):
    from tacgen.core.progress import print_once

    print_once.cache_clear()
    monkeypatch.setattr("tacgen.core.errors.find_spec", lambda name: None)
    assert recipe_of(device="auto") == recipe_of()
    assert "optics.device = auto: images are drawn as without the key" in capsys.readouterr().err


def test_warp_is_not_there(monkeypatch, tmp_path):
    monkeypatch.setattr("tacgen.core.errors.find_spec", lambda name: None)
    with pytest.raises(SensorError, match=r"optics.device = 'cuda' needs warp, not installed"):
        prepare(recipe_of(device="cuda"), tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_a_device_that_is_not_here(tmp_path):
    if pytest.importorskip("warp").is_cuda_available():
        pytest.skip("there is a GPU")
    with pytest.raises(
        SensorError, match=r"optics.device = 'cuda' is not here: Warp finds no CUDA"
    ):
        prepare(recipe_of(device="cuda"), tmp_path / "data")


@pytest.fixture
def gpu(monkeypatch):
    """Warp's own CPU in place of a GPU."""
    warp = pytest.importorskip("warp")
    monkeypatch.setattr("tacgen.batch.pad_images.find_device", lambda _: warp.get_device("cpu"))


def test_a_dataset_names_what_drew_its_images(monkeypatch, gpu, tmp_path):
    prepare(recipe_of(device="cuda"), tmp_path)
    plan = DatasetFolder(tmp_path).plan()
    assert plan["device"].startswith("cuda (")
    assert yaml.safe_load((tmp_path / "recipe.yaml").read_text())["optics"]["device"] == "cuda"
    prepare(recipe_of(device="cuda"), tmp_path)
    with pytest.raises(DatasetError, match='optics.device: "cuda" there, "none" now'):
        prepare(recipe_of(), tmp_path)
    monkeypatch.setattr("tacgen.batch.pad_images.name_of", lambda device, pad: "cuda (other)")
    with pytest.raises(
        DatasetError, match=r"device: images drawn on cuda \(.*\) there, on cuda \(ot"
    ):
        prepare(recipe_of(device="cuda"), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_grasp_differs_in_its_images_by_a_grey_level(engine, gpu):
    pytest.importorskip(engine)
    grid = {"force_n": [5.0], "x_mm": [0.0], "y_mm": [0.0], "z_mm": [60.0]}
    sections = {"objects": ["sugar_box"], "grid": grid, "physics": {"engine": engine},
                "frames": {"mode": "sequence", "count": 3}, "sensor": "gelsight_mini"}  # fmt: skip
    recipe, found = Recipe.model_validate({"name": "drawn", **sections}), []
    for device in ("none", "cuda"):
        with GraspPipeline(recipe, device) as pipeline:
            found.append(pipeline.sample(plan_recipe(recipe)[0]))
    plain, drawn = (one.pads["left"] for one in found)
    assert np.abs(plain.rgb.astype(int) - drawn.rgb).max() <= 1
    assert np.array_equal(plain.force_normal_n, drawn.force_normal_n)
    assert found[0].label == found[1].label
