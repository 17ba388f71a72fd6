"""Changes to the declared simulation, and grasps simulated with them, kept on disk."""

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.collection.gel import contact_law, gel_patch, mounted_sensor
from tacgen.collection.kept import kept_results
from tacgen.collection.recipe import ObjectEntry, Randomize, Recipe
from tacgen.collection.recipe_inputs import recipe_inputs
from tacgen.contact.indenter import Indenter
from tacgen.core.errors import DatasetError
from tacgen.core.files import sha256_of_content
from tacgen.core.processes import Report
from tacgen.core.records import GraspConfig, GraspObject, GraspPoint, GraspTrace, Mesh, frozen_array
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.objects import load_object
from tacgen.physics import FrameRequest, GelModel, GraspSimulator, PhysicsSettings, run_grasp
from tacgen.physics.settings import force_problem

OUTCOMES = "outcomes.jsonl"
"""The file of finished simulations in a folder of results."""
NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Perturbation:
    """Changes to an object and to the gripper that grasps it; the default changes nothing.

    The object is scaled first; then ``friction``, ``mass_kg`` and ``spinning_friction_mm`` replace
    its own figures, the factors multiply them and the centre of mass is shifted. A declared
    spinning friction follows the friction, to which a patch's moment is proportional. Of the
    gripper, force and height are changed and a compliance is added to its pads;
    ``settings_factors`` multiply any other figures of ``PhysicsSettings``, by name.
    """

    friction: float | None = None
    mass_kg: float | None = None
    spinning_friction_mm: float | None = None
    friction_factor: float = 1.0
    mass_factor: float = 1.0
    spinning_friction_factor: float = 1.0
    object_scale: float = 1.0
    center_of_mass_x_mm: float = 0.0
    center_of_mass_y_mm: float = 0.0
    center_of_mass_z_mm: float = 0.0
    force_scale: float = 1.0
    force_offset_n: float = 0.0
    height_offset_mm: float = 0.0
    compliance_mm_per_n: float = 0.0
    settings_factors: tuple[tuple[str, float], ...] = ()

    @property
    def center_of_mass_mm(self) -> tuple[float, float, float]:
        """Shift of the centre of mass, object frame."""
        return self.center_of_mass_x_mm, self.center_of_mass_y_mm, self.center_of_mass_z_mm

    def changes(self) -> dict[str, Any]:
        """The fields that are not at their default."""
        return {
            one.name: getattr(self, one.name)
            for one in fields(self)
            if getattr(self, one.name) != one.default
        }

    def and_then(self, other: "Perturbation") -> "Perturbation":
        """Both changes: factors multiply, shifts add, and a replaced figure is the other's.

        A factor on a figure that is then replaced is gone.
        """
        changes = self.changes()
        for name, factor in _REPLACED.items():
            if getattr(other, name) is not None:
                changes.pop(factor, None)
        for name, value in other.changes().items():
            if name == "settings_factors":
                before = dict(self.settings_factors)
                product = {key: before.get(key, 1.0) * factor for key, factor in value}
                changes[name] = tuple(sorted((before | product).items()))
            elif name not in changes or getattr(_UNCHANGED, name) is None:
                changes[name] = value
            elif getattr(_UNCHANGED, name) == 1.0:
                changes[name] *= value
            else:
                changes[name] += value
        return Perturbation(**changes)


_UNCHANGED = Perturbation()
_REPLACED = {"friction": "friction_factor", "mass_kg": "mass_factor"}
"""Figures that can be replaced, and the factor on each."""


def shift_of_center(shift_mm: Iterable[float]) -> dict[str, Any]:
    """The arguments of a ``Perturbation`` that shift the centre of mass (3,)."""
    return {f"center_of_mass_{axis}_mm": mm for axis, mm in zip("xyz", shift_mm, strict=True)}


def perturbed_object(grasped: GraspObject, change: Perturbation) -> GraspObject:
    """The object with the changes; its own arrays are left alone."""
    if change.object_scale != 1.0:
        grasped = _scaled(grasped, change.object_scale)
    declared = grasped.friction
    friction = (declared if change.friction is None else change.friction) * change.friction_factor
    spinning_mm = grasped.spinning_friction_mm
    if change.spinning_friction_mm is not None:
        spinning_mm = change.spinning_friction_mm
    elif spinning_mm is not None and declared > 0:
        spinning_mm *= friction / declared
    mass_kg = grasped.mass_kg if change.mass_kg is None else change.mass_kg
    mass_kg *= change.mass_factor
    return replace(
        grasped,
        friction=friction,
        spinning_friction_mm=spinning_mm,
        spinning_friction_factor=(
            grasped.spinning_friction_factor * change.spinning_friction_factor
        ),
        mass_kg=mass_kg,
        inertia_kg_mm2=frozen_array(grasped.inertia_kg_mm2 * (mass_kg / grasped.mass_kg)),
        center_of_mass_mm=frozen_array(
            grasped.center_of_mass_mm + np.array(change.center_of_mass_mm)
        ),
    )


def _scaled(grasped: GraspObject, factor: float) -> GraspObject:
    """The object of another size about the centre of its footprint, its mass as before."""

    def scaled(mesh: Mesh) -> Mesh:
        return Mesh(frozen_array(mesh.vertices_mm * factor), mesh.faces)

    return replace(
        grasped,
        surface=scaled(grasped.surface),
        collision=tuple(scaled(part) for part in grasped.collision),
        center_of_mass_mm=frozen_array(grasped.center_of_mass_mm * factor),
        inertia_kg_mm2=frozen_array(grasped.inertia_kg_mm2 * factor**2),
    )


def perturbed_settings(settings: PhysicsSettings, change: Perturbation) -> PhysicsSettings:
    """The settings of the gripper and the table with the changes."""
    compliance = change.compliance_mm_per_n
    if settings.pad_stiffness_n_mm > 0:
        compliance += 1 / settings.pad_stiffness_n_mm
    changed = replace(
        settings,
        delivered_force_scale=settings.delivered_force_scale * change.force_scale,
        delivered_force_offset_n=settings.delivered_force_offset_n + change.force_offset_n,
        height_offset_mm=settings.height_offset_mm + change.height_offset_mm,
        pad_stiffness_n_mm=1 / compliance if compliance > 0 else 0.0,
    )
    factors = {name: getattr(changed, name) * one for name, one in change.settings_factors}
    return replace(changed, **factors)


def recipe_object(entry: ObjectEntry) -> GraspObject:
    """The object of a recipe's entry, with the entry's own figures and the weight fixed to it."""
    change = Perturbation(
        friction=entry.friction,
        mass_kg=entry.mass_kg,
        spinning_friction_mm=entry.spinning_friction_mm,
        spinning_friction_factor=entry.spinning_friction_factor,
        object_scale=entry.scale,
        **shift_of_center(entry.center_of_mass_offset_mm),
    )
    grasped = perturbed_object(load_object(entry.object_folder()), change)
    return weighted_object(grasped, entry.added_mass_kg, entry.added_mass_at_mm)


def weighted_object(
    grasped: GraspObject, added_kg: float, at_mm: tuple[float, float, float] | None
) -> GraspObject:
    """The object with a small weight fixed to it at a point of its frame, or its centre of mass."""
    if not added_kg:
        return grasped
    total_kg = grasped.mass_kg + added_kg
    arm_mm = np.zeros(3) if at_mm is None else np.array(at_mm) - grasped.center_of_mass_mm
    # Both bodies about their common centre (Steiner): m a/(m + a) takes the place of the mass.
    steiner = arm_mm @ arm_mm * np.eye(3) - np.outer(arm_mm, arm_mm)
    inertia = grasped.inertia_kg_mm2 + grasped.mass_kg * added_kg / total_kg * steiner
    return replace(
        grasped,
        mass_kg=total_kg,
        center_of_mass_mm=frozen_array(grasped.center_of_mass_mm + added_kg / total_kg * arm_mm),
        inertia_kg_mm2=frozen_array(inertia),
    )


def perturbed_entry(entry: ObjectEntry, change: Perturbation) -> ObjectEntry:
    """The recipe's entry whose object is the perturbed one."""
    before = recipe_object(entry)
    after = perturbed_object(before, change)
    figures: dict[str, Any] = {}
    if after.mass_kg != before.mass_kg:
        factor, added_kg = after.mass_kg / before.mass_kg, entry.added_mass_kg
        figures["mass_kg"] = round(after.mass_kg - added_kg * factor, 6)
        if added_kg:
            figures["added_mass_kg"] = round(added_kg * factor, 6)
    if after.friction != before.friction:
        figures["friction"] = round(after.friction, 6)
    if change.object_scale != 1.0:
        figures["scale"] = round(entry.scale * change.object_scale, 6)
    if after.spinning_friction_factor != before.spinning_friction_factor:
        figures["spinning_friction_factor"] = round(after.spinning_friction_factor, 6)
    if entry.spinning_friction_mm is not None and after.spinning_friction_mm is not None:
        figures["spinning_friction_mm"] = round(after.spinning_friction_mm, 6)
    for name in ("center_of_mass_offset_mm", "added_mass_at_mm"):
        if (before_mm := getattr(entry, name)) is not None:
            moved = change.object_scale * np.array(before_mm) + np.array(change.center_of_mass_mm)
            if (now_mm := tuple(np.round(moved, 4).tolist())) != before_mm:
                figures[name] = now_mm
    return entry.model_copy(update=figures)


# Relative changes are log-normal, so that no draw makes a mass or a friction negative; beyond
# this many standard deviations a draw is pulled back, so that none is absurd.
_MAX_DEVIATIONS = 3.0


@dataclass(frozen=True, slots=True)
class Variation:
    """One draw: changes to object, gel and camera, and shifts of the grasp in mm and rad."""

    perturbation: Perturbation = field(default_factory=Perturbation)
    k_n_factor: float = 1.0
    gain_factor: float = 1.0
    position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0


def draw_variation(spread: Randomize, rng: np.random.Generator) -> Variation:
    """Draw what one grasp varies; the same generator state gives the same draw.

    Every figure consumes its random numbers whether it is varied or not, so that switching one
    on leaves the draws of the others as they were.
    """
    z = np.clip(rng.standard_normal(11), -_MAX_DEVIATIONS, _MAX_DEVIATIONS)
    x_mm, y_mm, z_mm = (np.array(spread.position_mm) * z[7:10]).tolist()
    return Variation(
        Perturbation(
            friction_factor=float(np.exp(spread.friction_relative * z[0])),
            mass_factor=float(np.exp(spread.mass_relative * z[1])),
            **shift_of_center((spread.center_of_mass_mm * z[2:5]).tolist()),
        ),
        k_n_factor=float(np.exp(spread.k_n_relative * z[5])),
        gain_factor=float(np.exp(spread.sensor_gain_relative * z[6])),
        position_mm=(x_mm, y_mm, z_mm),
        yaw_rad=float(spread.yaw_rad * z[10]),
    )


def vary_config(config: GraspConfig, variation: Variation) -> GraspConfig:
    """The configuration as it is carried out, off from the one asked for."""
    dx_mm, dy_mm, dz_mm = variation.position_mm
    return replace(
        config,
        x_mm=config.x_mm + dx_mm,
        y_mm=config.y_mm + dy_mm,
        z_mm=config.z_mm + dz_mm,
        yaw_rad=config.yaw_rad + variation.yaw_rad,
    )


@dataclass(frozen=True, slots=True)
class Outcome:
    """How one simulated grasp ended, and how far it was from ending otherwise.

    ``friction_ratio`` is that of ``records.SlipMargin``; ``swing_ratio`` and ``whole_swing_ratio``
    are its torsion ratios over the moment that is to be held so that the object turns no farther
    than a success may; ``turn_ratio`` is how far the lifted object turned over that turn. All
    numbers are NaN, and the label is −1, where the grasp was not executed.
    """

    label: int
    failure_mode: str
    friction_ratio: float = NAN
    swing_ratio: float = NAN
    rise_mm: float = NAN
    turn_ratio: float = NAN
    whole_swing_ratio: float = NAN
    status: str = "executed"

    @classmethod
    def of(cls, trace: GraspTrace, settings: PhysicsSettings) -> "Outcome":
        """The outcome of a trace that was simulated with those settings."""
        margin = trace.margin
        if margin is None:
            return cls(trace.label, trace.failure_mode, status=trace.status)
        share = margin.swing_moment_share
        swing, whole = (
            float("inf") if share == 0 else ratio / share
            for ratio in (margin.torsion_ratio, margin.whole_torsion_ratio)
        )
        turn_ratio = trace.turn_rad / settings.success_turn_rad
        ratios = margin.friction_ratio, swing
        return cls(trace.label, trace.failure_mode, *ratios, trace.rise_mm, turn_ratio, whole)


OutcomeKey = tuple[GraspPoint, Perturbation]
_CRASHED = Outcome(-1, "", status="crashed")


def check_forces(recipe: Recipe, real: RealGrasps) -> None:
    """Refuse real grasps that the recipe's gripper could not be asked for.

    Raises ``DatasetError``, listing each with its fix.
    """
    table, most_n = real.folder / "grasps.csv", recipe.robot.largest_force_n
    problems = [
        f"{table}: grasp {grasp.grasp_id!r}: force_n {problem}"
        for grasp in real.grasps
        if (problem := force_problem(grasp.config.force_n, most_n))
    ]
    DatasetError.raise_if(problems)


_WHY = {
    "toppled": "the object topples before",
    "unreachable": "out of the gripper's reach",
    "no_contact": "the fingers close on nothing",
    "crashed": "the simulation crashed",
}


def unexecuted_note(
    grasps: Sequence[RealGrasp], outcomes: Sequence[Outcome], consequence: str
) -> list[str]:
    """A sentence about the grasps that no simulation could execute, if there are any."""
    never = [
        f"{grasp.grasp_id!r}: {_WHY.get(outcome.status, outcome.status)}"
        for grasp, outcome in zip(grasps, outcomes, strict=True)
        if outcome.label < 0
    ]
    if not never:
        return []
    shown = ", ".join(never[:5]) + (", …" if len(never) > 5 else "")
    return [
        f"{len(never)} of {len(grasps)} grasps cannot be executed in simulation ({shown}) "
        f"and {consequence}; correct their positions or remove them"
    ]


def simulate_perturbed(
    recipe: Recipe,
    wanted: Iterable[tuple[GraspConfig, Perturbation]],
    out: Path,
    *,
    workers: int,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> dict[OutcomeKey, Outcome]:
    """The outcome of every wanted grasp under its perturbation.

    Lines of ``out/outcomes.jsonl`` are written as soon as a grasp has been simulated under all its
    perturbations; an interrupted run goes on from there. They carry a hash of all that the outcome
    depends on and the whole configuration, and are used for nothing else.
    """
    found: dict[GraspPoint, tuple[GraspConfig, dict[Perturbation, None]]] = {}
    for config, change in wanted:
        found.setdefault(config.point, (config, {}))[1][change] = None
    tasks = [(config, tuple(changes)) for config, changes in found.values()]
    names = {config.object for config, _ in tasks}
    inputs = recipe_inputs(recipe, names)
    declared = {name: sha256_of_content(inputs.of_objects([name])) for name in names}
    items = [
        [
            {
                "declared": declared[config.object],
                "grasp": config.point,
                "changes": change.changes(),
            }
            for change in changes
        ]
        for config, changes in tasks
    ]
    job = partial(_grasp_job, recipe, tasks)
    outcomes = kept_results(
        out / OUTCOMES, items, job, lambda kept: Outcome(**kept), workers=workers, show=show
    )
    return {
        (config.point, change): outcome
        for (config, changes), of_changes in zip(tasks, outcomes, strict=True)
        for change, outcome in zip(changes, of_changes, strict=True)
    }


@contextlib.contextmanager
def _grasp_job(
    recipe: Recipe,
    tasks: Sequence[tuple[GraspConfig, tuple[Perturbation, ...]]],
    missing: Sequence[Sequence[int]],
) -> Iterator[Callable[[int, Mapping[int, str], Report], list[dict[str, Any]]]]:
    """One process: a task is one grasp, its items are the perturbations to simulate it under."""
    settings = recipe.physics_settings
    built = lru_cache(maxsize=1)(recipe_object)
    law = contact_law(recipe.contact)
    indenter = Indenter(mounted_sensor(recipe, needs_table=False), recipe.contact.camera)
    first_item = np.cumsum([0, *(len(changes) + 1 for _, changes in tasks)])
    with GraspSimulator(recipe.robot.spec(), recipe.physics.engine) as simulator:

        def job(task: int, crashed: Mapping[int, str], report: Report) -> list[dict[str, Any]]:
            config, changes = tasks[task]
            base = built(recipe.entry_of(config.object))
            found = []
            for k in missing[task]:
                item = int(first_item[task]) + k
                if item in crashed:
                    found.append(asdict(_CRASHED))
                    continue
                report("start", item, None)
                changed = perturbed_settings(settings, changes[k])
                grasped = perturbed_object(base, changes[k])
                trace = run_grasp(
                    simulator,
                    grasped,
                    replace(config, index=task),
                    changed,
                    frames=FrameRequest(),
                    gel=GelModel(
                        partial(gel_patch, indenter, law, grasped.surface), bool(law.effects)
                    ),
                )
                found.append(asdict(Outcome.of(trace, changed)))
            return found

        yield job
