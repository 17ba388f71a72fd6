"""The list of grasps a recipe asks for, its train and test sides, and its division into shards."""

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tacgen.collection.recipe import Grid, ObjectEntry, Recipe
from tacgen.core.errors import RecipeError
from tacgen.core.progress import print_once
from tacgen.core.records import GraspConfig
from tacgen.objects.description import read_description
from tacgen.physics.settings import force_problem

AXES = ("force_n", "x_mm", "y_mm", "z_mm", "yaw_rad")
Grids = Sequence[Mapping[str, Any]]
"""The grids of a recipe's objects, a record each."""
MAX_GRASPS = 10_000_000  # years of one machine: a misspelt axis

Point = tuple[str, float, float, float, float, float]
"""What identifies a grasp: its object and the values of ``AXES``."""


@dataclass(frozen=True, slots=True)
class PlannedGrasp:
    """A grasp of the plan: its configuration, the side of the split, its shard and its seed.

    ``entry`` is the position of its object in the recipe.
    """

    config: GraspConfig
    entry: int
    split: str
    shard: int
    seed: int


@dataclass(frozen=True, slots=True)
class GraspPlan:
    """The grasps of a dataset in their order, and the grids that they came with, one after another.

    Each of ``grids`` holds a record an object: its name, its axes and how many of its points are
    drawn; each of ``parts`` is the number of grasps that a grid added to those before it.
    """

    grasps: tuple[PlannedGrasp, ...]
    grids: tuple[Grids, ...]
    parts: tuple[int, ...]


def plan_recipe(recipe: Recipe) -> tuple[PlannedGrasp, ...]:
    """Every grasp of ``recipe``, in order; axes left out are those of its objects' ``object.yaml``.

    Raises ``RecipeError`` if a force exceeds the gripper's, or the grid is too large.
    """
    return grown_plan(recipe, ()).grasps


def grown_plan(recipe: Recipe, recorded: Sequence[Grids]) -> GraspPlan:
    """The plan of ``recipe`` where a dataset already has the grids ``recorded``.

    Its grasps keep their places, and those that it lacks follow in shards of their own. Where a
    recorded grasp is none of the recipe's, the plan is that of the recipe alone.

    Raises ``RecipeError`` as ``plan_recipe`` does.
    """
    own: Grids = [_grid_of(recipe, entry) for entry in recipe.objects]
    grids = list(recorded)
    parts = _parts(recipe.seed, grids)
    before = set().union(*parts) if parts else set()
    there = {name: [p for p in before if p[0] == name] for name in {p[0] for p in before}}
    whole = _points(recipe.seed, own, there)
    if not before <= set(whole):
        grids, parts, before, whole = [], [], set(), _points(recipe.seed, own, {})
    added = [point for point in whole if point not in before]
    if added:
        grids, parts = [*grids, own], [*parts, added]
    planned: list[PlannedGrasp] = []
    entries = {entry.object_name: k for k, entry in enumerate(recipe.objects)}
    splits, shard = _splits(recipe, parts), 0
    for part in parts:
        for k, point in enumerate(part):
            config = GraspConfig(len(planned), *point)
            number = shard + k // recipe.dataset.shard_size
            seed = _draw(recipe.seed, "grasp", point)
            planned.append(PlannedGrasp(config, entries[point[0]], splits[point], number, seed))
        shard += -(-len(part) // recipe.dataset.shard_size)
    return GraspPlan(tuple(planned), tuple(grids), tuple(map(len, parts)))


def grid_rows(planned: Sequence[PlannedGrasp]) -> list[dict[str, object]]:
    """The plan as rows of a table: the configuration, its side of the split and its shard."""
    return [
        asdict(grasp.config) | {"split": grasp.split, "shard": grasp.shard} for grasp in planned
    ]


def _grid_of(recipe: Recipe, entry: ObjectEntry) -> dict[str, Any]:
    """The axes of one object's grid with its name, as plain data."""
    own, common = entry.grid or Grid(), recipe.grid
    ranges = read_description(entry.object_folder()).grasp_ranges
    gripper, settings = recipe.robot.spec().gripper, recipe.physics_settings
    axes = {
        axis: getattr(own, axis)
        or getattr(common, axis)
        or _scaled(axis, getattr(ranges, axis), entry.scale, gripper.lowest_mm)
        for axis in AXES[:-1]
    }
    largest_n = max(axes["force_n"])
    if problem := force_problem(largest_n, settings.max_force_n):
        msg = f"objects/{entry.name}: grasp force_n {problem}, or give grid.force_n in the recipe"
        raise RecipeError(msg)
    if problem := settings.compliance_problem(largest_n, gripper.pad.depth_mm):
        msg = f"objects/{entry.name}: grasp force_n {problem}"
        raise RecipeError(msg)
    has_yaw = entry.grid and "yaw_rad" in own.model_fields_set
    axes["yaw_rad"] = own.yaw_rad if has_yaw else common.yaw_rad
    size = int(np.prod([len(axis) for axis in axes.values()], dtype=float))
    if size > MAX_GRASPS:
        msg = f"the grid of {entry.name!r} has {size} grasps, more than {MAX_GRASPS}; thin it out"
        raise RecipeError(msg)
    sample = own.sample or common.sample
    if sample is not None and sample > size:
        print_once(
            f"grid.sample = {sample}: the grid of {entry.name!r} has {size} grasps, all taken"
        )
    listed = {axis: list(values) for axis, values in axes.items()}
    return {"object": entry.object_name, **listed, "sample": sample}


def _scaled(
    axis: str, values: tuple[float, ...], scale: float, lowest_mm: float
) -> tuple[float, ...]:
    """An axis of the object's own ranges at a scale; its mass stays, and so do forces.

    Pads that clear the table still do.
    """
    if axis == "force_n" or scale == 1.0:
        return values
    least = lowest_mm if axis == "z_mm" else -np.inf
    scaled = (max(value * scale, min(value, least)) for value in values)
    return tuple(dict.fromkeys(scaled))


def _points(seed: int, grids: Grids, there: Mapping[str, Sequence[Point]]) -> list[Point]:
    """Every grasp of some objects' grids, in order; a sample holds those that are ``there``."""
    found: list[Point] = []
    for grid in grids:
        name, sample = str(grid["object"]), grid["sample"]
        axes = [[float(value) + 0.0 for value in grid[axis]] for axis in AXES]
        points: list[Point] = [(name, *values) for values in itertools.product(*axes)]  # type: ignore[misc]
        if sample is not None and sample < len(points):
            kept = set(there.get(name, ()))
            left = [point for point in points if point not in kept]
            left.sort(key=lambda point: _draw(seed, "sample", point))
            kept |= set(left[: max(0, sample - len(kept))])
            points = [point for point in points if point in kept]
        found += points
    return found


def _parts(seed: int, grids: Sequence[Grids]) -> list[list[Point]]:
    """The grasps that each of a dataset's grids added."""
    parts: list[list[Point]] = []
    there: dict[str, list[Point]] = {}
    for grid in grids:
        before = {point for points in there.values() for point in points}
        parts.append([point for point in _points(seed, grid, there) if point not in before])
        for point in parts[-1]:
            there.setdefault(point[0], []).append(point)
    return parts


def _splits(recipe: Recipe, parts: Sequence[Sequence[Point]]) -> dict[Point, str]:
    """The side of each grasp: of each object the test fraction, by the grasps' own draws.

    A grasp that a dataset grows by changes no side of those before it.
    """
    sides: dict[Point, str] = {}
    counts: dict[str, tuple[int, int]] = {}  # grasps and test grasps of each object so far
    for part in parts:
        for name, points in itertools.groupby(part, key=lambda point: point[0]):
            drawn = sorted(points, key=lambda point: _draw(recipe.seed, "split", point))
            n_before, tests = counts.get(name, (0, 0))
            n_total = n_before + len(drawn)
            more = round(recipe.split.test_fraction * n_total) - tests
            more = min(max(more, 0), len(drawn))
            sides |= {point: "test" if k < more else "train" for k, point in enumerate(drawn)}
            counts[name] = n_total, tests + more
    return sides


def _draw(seed: int, stream: str, point: Point) -> int:
    """A random number below 2⁶³ of the recipe's seed and the grasp's own content alone."""
    digest = hashlib.sha256(repr((seed, stream, *point)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def rng_of(seed: int, *key: int) -> np.random.Generator:
    """Random numbers by identity: the same seed and key give the same ones."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
