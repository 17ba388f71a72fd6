"""The least force that holds an imported mesh, over the closed form mg/(2μ).

Every mesh is written as an STL, imported as `tacgen objects add` does, and grasped at the height of
its centre of mass, the bottle by its neck; the force is bisected and printed as a share of mg/(2μ).
Run it with ``python -m validation.physics.hold_thresholds [NAME ...]``.
"""

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from tacgen.core.records import GraspConfig, GraspObject
from tacgen.core.types import STANDARD_GRAVITY_M_S2
from tacgen.objects.add import MeshFacts, add_object
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp

MASS_KG = 0.35
FRICTIONS = (0.2, 0.4, 0.8)
ANGLES_RAD = (0.0, 0.11, 0.37, 0.9)  # of the mesh about z; none is a symmetry of a shape below
LOW, HIGH = 0.9, 1.4  # of mg/(2μ)
BOTTLE_MM = 65.0  # on the neck, from which it can slide by more than 30 mm; others at the middle
HALVINGS = 8  # to 0.2 % of mg/(2μ)


def cylinder(sections: int) -> trimesh.Trimesh:
    """A can of 66 × 100 mm."""
    return trimesh.creation.cylinder(radius=33.0, height=100.0, sections=sections)


def bottle() -> trimesh.Trimesh:
    """A turned body with a neck of 52 mm, which is grasped, on a foot of 64 mm: not convex."""
    profile = [(0, 0), (32, 0), (32, 30), (26, 38), (26, 110), (0, 110)]
    return trimesh.creation.revolve(np.array(profile, dtype=float), sections=180)


def hexagonal() -> trimesh.Trimesh:
    """A prism 50 mm wide between flats that face x."""
    solid = trimesh.creation.cylinder(radius=50 / np.sqrt(3), height=80.0, sections=6)
    flats = trimesh.transformations.rotation_matrix(np.pi / 6, [0, 0, 1])
    return solid.apply_transform(flats)


MESHES: dict[str, Callable[[], trimesh.Trimesh]] = {
    **{f"cylinder_{n}": partial(cylinder, n) for n in (8, 16, 64, 256, 1024, 2048)},
    **{
        f"sphere_{k}": partial(trimesh.creation.icosphere, subdivisions=k, radius=25.0)
        for k in (3, 4, 5)
    },
    "capsule": partial(trimesh.creation.capsule, height=50.0, radius=24.0, count=[64, 64]),
    "bottle": bottle,
    "hexagonal": hexagonal,
}
BY_FLATS = ("cylinder_8", "cylinder_16", "hexagonal")
"""Coarse prisms, which the gripper meets by their flats: it turns with them."""


def imported(name: str, angle_rad: float) -> GraspObject:
    """The mesh of that name, turned about z and imported."""
    solid = MESHES[name]()
    if name in ("cylinder_8", "cylinder_16"):
        turn = np.pi / int(name.split("_")[1])
        solid.apply_transform(trimesh.transformations.rotation_matrix(turn, [0, 0, 1]))
    solid.apply_transform(trimesh.transformations.rotation_matrix(angle_rad, [0, 0, 1]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.stl"
        solid.export(path)
        # A capsule on its tip would fall; here it is held as it stands.
        own = Path(folder) / "objects"
        return add_object(path, MeshFacts(MASS_KG, keep_pose=True), into=own).object


def holds(
    simulator: GraspSimulator, obj: GraspObject, friction: float, yaw_rad: float, ratio: float
) -> bool:
    """Whether ``ratio`` times mg/(2μ) holds ``obj``."""
    force_n = ratio * MASS_KG * STANDARD_GRAVITY_M_S2 / (2 * friction)
    height_mm = BOTTLE_MM if obj.name == "bottle" else float(obj.center_of_mass_mm[2])
    config = GraspConfig(0, obj.name, force_n, 0.0, 0.0, height_mm, yaw_rad)
    slippery = replace(obj, friction=friction)
    trace = run_grasp(simulator, slippery, config, PhysicsSettings(), frames=FrameRequest())
    return trace.label == 1


def hold_ratio(
    simulator: GraspSimulator, obj: GraspObject, friction: float, yaw_rad: float
) -> float:
    """Least force that holds ``obj`` over mg/(2μ); infinite where ``HIGH`` does not hold."""
    low, high = LOW, HIGH
    if not holds(simulator, obj, friction, yaw_rad, high):
        return float("inf")
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        enough = holds(simulator, obj, friction, yaw_rad, middle)
        low, high = (low, middle) if enough else (middle, high)
    return high


def main() -> None:
    """Print a line for each mesh, angle of it and yaw of the gripper: a ratio for each friction."""
    with GraspSimulator() as simulator:
        for name in sys.argv[1:] or MESHES:
            angles = [(turn, turn if name in BY_FLATS else 0.0) for turn in ANGLES_RAD]
            if name not in BY_FLATS:
                angles += [(0.0, yaw) for yaw in ANGLES_RAD[1:]]
            for turn_rad, yaw_rad in angles:
                obj = imported(name, turn_rad)
                ratios = [hold_ratio(simulator, obj, mu, yaw_rad) for mu in FRICTIONS]
                shown = " ".join(f"{ratio:.3f}" for ratio in ratios)
                counts = sorted(len(part.vertices_mm) for part in obj.collision)
                line = f"{name:14} {turn_rad:4.2f} {yaw_rad:4.2f} rad  {shown}  vertices {counts}"
                sys.stdout.write(f"{line}\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
