"""What the virtual sensor's camera sees of a rig session."""

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from numpy.typing import NDArray

from tacgen.contact import gel_map_mm
from tacgen.contact.ball import GelLattice
from tacgen.contact.gel_response import GelLoad
from tacgen.contact.gel_shear import GelShear
from tacgen.contact.shear import dilation_mm, marker_grid_mm
from tacgen.core.files import atomic_path, write_text
from tacgen.core.images import encode_png
from tacgen.core.records import Sensor
from tacgen.core.types import FloatArray
from tacgen.optics.deform import deform
from tacgen.optics.markers import draw_markers
from tacgen.optics.virtual_sensor import VirtualSensor
from tacgen.rig.effects import SessionTruth
from tacgen.rig.rig_recipe import RigRecipe
from tacgen.rig.schedule import CAMERA, press_rng

LAST = "sensor.yaml"  # the last file that is written


@dataclass(frozen=True, slots=True)
class BallContact:
    """A ball in the gel: depth map (H, W), the ball's centre, and the moved dots (n, 2)."""

    depth_mm: FloatArray
    center_mm: tuple[float, float]
    markers_mm: FloatArray

    def contact_center_px(self) -> tuple[float, float]:
        """Column and row of the middle of the contact: beside the ball's centre on a dome."""
        rows, columns = np.nonzero(self.depth_mm)
        return float(columns.mean()), float(rows.mean())

    def contact_radius_mm(self, pixel_area_mm2: float) -> float:
        """Radius of the circle of the contact's area."""
        return float(np.sqrt((self.depth_mm > 0).sum() * pixel_area_mm2 / np.pi))


def press_ball(
    sensor: Sensor,
    radius_mm: float,
    center_mm: tuple[float, float],
    volume_mm3: float,
    shear_sum_mm: FloatArray,
) -> BallContact:
    """Press a ball to a volume, then move it until the dots' motion sums to a shear (2,)."""
    points, pixels = marker_grid_mm(sensor), GelLattice.of(sensor)
    depth = pixels.ball_depth_mm(radius_mm, center_mm, volume_mm3)
    if not (depth > 0).any():
        return BallContact(depth, center_mm, points)
    rows, columns = np.nonzero(depth)
    patch = np.stack([pixels.x_mm[columns], pixels.y_mm[rows]], axis=1)
    points_moved = points + dilation_mm(points, patch, depth[rows, columns], sensor.pixel_area_mm2)
    load = GelLoad(volume_mm3, shear_sum_mm=shear_sum_mm)
    gel, window = GelShear(sensor), (0, sensor.height_px, 0, sensor.width_px)
    weigh = partial(gel.pressure_share, depth.astype(np.float32), window)
    state = gel.step(weigh, load, 1.0, None)
    if state is None:
        return BallContact(depth, center_mm, points_moved)
    dots = gel.motion_mm(state, points, load)
    # Dots sample the gel: what they sum to is the log's, to the last digit.
    pulled = shear_sum_mm != 0.0
    exact = np.divide(shear_sum_mm, dots.sum(axis=0), out=np.ones(2), where=pulled)
    shift_mm = exact * gel.object_motion(state, load).shift_mm
    moved = (center_mm[0] + float(shift_mm[0]), center_mm[1] + float(shift_mm[1]))
    depth = pixels.ball_depth_mm(radius_mm, moved, volume_mm3)
    return BallContact(depth, moved, points_moved + exact * dots)


class Camera:
    """A virtual sensor that takes pictures of ball contacts."""

    def __init__(self, recipe: RigRecipe, sensor: Sensor) -> None:
        self._sensor = sensor
        self._draws = recipe.images.markers
        self._noise_grey = recipe.noise.camera_grey
        self._optics = VirtualSensor.like(
            sensor, shadow=recipe.images.shadow, blur_mm=recipe.images.blur_mm
        )
        self._gel_mm = gel_map_mm(sensor)

    def take(self, contact: BallContact | None, rng: np.random.Generator) -> NDArray[np.uint8]:
        """A picture (H, W, 3), RGB; ``None`` is the gel at rest."""
        height = self._gel_mm
        points: FloatArray = marker_grid_mm(self._sensor)
        if contact is not None:
            height = self._gel_mm - deform(contact.depth_mm, self._sensor.mm_per_px)
            points = contact.markers_mm
        grey = self._optics.grey_levels(height).astype(np.float32)
        if self._draws and self._sensor.markers is not None:
            draw_markers(grey, points, self._sensor.markers.radius_mm, self._sensor.mm_per_px)
        grey += self._noise_grey * rng.standard_normal(grey.shape, dtype=np.float32)
        return np.rint(np.clip(grey, 0, 255)).astype(np.uint8)


def chosen_samples(log: pd.DataFrame, truth: SessionTruth, per_press: int) -> list[int]:
    """Rows of the log at which the camera takes pictures: the top of every press, and below."""
    chosen: list[int] = []
    for _, rows in log.groupby("trial").indices.items():
        volume = truth.volume_mm3[rows]
        moved = np.hypot(*truth.shear_mm[rows].T)
        top = int(rows[np.argmax(volume + 1e-3 * volume.max() * moved / max(moved.max(), 1e-12))])
        rising = rows[: int(np.argmax(volume)) + 1]
        levels = volume.max() * np.arange(1, per_press) / per_press
        chosen += [int(rising[np.argmin(np.abs(truth.volume_mm3[rising] - v))]) for v in levels]
        chosen.append(top)
    return chosen


def write_images(
    recipe: RigRecipe, sensor: Sensor, log: pd.DataFrame, truth: SessionTruth, folder: Path
) -> Path:
    """Write the press-image folder, but for pictures that are there, and return it."""
    folder = Path(folder)
    camera = Camera(recipe, sensor)
    _write_png(folder / "background.png", camera.take(None, press_rng(recipe, 10**6, CAMERA)))
    records: list[dict[str, Any]] = []
    taken: dict[int, int] = {}
    for row in chosen_samples(log, truth, recipe.images.per_press):
        sample = log.iloc[row]
        press = int(sample["trial"])
        index = taken.setdefault(press, 0)
        taken[press] += 1
        name = f"press_{press:04d}_{index}.png"
        contact = press_ball(
            sensor,
            float(sample["radius_mm"]),
            (float(sample["x_mm"]), float(sample["y_mm"])),
            float(truth.volume_mm3[row]),
            truth.shear_mm[row],
        )
        if not (folder / name).is_file():
            rng = press_rng(recipe, press * recipe.images.per_press + index, CAMERA)
            _write_png(folder / name, camera.take(contact, rng))
        records.append(_record(recipe, sensor, name, sample, contact))
    with atomic_path(folder / "presses.csv") as partial:
        pd.DataFrame(records).round(6).to_csv(partial, index=False)
    write_text(folder / LAST, yaml.safe_dump(_sensor_yaml(sensor), sort_keys=False))
    return folder


def _record(
    recipe: RigRecipe, sensor: Sensor, name: str, sample: pd.Series, contact: BallContact
) -> dict[str, Any]:
    record: dict[str, Any] = {"file": name, "radius_mm": sample["radius_mm"]}
    if recipe.images.labels:
        column, row = contact.contact_center_px()
        radius_px = contact.contact_radius_mm(sensor.pixel_area_mm2) / sensor.mm_per_px
        record |= {"center_x_px": column, "center_y_px": row, "contact_radius_px": radius_px}
    kept = ("trial", "time_s", "indenter", "x_mm", "y_mm", "force_normal_n", "force_shear_x_n",
            "force_shear_y_n", "temperature_c")  # fmt: skip
    return record | {column: sample[column] for column in kept if column in sample}


def _sensor_yaml(sensor: Sensor) -> dict[str, Any]:
    """What a reader of the folder needs to know of the sensor, in the form of sensor files."""
    names = ("name", "height_px", "width_px", "mm_per_px", "gel_depth_mm", "dome_radius_mm")
    content: dict[str, Any] = {name: getattr(sensor, name) for name in names}
    content["leds"] = [{"direction": list(led), "rgb": list(rgb)} for led, rgb in sensor.leds]
    if sensor.markers is not None:
        content["markers"] = asdict(sensor.markers)
    return content


def _write_png(path: Path, rgb: NDArray[np.uint8]) -> None:
    with atomic_path(path) as partial:
        partial.write_bytes(encode_png(rgb))
