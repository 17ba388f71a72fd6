"""Pictures to forces, against the virtual rig's truth, which no part of the reader has seen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
import trimesh
from typer.testing import CliRunner

import tacgen
from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.cli import app
from tacgen.contact import gel_map_mm
from tacgen.contact.gel_response import gel_loads
from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.contact.shear import marker_grid_mm
from tacgen.core.errors import SensorError, TableError
from tacgen.core.images import encode_png
from tacgen.core.records import ContactFrame, Estimate
from tacgen.core.resources import sensor_files
from tacgen.core.safe_io import read_rgb
from tacgen.core.sensors import load_sensor
from tacgen.optics import save_table
from tacgen.optics.reconstruct import Reconstructor
from tacgen.optics.virtual_sensor import VirtualSensor
from tacgen.presses.press_folder import read_presses
from tacgen.presses.screening import usable_presses
from tacgen.rig import load_rig_recipe
from tacgen.rig.images import Camera, press_ball
from tacgen.sensor.read_image import (
    _LATEST,
    MARKER_STDERR_PX,
    ImageReader,
    Reading,
    _with_forces,
    read_files,
    read_image,
    reading_line,
)
from validation.optics.sampled_table import sampled_table

K_N, K_S = 5.135, 0.8
LAMPS = (
    ((0.0, -0.866, -0.5), (0.05, 0.2, 1.9)),
    ((0.75, 0.433, -0.5), (0.08, 1.5, 0.15)),
    ((-0.75, 0.433, -0.5), (1.7, 0.12, 0.08)),
)
"""A third of a turn apart: red and blue opposite to each other, as a real Mini has them, leave
slopes between them that look alike, which is no matter of the reader."""


@pytest.fixture(scope="module")
def rig():
    """A Mini on the rig: its description, and a camera without and one with dots."""
    recipe = load_rig_recipe("rig_images_with_forces")
    plain = recipe.images.model_copy(update={"markers": False})
    sensor = replace(load_sensor(recipe.sensor, needs_table=False), leds=LAMPS)
    return (
        sensor,
        Camera(recipe.model_copy(update={"images": plain}), sensor),
        Camera(recipe, sensor),
    )


@pytest.fixture(scope="module")
def sensor(rig, tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / "table.npz"
    description = rig[0]
    table = sampled_table(
        VirtualSensor.like(description), gel_map_mm(description), sensor=description.name
    )
    save_table(table, path)
    return tacgen.Sensor("gelsight_mini", path, ContactLaw.linear(K_N, K_S))


@pytest.fixture(scope="module")
def reader(rig, sensor):
    return ImageReader(sensor, rig[1].take(None, np.random.default_rng(0)))


@pytest.fixture(scope="module")
def press_of_3_n(rig):
    contact = press_ball(rig[0], 6.0, (1.0, -0.7), K_N * 3.0, np.zeros(2))
    return rig[1].take(contact, np.random.default_rng(1))


@pytest.mark.slow
@pytest.mark.parametrize(("radius_mm", "force_n"), [(4.0, 1.0), (6.0, 4.0)])
def test_depth_volume_and_force_of_a_ball(rig, reader, radius_mm, force_n):
    """Within 5 % of volume, 7 % of force, 0.02 mm of depth over the picture."""
    description, camera, _ = rig
    contact = press_ball(description, radius_mm, (1.0, -0.7), K_N * force_n, np.zeros(2))
    found = reader.read(camera.take(contact, np.random.default_rng(1)))
    assert found.volume_mm3 == pytest.approx(K_N * force_n, rel=0.05)
    assert found.force_n[2] == pytest.approx(force_n, rel=0.07)
    assert np.sqrt(np.mean((found.depth_mm - contact.depth_mm) ** 2)) < 0.02
    assert found.depth_mm.sum() * description.pixel_area_mm2 == pytest.approx(
        found.volume_mm3, rel=1e-4
    )
    # The contact's rim is a pixel or two wide; the disc has a radius of some fifty.
    overlap = (found.contact_mask & (contact.depth_mm > 0)).sum()
    assert overlap > 0.85 * (found.contact_mask | (contact.depth_mm > 0)).sum()
    # Without dots no shear is known.
    assert np.isnan(found.force_n[:2]).all()
    assert 0 < found.force_stderr_n[2] < 0.1 * force_n


@pytest.mark.slow
@pytest.mark.parametrize(("force_n", "steep"), [(0.5, False), (6.0, True)])
def test_walls_steeper_than_the_table_are_reported(force_n, steep):
    """A flat punch's walls are vertical; the shipped table, made of balls, ends at 48°."""
    sensor = tacgen.Sensor("virtual_gelsight", dome_radius_mm=0.0)
    punch = trimesh.creation.cylinder(radius=3.0, height=4.0, sections=64)
    frame = sensor.render(punch, np.eye(4), force_n=force_n)
    found = read_image(frame.rgb, sensor)
    assert ("at the steepest slope of the table" in found.message) == steep
    is_right = found.volume_mm3 == pytest.approx(frame.volume_mm3, rel=0.05)
    assert is_right != steep


@pytest.mark.slow
@pytest.mark.parametrize(
    ("force_n", "is_steep", "is_bound"),
    [(0.5, False, False), (3.0, True, False), (6.0, True, True)],
)
def test_a_small_ball_deep_in_the_gel_is_right_or_a_lower_bound(
    force_n, is_steep, is_bound, tmp_path
):
    """Radius 2.5 mm: flanks up to 64° are continued from the bottom, steeper ones are said."""
    sensor = tacgen.Sensor("virtual_gelsight", dome_radius_mm=0.0)
    ball = trimesh.creation.icosphere(subdivisions=4, radius=2.5)
    cv2.imwrite(
        str(tmp_path / "a.png"), sensor.render(ball, np.eye(4), force_n=force_n).rgb[..., ::-1]
    )
    (row,) = read_files(ImageReader(sensor), [tmp_path / "a.png"], tmp_path / "out")
    found = pd.read_csv(tmp_path / "out/readings.csv").iloc[0]
    assert found["lower_bound"] == row["lower_bound"] == is_bound
    assert (found["steep_share"] > 0.01) == is_steep
    assert ("force at least" in reading_line(row)) == is_bound
    missing = force_n - row["force_normal_n"]
    if is_bound:
        assert missing > 3 * row["force_normal_stderr_n"]
        assert "a lower bound: " in row["message"]
    else:
        assert abs(missing) < 2 * row["force_normal_stderr_n"]


@pytest.mark.slow
def test_shear_from_dots(rig, sensor):
    description, _, camera = rig
    reader = ImageReader(sensor, camera.take(None, np.random.default_rng(0)))
    shear_n = np.array([0.6, -0.4])
    contact = press_ball(description, 6.0, (0.0, 0.0), K_N * 3.0, K_S * shear_n)
    found = reader.read(camera.take(contact, np.random.default_rng(1)))
    # 63 dots, each to about a tenth of a pixel: 0.05 mm of the sum, and as much of lost ones.
    np.testing.assert_allclose(found.force_n[:2], shear_n, atol=0.15)
    assert found.force_n[2] == pytest.approx(3.0, rel=0.07)
    assert (found.force_stderr_n[:2] < 0.15).all()
    # Each dot, in the order of the sensor's grid, moved as the rig moved it: to 0.1 px, and a few
    # at the contact's rim, where the light changes, to half a pixel.
    at_rest = marker_grid_mm(description)
    off = np.hypot(*(found.markers_mm - (contact.markers_mm - at_rest)).T) / description.mm_per_px
    assert np.median(off) < 0.1
    assert off.max() < 1.0
    np.testing.assert_allclose(found.marker_rest_mm, at_rest, atol=0.1 * description.mm_per_px)
    np.testing.assert_allclose(found.markers_mm.sum(axis=0), found.shear_sum_mm)
    assert found.markers_lost == 0


@pytest.mark.slow
def test_dots_that_a_picture_does_not_show_are_counted_and_give_no_shear(rig, sensor):
    """The dots of a strip of the picture are gone."""
    description, plain, camera = rig
    reader = ImageReader(sensor, camera.take(None, np.random.default_rng(0)))
    contact = press_ball(description, 6.0, (2.0, 0.0), K_N * 3.0, np.zeros(2))
    picture = camera.take(contact, np.random.default_rng(1))
    picture[:, :100] = plain.take(contact, np.random.default_rng(1))[:, :100]
    found = reader.read(picture)
    assert found.markers_lost >= 14
    assert np.isnan(found.force_n[:2]).all()
    assert "dots are not seen: the shear is not known" in found.message


@pytest.mark.slow
def test_no_contact_is_zero_force_and_says_so(rig, reader):
    found = reader.read(rig[1].take(None, np.random.default_rng(5)))
    assert not found.contact_mask.any()
    assert found.force_n.tolist() == [0.0, 0.0, 0.0]
    assert found.message == "no contact: the gel is nowhere deeper than 0.03 mm"


def test_a_further_picture_is_read_by_the_reader_of_the_one_before(rig, sensor, press_of_3_n):
    """It is made anew where the background changes, not only when another array holds it."""
    background = rig[1].take(None, np.random.default_rng(0))
    darker = np.rint(0.95 * background).astype(np.uint8)
    fresh = {
        k: tacgen.ImageReader(sensor, at).read(press_of_3_n)
        for k, at in enumerate((background, darker))
    }
    tacgen.read_image(background, sensor, background)
    kept = _LATEST[sensor]
    assert (
        tacgen.read_image(press_of_3_n, sensor, background.copy()).force_n[2] == fresh[0].force_n[2]
    )
    assert _LATEST[sensor] is kept
    assert tacgen.read_image(press_of_3_n, sensor, darker).force_n[2] == fresh[1].force_n[2]
    background[:] = darker  # a caller's buffer that is used again
    assert tacgen.read_image(press_of_3_n, sensor, background).force_n[2] == fresh[1].force_n[2]
    assert fresh[0].force_n[2] != fresh[1].force_n[2]
    mine = tacgen.Sensor("gelsight_mini", sensor.description.table, sensor.law)
    tacgen.read_image(press_of_3_n, mine, darker)
    mine.table = replace(mine.table)  # what a reader is made of
    before = _LATEST[mine]
    tacgen.read_image(press_of_3_n, mine, darker)
    assert _LATEST[mine] is not before


def test_a_reading_does_not_depend_on_the_pictures_before_it(rig, reader, press_of_3_n):
    """Forwards, backwards and alone: the same numbers, bit by bit."""
    description, camera, _ = rig
    shallow = press_ball(description, 4.0, (-2.0, 1.0), 2.0, np.zeros(2))
    pictures = [press_of_3_n, camera.take(None, np.random.default_rng(5))]
    pictures.append(camera.take(shallow, np.random.default_rng(6)))
    forwards = [reader.read(picture) for picture in pictures]
    backwards = [reader.read(picture) for picture in reversed(pictures)][::-1]
    for one, other in zip(forwards, backwards, strict=True):
        np.testing.assert_array_equal(one.depth_mm, other.depth_mm)
        np.testing.assert_array_equal(one.force_stderr_n, other.force_stderr_n)


def test_a_law_with_stiffening_is_inverted(reader, sensor):
    """The force is the one at which the law itself gives the volume."""
    from types import MappingProxyType

    from tacgen.contact.effects import find_effect
    from tacgen.sensor.read_image import _normal_force_n

    names = [p.name for p in find_effect("normal", "stiffening").parameters]
    effect = FittedEffect("stiffening", "normal", MappingProxyType({names[0]: Estimate(0.2, 0.0)}))
    law = ContactLaw("volume_linear", Estimate(K_N, 0.1), effects=(effect,))
    frame = ContactFrame(0.0, 3.0, np.zeros(2), 0.0, np.eye(4))
    volume = gel_loads(law, [frame])[0].volume_mm3
    assert volume != pytest.approx(3.0 * K_N, rel=1e-3)

    class Given:
        volume_mm3 = volume
        indentation_mm = 0.0

    assert _normal_force_n(law, Given()) == pytest.approx(3.0, abs=1e-3)


def fitted(name, channel, **parameters):
    """An effect with given parameters."""
    return FittedEffect(name, channel, {k: Estimate(v) for k, v in parameters.items()})


LAWS = {
    "anisotropy": [fitted("anisotropy", "shear", along_x=0.3, rotation_rad=0.2)],
    "normal coupling": [
        fitted("normal_coupling", "shear", amount=-0.4, exponent=-0.33, reference_n=6.0)
    ],
    "slip": [fitted("slip", "shear", mindlin=1.0, mu=0.8)],
    "shear coupling": [fitted("shear_coupling", "normal", ratio=0.2, ratio_reference=0.3)],
    "stiffening and anisotropy": [
        fitted("stiffening", "normal", amount=-0.2, reference_n=5.0),
        fitted("anisotropy", "shear", diagonal=-0.2),
    ],
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("pitch_mm", [2.0, 1.0])
def test_the_whole_law_is_inverted(name, pitch_mm):
    """Normal and shear force are those at which law, effects and grid of dots give the imprint."""
    law = replace(ContactLaw.linear(K_N, K_S, 2.0), effects=tuple(LAWS[name]))
    force_n = np.array([0.6, -0.4, 3.0])
    frame = ContactFrame(0.0, force_n[2], force_n[:2], 0.0, np.eye(4))
    (load,) = gel_loads(law, [frame])
    motion_mm = load.shear_sum_mm * (2.0 / pitch_mm) ** 2
    assert np.abs(motion_mm / (2.0 / pitch_mm) ** 2 / K_S - force_n[:2]).max() > 0.02 or (
        load.volume_mm3 != pytest.approx(K_N * force_n[2], rel=0.01)
    )
    found = _with_forces(imprint(load.volume_mm3, motion_mm), law, 0.058, pitch_mm)
    np.testing.assert_allclose(found.force_n, force_n, rtol=1e-5)
    assert (found.force_stderr_n > 0).all()
    assert found.message == ""
    # Without dots no shear is known, nor what it does to the volume.
    alone = _with_forces(imprint(load.volume_mm3, np.full(2, np.nan)), law, 0.058, np.nan)
    assert np.isnan(alone.force_n[:2]).all()
    assert ("shear_coupling" in alone.message) == (name == "shear coupling")
    if name != "shear coupling":
        assert alone.force_n[2] == pytest.approx(force_n[2], rel=1e-5)


def imprint(volume_mm3, motion_mm):
    """A reading without its forces."""
    none = np.zeros(3)
    dots = None if np.isnan(motion_mm).any() else np.zeros((63, 2))
    return Reading(none, none, none > 0, none, 0.3, volume_mm3, dots, none, 0.1, motion_mm, "")


def test_a_picture_may_be_a_file(tmp_path):
    sensor = tacgen.Sensor("gelsight_mini")
    ball = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
    rgb = sensor.render(ball, np.eye(4), 3.0).rgb
    places = [tmp_path / "press.png", tmp_path / "rest.png"]
    for path, image in zip(places, (rgb, sensor.at_rest_rgb()), strict=True):
        path.write_bytes(encode_png(image))
    expected = read_image(rgb, sensor, sensor.at_rest_rgb())
    for kind in (str, lambda path: path):
        found = read_image(kind(places[0]), "gelsight_mini", kind(places[1]))
        np.testing.assert_array_equal(found.rgb, rgb)
        np.testing.assert_array_equal(found.force_n, expected.force_n)
    assert expected.status == "ok"
    assert read_image(places[1], sensor).status == "no_contact"
    with pytest.raises(SensorError, match=r"nowhere\.png"):
        read_image(str(tmp_path / "nowhere.png"), sensor)


@pytest.mark.slow
def test_an_error_of_a_load_is_what_the_law_makes_of_that_of_the_imprint():
    """By Monte Carlo: loads of imprints that scatter as their standard errors say."""
    law = replace(ContactLaw.linear(K_N, K_S), effects=tuple(LAWS["anisotropy"]))
    frame = ContactFrame(0.0, 3.0, np.array([1.0, 0.0]), 0.0, np.eye(4))
    (load,) = gel_loads(law, [frame])
    found = _with_forces(imprint(load.volume_mm3, load.shear_sum_mm), law, 0.058, 2.0)
    noise_mm = np.sqrt(63) * MARKER_STDERR_PX * 0.058
    rng = np.random.default_rng(0)
    again = [
        _with_forces(
            imprint(
                load.volume_mm3 + 0.1 * rng.normal(),
                load.shear_sum_mm + noise_mm * rng.normal(size=2),
            ),
            law,
            0.058,
            2.0,
        ).force_n
        for _ in range(300)
    ]
    # 300 draws tell a standard deviation to 4 %.
    np.testing.assert_allclose(np.std(again, axis=0), found.force_stderr_n, rtol=0.15)


def test_an_effect_that_a_picture_cannot_show_is_named():
    effects = (
        fitted("creep", "normal", amount=0.3, tau_s=2.0),
        fitted("temperature", "normal", linear_per_c=0.01),
    )
    law = replace(ContactLaw.linear(K_N, K_S), effects=effects)
    found = _with_forces(imprint(15.0, np.zeros(2)), law, 0.058, 2.0)
    assert found.message.startswith("the contact law's creep, temperature follows what one picture")
    assert found.force_n[2] == pytest.approx(15.0 / K_N, rel=1e-3)


def test_a_motion_beyond_what_the_law_can_make_is_no_load():
    law = replace(
        ContactLaw.linear(K_N, K_S),
        effects=(fitted("slip", "shear", gross_mu=0.3, sharpness=20.0),),
    )
    found = _with_forces(imprint(15.0, np.array([3.0, 0.0])), law, 0.058, 2.0)
    assert np.isnan(found.force_n[:2]).all()
    assert np.isnan(found.force_stderr_n[:2]).all()
    assert found.force_n[2] == pytest.approx(15.0 / K_N)
    assert "saturated" in found.message
    # A motion that exceeds the limit by its error alone is one at the limit: a newton, not well.
    limit_mm = K_S * 0.3 * 15.0 / K_N
    near = _with_forces(imprint(15.0, np.array([limit_mm + 0.02, 0.0])), law, 0.058, 2.0)
    assert near.force_n[0] > 0.8
    assert near.force_stderr_n[0] > 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["anisotropy", pytest.param("normal coupling", marks=pytest.mark.exhaustive)]
)
def test_a_picture_of_a_gel_with_effects_is_read_by_its_law(rig, sensor, name):
    description, _, camera = rig
    law = replace(ContactLaw.linear(K_N, K_S, 2.0), effects=tuple(LAWS[name]))
    other = tacgen.Sensor("gelsight_mini", sensor.description.table, law)
    reader = ImageReader(other, camera.take(None, np.random.default_rng(0)))
    shear_n = np.array([1.0, 0.0])
    (load,) = gel_loads(law, [ContactFrame(0.0, 3.0, shear_n, 0.0, np.eye(4))])
    contact = press_ball(description, 6.0, (0.0, 0.0), load.volume_mm3, load.shear_sum_mm)
    found = reader.read(camera.take(contact, np.random.default_rng(1)))
    np.testing.assert_allclose(found.force_n[:2], shear_n, atol=0.15)
    assert found.force_n[2] == pytest.approx(3.0, rel=0.07)


def test_pictures_that_do_not_fit_are_refused(reader, sensor):
    with pytest.raises(SensorError, match="choose the sensor that took it"):
        reader.read(np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(TableError, match="it is of another sensor or light"):
        reader.read(np.full((240, 320, 3), 250, np.uint8))


VIEWS = {
    "red and blue are swapped": lambda rgb: rgb[..., ::-1],
    "turned by 180": lambda rgb: rgb[::-1, ::-1],
    "mirrored left to right": lambda rgb: rgb[:, ::-1],
    "mirrored top to bottom": lambda rgb: rgb[::-1],
    "times as large": lambda rgb: cv2.resize(rgb[12:-12, 16:-16], rgb.shape[1::-1]),
}


OTHER_VIEWS = "turned by 180", "mirrored top to bottom"  # of the same search


@pytest.mark.parametrize(
    "view",
    [
        pytest.param(view, marks=pytest.mark.exhaustive if view in OTHER_VIEWS else ())
        for view in VIEWS
    ],
)
def test_another_view_is_refused(sensor, reader, press_of_3_n, view):
    """Of the picture alone, and of both it and its background."""
    other = np.ascontiguousarray(VIEWS[view](press_of_3_n))
    with pytest.raises(TableError, match=f"the image does not match.*{view}"):
        reader.read(other)
    if view != "times as large":  # of light as even as the rig's that is not always seen
        with pytest.raises(TableError, match=f"the background does not match.*{view}"):
            ImageReader(sensor, np.ascontiguousarray(VIEWS[view](sensor.at_rest_rgb())))


@pytest.mark.parametrize("shift_px", [10, 20])
def test_a_shifted_picture_is_refused_or_its_error_covers_it(rig, reader, shift_px):
    contact = press_ball(rig[0], 4.0, (1.0, -0.7), K_N * 3.0, np.zeros(2))
    picture = rig[1].take(contact, np.random.default_rng(1))
    moved = np.concatenate([picture[:, shift_px:], picture[:, -shift_px:]], axis=1)
    refused = ""
    try:
        found = reader.read(moved)
    except TableError as error:
        refused = str(error)
    if refused:
        assert "shifted" in refused
    else:
        assert abs(found.force_n[2] - 3.0) < max(2.5 * found.force_stderr_n[2], 0.3)


SHAPES = {
    "two balls": ([(4.0, (-3.5, 0.0)), (3.0, (3.5, 1.0))], 4.0),
    "a cylinder that leaves the view": (
        trimesh.creation.cylinder(radius=3.0, height=60.0, sections=96).apply_transform(
            trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
        ),
        3.0,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two balls", "a cylinder that leaves the view"])
def test_volume_of_other_shapes(name):
    """Every contact counts, and what lies outside the rim is continued as the shape has it."""
    mesh, force_n = SHAPES[name]
    if isinstance(mesh, list):
        balls = [trimesh.creation.icosphere(4, radius) for radius, _ in mesh]
        for ball, (radius, (x, y)) in zip(balls, mesh, strict=True):
            ball.apply_translation([x, y, -radius])
        mesh = trimesh.util.concatenate(balls)
    sensor = tacgen.Sensor("virtual_gelsight", dome_radius_mm=0.0)
    frame = sensor.render(mesh, np.eye(4), force_n=force_n)
    found = read_image(frame.rgb, sensor)
    assert found.volume_mm3 == pytest.approx(frame.volume_mm3, rel=0.06)


@pytest.mark.slow
def test_real_balls_of_known_depth():
    """Volume and depth of four real presses: π d² (R - d/3) of the depth that the stage was at."""
    data = Path(__file__).parents[3] / "shared/data/press_sets/known_depth"
    if not data.exists():
        pytest.skip("the measured presses are not here")
    presses = usable_presses(read_presses(data / "presses"))
    reader = Reconstructor(fit_lookup(presses), presses.background)
    listed = pd.read_csv(data / "balls/truth.csv").dropna()
    for file, radius_mm, depth_mm in zip(
        listed["file"], listed["radius_mm"], listed["depth_mm"], strict=True
    ):
        shape = reader.shape_of(read_rgb(data / "balls" / file))
        cap_mm3 = np.pi * depth_mm**2 * (radius_mm - depth_mm / 3)
        imprint = shape.imprint(0.03)
        volume = imprint.depth_mm.sum() * shape.mm_per_px**2
        # The rest is the table's error and how the gel was stopped: a hundredth of a millimetre.
        assert volume == pytest.approx(cap_mm3, rel=0.15), file
        assert imprint.depth_mm.max() == pytest.approx(depth_mm, rel=0.08), file


@pytest.mark.slow
def test_the_command_writes_readings_and_depth_maps(rig, sensor, tmp_path):
    description, camera, _ = rig
    rng = np.random.default_rng(3)
    contact = press_ball(description, 6.0, (0.0, 0.0), 10.0, np.zeros(2))
    for name, what in (("rest", None), ("press", contact)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), camera.take(what, rng)[..., ::-1])
    out = tmp_path / "out"
    arguments = ["read", str(tmp_path / "press.png"), str(tmp_path / "rest.png"),
                 "--sensor", "gelsight_mini", "--table", sensor.description.table,
                 "--background", str(tmp_path / "rest.png"), "--out", str(out),
                 "--json"]  # fmt: skip
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    press, rest = json.loads(result.stdout)
    assert press["volume_mm3"] == pytest.approx(10.0, rel=0.05)
    assert press["force_shear_x_n"] is None
    assert press["markers"] == 0
    assert "no dots: shear not known" in reading_line(press)
    assert rest["force_normal_n"] == 0.0
    assert "no contact" in rest["message"]
    listed = pd.read_csv(out / "readings.csv")
    assert listed["file"].tolist() == ["press.png", "rest.png"]
    with np.load(out / "press.npz") as arrays:
        assert arrays["depth_mm"].shape == arrays["contact_mask"].shape == (240, 320)
    assert cv2.imread(str(out / "press_depth.png")).max() == 255


def test_a_file_that_is_no_picture_is_named_once(reader, tmp_path):
    path = tmp_path / "cut.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(SensorError) as error:
        read_files(reader, [path], tmp_path / "out")
    assert str(error.value).count("cut.png") == 1


SHIPPED = [
    pytest.param(name, marks=() if name in ("digit", "gelsight_mini") else pytest.mark.exhaustive)
    for name in sensor_files()
]


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_sensor_reads_what_it_renders(name):
    """With no background but its own, which on a dome is not the table's."""
    ball = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
    sensor = tacgen.Sensor(name)
    reading = tacgen.read_image(sensor.render(ball, np.eye(4), force_n=4.0).rgb, sensor)
    # A table of noisy real presses tells slopes to a tenth: within its stated error, or 5 %.
    off = abs(reading.force_n[2] - 4.0)
    assert off <= max(0.2, 2 * reading.force_stderr_n[2])
    assert off <= 0.4
