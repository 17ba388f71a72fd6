"""The virtual rig's camera: folders in the contract's form, pictures of the true contact."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest
import yaml

from tacgen.core.sensors import load_sensor
from tacgen.rig import RigRecipe, load_rig_recipe, run_rig
from tacgen.rig.images import press_ball


@pytest.fixture(scope="module")
def small() -> RigRecipe:
    """Four presses on the Mini's flat gel."""
    given = load_rig_recipe("rig_images_with_forces")
    schedule = given.schedule.model_copy(update={"presses": 4})
    images = given.images.model_copy(update={"per_press": 2, "labels": True})
    return given.model_copy(update={"schedule": schedule, "images": images})


@pytest.fixture(scope="module")
def folder(small, tmp_path_factory):
    out = tmp_path_factory.mktemp("rig")
    run_rig(small, out)
    return out


def test_the_folder_is_what_the_contract_says(small, folder):
    presses = folder / "presses"
    table = pd.read_csv(presses / "presses.csv")
    assert len(table) == 8
    assert {"file", "radius_mm", "center_x_px", "center_y_px", "contact_radius_px"} <= set(table)
    sensor = load_sensor(small.sensor, needs_table=False)
    for name in ["background.png", *table["file"]]:
        assert cv2.imread(str(presses / name)).shape == (*sensor.shape_px, 3)
    described = yaml.safe_load((presses / "sensor.yaml").read_text())
    assert described["mm_per_px"] == sensor.mm_per_px
    assert (folder / "press_log.csv").exists()


def test_the_contact_shows_where_it_is_labelled(small, folder):
    """The picture differs from the background around the label's circle and not far from it."""
    presses = folder / "presses"
    background = cv2.imread(str(presses / "background.png")).astype(float)
    for _, press in pd.read_csv(presses / "presses.csv").iterrows():
        changed = np.abs(cv2.imread(str(presses / press["file"])).astype(float) - background)
        rows, columns = np.indices(changed.shape[:2])
        away = np.hypot(columns - press["center_x_px"], rows - press["center_y_px"])
        near = changed[away < press["contact_radius_px"]].mean()
        assert near > 1.5 * changed[away > 2.0 * press["contact_radius_px"]].mean()


def test_a_ball_on_a_flat_gel_takes_its_cap(small):
    """V = π d² (R − d/3) and a contact circle of radius √(2Rd − d²)."""
    sensor = load_sensor(small.sensor, needs_table=False)
    radius, depth = 5.0, 0.6
    volume = np.pi * depth**2 * (radius - depth / 3.0)
    contact = press_ball(sensor, radius, (1.0, -0.5), volume, np.zeros(2))
    assert contact.depth_mm.max() == pytest.approx(depth, rel=2e-3)
    assert contact.contact_radius_mm(sensor.pixel_area_mm2) == pytest.approx(
        np.sqrt(2 * radius * depth - depth**2), rel=5e-3
    )


def test_on_a_dome_the_contact_lies_between_the_centres():
    """Two spheres meet in a circle on the line through their centres, (d² + R_d² − R²) / 2d² on."""
    given = load_rig_recipe("rig_images_with_forces")
    given = given.model_copy(
        update={"sensor": given.sensor.model_copy(update={"name": "gelsight"})}
    )
    sensor = load_sensor(given.sensor, needs_table=False)
    assert sensor.dome_radius_mm == 30.0
    contact = press_ball(sensor, 6.0, (3.0, -2.0), 3.0, np.zeros(2))
    column, row = contact.contact_center_px()
    d = 36.0 - contact.depth_mm.max()
    share = (d**2 + 30.0**2 - 6.0**2) / (2.0 * d**2)
    x_mm = (column - (sensor.width_px - 1) / 2) * sensor.mm_per_px
    y_mm = (row - (sensor.height_px - 1) / 2) * sensor.mm_per_px
    assert x_mm == pytest.approx(3.0 * share, rel=0.01)
    assert y_mm == pytest.approx(-2.0 * share, rel=0.01)


def test_markers_move_by_the_sum_that_was_asked_for(small):
    sensor = load_sensor(small.sensor, needs_table=False)
    still = press_ball(sensor, 5.0, (0.0, 0.0), 8.0, np.zeros(2))
    moved = press_ball(sensor, 5.0, (0.0, 0.0), 8.0, np.array([3.0, -1.0]))
    total = (moved.markers_mm - still.markers_mm).sum(axis=0)
    np.testing.assert_allclose(total, [3.0, -1.0], rtol=1e-9)
    assert moved.center_mm[0] > 0.0 > moved.center_mm[1]
