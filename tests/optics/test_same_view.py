"""Pictures of another view are proven so by the gel's texture or light; of the same view never."""

import re

import cv2
import numpy as np
import pytest

from tacgen.optics.same_view import alignment, other_view

SHAPE = 240, 320


def gel(seed, *, texture_grey=4.0, shape=SHAPE):
    """A gel at rest: slow light, alike from both sides, and fine texture."""
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")
    light = np.stack([120 + 10 * u * u, 110 - 8 * v * v, 100 + 5 * u * u], axis=-1)
    grain = cv2.GaussianBlur(rng.normal(size=(*shape, 3)), (0, 0), 1.0)
    return light + texture_grey * grain / grain.std()


def photograph(scene, rng, contact=None):
    """With noise, drift of the lamps and, if asked for, a contact (x, y, radius)."""
    height, width = scene.shape[:2]
    across = np.linspace(-1, 1, width)[None, :, None]
    picture = scene * rng.uniform(0.97, 1.03, 3) + 3 * rng.uniform(-1, 1, 3) * across
    if contact is not None:
        x, y, radius = contact
        columns, rows = np.arange(width) - x, np.arange(height)[:, None] - y
        inside = np.hypot(columns, rows) < radius
        slope = np.stack([columns + 0 * rows, rows + 0 * columns, -columns + 0 * rows], axis=-1)
        picture = picture + 60 * inside[..., None] * slope / radius
    return np.clip(np.rint(picture + rng.normal(0, 1.5, scene.shape)), 0, 255).astype(np.uint8)


def affine(image, zoom=1.0, shift=0.0):
    height, width = image.shape[:2]
    map_ = np.array([[zoom, 0, (1 - zoom) * width / 2 + shift], [0, zoom, (1 - zoom) * height / 2]])
    return cv2.warpAffine(image, map_, (width, height), borderMode=cv2.BORDER_REPLICATE)


OTHER = {
    "turned by 180°": lambda image: image[::-1, ::-1],
    "mirrored left to right": lambda image: image[:, ::-1],
    "mirrored top to bottom": lambda image: image[::-1],
    r"shifted by \(20, 0\) px": lambda image: affine(image, shift=20),
    r"1\.1[01] times as large": lambda image: affine(image, zoom=1.1),
    r"0\.9[234] times as large": lambda image: affine(image, zoom=0.93),
    r"1\.0[456] times as large": lambda image: affine(image, zoom=1.05),
}


@pytest.mark.parametrize("view", OTHER)
def test_another_view_is_named_though_the_light_looks_alike(view):
    rng = np.random.default_rng(1)
    scene = gel(2)
    background = photograph(scene, rng)
    press = photograph(scene, rng, (190, 130, 60))
    assert other_view(press, background) == ""
    other = np.ascontiguousarray(OTHER[view](press))
    found = other_view(other, background)
    assert re.search(view, found), found


def test_of_one_view_nothing_is_said():
    """With contacts up to most of the picture, and without texture up to a seventh of it."""
    rng = np.random.default_rng(3)
    for seed, texture_grey in ((4, 4.0), (5, 1.0), (6, 0.0)):
        scene = gel(seed, texture_grey=texture_grey)
        background = photograph(scene, rng)
        for radius in (20, 60, 110) if texture_grey else (20, 60):
            press = photograph(scene, rng, (*rng.uniform(100, 200, 2), radius))
            assert other_view(press, background) == ""
        assert alignment(press, background).is_same == (texture_grey > 0)


def test_a_gel_that_slides_under_its_lamps_is_no_other_view():
    """Its texture moves with it, the light, which has a clear slope here, does not."""
    rng = np.random.default_rng(7)
    width = SHAPE[1]
    slope = 60 * np.linspace(-1, 1, width)[None, :, None] ** 3
    texture = gel(8) - gel(8, texture_grey=0.0)
    still, moved = (gel(9, texture_grey=0.0) + slope + t for t in (texture, affine(texture, 1, 16)))
    assert other_view(photograph(moved, rng), photograph(still, rng)) == ""
