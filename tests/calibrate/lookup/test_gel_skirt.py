"""The skirt around a contact that a diagnosis finds is the one that a sensor draws."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tacgen.batch.sensor import BatchSensor
from tacgen.calibrate.lookup.gel_skirt import fitted_width
from tacgen.calibrate.lookup.gel_skirt import with_skirt as table_with_skirt
from tacgen.diagnose.optics.diagnose import _extended
from tacgen.diagnose.optics.fit import Model
from tacgen.optics.deform import Deformer
from tacgen.optics.effects.skirt import SKIRT_RADII, SLOPES
from tacgen.optics.table import load_table, save_table
from tacgen.presses.geometry import Membrane, PressedGel
from tacgen.sensor.read_image import ImageReader
from tacgen.sensor.simulated import Sensor

MM_PER_PX = 0.05
CONTACT_MM, BALL_MM = 1.36, 3.0
MEASURED = PressedGel(CONTACT_MM, BALL_MM, Membrane(0.61, 4.4))
"""As the presses of a DIGIT are."""


def drawn_slope(width, overlap, at_radii):
    """Slope of the renderer's gel around a ball, at distances in contact radii."""
    axis = (np.arange(161) - 80) * MM_PER_PX
    distance = np.hypot(axis, axis[:, None])
    level = np.sqrt(BALL_MM**2 - (overlap * CONTACT_MM) ** 2)
    depth = np.maximum(np.sqrt(np.maximum(BALL_MM**2 - distance**2, 0)) - level, 0)
    whole = (0, 161, 0, 161)
    part, (top, bottom, left, right) = Deformer(MM_PER_PX, width).deform(
        depth.astype(np.float32), whole, (161, 161)
    )
    gel = np.zeros((161, 161))
    gel[top:bottom, left:right] = part
    return np.interp(np.array(at_radii) * CONTACT_MM, axis[80:], -np.gradient(gel[80])[80:] / 0.05)


def test_the_fitted_width_draws_the_measured_slopes_beside_a_ball():
    width, at = fitted_width(MEASURED), (1.35, 1.5, 1.7, 2.0)
    measured = MEASURED.radial_slope(np.array(at) * CONTACT_MM)
    ratios = {w: drawn_slope(w, 1.37, at) / measured for w in (1.0, width)}
    assert abs(ratios[width] - 1.0).max() < 0.25
    assert ratios[1.0][3] < 0.05  # Taxim's has ended there


def test_a_wider_gel_has_a_wider_skirt():
    widths = [
        fitted_width(replace(MEASURED, membrane=Membrane(decay_mm, 4.4)))
        for decay_mm in (0.2, 0.4, 0.61)
    ]
    assert widths == sorted(widths)
    assert widths[0] < widths[-1]


def with_skirt(tmp_path, width):
    """The GelSight Mini's own table with a skirt of that width."""
    table = load_table(Sensor("gelsight_mini").description.table)
    path = tmp_path / f"{width}.npz"
    save_table(replace(table, effects={"skirt": {"width": width}}), path)
    return path


@pytest.mark.slow
def test_single_sensors_and_batches_draw_a_tables_skirt(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
    narrow = Sensor("gelsight_mini", with_skirt(tmp_path, 1.0)).render(ball, np.eye(4), 3.0)
    path = with_skirt(tmp_path, 3.0)
    wide = Sensor("gelsight_mini", path).render(ball, np.eye(4), 3.0)
    np.testing.assert_array_equal(wide.depth_mm, narrow.depth_mm)  # the skirt alone is wider
    rest = Sensor("gelsight_mini").at_rest_rgb().astype(int)
    changed = [(np.abs(one.rgb - rest).max(axis=2) > 5).sum() for one in (narrow, wide)]
    assert changed[1] > 1.2 * changed[0]
    batch = BatchSensor("gelsight_mini", 1, "cpu", table=path)
    out = batch.render_meshes([batch.add_mesh(ball)], np.eye(4)[None], [3.0])
    np.testing.assert_array_equal(out.rgb[0], wide.rgb)


@pytest.mark.parametrize("name", ["gelsight", "digit", "gelsight_mini"])
def test_shipped_tables_carry_the_skirt_of_their_own_presses(name):
    table = load_table(Sensor(name).description.table)
    assert table.effects == table_with_skirt(replace(table, effects={})).effects
    assert table.effects["skirt"]["width"] > 2.0


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_an_extended_table_carries_the_width_of_the_skirt_that_was_found(factor):
    table = load_table(Sensor("gelsight_mini").description.table)
    shared = {("skirt", name): factor for name in SLOPES}
    places = np.array([[k, k, 1.7] for k in range(3)])
    extended = _extended(table, Model((), {}, shared, places), 1.0, places)
    press = table.provenance["press_model"]
    membrane = Membrane(
        press["decay_mm"], press["sharpness"], tuple((radii, factor) for radii in SKIRT_RADII)
    )
    width = fitted_width(PressedGel(1.7, 2.5, membrane))
    assert extended.effects == {"skirt": {"width": width}}


@pytest.mark.slow
@pytest.mark.parametrize("width", [1.0, 3.25])
@pytest.mark.parametrize("radius_mm", [4.0, 8.0])
def test_a_deep_press_is_read_as_deep_whatever_its_skirt(tmp_path, width, radius_mm):
    """Slopes that are read too steep on one side do not lower the gel beyond it."""
    sensor, pose = Sensor("gelsight_mini", with_skirt(tmp_path, width)), np.eye(4)
    pose[:2, 3] = 1.0, -0.7
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius_mm)
    frame = sensor.render(ball, pose, 6.0)
    reading = ImageReader(sensor).read(frame.rgb)
    assert reading.volume_mm3 == pytest.approx(frame.volume_mm3, rel=0.1)
    assert abs(reading.volume_mm3 - frame.volume_mm3) < reading.volume_stderr_mm3


def test_a_reader_names_the_effects_that_it_does_not_undo(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ImageReader(Sensor("gelsight_mini", with_skirt(tmp_path, 3.0)))
    table = load_table(Sensor("gelsight_mini").description.table)
    effects = {"skirt": {"width": 3.0}, "vignetting": {}}
    save_table(replace(table, effects=effects), tmp_path / "dark.npz")
    with pytest.warns(UserWarning, match=r"\(vignetting\) are drawn, but not taken .* depth"):
        ImageReader(Sensor("gelsight_mini", tmp_path / "dark.npz"))
