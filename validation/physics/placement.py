"""How much a grasp's margins, label, shear and images change where all is moved together.

Of every object 16 grasps are drawn from its ranges and simulated at several placements: both moved
and turned on the table, or by less than 1 µm and 1e-5 rad. Run it with
``python -m validation.physics.placement [ENGINE] [SEED] [OBJECT ...]``.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tacgen.collection.gel import SETTLED_PRESS, gel_patch
from tacgen.contact.gel_response import gel_loads, rounded_pose_and_load
from tacgen.contact.law import ContactLaw
from tacgen.core.records import GraspConfig, GraspObject, GraspTrace, Mesh, frozen_array
from tacgen.core.resources import object_folders
from tacgen.core.sensors import load_sensor
from tacgen.core.types import FloatArray, rotation_about_z
from tacgen.objects import load_object
from tacgen.physics import FrameRequest, GelModel, GraspSimulator, PhysicsSettings, run_grasp
from tacgen.sensor.tactile_pad import TactilePad

GRASPS = 16
NEAR = 0.02  # of the border, within which a label may change


@dataclass(frozen=True, slots=True)
class Placement:
    """Where the origin of an object is on the table, and how it is turned about z."""

    x_mm: float = 0.0
    y_mm: float = 0.0
    yaw_rad: float = 0.0

    def of_object(self, obj: GraspObject) -> GraspObject:
        """The object there."""
        rotation = rotation_about_z(self.yaw_rad)
        shift_mm = np.array([self.x_mm, self.y_mm, 0.0])

        def there(mesh: Mesh) -> Mesh:
            return Mesh(frozen_array(mesh.vertices_mm @ rotation.T + shift_mm), mesh.faces)

        return replace(
            obj,
            surface=there(obj.surface),
            collision=tuple(map(there, obj.collision)),
            center_of_mass_mm=rotation @ obj.center_of_mass_mm + shift_mm,
            inertia_kg_mm2=rotation @ obj.inertia_kg_mm2 @ rotation.T,
        )

    def of_grasp(self, config: GraspConfig) -> GraspConfig:
        """The grasp of the object there."""
        rotation = rotation_about_z(self.yaw_rad)[:2, :2]
        x_mm, y_mm = (rotation @ [config.x_mm, config.y_mm] + [self.x_mm, self.y_mm]).tolist()
        yaw_rad = config.yaw_rad + self.yaw_rad
        return replace(config, x_mm=x_mm, y_mm=y_mm, yaw_rad=yaw_rad)


FAR = (
    Placement(),
    Placement(120.0, -80.0),
    Placement(yaw_rad=0.7),
    Placement(-60.0, 90.0, 2.1),
    Placement(37.3, 11.1, -1.234),
)
NEARBY = (Placement(), Placement(7e-4, -5e-4), Placement(yaw_rad=9e-6), Placement(-5e-4, 0, -6e-6))


def drawn(obj: GraspObject, seed: int, count: int = GRASPS) -> list[GraspConfig]:
    """Grasps at places of the object's ranges."""
    rng = np.random.default_rng(seed)
    axes = [obj.grasp_ranges[axis] for axis in ("force_n", "x_mm", "y_mm", "z_mm")]
    rows = [[float(rng.choice(axis)) for axis in axes] for _ in range(count)]
    return [GraspConfig(k, obj.name, *row) for k, row in enumerate(rows)]


class Study:
    """A simulator and a gel for all grasps."""

    def __init__(self, simulator: GraspSimulator, settings: PhysicsSettings) -> None:
        self.simulator, self.settings = simulator, settings
        sensor, self.law = load_sensor("gelsight"), ContactLaw.default()
        self.pad = TactilePad(sensor)

    def traces(
        self, obj: GraspObject, config: GraspConfig, placements: Sequence[Placement]
    ) -> list[GraspTrace]:
        """The grasp at each of the placements."""
        found = []
        for placement in placements:
            there = placement.of_object(obj)
            patch_of = partial(gel_patch, self.pad.indenter, self.law, there.surface)
            trace = run_grasp(
                self.simulator,
                there,
                placement.of_grasp(config),
                self.settings,
                frames=FrameRequest(),
                gel=GelModel(patch_of),
            )
            found.append(trace)
        return found

    def images(self, obj: GraspObject, trace: GraspTrace, placement: Placement) -> FloatArray:
        """Both pads' images (2, H, W, 3) at the moment of grasp."""
        surface, images = placement.of_object(obj).surface, []
        for (frame,) in trace.frames.values():
            (load,) = gel_loads(self.law, [frame], grasp_index=SETTLED_PRESS)
            pose, load = rounded_pose_and_load(frame.pose_gel_object, load)
            images.append(self.pad.image(self.pad.press(surface, pose, load)))
        return np.array(images, dtype=float)


def spread(ratios: Sequence[float]) -> float:
    """Largest over smallest less 1."""
    low, high = min(ratios), max(ratios)
    return high / low - 1 if low > 0 and np.isfinite(high) else float(high != low)


def main() -> None:
    """Print, for each object, median and 90th percentile of the spreads, and what changes."""
    engine, seed, *names = [*sys.argv[1:], *("pybullet", "0")[len(sys.argv) - 1 :]]
    settings = PhysicsSettings(engine=engine, tactile_pads="both")  # type: ignore[arg-type]
    columns = "friction ratio", "torsion ratio", "shear over N", "turn", "image, grey"
    sys.stdout.write(f"{'':18}{'':8}" + "".join(f"{name:>20}" for name in columns) + "  labels\n")
    with GraspSimulator(engine=settings.engine) as simulator:
        study = Study(simulator, settings)
        for name in names or list(object_folders()):
            obj = load_object(name)
            for where, placements in (("far", FAR), ("nearby", NEARBY)):
                sys.stdout.write(f"{name:18}{where:8}{_line(study, obj, int(seed), placements)}\n")
                sys.stdout.flush()


def _line(study: Study, obj: GraspObject, seed: int, placements: Sequence[Placement]) -> str:
    friction, torsion, shears, turns, images, changed = [], [], [], [], [], 0
    for config in drawn(obj, seed):
        traces = study.traces(obj, config, placements)
        margins = [trace.margin for trace in traces]
        labels = {trace.label for trace in traces}
        ratios = [m.friction_ratio for m in margins if m]
        torsions = [m.torsion_ratio for m in margins if m]
        near = any(abs(min(m.friction_ratio, m.torsion_ratio) - 1) < NEAR for m in margins if m)
        changed += len(labels) > 1 and not near
        if not ratios:
            continue
        friction.append(spread(ratios))
        torsion.append(spread(torsions))
        loads = [
            np.concatenate([trace.frames[pad][0].force_shear_n for pad in trace.frames])
            for trace in traces
            if trace.frames["left"]
        ]
        shears.append(float(np.ptp(loads, axis=0).max()) / config.force_n)
        turns.append(float(np.ptp([trace.turn_rad for trace in traces if trace.label == 1] or [0])))
        seen = [
            study.images(obj, trace, placement)
            for trace, placement in zip(traces, placements, strict=True)
            if trace.frames["left"]
        ]
        images.append(float(np.ptp(seen, axis=0).max()))
    shown = [
        f"{100 * np.median(found):9.3f} {100 * np.quantile(found, 0.9):8.2f} %"
        for found in (friction, torsion, shears, turns)
    ]
    shown.append(f"{np.median(images):9.1f} {max(images):8.1f}  ")
    return "".join(shown) + f"{changed:8d} of {len(friction)}"


if __name__ == "__main__":
    main()
