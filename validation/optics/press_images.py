"""An independent source of ball-press images: point lights, Phong gloss, a tensed skin, dots.

Nothing here imports the package. The gel's shape is the exact solution of a membrane on an
elastic bed under a ball, the light falls off with distance, the paint is glossy by Phong's
reflected ray, the lens darkens its corners, the camera has a gamma, and printed dots are carried
outwards by the contact. ``draw_presses`` is deterministic in its seed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.special import k0, k1

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Light:
    """A lamp: place in mm (x right, y down, z towards the object: inside is negative), RGB."""

    place_mm: tuple[float, float, float]
    rgb: tuple[float, float, float]


@dataclass(frozen=True)
class Sensor:
    """A tactile camera; ``dot_pitch_mm`` of 0 prints no dots, ``dome_mm`` of 0 is a flat gel."""

    shape: tuple[int, int]
    mm_per_px: float
    lights: tuple[Light, ...]
    dome_mm: float = 0.0
    skin_mm: float = 0.35
    """Decay length of the skin's tension over the gel's stiffness."""
    matt: float = 0.8
    gloss: float = 0.15
    shininess: float = 12.0
    ambient: float = 0.35
    vignetting: float = 0.0
    gamma: float = 1.0
    exposure: float = 90.0
    noise_grey: float = 1.0
    dot_pitch_mm: float = 0.0
    dot_radius_mm: float = 0.25


@dataclass(frozen=True)
class Press:
    """A picture and what is true of it: surface (H, W), mm, and the same without noise."""

    image: NDArray[np.uint8]
    clean: Floats
    surface_mm: Floats
    center_px: tuple[float, float]
    contact_px: float
    ball_mm: float


@dataclass(frozen=True)
class Session:
    """Presses of one sensor, with its background."""

    sensor: Sensor
    background: NDArray[np.uint8]
    presses: list[Press] = field(default_factory=list)


def gelsight_mini(
    lights: int = 3, *, dots: bool = True, shape: tuple[int, int] = (240, 320)
) -> Sensor:
    """A flat gel with printed dots and three or four lamps at its sides."""
    places = {
        3: (((0, -16, -7), (0.1, 0.3, 1.6)), ((15, 9, -7), (0.15, 1.5, 0.2)),
            ((-15, 9, -7), (1.6, 0.2, 0.1))),
        4: (((0, -14, -6), (0.1, 0.2, 1.5)), ((16, 0, -6), (0.2, 1.3, 0.2)),
            ((-16, 0, -6), (1.5, 0.2, 0.1)), ((0, 14, -6), (0.8, 0.8, 0.8))),
    }[lights]  # fmt: skip
    return Sensor(
        shape,
        18.6 / shape[1],
        tuple(Light(place, rgb) for place, rgb in places),
        skin_mm=0.4,
        gamma=1.2,
        dot_pitch_mm=2.0 if dots else 0.0,
    )


def digit(shape: tuple[int, int] = (320, 240)) -> Sensor:
    """A portrait picture of a slightly domed gel under strong lamps close by, dark corners."""
    lights = (
        Light((0.0, 14.0, -4.0), (1.9, 0.1, 0.1)),
        Light((10.0, -9.0, -4.0), (0.1, 1.6, 0.1)),
        Light((-10.0, -9.0, -4.0), (0.1, 0.1, 1.6)),
    )
    return Sensor(
        shape, 19.0 / shape[0], lights, dome_mm=60.0, skin_mm=0.3, gloss=0.3, vignetting=0.5,
        exposure=70.0, noise_grey=1.5,
    )  # fmt: skip


def draw_presses(
    sensor: Sensor,
    seed: int,
    *,
    count: int = 24,
    balls_mm: tuple[float, ...] = (3.0,),
    depth_share: tuple[float, float] = (0.35, 0.7),
    margin: float = 0.2,
) -> Session:
    """``count`` presses; the contact's radius is drawn between ``depth_share`` of the ball's."""
    rng = np.random.default_rng(seed)
    height, width = sensor.shape
    background, _ = _photograph(sensor, _rest(sensor), (0.0, 0.0), 0.0, rng)
    session = Session(sensor, background)
    for k in range(count):
        ball = balls_mm[k % len(balls_mm)]
        contact = ball * rng.uniform(*depth_share)
        center = (rng.uniform(margin, 1 - margin) * width, rng.uniform(margin, 1 - margin) * height)
        at_mm = _mm(sensor, *center)
        surface = _rest(sensor) + _dent(sensor, at_mm, contact, ball)
        image, clean = _photograph(sensor, surface, at_mm, contact, rng)
        session.presses.append(
            Press(image, clean, surface, center, contact / sensor.mm_per_px, ball)
        )
    return session


def write_folder(
    session: Session,
    folder: Path,
    *,
    labels: bool = True,
    scatter_px: float = 0.0,
    seed: int = 0,
    **sensor_yaml: object,
) -> Path:
    """The session as a press folder; labels are off by ``scatter_px`` and 3 % of the radius."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / "background.png"), session.background[..., ::-1])
    lines = ["file,radius_mm" + (",center_x_px,center_y_px,contact_radius_px" if labels else "")]
    for k, press in enumerate(session.presses):
        cv2.imwrite(str(folder / f"{k:02d}.png"), press.image[..., ::-1])
        x, y = np.array(press.center_px) + scatter_px * rng.normal(size=2)
        radius = press.contact_px * (1 + 0.03 * (scatter_px > 0) * rng.normal())
        line = f"{k:02d}.png,{press.ball_mm}"
        lines.append(line + (f",{x:.2f},{y:.2f},{radius:.2f}" if labels else ""))
    (folder / "presses.csv").write_text("\n".join(lines) + "\n")
    content = {"mm_per_px": session.sensor.mm_per_px, "dome_radius_mm": session.sensor.dome_mm}
    (folder / "sensor.yaml").write_text(yaml.safe_dump(content | sensor_yaml))
    return folder


def _mm(sensor: Sensor, column: float, row: float) -> tuple[float, float]:
    height, width = sensor.shape
    return (
        (column - (width - 1) / 2) * sensor.mm_per_px,
        (row - (height - 1) / 2) * sensor.mm_per_px,
    )


def _grid(sensor: Sensor) -> tuple[Floats, Floats]:
    rows, columns = np.indices(sensor.shape, dtype=float)
    height, width = sensor.shape
    return (columns - (width - 1) / 2) * sensor.mm_per_px, (
        rows - (height - 1) / 2
    ) * sensor.mm_per_px


def _rest(sensor: Sensor) -> Floats:
    x, y = _grid(sensor)
    return np.sqrt(sensor.dome_mm**2 - x**2 - y**2) - sensor.dome_mm if sensor.dome_mm else 0 * x


def _dent(sensor: Sensor, at_mm: tuple[float, float], contact_mm: float, ball_mm: float) -> Floats:
    """Height that a ball adds: its own cap (less the dome's) within the contact, K0 outside.

    Outside the contact the skin obeys ∇²w = w/λ²; value and slope are continuous at its edge.
    """
    x, y = _grid(sensor)
    r = np.hypot(x - at_mm[0], y - at_mm[1])
    length = sensor.skin_mm
    bend = 1 / sensor.dome_mm if sensor.dome_mm else 0.0

    def cap(s: Any) -> Any:
        return ball_mm - np.sqrt(ball_mm**2 - s**2) + 0.5 * bend * s**2

    edge_slope = contact_mm / np.sqrt(ball_mm**2 - contact_mm**2) + bend * contact_mm
    edge = -edge_slope * length * k0(contact_mm / length) / k1(contact_mm / length)
    inside = edge + cap(np.minimum(r, contact_mm)) - cap(contact_mm)
    outside = edge * k0(np.maximum(r, contact_mm) / length) / k0(contact_mm / length)
    return np.where(r < contact_mm, inside, outside)


def _photograph(
    sensor: Sensor,
    surface: Floats,
    at_mm: tuple[float, float],
    contact_mm: float,
    rng: np.random.Generator,
) -> tuple[NDArray[np.uint8], Floats]:
    x, y = _grid(sensor)
    grey = _light(sensor, x, y, surface)
    if sensor.dot_pitch_mm:
        grey = grey * (1 - 0.85 * _ink(sensor, x, y, at_mm, contact_mm))[..., None]
    noisy = grey + rng.normal(0, sensor.noise_grey, grey.shape)
    return np.rint(np.clip(noisy, 0, 255)).astype(np.uint8), np.clip(grey, 0, 255)


def _light(sensor: Sensor, x: Floats, y: Floats, surface: Floats) -> Floats:
    slope_y, slope_x = np.gradient(surface, sensor.mm_per_px)
    normal = np.stack([slope_x, slope_y, -np.ones_like(x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    point = np.stack([x, y, surface], axis=-1)
    light = np.full((*x.shape, 3), sensor.ambient)
    for lamp in sensor.lights:
        place = np.array(lamp.place_mm)
        ray = place - point
        distance = np.linalg.norm(ray, axis=-1, keepdims=True)
        ray = ray / distance
        facing = (normal * ray).sum(axis=-1)
        mirrored = 2 * facing * normal[..., 2] - ray[..., 2]
        glint = np.maximum(-mirrored, 0) ** sensor.shininess * (facing > 0)
        strength = (place @ place) / distance[..., 0] ** 2
        answer = strength * (sensor.matt * np.maximum(facing, 0) + sensor.gloss * glint)
        light += answer[..., None] * np.array(lamp.rgb)
    half_mm = [size * sensor.mm_per_px / 2 for size in sensor.shape]
    off = np.hypot(x, y) / np.hypot(half_mm[0], half_mm[1])
    dim = 1 - sensor.vignetting * off**2
    return 255 * (sensor.exposure / 255 * light * dim[..., None]) ** (1 / sensor.gamma)


def _ink(
    sensor: Sensor, x: Floats, y: Floats, at_mm: tuple[float, float], contact_mm: float
) -> Floats:
    """Share of each pixel that dots cover; a contact carries them outwards by up to 0.15 mm."""
    dx, dy = x - at_mm[0], y - at_mm[1]
    away = np.hypot(dx, dy)
    push = 0.0 if contact_mm == 0 else 0.15 * np.exp(-((away / contact_mm - 1) ** 2))
    was_x, was_y = x - push * dx / (away + 1e-9), y - push * dy / (away + 1e-9)
    pitch = sensor.dot_pitch_mm
    nearest = np.hypot(
        was_x - pitch * np.rint(was_x / pitch), was_y - pitch * np.rint(was_y / pitch)
    )
    return np.clip((sensor.dot_radius_mm - nearest) / sensor.mm_per_px + 0.5, 0, 1)


def with_noise(sensor: Sensor, noise_grey: float) -> Sensor:
    """The same sensor with another camera noise."""
    return replace(sensor, noise_grey=noise_grey)
