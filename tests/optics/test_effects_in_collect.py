"""What a diagnosis of images found reaches the dataset: the table's effects in collect's images."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline
from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import collect
from tacgen.dataset import Dataset
from tacgen.optics import load_table, save_table
from tests.small_world import write_world

pytestmark = pytest.mark.slow

EFFECTS = {
    "blur": {"sigma_mm": 0.6},
    "shadow": {"strength": 0.7, "length_mm": 4.0},
    "defocus": {"sigma_mm": 0.4},
    "illumination": {"r_uu": 0.2, "r_vv": 0.1, "r_u": 0.8, "r_v": -0.3, "g_u": -0.5, "g_v": 0.4},
    "cross_talk": {"rg": 0.2, "rb": 0.1, "gb": 0.1, "br": 0.3},
    "background_gain": {"gain_r": 1.1, "gain_g": 0.95, "offset_r": 3.0, "offset_b": -4.0},
    "vignetting": {"strength": 0.2, "change_strength": 0.3},
    "saturation": {"level_grey": 118.0, "knee_grey": 2.0},
}


def recipe_with(folder, effects):
    """One grasp, seen by a sensor whose table has these effects."""
    path = write_world(folder, grid="{force_n: [25], y_mm: [0], z_mm: [90]}")
    table = folder / "recipes" / "sensors" / "coarse.npz"
    save_table(replace(load_table(table), effects=effects), table)
    return load_recipe(path)


def images(folder, effects, monkeypatch):
    """What ``collect`` writes of that grasp, without the dataset."""
    monkeypatch.chdir(folder)
    recipe = recipe_with(folder, effects)
    (planned,) = plan_recipe(recipe)
    with GraspPipeline(recipe) as pipeline:
        pads = pipeline.sample(planned).pads
    return np.stack([pads[pad].rgb[0] for pad in sorted(pads)])


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        return images(tmp_path_factory.mktemp("plain"), {}, patch)


@pytest.mark.parametrize("name", EFFECTS)
def test_each_effect_changes_the_images_the_same_way_each_time(name, plain, tmp_path, monkeypatch):
    made = images(tmp_path, {name: EFFECTS[name]}, monkeypatch)
    again = images(tmp_path, {name: EFFECTS[name]}, monkeypatch)
    np.testing.assert_array_equal(made, again)
    changed = abs(made.astype(int) - plain.astype(int))
    assert changed.max() >= 3
    if name == "saturation":
        # The camera's noise of one grey level comes on top of the 118 at which it clips.
        assert made.max() <= 118 + 5 < plain.max()
    if name == "shadow":
        # Nothing but camera noise is ever brighter in shade.
        assert made.mean() < plain.mean()


def test_collect_writes_the_images_of_all_effects_together(tmp_path, monkeypatch):
    made = images(tmp_path, EFFECTS, monkeypatch)
    collect(recipe_with(tmp_path, EFFECTS), tmp_path / "out", workers=1, progress=False)
    pads = Dataset(tmp_path / "out").read(0).pads
    np.testing.assert_array_equal(made, np.stack([pads[pad].rgb[0] for pad in sorted(pads)]))
