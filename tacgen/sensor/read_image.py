"""From a sensor's picture to depth, contact, volume and force: the renderer's inverse."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import brentq, least_squares
from scipy.spatial import cKDTree

from tacgen.contact.gel import mm_to_px, px_to_mm
from tacgen.contact.gel_response import LOAD, ONSET_S
from tacgen.contact.indenter import contact_status
from tacgen.contact.law import ContactLaw
from tacgen.contact.shear import marker_grid_mm
from tacgen.core.errors import SensorError, TableError
from tacgen.core.files import atomic_path
from tacgen.core.images import encode_png
from tacgen.core.records import Estimate
from tacgen.core.safe_io import read_rgb
from tacgen.optics.dots import (
    LEAST_SEEN,
    MIN_TRACKED,
    Dots,
    Spots,
    dots_at_rest,
    dots_in,
    find_spots,
    follow,
)
from tacgen.optics.effects.skirt import SKIRT
from tacgen.optics.reconstruct import Reconstructor
from tacgen.optics.table import load_table
from tacgen.sensor.simulated import Frame, Sensor

LEAST_DEPTH_MM = 0.03
"""Shallower than this there is no contact: pictures of a gel at rest reach 0.02 mm by noise."""
SHALLOW_MM, CLEAR_STDERR = 0.2, 5.0
"""Up to so deep noise of 4 grey levels, or JPEG, makes an imprint; its volume is then less than so
many times its standard error: up to 3.2. A press of 0.02 N, 0.1 mm deep, has 14 times or more."""
CLIPPED, MOST_CLIPPED = 255, 0.05
"""A grey level that a camera clips, and the share of a contact at it up to which the force is
within its error: 4 N read as 4.2 ± 0.3 at 0.07 and 4.6 ± 0.8 at 0.13 of a picture."""
MARKER_STDERR_PX = 0.1
"""How well the centre of one dot is found, with what its motion loses where it is interpolated."""
MOST_OFF_STDERR = 3.0  # between the response that was read and that of the load that was found
FIRST_FORCE_N, FORCES_TRIED = 0.01, 80  # in steps of 16 %
LARGEST_FORCE_N = 1000.0  # no gel survives this; a law that needs more for a volume is saturated


Picture: TypeAlias = NDArray[np.uint8] | str | Path
"""An image (H, W, 3), RGB uint8, or the path of its file."""


def _no_markers() -> NDArray[np.float64]:
    return np.zeros((0, 2))


@dataclass(frozen=True, slots=True)
class Reading(Frame):
    """What a picture says of the contact: a frame, with standard errors.

    ``markers_mm`` (M, 2) is how far each printed dot is from ``marker_rest_mm`` (M, 2), its place
    at rest in the gel frame, in the order of the sensor's grid where all of its dots are found;
    ``markers_lost`` of them were not seen and move as their neighbours. Without printed dots they
    are (0, 2), and ``shear_sum_mm`` (2,), the sum of their motion, and the shear forces with their
    errors NaN. ``message`` is what the user should know (no contact, walls too steep).
    ``steep_share`` is the share of the contact that is at the steepest slope of the table; where
    ``lower_bound``, depth, volume and force are at least what stands here, and their errors do not
    hold what is missing.
    """

    force_stderr_n: NDArray[np.float64]
    volume_stderr_mm3: float
    shear_sum_mm: NDArray[np.float64]
    message: str
    steep_share: float = 0.0
    lower_bound: bool = False
    markers_mm: NDArray[np.float64] = field(default_factory=_no_markers)
    marker_rest_mm: NDArray[np.float64] = field(default_factory=_no_markers)
    markers_lost: int = 0

    def summary(self) -> dict[str, Any]:
        """The numbers alone, ready for JSON: None for what is not known."""
        names = ("shear_x", "shear_y", "normal")
        forces = {f"force_{n}_n": v for n, v in zip(names, self.force_n, strict=True)}
        errors = {f"force_{n}_stderr_n": v for n, v in zip(names, self.force_stderr_n, strict=True)}
        numbers = {
            **forces,
            **errors,
            "volume_mm3": self.volume_mm3,
            "volume_stderr_mm3": self.volume_stderr_mm3,
            "indentation_mm": self.indentation_mm,
            "shear_sum_x_mm": self.shear_sum_mm[0],
            "shear_sum_y_mm": self.shear_sum_mm[1],
        }
        known = {k: float(v) if math.isfinite(v) else None for k, v in numbers.items()}
        return {
            "contact": bool(self.contact_mask.any()),
            **known,
            "markers": len(self.markers_mm),
            "markers_lost": self.markers_lost,
            "message": self.message,
            "steep_share": round(self.steep_share, 4),
            "lower_bound": self.lower_bound,
        }


class ImageReader:
    """Reads pictures of one sensor; prepared once for all of them.

    ``sensor`` has the table and the contact law of the sensor that took the pictures;
    ``background_rgb`` (H, W, 3) is the gel at rest, of the same session, the table's where None.

    Raises ``SensorError`` if the background is not of the table's size, ``TableError`` if it is
    turned, cropped or coloured otherwise than the table's.

    Examples
    --------
    >>> import tacgen
    >>> sensor = tacgen.Sensor("gelsight_mini")
    >>> reader = tacgen.ImageReader(sensor)
    >>> float(reader.read(sensor.at_rest_rgb()).volume_mm3)
    0.0
    """

    def __init__(self, sensor: Sensor | str, background_rgb: Picture | None = None) -> None:
        self.sensor = sensor if isinstance(sensor, Sensor) else Sensor(sensor)
        at_rest = self.sensor.at_rest_rgb() if background_rgb is None else background_rgb
        self.background_rgb = self._checked(at_rest, "the background").copy()
        dome_mm = self.sensor.description.dome_radius_mm
        self._table = self.sensor.table
        # The imprint ends at the contact's rim, however wide the skirt around it is.
        if left_in := ", ".join(name for name in self._table.effects if name != SKIRT.name):
            msg = (
                f"the table's optical effects ({left_in}) are drawn, but not taken out of a "
                "picture that is read: depth and volume may be off by more than their errors; "
                "check the volume of a press of known depth"
            )
            warnings.warn(msg, stacklevel=2)
        self._scale = self.sensor.table.shape_px, self.sensor.table.mm_per_px
        self._reconstructor = Reconstructor(self.sensor.table, self.background_rgb, dome_mm)
        spots = find_spots(self.background_rgb)
        self._dots = spots.mask(spots.usable) if spots.usable.sum() >= MIN_TRACKED else None
        self.dot_pitch_mm, self._at_rest = math.nan, None
        if self._dots is not None:
            self._at_rest = self._in_grid(dots_at_rest(self.background_rgb))
            spacing_mm = self._at_rest.spacing_px * self.sensor.table.mm_per_px
            markers = self.sensor.description.markers
            self.dot_pitch_mm = markers.pitch_mm if markers else spacing_mm

    @cached_property
    def _curve(self) -> NDArray[np.float64]:
        return normal_curve(self.sensor.law)

    def is_of(self, sensor: Sensor, background_rgb: NDArray[np.uint8]) -> bool:
        """Whether it was made from this sensor, with the table that it has now, and background."""
        same = self.sensor is sensor and self._table is sensor.table
        return same and np.array_equal(self.background_rgb, background_rgb)

    def read(self, image_rgb: Picture) -> Reading:
        """Depth, contact, volume and force of one picture (H, W, 3), RGB uint8, or of its file.

        Raises ``SensorError`` if it is of another size, ``TableError`` if it does not match the
        background: another sensor or light, other colours, turned, shifted or cropped otherwise.
        """
        rgb = self._checked(image_rgb, "the image")
        spots = hidden = None
        if self._dots is not None:
            spots = find_spots(rgb)
            hidden = dots_in(spots, self._dots)
        shape = self._reconstructor.shape_of(rgb, hidden)
        imprint = shape.imprint(LEAST_DEPTH_MM)
        volume_stderr = shape.volume_stderr_mm3(imprint)
        small = np.asarray(imprint.depth_mm, np.float64)
        volume = float(small.sum()) * shape.mm_per_px**2
        is_noise = small.max() < SHALLOW_MM and 0 < volume < CLEAR_STDERR * volume_stderr
        if is_noise:
            small, volume, volume_stderr = np.zeros_like(small), 0.0, 0.0
        height, width = rgb.shape[:2]
        # The depth keeps its volume: enlarged, it is scaled to the sum that it had.
        depth = np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR))
        pixel_mm2 = self.sensor.table.mm_per_px**2
        depth = depth * (volume / max(float(depth.sum()) * pixel_mm2, 1e-12))
        touched = depth > 0
        motion, rest, lost = self._motion(spots)
        shear, places, unseen = np.full(2, math.nan), None, ""
        if len(rest):
            places = np.asarray(mm_to_px(rest + motion, *self._scale), np.float64)
            if lost > (1.0 - LEAST_SEEN) * len(rest):
                unseen = f"{lost} of {len(rest)} dots are not seen: the shear is not known"
            else:
                shear = motion.sum(axis=0)
        reading = Reading(
            rgb=rgb,
            depth_mm=depth.astype(np.float32),
            contact_mask=touched,
            force_n=np.zeros(3),
            indentation_mm=float(depth.max()),
            volume_mm3=volume,
            markers_px=places,
            force_stderr_n=np.zeros(3),
            volume_stderr_mm3=volume_stderr,
            shear_sum_mm=shear,
            message="",
            status=contact_status(1.0, touches=bool(touched.any())),
            markers_mm=motion,
            marker_rest_mm=rest,
            markers_lost=lost,
        )
        if not touched.any():
            none = f"no contact: the gel is nowhere deeper than {LEAST_DEPTH_MM} mm"
            none += " by more than its error" * is_noise
            return replace(reading, message="; ".join((none, *self._reconstructor.doubts)))
        pitch_mm = math.nan if unseen else self.dot_pitch_mm
        law, mm_per_px = self.sensor.law, self.sensor.table.mm_per_px
        reading = _with_forces(reading, law, mm_per_px, pitch_mm, self._curve)
        clipped = np.logical_or.reduce([rgb[..., channel] == CLIPPED for channel in range(3)])
        white = float(clipped[touched].mean())
        bright = f"{white:.0%} of the contact is overexposed: expose less, as for the table"
        bright += "; depth and force may be too large or too small"
        doubts = (unseen, *self._reconstructor.doubts, bright * (white > MOST_CLIPPED))
        message = "; ".join(filter(None, (reading.message, *doubts)))
        reading = replace(reading, message=message, steep_share=shape.steepest_share)
        # A clipped colour looks like a steep slope.
        if not shape.is_lower_bound or white > MOST_CLIPPED:
            return reading
        limit_deg = math.degrees(math.atan(self._reconstructor.steepest))
        steep = (
            f"a lower bound: {shape.steepest_share:.0%} of the contact is at the steepest slope of "
            f"the table, {limit_deg:.0f}°, and behind steeper walls depth, volume and force are "
            "too low; press less deep"
        )
        message = "; ".join(filter(None, (reading.message, steep)))
        return replace(reading, message=message, lower_bound=True)

    def _in_grid(self, dots: Dots) -> Dots:
        """The dots at rest in the order of the sensor's grid, where they are all of its dots."""
        grid = marker_grid_mm(self.sensor.description)
        if self.sensor.description.markers is None or len(dots) != len(grid):
            return dots
        _, index = cKDTree(px_to_mm(dots.places_px, *self._scale)).query(grid)
        return (
            replace(dots, places_px=dots.places_px[index]) if len({*index}) == len(grid) else dots
        )

    def _motion(self, spots: Spots | None) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
        """Motion of the dots (M, 2), mm, their places at rest, and how many were not seen."""
        if self._at_rest is None or spots is None:
            return _no_markers(), _no_markers(), 0
        motion, seen = follow(self._at_rest, [spots])
        moved_mm = np.asarray(motion[0] * self.sensor.table.mm_per_px, np.float64)
        return (
            moved_mm,
            np.asarray(px_to_mm(self._at_rest.places_px, *self._scale), np.float64),
            len(self._at_rest) - int(seen[0]),
        )

    def _checked(self, picture: Picture, what: str) -> NDArray[np.uint8]:
        if isinstance(picture, (str, Path)):
            image = read_rgb(Path(picture), SensorError)
            what = f"{picture}"
        else:
            image = np.asarray(picture)
        height, width = self.sensor.table.shape_px
        if image.dtype != np.uint8 or image.shape != (height, width, 3):
            msg = (
                f"{what} is {image.dtype} of shape {image.shape}; {self.sensor.description.name}'s "
                f"table is for uint8 RGB of shape {(height, width, 3)}: choose the sensor that "
                "took it, or give a table that was calibrated at this size"
            )
            raise SensorError(msg)
        return image


def sensor_of(name: str, table: Path | None = None, contact: Path | None = None) -> Sensor:
    """The sensor that took pictures: of the geometry that its table states, if one is given."""
    geometry = load_table(table).geometry if table else {}
    scale, dome = (geometry.get(of) for of in ("mm_per_px", "dome_radius_mm"))
    return Sensor(name, table, contact, mm_per_px=scale, dome_radius_mm=dome)


def read_image(
    image_rgb: Picture,
    sensor: Sensor | str,
    background_rgb: Picture | None = None,
) -> Reading:
    """The contact that a picture shows: depth, mask, volume, force with its standard error.

    A further picture of the same ``Sensor`` and background takes a tenth of the first one's time;
    for many of them prepare an :class:`ImageReader` once.

    Parameters
    ----------
    image_rgb, background_rgb : (H, W, 3) uint8, or path of an image file
        RGB; the background is the gel at rest, by default as the table has it.
    sensor : Sensor or str
        The sensor that took the picture, with its table and contact law.

    Raises
    ------
    SensorError
        If the picture is of another size.
    TableError
        If it does not match the background, or the background the table.

    Source
    ------
    Yuan, Dong & Adelson 2017 (GelSight, §4): slopes by the inverted table, then Poisson's
    equation; force by Si et al. 2022, Eq. 1: F = V / k_n, or the inverse of the whole law.

    Examples
    --------
    >>> import numpy as np, tacgen, trimesh
    >>> ball = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
    >>> sensor = tacgen.Sensor("gelsight_mini")
    >>> picture = sensor.render(ball, np.eye(4), force_n=3.0).rgb
    >>> reading = tacgen.read_image(picture, sensor)
    >>> bool(abs(reading.force_n[2] - 3.0) < reading.force_stderr_n[2] < 0.5)
    True
    """
    if not isinstance(sensor, Sensor):
        return ImageReader(sensor, background_rgb).read(image_rgb)
    at_rest = sensor.at_rest_rgb() if background_rgb is None else background_rgb
    if isinstance(at_rest, (str, Path)):
        at_rest = read_rgb(Path(at_rest), SensorError)
    known = _LATEST.get(sensor)
    if known is None or not known.is_of(sensor, at_rest):
        _LATEST.clear()
        known = _LATEST[sensor] = ImageReader(sensor, at_rest)
    return known.read(image_rgb)


_LATEST: dict[Sensor, ImageReader] = {}
"""The reader of the last call, which the next one of the same sensor and background uses again."""


def read_files(reader: ImageReader, paths: Sequence[Path], out: Path) -> list[dict[str, Any]]:
    """Read image files and write what they show into the folder ``out``; returns the rows.

    ``readings.csv`` has one row an image; ``<name>.npz`` holds ``depth_mm``, ``contact_mask`` and,
    where the picture has dots, ``markers_mm`` with ``marker_rest_mm``; ``<name>_depth.png`` shows
    the depth, white at the deepest. Where files of several folders have one name, the name of the
    folder stands before it.

    Raises ``SensorError`` if a file is no image, two have one name nevertheless, or one does not
    fit the sensor; nothing is then written.
    """
    names = _names(paths)
    readings = []
    for path in paths:
        rgb = read_rgb(path, SensorError)
        try:
            readings.append(reader.read(rgb))
        except (SensorError, TableError) as error:
            msg = f"{path}: {error}"
            raise SensorError(msg) from None
    rows = []
    out.mkdir(parents=True, exist_ok=True)
    for path, name, reading in zip(paths, names, readings, strict=True):
        rows.append({"file": name + path.suffix, **reading.summary()})
        with atomic_path(out / f"{name}.npz") as partial, partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **_arrays(reading))
        brightness = 255.0 * reading.depth_mm / max(reading.indentation_mm, LEAST_DEPTH_MM)
        grey = np.repeat(np.rint(brightness).astype(np.uint8)[..., None], 3, axis=2)
        with atomic_path(out / f"{name}_depth.png") as partial:
            partial.write_bytes(encode_png(grey))
    with atomic_path(out / "readings.csv") as partial:
        pd.DataFrame(rows).to_csv(partial, index=False)
    return rows


def _arrays(reading: Reading) -> dict[str, NDArray[Any]]:
    """What the ``.npz`` of a picture holds; of the dots only where it has them."""
    arrays: dict[str, NDArray[Any]] = {
        "depth_mm": reading.depth_mm,
        "contact_mask": reading.contact_mask,
    }
    if len(reading.markers_mm):
        arrays |= {"markers_mm": reading.markers_mm, "marker_rest_mm": reading.marker_rest_mm}
    return arrays


def _names(paths: Sequence[Path]) -> list[str]:
    """A name for what is read from each file."""
    names = [path.stem for path in paths]
    if len(set(names)) < len(names):
        names = [f"{path.absolute().parent.name}_{path.stem}" for path in paths]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        msg = f"two images would be {twice}: give each once, or read them into separate folders"
        raise SensorError(msg)
    return names


def reading_line(row: dict[str, Any]) -> str:
    """One row of ``read_files`` as a line of text."""
    if not row["contact"]:
        return f"{row['file']}: {row['message']}"
    at_least = "at least " if row["lower_bound"] else ""
    volume = f"{row['volume_mm3']:.2f} ± {row['volume_stderr_mm3']:.2f}"
    text = f"{row['file']}: volume {at_least}{volume} mm³, depth {row['indentation_mm']:.3f} mm, "
    if row["force_normal_n"] is None:
        return f"{text}{row['message']}"
    text += f"force {at_least}{row['force_normal_n']:.2f} ± {row['force_normal_stderr_n']:.2f} N"
    if row["force_shear_x_n"] is not None:
        x, y = (
            f"{row[f'force_shear_{axis}_n']:.2f} ± {row[f'force_shear_{axis}_stderr_n']:.2f}"
            for axis in "xy"
        )
        text += f", shear {x}, {y} N"
    elif not row["markers"]:
        text += ", no dots: shear not known"
    return f"{text}; {row['message']}" if row["message"] else text


def _with_forces(
    reading: Reading,
    law: ContactLaw,
    mm_per_px: float,
    pitch_mm: float,
    curve: NDArray[np.float64] | None = None,
) -> Reading:
    """The load at which a contact law gives a volume and a sum of the dots' motion.

    ``pitch_mm`` is the dots' distance; NaN without dots, where the normal force alone is found.
    ``curve`` is the law's :func:`normal_curve`, where it is known.
    """
    is_depth = law.law == "linear_depth"
    normal = reading.indentation_mm if is_depth else reading.volume_mm3
    k = law.k_depth_mm_per_n if is_depth and law.k_depth_mm_per_n else law.k_n_mm3_per_n
    share = reading.volume_stderr_mm3 / reading.volume_mm3
    response, stderr = np.array([normal]), np.array([normal * _with_error_of(k, share)])
    k_s, unknown = law.k_s_mm_per_n, np.full(2, math.nan)
    if not math.isnan(pitch_mm + k_s.value):
        # Each dot stands for its area, as each marker of the law's grid does.
        of_law = 1.0 if math.isnan(law.marker_pitch_mm) else (pitch_mm / law.marker_pitch_mm) ** 2
        motion = of_law * reading.shear_sum_mm
        n_dots = 0 if reading.markers_px is None else len(reading.markers_px)
        noise = of_law * math.sqrt(n_dots) * MARKER_STDERR_PX * mm_per_px
        by_k_s = _with_error_of(k_s, 0.0) * motion
        response, unknown = np.append(response, motion), np.zeros(0)
        stderr = np.append(stderr, np.hypot(noise, by_k_s))
    message = _taken_as_known(law, LOAD[1 : 1 + len(response)])
    load, errors = _load_of(law, reading, response, stderr, curve)
    saturated = not np.isfinite(load).all()
    if saturated:
        message = "no load of the contact law makes this imprint: saturated"
        if len(load) > 1:
            unknown = np.full(2, math.nan)
            load, errors = _load_of(law, reading, response[:1], stderr[:1], curve)
    return replace(
        reading,
        force_n=np.array([*unknown, *load[1:], load[0]]),
        force_stderr_n=np.array([*unknown, *errors[1:], errors[0]]),
        message=message,
        saturated=saturated,
    )


def _with_error_of(k: Estimate, share: float) -> float:
    """A relative error together with that of a compliance, where it has one."""
    return share if math.isnan(k.stderr) else math.hypot(share, k.stderr / k.value)


def _load_of(
    law: ContactLaw,
    reading: Reading,
    response: NDArray[np.float64],
    stderr: NDArray[np.float64],
    curve: NDArray[np.float64] | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Load of a response, into the gel and where given along it, and its errors; NaN if none.

    Effects with memory are taken at the beginning of the load: one picture has no history.
    """
    start = _normal_force_n(law, reading, curve)
    load = np.array([start, *(response[1:] / law.k_s_mm_per_n.value)])
    scale = np.maximum(stderr, 1e-6 * np.abs(response).max())

    def off(at: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((_response(law, at) - response) / scale)

    if law.effects and len(load) > 1 and math.isfinite(start):
        most = [LARGEST_FORCE_N] * len(load)
        least = [0.0, *(-LARGEST_FORCE_N for _ in load[1:])]
        first = np.clip(load, least, most)
        found = least_squares(
            off,
            first,
            bounds=(least, most),
            x_scale=np.maximum(np.abs(first), 0.1),
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
        load = np.asarray(found.x, np.float64)
    steps = np.diag(1e-4 * np.maximum(np.abs(load), 0.01))
    if not np.isfinite(load).all() or np.abs(off(load)).max() > MOST_OFF_STDERR:
        return np.full(len(load), math.nan), np.full(len(load), math.nan)
    columns = [
        (_response(law, load + step) - _response(law, load - step)) / (2.0 * step.sum())
        for step in steps
    ]
    inverse = np.linalg.pinv(np.stack(columns, axis=1))
    return load, np.sqrt(((inverse * stderr) ** 2).sum(axis=1))


def _response(law: ContactLaw, load: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the law makes of a load (1,) or (3,) that has just come on a gel at rest."""
    names = LOAD[1 : 1 + len(load)]
    rest = {"trial": 0.0, "time_s": -ONSET_S, **dict.fromkeys(names, 0.0)}
    memory = law.advance(rest, {})[2] if law.effects else {}
    row = {**rest, "time_s": 0.0, **dict(zip(names, load.tolist(), strict=True))}
    normal, motion, _ = law.advance(row, memory)
    return np.array([normal, *motion])[: len(load)]


def normal_curve(law: ContactLaw) -> NDArray[np.float64]:
    """Forces (n, 2), from 0 up, and what the law makes of each alone."""
    forces = [0.0, *np.geomspace(FIRST_FORCE_N, LARGEST_FORCE_N, FORCES_TRIED).tolist()]
    return np.array([[force, *_response(law, np.array([force]))] for force in forces])


def _normal_force_n(
    law: ContactLaw, reading: Reading, curve: NDArray[np.float64] | None = None
) -> float:
    """The least force that alone gives a volume, or a depth under TACTO's law; inf if none does.

    ``curve`` is the law's :func:`normal_curve`, where it is known.
    """
    response = reading.indentation_mm if law.law == "linear_depth" else reading.volume_mm3
    forces, made = (normal_curve(law) if curve is None else curve).T
    # Beyond the loads that it was fitted to a law may turn back, and give the volume once more.
    enough = np.flatnonzero(made[1:] >= response)
    if not len(enough):
        return math.inf
    low, high = forces[enough[0] : enough[0] + 2].tolist()
    # On a chord of the curve, which a law without effects is, nothing is left to search.
    chord = float(np.interp(response, made[enough[0] : enough[0] + 2], (low, high)))

    def excess(force_n: float) -> float:
        return float(_response(law, np.array([force_n]))[0]) - response

    if abs(excess(chord)) <= 1e-12 * response:
        return chord
    root: Any = brentq(excess, low, high, xtol=1e-9)
    return float(root)


def _taken_as_known(law: ContactLaw, columns: tuple[str, ...]) -> str:
    """What the user should know of effects that follow what one picture does not show."""
    names = [
        fitted.name
        for fitted in law.effects
        if (effect := fitted.effect).in_simulation
        and (
            effect.stage == "memory"
            or effect.is_of_trials
            or not set(effect.needs) <= {"trial", "time_s", *columns}
        )
    ]
    if not names:
        return ""
    return (
        f"the contact law's {', '.join(dict.fromkeys(names))} follows what one picture does not "
        "show (the load's past, the place, the indenter, the session, shear without dots): it is "
        "taken as a load that has just come on a gel at rest"
    )
