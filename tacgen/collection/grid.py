"""The list of grasps a recipe asks for, its train and test sides, and its division into shards."""

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from tacgen.collection.recipe import Grid, ObjectEntry, Recipe
from tacgen.core.errors import RecipeError
from tacgen.core.records import GraspConfig
from tacgen.objects.description import read_description
from tacgen.physics.settings import LOWEST_PAD_MM, force_problem

AXES = ("force_n", "x_mm", "y_mm", "z_mm")
MAX_GRASPS = 10_000_000  # years of one machine: a misspelt axis

# Streams of a recipe's random numbers; an object's own number follows, so that adding an object
# changes nothing for those before it.
_STREAM_SAMPLE, _STREAM_SPLIT, _STREAM_GRASP = range(3)


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


def plan_recipe(recipe: Recipe) -> tuple[PlannedGrasp, ...]:
    """Every grasp of ``recipe``, in order; axes left out are those of its objects' ``object.yaml``.

    Raises ``RecipeError`` if a force exceeds the gripper's, or the grid is too large.
    """
    planned: list[PlannedGrasp] = []
    size = recipe.dataset.shard_size
    for number, entry in enumerate(recipe.objects):
        points = _points(recipe, entry, number)
        splits = _splits(recipe, number, len(points))
        for point, split in zip(points, splits, strict=True):
            index = len(planned)
            config, shard = GraspConfig(index, entry.name, *point), index // size
            seed = _grasp_seed(recipe.seed, index)
            planned.append(PlannedGrasp(config, number, split, shard, seed))
    return tuple(planned)


def grid_rows(planned: Sequence[PlannedGrasp]) -> list[dict[str, object]]:
    """The plan as rows of a table: the configuration, its side of the split and its shard."""
    return [
        asdict(grasp.config) | {"split": grasp.split, "shard": grasp.shard} for grasp in planned
    ]


def _points(recipe: Recipe, entry: ObjectEntry, number: int) -> Sequence[tuple[float, ...]]:
    """(force_n, x_mm, y_mm, z_mm, yaw_rad) of every grasp of one object, in grid order."""
    own, common = entry.grid or Grid(), recipe.grid
    ranges = read_description(entry.object_folder()).grasp_ranges
    axes = [
        getattr(own, axis) or getattr(common, axis) or _scaled(axis, getattr(ranges, axis), entry)
        for axis in AXES
    ]
    largest_n, settings = max(axes[0]), recipe.physics_settings
    if problem := force_problem(largest_n, settings.max_force_n):
        msg = f"objects/{entry.name}: grasp force_n {problem}, or give grid.force_n in the recipe"
        raise RecipeError(msg)
    if problem := settings.compliance_problem(largest_n):
        msg = f"objects/{entry.name}: grasp force_n {problem}"
        raise RecipeError(msg)
    yaw = own.yaw_rad if entry.grid and "yaw_rad" in own.model_fields_set else common.yaw_rad
    axes.append(yaw)
    size = int(np.prod([len(axis) for axis in axes], dtype=float))
    if size > MAX_GRASPS:
        msg = f"the grid of {entry.name!r} has {size} grasps, more than {MAX_GRASPS}; thin it out"
        raise RecipeError(msg)
    points = list(itertools.product(*axes))
    sample = own.sample or common.sample
    if sample is None or sample >= size:
        return points
    rng = rng_of(recipe.seed, _STREAM_SAMPLE, number)
    return [points[i] for i in np.sort(rng.choice(size, sample, replace=False))]


def _scaled(axis: str, values: tuple[float, ...], entry: ObjectEntry) -> tuple[float, ...]:
    """An axis of the object's own ranges at the entry's scale; its mass stays, and so do forces.

    Pads that clear the table still do.
    """
    if axis == "force_n" or entry.scale == 1.0:
        return values
    least = LOWEST_PAD_MM if axis == "z_mm" else -np.inf
    scaled = (max(value * entry.scale, min(value, least)) for value in values)
    return tuple(dict.fromkeys(scaled))


def _splits(recipe: Recipe, number: int, count: int) -> list[str]:
    n_test = round(recipe.split.test_fraction * count)
    order = rng_of(recipe.seed, _STREAM_SPLIT, number).permutation(count)
    tests = set(order[:n_test].tolist())
    return ["test" if i in tests else "train" for i in range(count)]


def _grasp_seed(seed: int, index: int) -> int:
    sequence = np.random.SeedSequence(seed, spawn_key=(_STREAM_GRASP, index))
    return int(sequence.generate_state(1, np.uint64)[0] >> np.uint64(1))


def rng_of(seed: int, *key: int) -> np.random.Generator:
    """Random numbers by identity: the same seed and key give the same ones."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
