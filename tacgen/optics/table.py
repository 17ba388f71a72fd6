"""The calibrated lookup table: gel slope and image position in, colour change out."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, FiniteFloat, ValidationError

from tacgen.core.errors import TableError
from tacgen.core.files import atomic_path
from tacgen.core.safe_io import check_archive
from tacgen.core.schema import MOST_PROBLEMS, Section, problem_text
from tacgen.optics.image_models import ContactLight as ContactLight
from tacgen.optics.image_models import (
    ImageModel,
    Quadratic,
    Response,
    load_model,
    nearest_quadratic,
)
from tacgen.optics.image_models import features as features
from tacgen.optics.shade import N_FEATURES as N_FEATURES

Leds = tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...]
"""One (unit vector from the gel towards the light, RGB weight) a light; gel axes."""

DEFAULT_ELEVATION_RAD = math.radians(20.0)
"""Assumed for lights of unknown height: side-lit gels have theirs at 10° to 30°."""


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
    model : ImageModel, optional
        Another model, which renders instead: see :meth:`of_model`.
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
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    response: NDArray[np.float32] | None = None
    contact: ContactLight | None = None
    model: ImageModel | None = None

    @classmethod
    def of_model(
        cls,
        model: ImageModel,
        background: NDArray[np.float32],
        mm_per_px: float,
        max_slope_rad: float,
        **others: Any,
    ) -> "LookupTable":
        """A table of any image model; its coefficients are the quadratic nearest to it."""
        coefficients = nearest_quadratic(model, max_slope_rad)
        return cls(coefficients, background, mm_per_px, max_slope_rad, model=model, **others)

    @property
    def image_model(self) -> ImageModel:
        """What renders it, and is inverted."""
        if self.model is not None:
            return self.model
        if self.response is not None:
            return Response(self.response, self.max_slope_rad, self.contact)
        return Quadratic(self.coefficients, self.max_slope_rad, self.interpolation)

    @property
    def geometry(self) -> dict[str, float]:
        """``mm_per_px``, and ``dome_radius_mm`` where it is known, of the sensor that it is of."""
        dome = {"dome_radius_mm": self.contact.dome_radius_mm} if self.contact else {}
        return {"mm_per_px": self.mm_per_px} | dome

    @property
    def origin(self) -> str:
        """What its colours come from, in a few words: real presses, or a virtual sensor."""
        known = self.provenance
        if "source" in known:
            return str(known["source"])
        if "n_presses" in known:
            return f"{known['n_presses']} ball presses ({known.get('made_by', 'tacgen')})"
        return "not recorded" if self.sensor != "taxim" else "a Taxim calibration, imported"

    def __post_init__(self) -> None:
        problems = []
        if self.coefficients.ndim != 4 or self.coefficients.shape[2:] != (3, N_FEATURES):
            problems.append(
                f"coefficients have shape {self.coefficients.shape}, "
                f"not (n_slope, n_direction, 3, {N_FEATURES})"
            )
        if self.background.ndim != 3 or self.background.shape[2] != 3:
            problems.append(f"background has shape {self.background.shape}, not (H, W, 3)")
        if self.response is not None:
            problems += Response(self.response, self.max_slope_rad, self.contact).problems()
        elif self.contact is not None:
            shape = self.contact.change.shape
            problems.append(f"contact has shape {shape}, but there is no response that it adds to")
        if self.interpolation not in ("linear", "floor"):
            problems.append(f"interpolation is {self.interpolation!r}, not 'linear' or 'floor'")
        TableError.raise_if(problems)

    @property
    def shape_px(self) -> tuple[int, int]:
        """(height, width) of the images it renders."""
        return self.background.shape[0], self.background.shape[1]


PositiveFinite = Annotated[FiniteFloat, Field(gt=0)]
MAX_TABLE_BYTES = 1 << 28  # of its arrays, unpacked; a table has some megabytes


class _ContactHeader(Section):
    depth_mm: PositiveFinite
    dome_radius_mm: Annotated[FiniteFloat, Field(ge=0)] = 0.0


class _Header(Section):
    """What stands in a table's file beside its arrays."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    mm_per_px: PositiveFinite
    max_slope_rad: Annotated[float, Field(gt=0, le=math.pi / 2)]
    interpolation: Literal["linear", "floor"]
    sensor: str
    noise_grey: Annotated[FiniteFloat, Field(ge=0)]
    effects: dict[str, dict[str, FiniteFloat]]
    provenance: dict[str, Any]
    contact: _ContactHeader | None = None
    """Of early tables, which name no model."""
    model: dict[str, Any] = Field(default_factory=dict)


_SCALARS = ("mm_per_px", "max_slope_rad", "interpolation", "sensor", "noise_grey")


def save_table(table: LookupTable, path: Path) -> None:
    """Write ``table`` as an .npz that ``load_table`` reads, whole or not at all."""
    meta = {name: getattr(table, name) for name in _SCALARS}
    meta["effects"] = {name: dict(parameters) for name, parameters in table.effects.items()}
    meta["provenance"] = dict(table.provenance)
    model = table.image_model
    section, numbers = model.save()
    meta["model"] = {**numbers, "kind": model.kind}
    arrays: dict[str, Any] = {
        **section,
        "coefficients": table.coefficients,
        "background": table.background,
    }
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
    ((640, 480), 0.027)
    """
    path = Path(path)
    try:
        check_archive(path, MAX_TABLE_BYTES)
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in ("coefficients", "background", "meta")}
            arrays |= {name: archive[name] for name in archive.files}
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
    header = _read_header(path, arrays.pop("meta"))
    for name, array in arrays.items():
        if array.dtype.kind not in "fiu" or not np.isfinite(array).all() or not array.size:
            msg = f"{path}: {name} holds no finite numbers; calibrate again or fetch it anew"
            raise TableError(msg)
    numbers = {**header.model_dump(exclude={"model"}, exclude_none=True), **header.model}
    kind = numbers.get("kind", "response" if "response" in arrays else "quadratic")
    try:
        if "contact" in numbers:
            contact = _ContactHeader.model_validate(numbers["contact"], strict=True)
            numbers["contact"] = contact.model_dump()
        model = load_model(kind, arrays, numbers)
        members: dict[str, Any] = {"model": model}
        if isinstance(model, Response):
            members = {"response": model.response, "contact": model.contact}
        elif isinstance(model, Quadratic):
            members = {}
        return LookupTable(
            coefficients=arrays["coefficients"].astype(np.float32),
            background=arrays["background"].astype(np.float32),
            effects=header.effects,
            provenance=header.provenance,
            **members,
            **{name: getattr(header, name) for name in _SCALARS},
        )
    except TableError as error:
        problems = [f"{path}: {line}" for line in str(error).splitlines()]
        raise TableError.from_problems(problems) from None
    except (KeyError, TypeError, ValueError) as error:
        what = str(error.args[0]) if error.args else "its contact"
        msg = f"{path}: its image model {kind!r} lacks or misstates {what}; calibrate again"
        raise TableError(msg) from None


def _read_header(path: Path, meta: NDArray[Any]) -> _Header:
    """The header, checked as strictly as a recipe."""
    try:
        return _Header.model_validate_json(meta.tobytes())
    except ValidationError as error:
        found = error.errors()
    if any(one["type"] == "extra_forbidden" for one in found):
        keys = ", ".join(str(one["loc"][-1]) for one in found if one["type"] == "extra_forbidden")
        msg = f"{path}: made by a newer tacgen (its header has {keys}); upgrade tacgen"
        raise TableError(msg)
    raise TableError.from_problems(
        [
            f"{path}: header: {'.'.join(map(str, one['loc']))}{' ' if one['loc'] else ''}"
            f"{problem_text(one)}; calibrate again or fetch it anew"
            for one in found[:MOST_PROBLEMS]
        ]
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
