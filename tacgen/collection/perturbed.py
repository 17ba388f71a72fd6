"""Grasps in worlds that differ from the declared one, simulated in parallel and kept on disk."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from tacgen.collection.pipeline import recipe_object
from tacgen.collection.randomize import with_friction, with_mass, with_scale
from tacgen.collection.recipe import ObjectEntry, Recipe
from tacgen.core.errors import DatasetError
from tacgen.core.files import sha256_of
from tacgen.core.records import GraspConfig, GraspObject, GraspTrace, frozen_array
from tacgen.core.resources import find_object_folder
from tacgen.core.workers import Report, run_tasks
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp

GRASP_LIMIT_S = 120.0
NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Alteration:
    """How a world differs from the one that a recipe declares; the default is that one itself.

    ``friction`` replaces the coefficient, the factors multiply what is declared, and the rest is
    added to it. A factor on friction acts on the spinning friction too, as μ does.
    """

    friction: float | None = None
    friction_factor: float = 1.0
    mass_factor: float = 1.0
    center_of_mass_x_mm: float = 0.0
    center_of_mass_y_mm: float = 0.0
    center_of_mass_z_mm: float = 0.0
    spinning_friction_factor: float = 1.0
    object_scale: float = 1.0
    force_scale: float = 1.0
    force_offset_n: float = 0.0
    height_offset_mm: float = 0.0
    compliance_mm_per_n: float = 0.0

    def changes(self) -> dict[str, float]:
        """What differs from the declared world."""
        return {
            field.name: getattr(self, field.name)
            for field in fields(self)
            if getattr(self, field.name) != field.default
        }


@dataclass(frozen=True, slots=True)
class Outcome:
    """How one simulated grasp ended, and how far it was from ending otherwise.

    Margins and ratios are those of ``records.SlipMargin``; all are NaN, and the label is −1,
    where the grasp was not executed.
    """

    label: int
    failure_mode: str
    translational_margin: float
    rotational_margin: float
    friction_ratio: float = NAN
    torsion_ratio: float = NAN
    rise_mm: float = NAN
    turn_rad: float = NAN
    status: str = "executed"

    @classmethod
    def of(cls, trace: GraspTrace) -> Outcome:
        """The outcome of a trace."""
        margin = trace.margin
        if margin is None:
            return cls(trace.label, trace.failure_mode, NAN, NAN, status=trace.status)
        return cls(
            trace.label,
            trace.failure_mode,
            margin.translational,
            margin.rotational,
            margin.friction_ratio,
            margin.torsion_ratio,
            trace.rise_mm,
            trace.turn_rad,
        )


def declared_sha256(recipe: Recipe, name: str) -> str:
    """A hash of the recipe and of the files of the object ``name``."""
    digest = hashlib.sha256(recipe.sha256().encode())
    for path in sorted(find_object_folder(name).rglob("*")):
        if path.is_file():
            digest.update(f"{path.name} {sha256_of(path)}".encode())
    return digest.hexdigest()


Place = tuple[str, float, float, float, float, float]
"""A configuration without its number: what was asked for."""
Key = tuple[Place, Alteration]
_CRASHED = Outcome(-1, "", NAN, NAN, status="crashed")


def place_of(config: GraspConfig) -> Place:
    """The configuration without its number."""
    return config.object, config.force_n, config.x_mm, config.y_mm, config.z_mm, config.yaw_rad


def altered_object(grasped: GraspObject, alteration: Alteration) -> GraspObject:
    """The object as an altered world has it."""
    if alteration.friction is not None:
        grasped = with_friction(grasped, alteration.friction)
    grasped = with_friction(grasped, grasped.friction * alteration.friction_factor)
    grasped = with_mass(grasped, grasped.mass_kg * alteration.mass_factor)
    if alteration.object_scale != 1.0:
        grasped = with_scale(grasped, alteration.object_scale)
    shift = (
        alteration.center_of_mass_x_mm,
        alteration.center_of_mass_y_mm,
        alteration.center_of_mass_z_mm,
    )
    return replace(
        grasped,
        center_of_mass_mm=frozen_array(grasped.center_of_mass_mm + np.array(shift)),
        spinning_friction_mm=grasped.spinning_friction_mm * alteration.spinning_friction_factor,
    )


def altered_settings(settings: PhysicsSettings, alteration: Alteration) -> PhysicsSettings:
    """The gripper and table of an altered world."""
    compliance = alteration.compliance_mm_per_n
    if settings.pad_stiffness_n_mm > 0:
        compliance += 1 / settings.pad_stiffness_n_mm
    return replace(
        settings,
        delivered_force_scale=settings.delivered_force_scale * alteration.force_scale,
        delivered_force_offset_n=settings.delivered_force_offset_n + alteration.force_offset_n,
        height_offset_mm=settings.height_offset_mm + alteration.height_offset_mm,
        pad_stiffness_n_mm=1 / compliance if compliance > 0 else 0.0,
    )


def check_forces(recipe: Recipe, real: RealGrasps) -> None:
    """Refuse real grasps that the recipe's gripper could not be asked for.

    Raises
    ------
    DatasetError
        Listing each with its mend.
    """
    limit = recipe.robot.max_force_n
    problems = [
        f"{real.folder / 'grasps.csv'}: grasp {grasp.grasp_id!r} asks for {grasp.config.force_n:g} "
        f"N, more than robot.max_force_n = {limit:g} of recipe {recipe.name!r}; raise it there"
        for grasp in real.grasps
        if grasp.config.force_n > limit
    ]
    if problems:
        raise DatasetError.from_problems(problems)


_WHY = {
    "unreachable": "out of the gripper's reach",
    "no_contact": "the fingers close on nothing",
    "crashed": "the simulation crashed",
}


def words_about_unexecuted(
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
        f"{len(never)} of {len(grasps)} grasps cannot be executed in the simulated world ({shown}) "
        f"and {consequence}; mend their place or take them out"
    ]


def simulate_altered(
    recipe: Recipe,
    wanted: Iterable[tuple[GraspConfig, Alteration]],
    out: Path,
    *,
    workers: int,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> dict[Key, Outcome]:
    """The outcome of every wanted grasp in its world.

    Lines of ``out/outcomes.jsonl`` are written as soon as a grasp has been simulated in all its
    worlds; a run that was interrupted goes on from there. They carry the hashes of the recipe and
    of the object's files and the whole configuration, and are used for nothing else.
    """
    wanted = list(wanted)
    store = _Store(out / "outcomes.jsonl", recipe, {config.object for config, _ in wanted})
    kept = store.read()
    jobs: dict[Place, tuple[GraspConfig, dict[Alteration, None]]] = {}
    keys: dict[Key, None] = {}
    for config, alteration in wanted:
        place = place_of(config)
        keys[place, alteration] = None
        worlds = jobs.setdefault(place, (config, {}))[1]
        if (place, alteration) not in kept:
            worlds[alteration] = None
    listed = [(config, tuple(worlds)) for config, worlds in jobs.values()]
    pending = [k for k, (_, worlds) in enumerate(listed) if worlds]
    done = len(listed) - len(pending)
    show(done, len(listed))
    make_job = partial(_grasp_job, recipe, tuple(listed))
    for event in run_tasks(pending, make_job, workers=workers, item_limit_s=GRASP_LIMIT_S):
        if event.kind != "done":
            continue
        config, simulated = listed[event.task]
        place = place_of(config)
        found = {(place, world): one for world, one in zip(simulated, event.value, strict=True)}
        store.append(found)
        kept |= found
        done += 1
        show(done, len(listed))
    return {key: kept[key] for key in keys}


Task = tuple[GraspConfig, tuple[Alteration, ...]]


@contextlib.contextmanager
def _grasp_job(
    recipe: Recipe, tasks: Sequence[Task]
) -> Iterator[Callable[[int, Mapping[int, str], Report], list[Outcome]]]:
    """One process: a task is one grasp, its items are the worlds to simulate it in."""
    entries = {entry.name: entry for entry in recipe.objects}
    settings = recipe.physics_settings
    built = lru_cache(maxsize=1)(recipe_object)
    first_item = np.cumsum([0, *(len(worlds) + 1 for _, worlds in tasks)])
    with GraspSimulator(recipe.robot.name) as simulator:

        def job(task: int, crashed: Mapping[int, str], report: Report) -> list[Outcome]:
            config, worlds = tasks[task]
            base = built(entries.get(config.object, ObjectEntry(name=config.object)))
            found = []
            for k, world in enumerate(worlds):
                item = int(first_item[task]) + k
                if item in crashed:
                    found.append(_CRASHED)
                    continue
                report("start", item, None)
                trace = run_grasp(
                    simulator,
                    altered_object(base, world),
                    replace(config, index=task),
                    altered_settings(settings, world),
                    frames=FrameRequest(),
                )
                found.append(Outcome.of(trace))
            return found

        yield job


class _Store:
    """Finished simulations on disk, a line each."""

    def __init__(self, path: Path, recipe: Recipe, names: Iterable[str]) -> None:
        self._path = path
        self._made_with = {name: declared_sha256(recipe, name) for name in names}

    def read(self) -> dict[Key, Outcome]:
        """What is there of these objects as declared; a line cut short by a crash is passed over.

        Lines of objects that were declared otherwise then are passed over too.
        """
        found: dict[Key, Outcome] = {}
        if not self._path.is_file():
            return found
        for line in self._path.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                data = json.loads(line)
                name, *numbers = data["grasp"]
                if data["declared"] == self._made_with.get(name):
                    key = ((name, *map(float, numbers)), Alteration(**data["world"]))
                    found[key] = Outcome(**data["outcome"])
            except (ValueError, KeyError, TypeError, RecursionError):
                continue
        return found

    def append(self, outcomes: Mapping[Key, Outcome]) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            for (place, world), one in outcomes.items():
                line = {
                    "declared": self._made_with[place[0]],
                    "grasp": place,
                    "world": world.changes(),
                    "outcome": asdict(one),
                }
                file.write(json.dumps(line) + "\n")
