"""Finding the contact circle of a ball press in its image."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import least_squares

from tacgen.core.types import BoolArray, FloatArray
from tacgen.optics.dots import coarse
from tacgen.presses.geometry import Membrane, PressedGel
from tacgen.presses.rules import IMAGES

SHADING_POWERS = [(i, degree - i) for degree in (1, 2, 3) for i in range(degree + 1)]


@dataclass(frozen=True, slots=True)
class Circle:
    """A contact circle in pixels of the image; ``problem`` says why it cannot be used.

    ``radius_px`` is that of the rim, where the gel leaves the ball; ``edge_px`` is where the change
    has fallen to half: about where the ball meets the level of the gel at rest, below which the
    gel around the contact sinks.
    """

    center_px: FloatArray
    radius_px: float
    problem: str = ""
    edge_px: float = float("nan")


def find_circle(
    image: NDArray[Any], background: NDArray[Any], hidden: BoolArray | None = None
) -> Circle:
    """The contact circle of a press from its image and the background, both (H, W, 3) RGB.

    What changed against the background, relative to the light at its place, is thresholded low to
    find the patch; from its middle, the edge is looked for in every direction on that direction's
    own scale, and a circle is fitted robustly to these points. Its centre is then moved to where
    the shading is best explained by a ball, because lamps draw the edge to one side. ``hidden``
    (H, W) are pixels that show no gel: printed dots.
    """
    scale, size = _work_size(image)
    rest = coarse(background, size, hidden)
    change = drift_free_change(image, background, hidden)
    nothing = Circle(np.full(2, np.nan), float("nan"), "shows no contact")
    if _scatter_and_top(np.linalg.norm(change, axis=2))[2] < IMAGES.min_change_grey:
        return nothing
    light = cv2.GaussianBlur(rest, (0, 0), 0.05 * size[0])
    relative = change / (light + IMAGES.dark_grey)
    strength = np.linalg.norm(relative, axis=2)
    middle, scatter, top = _scatter_and_top(strength)
    if top < IMAGES.clear_sigmas * scatter:
        return nothing
    strength = np.maximum(strength - middle, 0.0)
    patch, others = _largest_patch(strength > max(IMAGES.patch_share * top, 4.0 * scatter))
    center, edge, problem = _circle_around(patch, strength, 4.0 * scatter)
    center = center if problem else _center_of_shading(relative, center, edge)
    radius = edge if problem else _rim_radius(strength, center, edge, 4.0 * scatter)
    if others.any() and np.percentile(strength[others], 95) < IMAGES.second_strength_share * top:
        others = np.zeros_like(others)
    problem = problem or _problem(patch, others, center, radius)
    return Circle((center + 0.5) / scale - 0.5, radius / scale, problem, edge / scale)


def drift_free_change(
    image: NDArray[Any], background: NDArray[Any], hidden: BoolArray | None = None
) -> FloatArray:
    """What a picture changes of the background (h, w, 3), at most 160 px wide, less the drift."""
    _, size = _work_size(image)
    seen, rest = coarse(image, size, hidden), coarse(background, size, hidden)
    return _without_drift(np.asarray(cv2.GaussianBlur(seen - rest, (0, 0), 1.0)))


def _work_size(image: NDArray[Any]) -> tuple[float, tuple[int, int]]:
    """Scale and size (width, height) of the pictures that are looked at."""
    height, width = image.shape[:2]
    scale = min(1.0, IMAGES.work_width_px / width)
    return scale, (max(8, round(width * scale)), max(8, round(height * scale)))


def _without_drift(change: FloatArray) -> FloatArray:
    """The change (h, w, 3) less what lamps have drifted by, a polynomial in position.

    It is fitted to the bare gel, by weights that a contact's large changes lose.
    """
    height, width = change.shape[:2]
    v, u = (part.ravel() for part in np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j])
    powers = range(IMAGES.drift_degree + 1)
    basis = np.column_stack([u**i * v**j for i in powers for j in powers if i + j in powers])
    values = change.reshape(-1, 3).astype(np.float64)
    rest: FloatArray = values - np.median(values, axis=0)
    for _ in range(IMAGES.drift_steps):
        size = np.linalg.norm(rest, axis=1)
        scale = float(np.median(size)) + 1.0
        weight = 1.0 / (1.0 + (size / scale) ** 2) ** 2
        weighted = basis * weight[:, None]
        rest = values - basis @ np.linalg.solve(weighted.T @ basis, weighted.T @ values)
    return rest.reshape(change.shape)


def _scatter_and_top(strength: FloatArray) -> tuple[float, float, float]:
    """Level and scatter of the bare gel, and how far the most changed pixels rise above it."""
    middle = float(np.median(strength))
    scatter = 1.4826 * float(np.median(np.abs(strength - middle))) + 1e-6
    return middle, scatter, float(np.percentile(strength, 99.8)) - middle


def _largest_patch(mask: BoolArray) -> tuple[BoolArray, BoolArray]:
    """The largest connected patch of ``mask``, closed and without holes; and the next largest."""
    closed = ndimage.binary_closing(np.pad(mask, 4), iterations=3)[4:-4, 4:-4]
    labels, count = ndimage.label(closed)
    if count == 0:
        return closed, closed
    sizes = ndimage.sum_labels(closed, labels, np.arange(1, count + 1))
    order = np.argsort(-sizes)
    filled: BoolArray = ndimage.binary_fill_holes(labels == 1 + order[0])
    second = labels == 1 + order[1] if count > 1 else np.zeros_like(filled)
    return filled, second


def _circle_around(
    patch: BoolArray, strength: FloatArray, least: float
) -> tuple[FloatArray, float, str]:
    """Centre (x, y) and radius of the edge, seen from the patch's middle; what is wrong."""
    rows, columns = np.nonzero(patch)
    radius = max(float(np.sqrt(len(rows) / np.pi)), 1.0)
    center = np.array([columns.mean(), rows.mean()]) if len(rows) else np.full(2, np.nan)
    if not len(rows):
        return center, radius, "shows no contact"
    for _ in range(3):
        points = _edge_points(strength, center, radius, least)
        if len(points) < IMAGES.min_edge_directions * IMAGES.n_directions:
            return center, radius, "what changed is not round"
        fitted, off = _fit_circle(points, np.array([*center, radius]))
        center, radius = fitted[:2], float(abs(fitted[2]))
    if off > IMAGES.max_out_of_round_radii * radius:
        return center, radius, "what changed is not round"
    return center, radius, ""


def _center_of_shading(change: FloatArray, center: FloatArray, radius: float) -> FloatArray:
    """Centre (x, y) of the ball whose slopes explain the relative change (h, w, 3) best.

    For each centre and contact radius the change is a polynomial in the normal of the gel.
    """
    distance = np.hypot(*(np.indices(change.shape[:2]) - center[::-1, None, None]))
    rows, columns = np.nonzero(distance < IMAGES.shaded_radii * radius)
    some = slice(None, None, max(1, len(rows) // IMAGES.shaded_pixels))
    rows, columns, seen = rows[some], columns[some], change[rows[some], columns[some]]
    ridge = 1e-6 * len(seen) * np.eye(len(SHADING_POWERS))  # where a power is another's multiple

    def unexplained(ball: FloatArray) -> FloatArray:
        contact = abs(float(ball[2]))
        rim = Membrane(IMAGES.shaded_rim_radii * contact, 4.0)
        gel = PressedGel(contact, IMAGES.shaded_ball_radii * contact, rim)
        gx, gy = gel.slope(columns - ball[0], rows - ball[1])
        nx, ny = np.stack([gx, gy]) / np.sqrt(1.0 + gx * gx + gy * gy)
        terms = np.stack([nx**i * ny**j for i, j in SHADING_POWERS])
        weights = np.linalg.solve(terms @ terms.T + ridge, terms @ seen)
        return np.asarray(seen - terms.T @ weights).ravel()

    start = np.array([*center, IMAGES.shaded_start_edges * radius])
    found = least_squares(unexplained, start, diff_step=1e-3, max_nfev=10).x[:2]
    return found if np.hypot(*(found - center)) < 0.3 * radius else center


def _profiles(
    strength: FloatArray, center: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray]:
    """The change along each direction (n, k), NaN out of view; and its largest (n,)."""
    angle = 2 * np.pi * np.arange(IMAGES.n_directions) / IMAGES.n_directions
    reach = np.arange(0.0, 2.2 * radius + 3.0, IMAGES.profile_step_px)
    x = center[0] + np.cos(angle)[:, None] * reach
    y = center[1] + np.sin(angle)[:, None] * reach
    height, width = strength.shape
    seen = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    profile = ndimage.map_coordinates(strength, [y, x], order=1, mode="nearest")
    near = reach <= 1.5 * radius + 1.0
    return np.where(seen, profile, np.nan), np.where(seen & near, profile, 0.0).max(axis=1)


def _edge_points(
    strength: FloatArray, center: FloatArray, radius: float, least: float
) -> FloatArray:
    """Where the change falls to half of its largest along each direction (n, 2).

    Directions without a clear change, and those whose edge lies out of view, are skipped.
    """
    profile, top = _profiles(strength, center, radius)
    level = IMAGES.edge_share * top
    above = np.nan_to_num(profile, nan=np.inf) > level[:, None]
    # The first fall beyond the highest point of a direction.
    peak = np.argmax(np.nan_to_num(profile) == top[:, None], axis=1)
    fallen = ~above & (np.arange(profile.shape[1]) > peak[:, None])
    first = np.argmax(fallen, axis=1)
    k = np.arange(IMAGES.n_directions)
    clear = fallen.any(axis=1) & (top > least)
    before, after = profile[k, first - 1], profile[k, first]
    share = (before - level) / np.maximum(before - after, 1e-9)
    edge = IMAGES.profile_step_px * (first - 1 + np.clip(share, 0.0, 1.0))
    angle = 2 * np.pi * k / IMAGES.n_directions
    points = center + edge[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return np.asarray(points[clear])


def _rim_radius(strength: FloatArray, center: FloatArray, radius: float, least: float) -> float:
    """Where the mean profile of all clear directions leaves its largest value for good."""
    profile, top = _profiles(strength, center, radius)
    clear = top > least
    relative = profile[clear] / top[clear, None]
    seen = np.isfinite(relative).sum(axis=0)
    mean = np.nansum(relative, axis=0) / np.maximum(seen, 1)
    mean[seen < 0.3 * clear.sum()] = 0.0
    last = np.nonzero(mean >= IMAGES.rim_share * mean.max())[0][-1]
    return float(IMAGES.profile_step_px * last)


def _fit_circle(points: FloatArray, start: FloatArray) -> tuple[FloatArray, float]:
    """Circle (x, y, radius) through points, robust to tails; and their median distance."""

    def distance(circle: FloatArray) -> FloatArray:
        return np.asarray(np.hypot(points[:, 0] - circle[0], points[:, 1] - circle[1]) - circle[2])

    scale = max(0.03 * float(start[2]), 0.3)
    fitted = least_squares(distance, start, loss="soft_l1", f_scale=scale).x
    return fitted, float(np.median(np.abs(distance(fitted))))


def _problem(patch: BoolArray, second: BoolArray, center: FloatArray, radius: float) -> str:
    height, width = patch.shape
    if radius < 2:
        return "shows a change of less than 2 pixels across, too small for a contact"
    if not (0 <= center[0] < width and 0 <= center[1] < height):
        return "the contact's centre lies out of view"
    if radius > 0.45 * min(height, width):
        return "the change covers most of the image: the background does not match this press"
    if second.sum() > IMAGES.second_contact_share * patch.sum():
        return "shows more than one contact"
    return ""


def outside_share(center_px: FloatArray, radius_px: float, shape_px: tuple[int, int]) -> float:
    """The share of a circle that lies outside the image, 0 to 1."""
    height, width = shape_px
    side = np.linspace(-1, 1, 81)
    x, y = np.meshgrid(side, side)
    disc = np.hypot(x, y) <= 1
    column, row = center_px[0] + radius_px * x[disc], center_px[1] + radius_px * y[disc]
    seen = (column > -0.5) & (column < width - 0.5) & (row > -0.5) & (row < height - 0.5)
    return float(1 - seen.mean())


def disc_of(circle: Circle, shape_px: tuple[int, int]) -> tuple[BoolArray, int]:
    """Pixels of a circle on a lattice that holds a thousand of them, and how wide that is."""
    step = max(1, int(circle.radius_px / 20))
    rows, columns = np.arange(0, shape_px[0], step)[:, None], np.arange(0, shape_px[1], step)
    x_px, y_px = circle.center_px
    return (columns - x_px) ** 2 + (rows - y_px) ** 2 <= circle.radius_px**2, step


def change_in(image: NDArray[np.uint8], rest: NDArray[np.uint8], circle: Circle) -> float:
    """How much more the circle differs from the gel at rest than the remaining image does."""
    disc, step = disc_of(circle, rest.shape[:2])
    change = image[::step, ::step].astype(np.float32) - rest[::step, ::step]
    change = np.abs(change - np.median(change, axis=(0, 1))).mean(axis=2)
    return float(change[disc].mean() - np.median(change[~disc]))
