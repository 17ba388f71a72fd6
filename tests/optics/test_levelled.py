"""The gel that nothing touches is where depth is counted from."""

import numpy as np

from tacgen.optics.reconstruct import _levelled

ROWS, COLUMNS = np.indices((240, 320), dtype=float)
DISTANCE = np.hypot(ROWS - 120, COLUMNS - 140)
BALL = np.maximum(1.0 - (DISTANCE / 60) ** 2, 0.0)


def tilted(top, left):
    return top * ROWS / 240 + left * COLUMNS / 320 - 0.1


def test_a_tilt_of_the_gel_around_a_contact_is_taken_away():
    depth = _levelled(BALL + tilted(0.3, -0.2), DISTANCE > 60)
    np.testing.assert_allclose(depth, BALL, atol=0.01)  # of 0.3 mm, held level


def test_a_flat_face_that_looks_like_bare_gel_is_none():
    punch = 0.8 * (np.maximum(abs(ROWS - 120), abs(COLUMNS - 140)) < 50)
    wall = abs(np.maximum(abs(ROWS - 120), abs(COLUMNS - 140)) - 50) < 4
    np.testing.assert_allclose(_levelled(punch + tilted(0.1, 0.1), ~wall), punch, atol=0.005)
    shallow = 0.3 * punch + 0.8 * wall  # touches no edge of the picture
    np.testing.assert_allclose(_levelled(shallow, ~wall), shallow, atol=0.005)


def test_gel_in_a_corner_alone_does_not_tilt():
    corner = (ROWS < 24) & (COLUMNS < 24)
    noise = np.random.default_rng(0).normal(0.0, 0.02, BALL.shape) * corner
    assert abs(_levelled(BALL + noise, corner) - BALL).max() < 0.1
    np.testing.assert_array_equal(_levelled(BALL, np.zeros(BALL.shape, bool)), BALL)
