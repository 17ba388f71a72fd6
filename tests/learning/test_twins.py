"""Grasps that differ in an axis that changes nothing stand on one side of the split."""

import zlib
from dataclasses import replace

import numpy as np
import pytest

from tacgen.core.records import GraspConfig
from tacgen.dataset.export import export_dataset
from tacgen.learning.evaluate import evaluate
from tacgen.learning.grasps import SimulatedGrasps
from tacgen.learning.splits import plan_models
from tacgen.learning.train import train
from tacgen.learning.twins import equal_ranges, equal_within_noise, one_sided
from tests.learning.conftest import REFERENCE, collect, make_sample, make_spec, recipe_of

X_MM, Y_MM, FORCE_N = (-2.0, 0.0, 2.0), (-1.0, 0.0, 1.0), range(2, 10)


def centred(index, spec):
    """Fingers centre the can along x; along y the imprint moves by a pixel a millimetre."""
    sample = make_sample(0, spec)  # executed
    k, (x, y) = index // 9, divmod(index % 9, 3)
    config = GraspConfig(index, "can", float(FORCE_N[k]), X_MM[x], Y_MM[y], 40.0)
    rng = np.random.default_rng(index)
    gel = REFERENCE.astype(float)
    radius, place = 8 + k, 30 + int(Y_MM[y])
    gel[10 : 10 + radius, place : place + radius] += 40
    frames = gel + rng.normal(0, 2, (len(spec.time_s), *gel.shape))
    felt = replace(
        sample.pads["left"],
        rgb=np.clip(np.rint(frames), 0, 255).astype(np.uint8),
        force_normal_n=np.full(len(spec.time_s), config.force_n),
        indentation_mm=np.full(len(spec.time_s), 0.1 * config.force_n),
    )
    label = int(config.force_n + config.y_mm > 5.5)
    mode = "" if label else "translational_slip"
    split = "test" if zlib.crc32(b"%d" % index) % 8 == 0 else "train"
    return replace(
        sample,
        config=config,
        seed=index,
        label=label,
        failure_mode=mode,
        split=split,
        pads={"left": felt},
    )


@pytest.fixture(scope="module")
def grid(tmp_path_factory):
    spec = make_spec(9 * len(FORCE_N))
    return SimulatedGrasps(collect(tmp_path_factory.mktemp("grid") / "data", spec, centred))


def test_an_axis_that_changes_nothing_is_found_and_named(grid):
    assert equal_ranges(grid) == {"can": {"x_mm": [(-2.0, 2.0)]}}


def test_grasps_that_differ_in_it_alone_stand_on_one_side(grid):
    table, notes = one_sided(grid.table, equal_ranges(grid))
    assert notes[0].startswith("can: x_mm from -2 to 2 changes neither contact, image nor outcome")
    recipe = recipe_of(objects=["can"], training={"validation_fraction": 0.3})
    (plan,) = plan_models(recipe, table, "data", equal_ranges(grid))
    tested = np.flatnonzero(table.split == "test")
    seen = [
        set(zip(grid.table.force_n[rows], grid.table.y_mm[rows], strict=True))
        for rows in (plan.fit_rows, plan.validation_rows, tested)
    ]
    assert all(seen)
    assert len(set.union(*seen)) == sum(map(len, seen))
    # An eighth of the 24 groups is tested, each with all of its three grasps.
    assert len(tested) == 9
    assert f"{(table.split != grid.table.split).sum()} grasps change sides" in notes[1]


@pytest.mark.slow
def test_a_run_is_tested_on_its_own_side(grid, tmp_path):
    recipe = recipe_of(objects=["can"], training={"epochs": 1})
    train(recipe, grid.root, tmp_path / "run")
    result = evaluate(tmp_path / "run", data=grid.root)
    assert result["n"] == 9
    export_dataset(grid.root, tmp_path / "real", "real-grasps")
    assert evaluate(tmp_path / "run", real=tmp_path / "real")["n"] == 9


@pytest.mark.parametrize("noise_grey", [0.0, 1.0, 4.0])
def test_images_are_equal_until_something_but_noise_changes(noise_grey):
    rng = np.random.default_rng(2)
    gel = np.full((120, 160, 3), 100.0)
    pressed = gel.copy()
    pressed[40:80, 60:100] += 3

    def taken(image):
        return np.rint(image + rng.normal(0, noise_grey, image.shape)).astype(np.uint8)

    assert equal_within_noise(taken(gel), taken(gel))
    assert not equal_within_noise(taken(gel), taken(pressed))
