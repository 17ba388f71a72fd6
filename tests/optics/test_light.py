"""Shadows, effects, markers and the virtual sensor."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from tacgen.core.errors import TableError
from tacgen.core.records import Sensor
from tacgen.optics.effects import Patch, Stage, check_effects, optical_effect, optical_effects
from tacgen.optics.effects.shadow import (
    PENUMBRA_MM,
    cast_shadow,
    shadow_reach_mm,
)
from tacgen.optics.markers import draw_markers
from tacgen.optics.table import LookupTable, leds_of_table
from tacgen.optics.virtual_sensor import Led, Paint, VirtualSensor
from tests.messages import refused
from validation.optics.sampled_table import sampled_table

MM_PER_PX = 0.1
PENUMBRA = 0.7
LEDS = tuple(
    ((0.866 * math.cos(a), 0.866 * math.sin(a), -0.5), tuple(1.5 * (i == k) for k in range(3)))
    for i, a in enumerate((0.3, -1.9, 2.2))
)
SENSOR = Sensor("small", 90, 120, MM_PER_PX, 3.0, 0.0, None, LEDS)
VIRTUAL = VirtualSensor.like(SENSOR)


def ridge(shape=(80, 100), depth_mm=1.0):
    """A wall across the image, pressed in to ``depth_mm``, four pixels wide."""
    height = np.zeros(shape, dtype=np.float32)
    height[:, 48:52] = -depth_mm
    return height


@pytest.mark.parametrize("elevation_deg", [15, 30, 45])
def test_a_wall_casts_the_shadow_of_trigonometry(elevation_deg):
    """Of a wall d deep, d / tan(elevation) long, on the side away from the light."""
    elevation = math.radians(elevation_deg)
    direction = (math.cos(elevation), 0.0, -math.sin(elevation))
    shade = cast_shadow(ridge(), MM_PER_PX, direction)[40]
    length_px = 1.0 / math.tan(elevation) / MM_PER_PX
    soft_px = PENUMBRA_MM / math.tan(elevation) / MM_PER_PX
    for away_px in range(1, 46):
        inside = away_px < length_px - soft_px - 1
        outside = away_px > length_px + 1
        value = shade[48 - away_px]
        assert (value == 1) if inside else (value == 0) if outside else 0 <= value <= 1
    assert not shade[52:].any()


@pytest.mark.parametrize("azimuth_deg", range(0, 360, 30))
def test_a_pits_shadow_points_away_from_the_light_whatever_the_direction(azimuth_deg):
    rows, columns = np.indices((101, 101)) - 50
    height = (-np.exp(-(rows**2 + columns**2) / 50.0)).astype(np.float32)
    azimuth = math.radians(azimuth_deg)
    direction = (0.94 * math.cos(azimuth), 0.94 * math.sin(azimuth), -0.342)
    shade = cast_shadow(height, MM_PER_PX, direction)
    weight = shade.sum()
    centre = np.array([(columns * shade).sum(), (rows * shade).sum()]) / weight
    away = -np.array([math.cos(azimuth), math.sin(azimuth)])
    assert centre @ away / np.linalg.norm(centre) > 0.98
    distance = np.hypot(rows, columns)[shade > 0].max() * MM_PER_PX
    assert distance < shadow_reach_mm(1.0, ((direction, (1, 1, 1)),)) + 1


def test_flat_gel_has_no_shadow_and_rays_agree_with_the_sweep():
    """The virtual sensor steps rays to a light at a finite place; the sweep takes a direction."""
    assert cast_shadow(np.zeros((30, 40), dtype=np.float32), 0.1, (0.6, 0.6, -0.5)) is None
    far = Led((600.0, 300.0, -300.0), (1.0, 1.0, 1.0))
    virtual = VirtualSensor(80, 100, MM_PER_PX, (far,), shadow=1.0)
    rows, columns = np.indices((80, 100))
    height = -np.exp(-((rows - 40.0) ** 2 + (columns - 50.0) ** 2) / 60.0)
    by_rays = virtual._hidden(height, far) * 0.1 / PENUMBRA_MM
    length = math.sqrt(600**2 + 300**2 + 300**2)
    swept = cast_shadow(
        height.astype(np.float32), MM_PER_PX, (600 / length, 300 / length, -300 / length)
    )
    both = (by_rays > 0.2) & (swept > 0.2)
    either = (by_rays > 0.2) | (swept > 0.2)
    assert either.sum() > 100
    assert both.sum() > 0.85 * either.sum()


@pytest.mark.parametrize("azimuth_deg", [0, 40, 100, 225, 300])
@pytest.mark.parametrize("distance_mm", [4.0, 8.0])
def test_a_near_lamp_hides_what_rays_to_it_find_hidden(azimuth_deg, distance_mm):
    """Rays are stepped from each pixel to the lamp, which may stand beneath the picture."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(25)
    lamp_mm = distance_mm * np.array([math.cos(azimuth), math.sin(azimuth), -math.tan(elevation)])
    rows, columns = np.indices((80, 100))
    height = sum(
        -depth * np.exp(-((rows - r) ** 2 + (columns - c) ** 2) / 30.0)
        for depth, r, c in [(0.8, 20, 25), (1.0, 55, 70), (0.6, 62, 20)]
    )
    x, y = (columns - 49.5) * MM_PER_PX, (rows - 39.5) * MM_PER_PX
    away_mm = np.hypot(x - lamp_mm[0], y - lamp_mm[1])
    lamp_tangent = (height - lamp_mm[2]) / away_mm
    hidden, own = np.zeros(height.shape), np.zeros(height.shape)
    for step_mm in np.arange(0.05, 12, 0.05):
        share = step_mm / away_mm
        at = [axis + share * (lamp - axis) for axis, lamp in ((y, lamp_mm[1]), (x, lamp_mm[0]))]
        at = np.stack([at[0] / MM_PER_PX + 39.5, at[1] / MM_PER_PX + 49.5])
        relief = map_coordinates(height, at, order=1, cval=1e6)
        tangent = np.where(share < 1, (height - relief) / step_mm, 0)
        part = np.clip((tangent / lamp_tangent - 1) / PENUMBRA, 0, 1)
        hidden = np.maximum(hidden, part)
        if step_mm < 1.5 * MM_PER_PX:
            own = np.maximum(own, part)
    direction = (*(math.cos(elevation) * lamp_mm[:2] / distance_mm), -math.sin(elevation))
    swept = cast_shadow(
        height.astype(np.float32), MM_PER_PX, direction,
        lamp_distance_mm=distance_mm, penumbra=PENUMBRA, middle_px=(39.5, 49.5),
    )  # fmt: skip
    rays, away = hidden - own, away_mm > 0.5
    assert (rays[away] > 0.3).sum() > 50
    assert abs(swept - rays)[away].mean() < 0.01
    assert np.quantile(abs(swept - rays)[away], 0.99) < 0.2


def test_lights_are_found_again_in_a_table():
    made = sampled_table(VIRTUAL, np.zeros(SENSOR.shape_px), sensor="small")
    for ((x, y, _), _), (direction, _) in zip(leds_of_table(made), LEDS, strict=True):
        turned = math.atan2(y, x) - math.atan2(direction[1], direction[0])
        assert abs(math.remainder(turned, 2 * math.pi)) < math.radians(5)


def patch(height_px=40, width_px=50):
    rng = np.random.default_rng(0)
    return Patch(
        rng.uniform(80, 150, (height_px, width_px, 3)).astype(np.float32),
        ((np.arange(width_px) + 0.5) / width_px - 0.5).astype(np.float32)[None, :],
        ((np.arange(height_px) + 0.5) / height_px - 0.5).astype(np.float32)[:, None],
        MM_PER_PX,
    )


RENDERED = optical_effects(Stage.SURFACE)


@pytest.mark.parametrize("effect", RENDERED, ids=lambda effect: effect.name)
def test_an_effect_keeps_shape_and_input_and_does_nothing_at_its_identity(effect):
    shape = (40, 50) if effect.stage == Stage.SURFACE else (40, 50, 3)
    array = np.random.default_rng(1).uniform(60, 200, shape).astype(np.float32)
    before = array.copy()
    still = {parameter: bounds.identity for parameter, bounds in effect.parameters.items()}
    here = replace(patch(), window=(0, 40, 0, 50), height_mm=ridge((40, 50)))
    coefficients = np.full((3, 4, 3, 6), -20.0, np.float32)
    coefficients[:, 2] = 20.0  # slopes along x are bright: the lamps stand there
    made = LookupTable(coefficients, here.background, MM_PER_PX, 1.2, effects={})

    def applied(values):
        return effect.apply(array, here, **values, **effect.prepare(made, LEDS, **values))

    np.testing.assert_allclose(applied(still), array, atol=1e-4)
    moved = {
        p: 0.5 * (b.lower + b.upper) + 0.2 * (b.upper - b.lower)
        for p, b in effect.parameters.items()
    }
    changed = applied(moved)
    np.testing.assert_array_equal(array, before)
    assert changed.shape == array.shape
    assert changed.dtype == np.float32
    assert np.isfinite(changed).all()
    assert abs(changed - array).max() > 0.1


def test_effects_do_what_they_say():
    here = patch()
    image = here.background + np.float32(20)
    gained = optical_effect("background_gain").apply(image, here, gain_r=1.1, offset_g=4.0)
    np.testing.assert_allclose(gained[..., 0], 1.1 * image[..., 0], rtol=1e-5)
    np.testing.assert_allclose(gained[..., 1] - image[..., 1], 4.0, atol=1e-4)
    mixed = optical_effect("cross_talk").apply(image, here, rg=0.1)
    np.testing.assert_allclose(mixed[..., 0] - image[..., 0], 2.0, atol=1e-4)
    np.testing.assert_array_equal(mixed[..., 1:], image[..., 1:])
    darker = optical_effect("vignetting").apply(image, here, strength=0.4)
    corner = 1 - 0.4 * 2 * (here.u[0, 0] ** 2 + here.v[0, 0] ** 2)
    np.testing.assert_allclose(darker[0, 0], image[0, 0] * corner, rtol=1e-5)
    same_lens = optical_effect("vignetting").apply(image, here, change_strength=0.4)
    np.testing.assert_allclose(same_lens[0, 0], here.background[0, 0] + 20 * corner, rtol=1e-5)
    brighter = optical_effect("illumination").apply(image, here, g_u=0.5)
    np.testing.assert_allclose(
        brighter[..., 1] - image[..., 1], np.tile(10 * here.u, (len(here.v), 1)), atol=1e-4
    )
    np.testing.assert_allclose(brighter[..., [0, 2]], image[..., [0, 2]], atol=1e-4)
    assert optical_effect("saturation").apply(image, here, level_grey=110.0).max() == 110
    bent = optical_effect("saturation").apply(image, here, level_grey=110.0, knee_grey=5.0)
    assert bent.max() < 110
    np.testing.assert_array_less(bent, image)
    slope = np.tile(0.3 * here.u, (40, 1)).astype(np.float32)
    np.testing.assert_allclose(
        optical_effect("blur").apply(slope, here, sigma_mm=0.3), slope, atol=1e-6
    )


def test_unknown_effects_are_all_named():
    with refused(TableError):
        check_effects({"halo": {}, "blur": {"sigma_px": 1.0}})
    check_effects({"shadow": {"strength": 0.5}, "press_center": {"x_mm": 0.1}})


def test_a_marker_darkens_its_own_area_and_moves_by_fractions_of_a_pixel():
    def dot(x_mm, y_mm):
        image = np.full((90, 120, 3), 100, dtype=np.float32)
        draw_markers(image, np.array([[x_mm, y_mm], [99.0, 0.0]]), 0.4, MM_PER_PX)
        missing = 100 - image[..., 0]
        rows, columns = np.indices(missing.shape)
        total = missing.sum()
        return total, (columns * missing).sum() / total, (rows * missing).sum() / total

    total, column, row = dot(0.0, 0.0)
    # Ink gives back a quarter of the light over π r² pixels.
    assert total == pytest.approx(75 * math.pi * 4**2, rel=0.02)
    assert (column, row) == pytest.approx((59.5, 44.5), abs=0.01)
    _, moved_column, moved_row = dot(0.033, -1.05)
    assert moved_column - column == pytest.approx(0.33, abs=0.03)
    assert moved_row - row == pytest.approx(-10.5, abs=0.03)


def test_the_virtual_sensor_obeys_lambert_and_the_inverse_square():
    led = Led((10.0, 0.0, -10.0), (1.0, 0.0, 0.0))
    plain = VirtualSensor(
        10, 10, 0.1, (led,), Paint(1.0, 0.0), (0.0, 0.0, 0.0), glare=0.0, exposure=0.4, gamma=1.0
    )

    def red(x_mm=0.0, slope_x=0.0):
        zero = np.zeros(1)
        return float(plain.shade(zero + x_mm, zero, zero, zero + slope_x, zero)[0, 0])

    assert red() == pytest.approx(255 * 0.4 * math.sqrt(0.5))
    # Facing the light at 45°, and turned edge-on to it.
    assert red(slope_x=1.0) == pytest.approx(255 * 0.4)
    assert red(slope_x=-1.0) == pytest.approx(0, abs=1e-9)
    # Nearer by half: the cosine at (5, −10), times (√200 / √125)².
    assert red(x_mm=5.0) == pytest.approx(255 * 0.4 * 10 / math.sqrt(125) * 200 / 125)
