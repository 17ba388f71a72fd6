"""The calibrated lookup table: gel slope and image position in, colour change out."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.core.errors import TableError
from tacgen.core.files import atomic_path
from tacgen.core.safe_io import check_archive

Leds = tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]
"""One (unit vector from the gel towards the light, RGB weight) a light; gel axes."""

DEFAULT_ELEVATION_RAD = math.radians(20.0)
"""Assumed for lights of unknown height: side-lit gels have theirs at 10° to 30°."""
N_FEATURES = 6  # x², y², xy, x, y, 1 in image position, Taxim's order


def features(u: FloatArray, v: FloatArray) -> NDArray[np.float64]:
    """The six features of image position (…, 6), in the table's order."""
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=-1)


@dataclass(frozen=True, slots=True)
class ContactLight:
    """What gel pressed in answers otherwise than gel of the same slope at rest.

    At depth d below the gel at rest a pixel with unit normal (nx, ny, ·) gains
    d / (d + ``depth_mm``) · (c₀ + c₁ nx + c₂ ny), the c linear between nodes of position.

    ``change`` (n_rows, n_columns, 3, 3) holds c₀, c₁, c₂ at each node, RGB grey levels last; node
    (r, c) stands where it does in a table's ``response``. At ``depth_mm`` half of it shows. The gel
    at rest, of ``dome_radius_mm`` (0: flat), is 0 mm high at its centre.
    """

    change: NDArray[np.float32]
    depth_mm: float
    dome_radius_mm: float = 0.0

    def rest_mm(self, shape_px: tuple[int, int], mm_per_px: float) -> NDArray[np.float32]:
        """Height (H, W) of the gel at rest."""
        height, width = shape_px
        if self.dome_radius_mm <= 0:
            return np.zeros(shape_px, dtype=np.float32)
        x = (np.arange(width) - (width - 1) / 2) * mm_per_px
        y = (np.arange(height) - (height - 1) / 2) * mm_per_px
        square = np.minimum(x[None, :] ** 2 + y[:, None] ** 2, (0.95 * self.dome_radius_mm) ** 2)
        sag = np.sqrt(self.dome_radius_mm**2 - square) - self.dome_radius_mm
        return np.asarray(sag, dtype=np.float32)


@dataclass(frozen=True, slots=True)
class LookupTable:
    """Taxim's polynomial lookup table of one sensor.

    The slope of the gel-frame height map h is (gx, gy) = (∂h/∂x, ∂h/∂y), x along columns, y along
    rows (down), h out of the gel. Its magnitude is atan √(gx² + gy²) in [0, ``max_slope_rad``] and
    its direction atan2(gy, gx) in [−π, π). Node (i, j) of the table stands at magnitude
    i·max_slope_rad/(n_slope − 1) and direction −π + 2π·j/n_direction; between nodes the renderer
    interpolates linearly (``interpolation="linear"``, direction wraps around) or takes the node
    below (``"floor"``, what Taxim does). Positions are u = (column + ½)/width − ½ and
    v = (row + ½)/height − ½, so a table does not depend on the resolution it is stored for.

    Attributes
    ----------
    coefficients : (n_slope, n_direction, 3, 6) float32
        Grey levels, channels RGB, features u², v², uv, u, v, 1.
    background : (H, W, 3) float32
        RGB grey levels such that the undeformed gel (dome included) renders the reference image.
    response : (n_slope, n_direction, n_rows, n_columns, 3) float32, optional
        Grey levels that each slope adds at nodes of position, for light that is no quadratic in
        position. Where it is given it is what renders, linear between its nodes in all four
        directions; its nodes of slope and direction are spaced as those of the coefficients, but
        are as many as its shape has, and node (r, c) stands at v = r/(n_rows − 1) − ½,
        u = c/(n_columns − 1) − ½. The coefficients are then the quadratic nearest to it.
    contact : ContactLight, optional
        What a contact adds to the response, at the response's nodes of position.
    mm_per_px : float
    max_slope_rad : float
        At most π/2.
    noise_grey : float
        Standard deviation of the camera's noise, for renders that ask for noise.
    effects : mapping
        Optical effects, name → parameters, which the renderer applies; `tacgen diagnose optics`
        finds them.
    provenance : mapping
        What it was made of: hashes, versions, chosen settings, held-out error.

    Source: Si & Yuan 2022, Taxim, Eq. 3.
    """

    coefficients: NDArray[np.float32]
    background: NDArray[np.float32]
    mm_per_px: float
    max_slope_rad: float
    interpolation: str = "linear"
    sensor: str = ""
    noise_grey: float = 0.0
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=lambda: MappingProxyType({}))
    provenance: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    response: NDArray[np.float32] | None = None
    contact: ContactLight | None = None

    def __post_init__(self) -> None:
        problems = []
        if self.coefficients.ndim != 4 or self.coefficients.shape[2:] != (3, N_FEATURES):
            problems.append(
                f"coefficients have shape {self.coefficients.shape}, "
                f"not (n_slope, n_direction, 3, {N_FEATURES})"
            )
        if self.background.ndim != 3 or self.background.shape[2] != 3:
            problems.append(f"background has shape {self.background.shape}, not (H, W, 3)")
        if self.response is not None and (
            self.response.ndim != 5 or min(self.response.shape) < 2 or self.response.shape[4] != 3
        ):
            problems.append(
                f"response has shape {self.response.shape}, not (n_slope, n_direction, n_rows, "
                "n_columns, 3) with at least two nodes each way"
            )
        if self.contact is not None and (
            self.response is None
            or self.contact.change.shape != (*self.response.shape[2:4], 3, 3)
            or not self.contact.depth_mm > 0
        ):
            problems.append(
                f"contact has shape {self.contact.change.shape} and depth "
                f"{self.contact.depth_mm:g} mm, not (n_rows, n_columns, 3, 3) with the response's "
                "nodes of position and a depth above 0"
            )
        if self.interpolation not in ("linear", "floor"):
            problems.append(f"interpolation is {self.interpolation!r}, not 'linear' or 'floor'")
        TableError.raise_if(problems)

    @property
    def shape_px(self) -> tuple[int, int]:
        """(height, width) of the images it renders."""
        return self.background.shape[0], self.background.shape[1]


def contact_at(
    table: LookupTable,
    gx: FloatArray,
    gy: FloatArray,
    depth_mm: FloatArray,
    u: FloatArray,
    v: FloatArray,
) -> FloatArray:
    """Grey levels (n, 3) that a contact of slopes and depths (n,) adds, in float64."""
    if table.contact is None:
        return np.zeros((len(gx), 3))
    change = table.contact.change
    n_rows, n_columns = change.shape[:2]
    down, across = (v + 0.5) * (n_rows - 1), (u + 0.5) * (n_columns - 1)
    row = np.clip(down.astype(int), 0, n_rows - 2)
    column = np.clip(across.astype(int), 0, n_columns - 2)
    down, across = (down - row)[:, None, None], (across - column)[:, None, None]
    here = (1 - down) * ((1 - across) * change[row, column] + across * change[row, column + 1])
    here += down * ((1 - across) * change[row + 1, column] + across * change[row + 1, column + 1])
    depth = np.maximum(depth_mm, 0.0)
    share = depth / (depth + table.contact.depth_mm)
    length = np.sqrt(1.0 + gx * gx + gy * gy)
    terms = np.stack([share, share * gx / length, share * gy / length], axis=-1)
    return np.asarray((terms[:, :, None] * here).sum(axis=1))


_SCALARS = ("mm_per_px", "max_slope_rad", "interpolation", "sensor", "noise_grey")


def save_table(table: LookupTable, path: Path) -> None:
    """Write ``table`` as an .npz that ``load_table`` reads, whole or not at all."""
    meta = {name: getattr(table, name) for name in _SCALARS}
    meta["effects"] = {name: dict(parameters) for name, parameters in table.effects.items()}
    meta["provenance"] = dict(table.provenance)
    arrays: dict[str, Any] = {"coefficients": table.coefficients, "background": table.background}
    if table.response is not None:
        arrays["response"] = table.response.astype(np.float16)
    if table.contact is not None:
        arrays["contact"] = table.contact.change.astype(np.float32)
        meta["contact"] = {
            "depth_mm": table.contact.depth_mm, "dome_radius_mm": table.contact.dome_radius_mm
        }  # fmt: skip
    with atomic_path(Path(path)) as partial, partial.open("wb") as file:
        np.savez_compressed(
            file,
            **arrays,
            meta=np.frombuffer(json.dumps(meta, sort_keys=True).encode(), dtype=np.uint8),
        )


def load_table(path: Path | str) -> LookupTable:
    """Read a ``table.npz``.

    Raises
    ------
    TableError
        If the file is missing, damaged, or not a tacgen table.

    Examples
    --------
    >>> table = tacgen.load_table(tacgen.Sensor("digit").description.table)
    >>> table.shape_px, round(table.mm_per_px, 4)
    ((320, 240), 0.0594)
    """
    path = Path(path)
    try:
        check_archive(path)
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in ("coefficients", "background", "meta")}
            arrays |= {name: archive[name] for name in ("response", "contact") if name in archive}
    except FileNotFoundError:
        msg = f"{path}: no such table; `tacgen calibrate lookup` makes one"
        raise TableError(msg) from None
    except KeyError as error:
        msg = (
            f"{path}: not a tacgen table ({error.args[0]}); "
            "a Taxim polycalib.npz is read by `tacgen calibrate import`"
        )
        raise TableError(msg) from None
    except (OSError, ValueError, BadZipFile) as error:
        msg = f"{path}: cannot be read as a table: {error}"
        raise TableError(msg) from None
    meta = json.loads(arrays["meta"].tobytes())
    scalars = {name: meta[name] for name in _SCALARS}
    contact = None
    if "contact" in arrays:
        contact = ContactLight(arrays["contact"].astype(np.float32), **meta["contact"])
    return LookupTable(
        coefficients=arrays["coefficients"].astype(np.float32),
        background=arrays["background"].astype(np.float32),
        effects=meta["effects"],
        provenance=meta["provenance"],
        response=arrays["response"].astype(np.float32) if "response" in arrays else None,
        contact=contact,
        **scalars,
    )


def leds_of_table(table: LookupTable) -> Leds:
    """One light a channel, in the direction whose slopes the table brightens most.

    For tables of sensors whose lights nobody described; the elevation cannot be read off a table.
    """
    constant = table.coefficients[..., 5].astype(np.float64)
    n_slope, n_direction = constant.shape[:2]
    angle = -math.pi + 2 * math.pi * np.arange(n_direction) / n_direction
    middle = slice(max(1, n_slope // 8), max(2, n_slope // 2))
    level, down = math.cos(DEFAULT_ELEVATION_RAD), -math.sin(DEFAULT_ELEVATION_RAD)
    leds = []
    for channel in range(3):
        brightness = constant[middle, :, channel].mean(axis=0)
        x, y = (brightness * np.cos(angle)).sum(), (brightness * np.sin(angle)).sum()
        azimuth = math.atan2(y, x)
        direction = (level * math.cos(azimuth), level * math.sin(azimuth), down)
        rgb = (float(channel == 0), float(channel == 1), float(channel == 2))
        leds.append((direction, rgb))
    return tuple(leds)
