"""Real grasps of a block whose friction is known, and the command that finds it."""

from pathlib import Path

import numpy as np

from tacgen.collection.perturbed import recipe_object
from tacgen.collection.recipe import ObjectEntry
from tacgen.core.types import STANDARD_GRAVITY_M_S2

BOX, MU = "sugar_box", 0.4


def write_friction_case(folder: Path) -> list[str]:
    """Four grasps labelled by 2 μ F ≥ m g, and what to type after ``tacgen``."""
    box = recipe_object(ObjectEntry(name=BOX))
    threshold_n = box.mass_kg * STANDARD_GRAVITY_M_S2 / (2 * MU)
    height_mm = box.center_of_mass_mm[2]
    (folder / "real").mkdir()
    lines = ["grasp_id,object,force_n,x_mm,y_mm,z_mm,label"] + [
        f"g{k},{BOX},{threshold_n * part:.4f},0,0,{height_mm:g},{int(part > 1)}"
        for k, part in enumerate(np.array([0.7, 0.9, 1.1, 1.4]))
    ]
    (folder / "real/grasps.csv").write_text("\n".join(lines) + "\n")
    (folder / "sweep.yaml").write_text(f"name: sweep\nobjects: [{BOX}]\n")
    options = ["--real", "real", "--out", "fit", "--mu", "0.3:0.5:0.1", "--workers", "1"]
    return ["friction", "sweep.yaml", *options]
