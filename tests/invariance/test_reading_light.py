"""The lamps at which a picture and its background were taken must not matter to what is read."""

import numpy as np
import pytest
import trimesh

import tacgen
from tacgen.core.errors import TableError
from tacgen.core.resources import sensor_files
from tacgen.sensor.read_image import ImageReader
from tests.messages import refused

BALL = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
FORCE_N = 4.0


SENSORS = list(sensor_files())


@pytest.fixture(scope="module", params=SENSORS)
def taken(request):
    """A sensor, its gel at rest and a press, once for all lights."""
    sensor = tacgen.Sensor(request.param)
    return sensor, sensor.at_rest_rgb(), sensor.render(BALL, np.eye(4), FORCE_N).rgb


def in_light(rgb, gain=1.0, grey=0.0, outwards=0.0):
    """By channel; ``outwards`` is what the corners lose."""
    v, u = np.meshgrid(*(np.linspace(-1, 1, n) for n in rgb.shape[:2]), indexing="ij")
    field = np.asarray(gain) * (1.0 - outwards * (u**2 + v**2) / 2)[..., None]
    return np.clip(np.rint(rgb * field + np.asarray(grey)), 0, 255).astype(np.uint8)


LIGHTS = {
    "0.7": {"gain": 0.7},
    "0.9": {"gain": 0.9},
    "1.1": {"gain": 1.1},
    "1.3": {"gain": 1.3},
    "by colour": {"gain": [0.8, 1.0, 0.9]},
    "a pedestal": {"grey": 8.0},
    "both": {"gain": 0.8, "grey": 8.0},
    "vignetting": {"outwards": 0.25},
}
BETWEEN = ("0.9", "1.1", "both")
"""Lights between others, or of two together."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("taken", "light"),
    [
        pytest.param(
            SENSORS[k % len(SENSORS)],
            light,
            marks=pytest.mark.exhaustive if light in BETWEEN else (),
        )
        for k, light in enumerate(LIGHTS)
    ],
    indirect=["taken"],
)
def test_a_picture_and_its_background_in_another_light_are_the_same_force(taken, light):
    sensor, rest, press = taken
    plain = ImageReader(sensor, rest).read(press).force_n[2]
    reader = ImageReader(sensor, in_light(rest, **LIGHTS[light]))
    found = reader.read(in_light(press, **LIGHTS[light]))
    assert abs(found.force_n[2] - FORCE_N) < 2 * found.force_stderr_n[2]
    if light != "1.3":  # where the camera clips: its error grows
        assert found.force_n[2] == pytest.approx(plain, rel=0.03)
        assert "background" not in found.message


@pytest.mark.slow
@pytest.mark.parametrize("taken", SENSORS[:1], indirect=True)
def test_a_light_out_of_range_is_stated(taken):
    sensor, rest, press = taken
    reader = ImageReader(sensor, in_light(rest, 0.5))
    found = reader.read(in_light(press, 0.5))
    assert "the background is 0.50, 0.50, 0.50 times as bright" in found.message
    for lost in (0, 255):
        with refused(TableError):
            ImageReader(sensor, np.full_like(rest, lost))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("taken", "noise_grey"), [(SENSORS[0], 0.0), (SENSORS[-1], 3.0)], indirect=["taken"]
)
def test_a_background_is_no_contact_with_itself(taken, noise_grey):
    sensor, rest, _ = taken
    rng = np.random.default_rng(0)
    one, other = (in_light(rest, grey=noise_grey * rng.normal(size=rest.shape)) for _ in range(2))
    found = ImageReader(sensor, one).read(other)
    assert found.status == "no_contact"
    assert not found.contact_mask.any()
    assert found.force_n.tolist() == [0.0, 0.0, 0.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("taken", "shape", "force_n"),
    [
        (SENSORS[0], "ball", 0.5),
        pytest.param(SENSORS[-1], "box", 4.0, marks=pytest.mark.exhaustive),
    ],
    indirect=["taken"],
)
def test_a_press_as_background_is_stated(taken, shape, force_n):
    sensor, rest, press = taken
    mesh = BALL if shape == "ball" else trimesh.creation.box([6, 4, 4])
    pressed = sensor.render(mesh, np.eye(4), force_n).rgb
    _height, width = rest.shape[:2]
    for image in (press, pressed):
        message = ImageReader(sensor, pressed).read(image).message
        assert "the background may show a press" in message
        # It is found on pictures 80 px wide: to half a pixel of those.
        x = int(message.split("a press, at (")[1].split(",")[0])
        assert abs(x - (width - 1) / 2) <= width / 80 / 2
    assert "show a press" not in ImageReader(sensor, rest).read(press).message


@pytest.mark.slow
@pytest.mark.parametrize("taken", SENSORS[:1], indirect=True)
def test_a_grey_picture_is_refused(taken):
    sensor, rest, press = taken
    grey = np.repeat(press.mean(axis=2, keepdims=True), 3, axis=2).astype(np.uint8)
    with refused(TableError):
        ImageReader(sensor, rest).read(grey)
