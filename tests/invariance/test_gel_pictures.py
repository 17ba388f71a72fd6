"""What must not matter to the picture of a gel, and to what is read from it."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tacgen.contact.gel_response import GelLoad
from tacgen.contact.law import ContactLaw
from tacgen.core.records import Markers, Mesh, Sensor
from tacgen.optics import render_rgb
from tacgen.optics.image_models import ContactLight
from tacgen.optics.reconstruct import Reconstructor
from tacgen.sensor.read_image import _with_forces
from tacgen.sensor.tactile_pad import TactilePad
from tests.sensor.test_read_image import imprint
from tests.small_world import slope_table

FLAT = Sensor("flat", 120, 160, 0.1, 3.0, 0.0, Markers(6, 8, 2.0, 0.2))
BALL = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
MESH = Mesh.fixed(BALL.vertices, BALL.faces)


def models():
    """A table of each image model, all of one gel whose light does not depend on the place."""
    plain = slope_table(FLAT.shape_px, FLAT.mm_per_px)
    u = np.zeros((len(plain.coefficients), plain.coefficients.shape[1], 4, 5, 3), np.float32)
    response = u + plain.coefficients[..., 5][:, :, None, None]
    light = ContactLight(np.full((4, 5, 3, 3), 6.0, np.float32), 0.3)
    return {
        "quadratic": plain,
        "response": replace(plain, response=response),
        "contact": replace(plain, response=response, contact=light),
    }


MODELS = models()


def pressed(table, x_px=0, y_px=0, **options):
    """The picture of a ball that is pressed in, so many pixels beside the middle."""
    pose = np.eye(4)
    pose[:2, 3] = 0.1 * x_px, 0.1 * y_px
    pad = TactilePad(FLAT, table, **options)
    held = pad.press(MESH, pose, GelLoad(8.0))
    return pad.image(held), held


@pytest.mark.parametrize("name", MODELS)
def test_a_model_held_otherwise_draws_the_same_picture(name):
    """Quadratic or response of the same light; a contact adds to both alike."""
    plain, other = (pressed(MODELS[k])[0].astype(int) for k in ("quadratic", name))
    if name == "contact":
        assert (other - plain).max() > 5
        other = pressed(replace(MODELS[name], contact=None))[0].astype(int)
    assert np.abs(other - plain).max() <= 1


@pytest.mark.parametrize("name", MODELS)
def test_a_window_of_blocks_along_the_gel_shifts_the_picture(name):
    plain, moved = pressed(MODELS[name])[0], pressed(MODELS[name], 8, -12)[0]
    np.testing.assert_array_equal(moved, np.roll(plain, (-12, 8), axis=(0, 1)))


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_where_on_the_gel_it_is_does_not_matter_to_what_is_read(name):
    """Volume and depth of a ball within a percent, wherever its picture is taken."""
    table = MODELS[name]
    reader = Reconstructor(table, render_rgb(np.zeros(FLAT.shape_px), table))
    found = []
    for x_px, y_px in ((0, 0), (21, -13), (-17, 9)):
        rgb, held = pressed(table, x_px, y_px)
        shape = reader.shape_of(rgb)
        depth = shape.imprint(0.03).depth_mm
        found.append((depth.sum() * shape.mm_per_px**2, depth.max()))
        assert found[-1][0] == pytest.approx(held.volume_mm3, rel=0.05)
    np.testing.assert_allclose(found, [found[0]] * 3, rtol=0.01)


def test_a_brighter_background_is_no_contact():
    """Read is the change: both pictures brighter by as much show the same gel."""
    table = MODELS["quadratic"]
    rgb, _ = pressed(table)
    rest = render_rgb(np.zeros(FLAT.shape_px), table)
    plain = Reconstructor(table, rest).shape_of(rgb).depth_mm
    brighter = Reconstructor(table, rest + np.uint8(9)).shape_of(rgb + np.uint8(9)).depth_mm
    np.testing.assert_allclose(brighter, plain, atol=1e-5)


@pytest.mark.parametrize("pitch_mm", [0.5, 1.0, 3.0])
def test_another_grid_of_dots_reads_the_same_shear(pitch_mm):
    law = ContactLaw.linear(5.0, 0.8, marker_pitch_mm=2.0)
    share = (2.0 / pitch_mm) ** 2
    forces = [
        _with_forces(imprint(15.0, at * np.array([0.6, -0.4])), law, 0.06, pitch).force_n
        for at, pitch in ((1.0, 2.0), (share, pitch_mm))
    ]
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-9)
    # A law of an unknown grid is of the dots that are read.
    unknown = ContactLaw.linear(5.0, 0.8)
    found = _with_forces(imprint(15.0, np.array([0.6, -0.4])), unknown, 0.06, pitch_mm)
    np.testing.assert_allclose(found.force_n, forces[0], rtol=1e-9)
