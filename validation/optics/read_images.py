"""Errors of ``tacgen read`` on presses of the virtual rig that no table was fitted to.

    python -m validation.optics.read_images [--presses 12] [--seed 11] [--table TABLE --sensor S]

For the virtual sensor (or ``--sensor``) the balls of ``rig_images_with_forces`` are pressed anew,
each picture is read with its own table (or ``--table``) and the true k_n, and compared with the
truth.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from tacgen.contact.law import ContactLaw
from tacgen.core.sensors import load_sensor
from tacgen.rig import load_rig_recipe
from tacgen.rig.images import Camera, press_ball
from tacgen.rig.run import simulate_session
from tacgen.sensor.read_image import ImageReader
from tacgen.sensor.simulated import Sensor

SENSORS = ("virtual_gelsight",)


def press_errors(name: str, presses: int, seed: int, table: str | None) -> np.ndarray:
    """Relative error of volume and of force, RMSE of depth (mm), relative standard error of the
    force, and contact radius over ball radius; (n, 5).
    """
    recipe = load_rig_recipe("rig_images_with_forces").model_copy(update={"seed": seed})
    recipe = recipe.model_copy(
        update={
            "sensor": recipe.sensor.model_copy(update={"name": name}),
            "schedule": recipe.schedule.model_copy(update={"presses": presses}),
            "images": recipe.images.model_copy(update={"markers": False}),
        }
    )
    description, session = load_sensor(recipe.sensor, needs_table=False), simulate_session(recipe)
    camera, rng = Camera(recipe, description), np.random.default_rng(seed)
    law = ContactLaw.linear(recipe.law.k_n_mm3_per_n, recipe.law.k_s_mm_per_n)
    reader = ImageReader(Sensor(name, table, law), camera.take(None, rng))
    rows = []
    for _, samples in session.log.groupby("trial"):
        row = samples["force_normal_n"].idxmax()
        volume = float(session.truth.volume_mm3[row])
        sample = session.log.loc[row]
        center = float(sample["x_mm"]), float(sample["y_mm"])
        contact = press_ball(description, float(sample["radius_mm"]), center, volume, np.zeros(2))
        found = reader.read(camera.take(contact, rng))
        true_n = volume / law.k_n_mm3_per_n.value
        rows.append(
            (
                found.volume_mm3 / volume - 1.0,
                found.force_n[2] / true_n - 1.0,
                float(np.sqrt(np.mean((found.depth_mm - contact.depth_mm) ** 2))),
                found.force_stderr_n[2] / true_n,
                contact.contact_radius_mm(description.pixel_area_mm2) / sample["radius_mm"],
            )
        )
    return np.array(rows)


def main() -> None:
    """Print a line for each sensor."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presses", type=int, default=12)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--table")
    parser.add_argument("--sensor", nargs="*", default=SENSORS)
    options = parser.parse_args()
    for name in options.sensor:
        found = press_errors(name, options.presses, options.seed, options.table)
        volume, force = 100 * np.abs(found[:, 0]), 100 * np.abs(found[:, 1])
        sys.stdout.write(
            f"{name:14} volume: mean {100 * found[:, 0].mean():+.1f} %, median error "
            f"{np.median(volume):.1f} %, {np.mean(volume <= 5):.0%} within 5 %; force "
            f"{np.mean(force <= 7):.0%} within 7 %; depth RMSE median "
            f"{np.median(found[:, 2]):.4f}, worst {found[:, 2].max():.4f} mm; "
            f"stated standard error {100 * np.median(found[:, 3]):.1f} %\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
