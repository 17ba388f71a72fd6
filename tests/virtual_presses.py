"""Ball presses on the virtual sensor: physics throughout, no lookup table anywhere."""

from dataclasses import replace

import numpy as np

from tacgen.core.records import Sensor
from tacgen.optics import deform
from tacgen.optics.virtual_sensor import VirtualSensor
from tacgen.presses.press_images import PressImages

LEDS = (
    ((0.94, 0.0, -0.34), (0.9, 0.05, 0.05)),
    ((-0.47, 0.81, -0.34), (0.05, 0.9, 0.05)),
    ((-0.47, -0.81, -0.34), (0.05, 0.05, 0.9)),
)


def virtual_sensor(shape=(96, 128), mm_per_px=0.14, **effects) -> VirtualSensor:
    sensor = Sensor("test", *shape, mm_per_px, gel_depth_mm=3.0, leds=LEDS)
    return VirtualSensor.like(sensor, distance_mm=16.0, **effects)


def virtual_presses(
    seed,
    *,
    count=24,
    sensor=None,
    ball_mm=2.0,
    noise=1.0,
    dome_mm=0.0,
    center_scatter_px=0.0,
    label_scale=1.0,
    gain_scatter=0.0,
    vignetting=0.0,
    clip=255.0,
    labelled=True,
) -> PressImages:
    """Presses at random places and depths; every argument but the first few is an effect."""
    rng = np.random.default_rng(seed)
    sensor = sensor or virtual_sensor()
    height, width = sensor.height_px, sensor.width_px
    scale = sensor.mm_per_px
    rows, columns = np.mgrid[:height, :width].astype(float)
    x, y = (columns - (width - 1) / 2) * scale, (rows - (height - 1) / 2) * scale
    rest = np.zeros_like(x)
    if dome_mm:
        rest = np.sqrt(dome_mm**2 - x**2 - y**2) - dome_mm
    corner = (x / (width * scale)) ** 2 + (y / (height * scale)) ** 2

    def photograph(height_mm, gain):
        grey = sensor.grey_levels(height_mm) * (1 - 2 * vignetting * corner)[..., None] * gain
        grey = grey + rng.normal(0, noise, grey.shape)
        return np.rint(np.clip(grey, 0, clip)).astype(np.uint8)

    images, centers, radii = [], [], []
    for _ in range(count):
        cx, cy = rng.uniform(0.22, 0.78) * width, rng.uniform(0.22, 0.78) * height
        contact_mm = rng.uniform(1.15, 1.5)
        px, py = (cx - (width - 1) / 2) * scale, (cy - (height - 1) / 2) * scale
        rho = np.hypot(x - px, y - py)
        top = rest[int(cy), int(cx)]
        sunk = ball_mm - np.sqrt(ball_mm**2 - contact_mm**2)
        if dome_mm:
            sunk += contact_mm**2 / (2 * dome_mm)
        ball = top - sunk + ball_mm - np.sqrt(np.maximum(ball_mm**2 - rho**2, 1e-6))
        depth = np.where(rho < ball_mm, np.maximum(rest - ball, 0), 0)
        surface = rest - deform(depth, scale)
        gain = 1 + gain_scatter * rng.normal(size=3)
        images.append(photograph(surface, gain))
        centers.append([cx, cy] + center_scatter_px * rng.normal(size=2))
        radii.append(contact_mm / scale * label_scale)
    nothing = np.full(count, np.nan)
    return PressImages(
        images=np.stack(images),
        background=photograph(rest, 1.0),
        names=tuple(f"{k}.png" for k in range(count)),
        center_px=np.array(centers) if labelled else np.column_stack([nothing, nothing]),
        radius_px=np.array(radii) if labelled else nothing,
        ball_radius_mm=np.full(count, ball_mm),
        mm_per_px=scale,
        dome_radius_mm=dome_mm,
        sensor="test",
    )


def repeated(presses, frames, *, noise=1.0, seed=0) -> PressImages:
    """Each press as ``frames`` pictures with noise of their own; the first is as it was."""
    rng = np.random.default_rng(seed)
    several = presses.select(np.repeat(np.arange(len(presses)), frames))
    noisy = several.images + rng.normal(0, noise, several.images.shape)
    images = np.rint(np.clip(noisy, 0, 255)).astype(np.uint8)
    images[::frames] = presses.images
    names = tuple(f"{k}.png" for k in range(len(several)))
    return replace(several, images=images, names=names, experiment=np.arange(len(several)))
