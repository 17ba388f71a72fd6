"""What an image model is: from the slopes of a gel to grey levels, and back."""

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.errors import TableError
from tacgen.core.types import FloatArray, Window

TableSection: TypeAlias = tuple[dict[str, NDArray[Any]], dict[str, Any]]
"""Arrays and numbers of a model in a table's file."""


Floats: TypeAlias = NDArray[np.float32]
Shade: TypeAlias = Callable[[Floats, Window, NDArray[np.int32], Floats], None]
"""Writes grey levels into an image (H, W, 3), its last argument, in the spans of each row of a
window, of a deformed surface (H, W), mm, gel frame, C-contiguous: a model made ready."""


class ImageModel(Protocol):
    """What the gel's slope, place and depth add to the background of a table, in grey levels.

    A class of this kind, made known by :func:`register_model`, is all that another model takes: a
    table that holds one renders, is inverted, written and read like any other. ``kind`` names it in
    the file.
    """

    kind: ClassVar[str]

    @property
    def sees_depth(self) -> bool:
        """Whether it tells a contact from gel of the same slope at rest."""
        return False

    def shade(self, background: NDArray[np.float32], mm_per_px: float) -> Shade:
        """The model made ready for images of ``background`` (H, W, 3), to which it adds."""

    def slope_colors(self, gx: FloatArray, gy: FloatArray) -> FloatArray:
        """Grey levels (…, rows, columns, 3) that slopes ∂h/∂x and ∂h/∂y (…) add at nodes of place.

        The nodes are spread evenly from edge to edge of the image; the inverse searches them.
        """

    def contact_light(self, shape_px: tuple[int, int]) -> tuple[NDArray[np.float32], float]:
        """What a deep contact adds at each pixel, and the depth, mm, at which half of it shows.

        (H, W, 3, 3): grey levels, RGB last, for 1, nx and ny of the surface's normal.
        """
        return np.zeros((*shape_px, 3, 3), np.float32), 1.0

    def save(self) -> TableSection:
        """The arrays and the numbers from which ``load`` makes it again."""

    @classmethod
    def load(cls, arrays: Mapping[str, NDArray[Any]], numbers: Mapping[str, Any]) -> "ImageModel":
        """The model of a table's file; a ``KeyError`` where something is missing."""


Model = TypeVar("Model", bound=type[ImageModel])
_MODELS: dict[str, type[ImageModel]] = {}


def register_model(model: Model) -> Model:
    """Make a model known to the tables that name its kind; a ``TableError`` if there is one."""
    if _MODELS.setdefault(model.kind, model) is not model:
        msg = f"image model {model.kind!r} is registered twice"
        raise TableError(msg)
    return model


def load_model(
    kind: str, arrays: Mapping[str, NDArray[Any]], numbers: Mapping[str, Any]
) -> ImageModel:
    """The model of a table's file; a ``TableError`` where there is none of its kind."""
    if kind not in _MODELS:
        msg = (
            f"its image model {kind!r} is unknown (there are {', '.join(_MODELS)}); upgrade tacgen"
        )
        raise TableError(msg)
    return _MODELS[kind].load(arrays, numbers)


def features(u: FloatArray, v: FloatArray) -> NDArray[np.float64]:
    """The six features of image position (…, 6), in the table's order."""
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=-1)


def nearest_quadratic(
    model: ImageModel, max_slope_rad: float, n_slope: int = 48, n_direction: int = 120
) -> NDArray[np.float32]:
    """Coefficients (n_slope, n_direction, 3, 6) of the quadratic in position nearest to a model."""
    slope = np.tan(np.linspace(0.0, min(max_slope_rad, 1.5), n_slope))[:, None]
    turn = -np.pi + 2 * np.pi * np.arange(n_direction) / n_direction
    colors = model.slope_colors(slope * np.cos(turn), slope * np.sin(turn))
    v, u = np.meshgrid(*(np.linspace(-0.5, 0.5, n) for n in colors.shape[2:4]), indexing="ij")
    solve = np.linalg.pinv(features(u.ravel(), v.ravel()))
    flat = colors.reshape(n_slope, n_direction, -1, 3)
    return np.asarray(np.einsum("fp,sdpc->sdcf", solve, flat), np.float32)


def between_nodes(
    nodes: FloatArray, max_slope_rad: float, gx: FloatArray, gy: FloatArray
) -> FloatArray:
    """Grey levels (…, rows, columns, 3) between the nodes (n_slope, n_direction, …) of slopes."""
    flat = nodes.reshape(*nodes.shape[:2], -1)
    colors = np.empty((np.size(gx), flat.shape[2]), nodes.dtype)
    x, y = (np.ravel(np.asarray(part, np.float64)) for part in (gx, gy))
    _between(flat, max_slope_rad, x, y, colors)
    return colors.reshape(*np.shape(gx), *nodes.shape[2:])


@njit(cache=True, nogil=True, error_model="numpy")
def _between(
    nodes: NDArray[Any],
    max_slope_rad: float,
    gx: NDArray[Any],
    gy: NDArray[Any],
    colors: NDArray[Any],
) -> None:
    """Values between nodes (n_slope, n_direction, N) at slopes (n,), into ``colors`` (n, N)."""
    n_slope, n_direction, size = nodes.shape
    for k in range(len(gx)):
        i = math.atan(math.hypot(gx[k], gy[k])) / max_slope_rad * (n_slope - 1)
        j = (math.atan2(gy[k], gx[k]) + math.pi) / (2.0 * math.pi) * n_direction
        i = min(i, n_slope - 1.0)
        low_i, low_j = min(int(i), n_slope - 2), int(j)
        fi, fj = i - low_i, j - low_j
        low_j = low_j % n_direction
        high_j = (low_j + 1) % n_direction
        a, b = nodes[low_i, low_j], nodes[low_i, high_j]
        c, d = nodes[low_i + 1, low_j], nodes[low_i + 1, high_j]
        for n in range(size):
            near = (1.0 - fi) * ((1.0 - fj) * a[n] + fj * b[n])
            colors[k, n] = near + fi * ((1.0 - fj) * c[n] + fj * d[n])
