"""Which pictures are of one press: what is held out, counted and drawn together.

A rig takes several pictures of a press. They share its place, its ball and the light of its moment,
so that what is learnt from one is known of the others.
"""

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.presses.press_images import PressImages
from tacgen.presses.rules import IMAGES


def experiments_of(presses: PressImages) -> IntArray:
    """Number of the press (N,) that each picture is of, from 0, in order of appearance."""
    unknown = np.full((len(presses), 2), np.nan)
    stage_mm = unknown if presses.stage_mm is None else presses.stage_mm
    return grouped(
        presses.images,
        presses.background,
        circle_px=np.column_stack([presses.center_px, presses.radius_px]),
        stage_px=stage_mm / presses.mm_per_px,
        ball_radius_mm=presses.ball_radius_mm,
        trial=unknown[:, 0] if presses.trial is None else presses.trial,
    )


def grouped(
    images: Iterable[NDArray[np.uint8]],
    background: NDArray[np.uint8],
    *,
    circle_px: FloatArray,
    stage_px: FloatArray,
    ball_radius_mm: FloatArray,
    trial: FloatArray,
) -> IntArray:
    """Number of the press (N,) that each picture is of, from 0, in order of appearance.

    Pictures are of one press where they have the same ``trial``; or lie at one place, with one ball
    and one contact radius; or are alike but for noise. A ``trial`` that is the same for all says
    nothing. Circles (N, 3), places by a stage (N, 2), balls and trials (N,) are NaN where unknown.
    """
    ball = np.nan_to_num(ball_radius_mm)
    of_ball = 1e6 * ball[:, None]  # other balls are far away
    pairs = [
        _near(np.hstack([circle_px, of_ball]), IMAGES.near_px),
        _near(np.hstack([stage_px, circle_px[:, 2:], of_ball]), IMAGES.near_px),
    ]
    if len(np.unique(trial[np.isfinite(trial)])) > 1:
        pairs.append(_near(np.hstack([trial[:, None], of_ball]), 0.0))
    alike = _alike(images, background)
    pairs.append(alike[ball[alike[:, 0]] == ball[alike[:, 1]]])
    one, other = np.concatenate(pairs).T
    links = coo_array((np.ones(len(one)), (one, other)), shape=(len(ball), len(ball)))
    return ranked(connected_components(links, directed=False)[1])


def ranked(groups: IntArray) -> IntArray:
    """Groups (N,) numbered from 0 in the order in which they first appear."""
    _, first, inverse = np.unique(groups, return_index=True, return_inverse=True)
    return np.asarray(np.argsort(np.argsort(first))[inverse.ravel()])


def per_experiment(values: FloatArray, experiment: IntArray) -> FloatArray:
    """Means (E, …) over the pictures of each experiment of values (N, …)."""
    number = ranked(experiment)
    if len(number) and number.max() + 1 == len(number):
        return values  # each its own
    count = np.bincount(number)
    sums = np.zeros((len(count), *values.shape[1:]))
    np.add.at(sums, number, values)
    return np.asarray(sums / count.reshape(-1, *[1] * (values.ndim - 1)))


def is_clear(gain: FloatArray) -> bool:
    """Whether gains (n,), of presses or groups of them, are above 0 by one standard error."""
    return bool(gain.sum() > np.sqrt(len(gain)) * gain.std(ddof=1))


def _near(places: FloatArray, within: float) -> IntArray:
    """Pairs (n, 2) of rows of ``places`` that are nowhere farther apart; NaN is near nothing."""
    known = np.nonzero(np.isfinite(places).all(axis=1))[0]
    if len(known) < 2:
        return np.zeros((0, 2), np.int64)
    # The first of equal places stands for all: a thousand of them would be half a million pairs.
    unique, first, inverse = np.unique(
        places[known], axis=0, return_index=True, return_inverse=True
    )
    equal = np.column_stack([known[first][inverse.ravel()], known])
    near = cKDTree(unique).query_pairs(within + 1e-9, p=np.inf, output_type="ndarray")
    return np.concatenate([equal, known[first][near]])


def _alike(images: Iterable[NDArray[np.uint8]], background: NDArray[np.uint8]) -> IntArray:
    """Pairs (n, 2) of pictures that are equal but for noise."""
    height, width = background.shape[:2]
    columns = max(2, min(IMAGES.compared_press_px, width // IMAGES.block_px))
    size = (columns, max(2, round(columns * height / width)))
    rest = _small(background, size)
    changes = np.stack([_small(image, size) - rest for image in images])
    changes -= np.median(changes, axis=(1, 2), keepdims=True)  # lamps as a whole
    flat = changes.reshape(len(changes), -1)
    power = (flat**2).sum(axis=1)
    found = []
    for start in range(0, len(flat), IMAGES.rows_at_once):
        rows = slice(start, start + IMAGES.rows_at_once)
        apart = power[rows, None] + power - 2 * flat[rows] @ flat.T
        same: BoolArray = apart < IMAGES.alike_press_share**2 * np.minimum(power[rows, None], power)
        one, other = np.nonzero(same)
        found.append(np.column_stack([one + start, other])[one + start < other])
    return np.concatenate(found)


def _small(image: NDArray[np.uint8], size: tuple[int, int]) -> FloatArray:
    small = cv2.resize(np.asarray(image, np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float64)
