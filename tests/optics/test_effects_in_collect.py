"""What a diagnosis of images found reaches the dataset: the table's effects in collect's images."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import collect
from tacgen.dataset import Dataset
from tacgen.diagnose.optics.extended_table import effects_of, with_effects
from tacgen.diagnose.optics.model import Optics
from tacgen.optics import load_table, save_table
from tests.small_world import write_world

FOUND = Optics(
    sigma_mm=np.array([0.6]),
    light=np.array([[0.2, 0.1, 0.0, 0.8, -0.3], [0.0, 0.2, 0.1, -0.5, 0.4], [0.0] * 5]),
    mixing=np.array([0.2, 0.1, 0.0, 0.1, 0.3, 0.0]),
    shadow=np.array([0.7]),
    shadow_length_mm=4.0,
    gain=np.array([0.1, -0.05, 0.02]),
    offset=np.array([3.0, 0.0, -4.0]),
    dimming=np.array([0.3]),
    dimming_all=np.array([0.2]),
    level=np.array([118.0]),
    knee=np.array([2.0]),
)
EFFECTS = effects_of(FOUND)


def images(folder, effects, monkeypatch, name="out"):
    monkeypatch.chdir(folder)
    recipe = write_world(folder, grid="{force_n: [25], y_mm: [0], z_mm: [90]}")
    path = folder / "recipes" / "sensors" / "coarse.npz"
    save_table(replace(load_table(path), effects=effects), path)
    collect(load_recipe(recipe), folder / name, workers=1, progress=False)
    dataset = Dataset(folder / name)
    pads = dataset.read(0).pads
    return np.stack([pads[pad].rgb[0] for pad in sorted(pads)])


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        return images(tmp_path_factory.mktemp("plain"), {}, patch)


@pytest.mark.parametrize("name", EFFECTS)
def test_each_effect_changes_what_collect_writes_the_same_way_each_time(
    name, plain, tmp_path, monkeypatch
):
    made = images(tmp_path, {name: EFFECTS[name]}, monkeypatch)
    again = images(tmp_path, {name: EFFECTS[name]}, monkeypatch, "again")
    np.testing.assert_array_equal(made, again)
    changed = abs(made.astype(int) - plain.astype(int))
    assert changed.max() >= 3
    if name == "saturation":
        # The camera's noise of one grey level comes on top of the 118 at which it clips.
        assert made.max() <= 118 + 5 < plain.max()
    if name == "shadow":
        # Nothing but camera noise is ever brighter in shade.
        assert made.mean() < plain.mean()


def test_a_tables_effects_are_read_back_as_they_were_written():
    again = with_effects(Optics(), EFFECTS)
    for name in ("sigma_mm", "light", "mixing", "shadow", "gain", "offset", "level", "knee"):
        np.testing.assert_allclose(getattr(again, name), getattr(FOUND, name), atol=1e-12)
    assert effects_of(again).keys() == EFFECTS.keys()
