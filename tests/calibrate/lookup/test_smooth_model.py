"""The smooth model against polynomials that are known, and against light from lamps close by."""

from __future__ import annotations

import numpy as np

from tacgen.calibrate.lookup.settings import FitSettings
from tacgen.calibrate.lookup.smooth_model import (
    design,
    light_terms,
    n_light_terms,
    n_position_features,
    position_features,
    solve_ridge,
)

LIGHT = np.stack([np.outer(np.linspace(0.5, -0.5, 40), np.ones(50)) ** k for k in (1, 2, 3)], -1)


def places(seed, n=4000):
    rng = np.random.default_rng(seed)
    angle, sine = rng.uniform(-np.pi, np.pi, n), 0.8 * np.sqrt(rng.uniform(0, 1, n))
    u, v = rng.uniform(-0.5, 0.5, (2, n))
    return sine * np.cos(angle), sine * np.sin(angle), u, v


def slopes(nx, ny):
    """The gel at rest with these normals: gx, gy and no depth."""
    nz = np.sqrt(1 - nx**2 - ny**2)
    return nx / nz, ny / nz, np.zeros_like(nx)


def fitted(normal, position, grey, settings, depth=0.0):
    gx, gy, none = slopes(*normal)
    columns = design(light_terms(gx, gy, none + depth, settings.degree), position)
    n = len(grey)
    return solve_ridge(columns.T @ columns / n, columns.T @ grey / n, settings)


def test_known_polynomials_are_recovered():
    """Grey levels written out by hand, of degree 3 in the normal and 4 in position."""
    nx, ny, u, v = places(1)

    def truth(nx, ny, u, v):
        return np.stack(
            [
                80 * nx * (1 + 3 * u * v**3) + 20 * ny**2,
                -60 * ny * (1 - u**4) + 30 * nx * ny**2 * v,
                40 * nx**3 - 25 * ny * u**2 * v**2,
            ],
            axis=-1,
        )

    settings = FitSettings(degree=3, position_degree=4, ridge=1e-12)
    position = position_features(u, v, LIGHT, 4)
    model = fitted((nx, ny), position, truth(nx, ny, u, v), settings)
    assert model.weights.shape == (n_light_terms(3), n_position_features(4), 3)
    nx, ny, u, v = places(2, 500)
    position = position_features(u, v, LIGHT, 4)
    made = model.of_terms(light_terms(*slopes(nx, ny), 3), position)
    np.testing.assert_allclose(made, truth(nx, ny, u, v), atol=1e-3)
    slope, direction = np.arcsin(np.hypot(nx[:1], ny[:1])), np.arctan2(ny[:1], nx[:1])
    response = model.responses(slope, direction, position[:1])
    np.testing.assert_allclose(response[0, 0, 0], truth(nx, ny, u, v)[0], atol=1e-3)


def test_what_a_contact_adds_is_told_from_its_slope():
    """1 − exp(−d/0.8 mm) is no d/(d + 1 mm), but the model comes within a tenth of it."""
    nx, ny, u, v = places(5)
    depth = np.random.default_rng(6).uniform(0, 1.2, len(nx))
    shade = 1 - np.exp(-depth / 0.8)
    grey = np.stack([50 * nx - 30 * shade, 20 * shade * nx, 15 * shade * ny * (1 + u)], axis=-1)
    settings = FitSettings(degree=3, position_degree=2, ridge=1e-9)
    position = position_features(u, v, LIGHT, 2)
    model = fitted((nx, ny), position, grey, settings, depth)
    terms = light_terms(*slopes(nx, ny)[:2], depth, 3)
    error = np.sqrt(((model.of_terms(terms, position) - grey) ** 2).mean(axis=0))
    assert (error < 0.1 * grey.std(axis=0)).all()
    level = model.of_contact(position)[:, 0].mean(axis=0)
    assert level[0] < -40
    assert abs(level[1:]).max() < 5


def test_near_lamps_need_more_than_a_quadratic_in_position():
    """Lambert's law under a lamp beside the gel, whose light falls off with squared distance."""

    def lamps(nx, ny, u, v):
        nz = np.sqrt(1 - nx**2 - ny**2)
        grey = []
        for at in ((-0.7, 0.0), (0.5, 0.6), (0.4, -0.7)):
            to = np.stack([at[0] - u, at[1] - v, np.full_like(u, 0.35)], axis=-1)
            distance = np.linalg.norm(to, axis=-1)
            facing = np.maximum(-nx * to[:, 0] - ny * to[:, 1] + nz * to[:, 2], 0) / distance
            level = to[:, 2] / distance
            grey.append(60 * (facing - level) / distance**2)
        return np.stack(grey, axis=-1)

    errors = {}
    for degree in (2, 4):
        nx, ny, u, v = places(3, 12000)
        position = position_features(u, v, LIGHT, degree)
        settings = FitSettings(degree=5, position_degree=degree, ridge=1e-6)
        model = fitted((nx, ny), position, lamps(nx, ny, u, v), settings)
        nx, ny, u, v = places(4, 2000)
        terms = light_terms(*slopes(nx, ny), 5)
        made = model.of_terms(terms, position_features(u, v, LIGHT, degree))
        errors[degree] = float(np.sqrt(((made - lamps(nx, ny, u, v)) ** 2).mean()))
    assert errors[4] < 0.6 * errors[2]
