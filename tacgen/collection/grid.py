"""The list of grasps a recipe asks for, its train and test sides, and its division into shards."""

import hashlib
import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tacgen.collection.border import choose_near_border
from tacgen.collection.recipe import Adaptive, Grid, ObjectEntry, Recipe
from tacgen.core.arrays import FloatArray, IntArray
from tacgen.core.errors import RecipeError
from tacgen.core.progress import print_once
from tacgen.core.records import GraspConfig
from tacgen.objects.description import read_description
from tacgen.physics.settings import force_problem

AXES = ("force_n", "x_mm", "y_mm", "z_mm", "yaw_rad")
Grids = Sequence[Mapping[str, Any]]
"""The grids of a recipe's objects, a record each."""
MAX_GRASPS = 10_000_000  # years of one machine: a misspelt axis
SAME_YAW_RAD = 0.005  # after a whole turn: π is also written as 3.14
MAX_CANDIDATES = 4096  # of a large grid: far closer together than a batch's grasps

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

    Each of ``grids`` holds a record an object: its name, its axes and how many of its points there
    are; each of ``parts`` is the number of grasps that a grid added to those before it. Where a
    recipe is adaptive, a grid is a batch: its record also has the number of its ``tests``, and the
    points that were ``chosen``. Batches that follow from grasps still to be made have their number
    in ``parts`` alone.
    """

    grasps: tuple[PlannedGrasp, ...]
    grids: tuple[Grids, ...]
    parts: tuple[int, ...]

    @property
    def n_to_choose(self) -> int:
        """How many grasps are not chosen yet."""
        return sum(self.parts) - len(self.grasps)


def plan_recipe(recipe: Recipe) -> tuple[PlannedGrasp, ...]:
    """Every grasp of ``recipe``, in order; axes left out are those of its objects' ``object.yaml``.

    Of an adaptive recipe these are the grasps that are drawn at random, which come first.

    Raises ``RecipeError`` if a force exceeds the gripper's, or the grid is too large.
    """
    return grown_plan(recipe, ()).grasps


Labels = Callable[[int], IntArray | None]
"""The labels (n,) of the first n grasps of a dataset; None until all of them are made."""


def grown_plan(
    recipe: Recipe, recorded: Sequence[Grids], labels_of: Labels = lambda _: None
) -> GraspPlan:
    """The plan of ``recipe`` where a dataset already has the grids ``recorded``.

    Its grasps keep their places, and those that it lacks follow in shards of their own; of an
    adaptive recipe the next batch, once ``labels_of`` knows all grasps before it. Where a
    recorded grasp is none of the recipe's, the plan is that of the recipe alone.

    Raises ``RecipeError`` as ``plan_recipe`` does.
    """
    own: Grids = [_grid_of(recipe, entry) for entry in recipe.objects]
    grids = list(recorded)
    parts = _parts(recipe.seed, grids)
    if not set().union(*parts) <= set(_points(recipe.seed, own, _by_object(parts))):
        grids, parts = [], []
    to_come = _batches(recipe, own, _by_object(parts))
    if to_come:
        known = [point for part in parts for point in part]
        sides = _splits(recipe, grids, parts)
        batch = _with_choice(recipe, own, to_come[0], known, sides, labels_of)
        if batch is not None:
            grids, to_come = [*grids, batch], to_come[1:]
            parts = _parts(recipe.seed, grids)
    planned: list[PlannedGrasp] = []
    entries = {entry.object_name: k for k, entry in enumerate(recipe.objects)}
    splits, shard = _splits(recipe, grids, parts), 0
    for part in parts:
        for k, point in enumerate(part):
            config = GraspConfig(len(planned), *point)
            number = shard + k // recipe.dataset.shard_size
            seed = _draw(recipe.seed, "grasp", point)
            planned.append(PlannedGrasp(config, entries[point[0]], splits[point], number, seed))
        shard += -(-len(part) // recipe.dataset.shard_size)
    sizes = [*map(len, parts), *(sum(more.values()) for more in to_come)]
    return GraspPlan(tuple(planned), tuple(grids), tuple(sizes))


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
    axes["yaw_rad"] = _turned_once(entry.name, own.yaw_rad if has_yaw else common.yaw_rad)
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


def _turned_once(name: str, yaw_rad: Sequence[float]) -> tuple[float, ...]:
    """The angles without those that are others' after whole turns, the rounding of π aside."""
    kept = list[float]()
    for angle in yaw_rad:
        turns = [(angle - other) / math.tau for other in kept]
        if any(round(one) and abs(one - round(one)) * math.tau < SAME_YAW_RAD for one in turns):
            print_once(
                f"grid.yaw_rad of {name!r}: {angle:g} is a whole turn from another: left out"
            )
        else:
            kept.append(angle)
    return tuple(kept)


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
        if "chosen" in grid:
            found += [(name, *map(float, point)) for point in grid["chosen"]]  # type: ignore[misc]
            continue
        points = _whole(grid)
        if sample is not None and sample < len(points):
            kept = set(there.get(name, ()))
            left = [point for point in points if point not in kept]
            left.sort(key=lambda point: _draw(seed, "sample", point))
            kept |= set(left[: max(0, sample - len(kept))])
            points = [point for point in points if point in kept]
        found += points
    return found


def _whole(grid: Mapping[str, Any]) -> list[Point]:
    """Every point of an object's grid, in order."""
    axes = [[float(value) + 0.0 for value in grid[axis]] for axis in AXES]
    return [(str(grid["object"]), *values) for values in itertools.product(*axes)]  # type: ignore[misc]


def _parts(seed: int, grids: Sequence[Grids]) -> list[list[Point]]:
    """The grasps that each of a dataset's grids added."""
    parts: list[list[Point]] = []
    for grid in grids:
        there = _by_object(parts)
        before = {point for points in there.values() for point in points}
        parts.append([point for point in _points(seed, grid, there) if point not in before])
    return parts


def _by_object(parts: Sequence[Sequence[Point]]) -> dict[str, list[Point]]:
    found: dict[str, list[Point]] = {}
    for part in parts:
        for point in part:
            found.setdefault(point[0], []).append(point)
    return found


def _total(grid: Mapping[str, Any]) -> int:
    """How many grasps an object's grid asks for."""
    size = math.prod(len(grid[axis]) for axis in AXES)
    return min(grid["sample"] or size, size)


def _adaptive(recipe: Recipe, entry: ObjectEntry) -> Adaptive | None:
    own = entry.grid.adaptive if entry.grid else None
    return own or recipe.grid.adaptive


def _test_grasps(recipe: Recipe, n_grasps: int) -> int:
    return round(recipe.split.test_fraction * n_grasps)


def _batches(
    recipe: Recipe, own: Grids, there: Mapping[str, Sequence[Point]]
) -> list[dict[str, int]]:
    """How many grasps of each object every batch to come adds; one batch if none is adaptive."""
    count = {str(grid["object"]): len(there.get(str(grid["object"]), ())) for grid in own}
    found: list[dict[str, int]] = []
    while True:
        more: dict[str, int] = {}
        for entry, grid in zip(recipe.objects, own, strict=True):
            name, adaptive = entry.object_name, _adaptive(recipe, entry)
            step = total = _total(grid)
            if adaptive is not None:
                first = adaptive.first + _test_grasps(recipe, total)
                step = adaptive.batch if count[name] else first
            more[name] = max(0, min(step, total - count[name]))
            count[name] += more[name]
        if not any(more.values()):
            return found
        found.append(more)


def _with_choice(
    recipe: Recipe,
    own: Grids,
    more: Mapping[str, int],
    known: Sequence[Point],
    sides: Mapping[Point, str],
    labels_of: Labels,
) -> Grids | None:
    """The records of the next batch; None where it follows from grasps that are not made yet.

    What test grasps came to is not looked at: it would leak into the training set.
    """
    there = _by_object([known])
    labels: IntArray | None = None
    found: list[dict[str, Any]] = []
    for entry, grid in zip(recipe.objects, own, strict=True):
        name = entry.object_name
        if _adaptive(recipe, entry) is None:
            found.append(dict(grid))
            continue
        n_there = len(there.get(name, ()))
        record = {**grid, "sample": n_there + more[name], "tests": 0}
        if n_there == 0:
            record["tests"] = _test_grasps(recipe, _total(grid))
        elif more[name]:
            labels = labels_of(len(known)) if labels is None else labels
            if labels is None:
                return None
            own_rows = [k for k, point in enumerate(known) if point[0] == name]
            rows = [k for k in own_rows if sides[known[k]] == "train"]
            taken = {known[k] for k in own_rows}
            made = [known[k] for k in rows]
            record["chosen"] = _choice(recipe.seed, grid, taken, made, labels[rows], more[name])
        found.append(record)
    return found


def _choice(
    seed: int,
    grid: Mapping[str, Any],
    taken: Collection[Point],
    made: Sequence[Point],
    labels: IntArray,
    count: int,
) -> list[list[float]]:
    """The values of ``AXES`` of an object's next grasps, sorted.

    They follow from the ``labels`` of those ``made``, and are none of those ``taken``.
    An axis counts by the places of its values: they lie as close as whoever listed them finds that
    it matters, forces by equal factors.
    """
    place = [
        {value: k / max(len(grid[axis]) - 1, 1) for k, value in enumerate(sorted(grid[axis]))}
        for axis in AXES
    ]

    def places(points: Sequence[Point]) -> FloatArray:
        numbers = [[at[value] for at, value in zip(place, p[1:], strict=True)] for p in points]
        return np.array(numbers, np.float64)

    # Ties go by the points' own draws, as do those that are looked at in a large grid.
    open_to = [point for point in _whole(grid) if point not in taken]
    open_to = sorted(open_to, key=lambda point: _draw(seed, "sample", point))[:MAX_CANDIDATES]
    chosen = choose_near_border(places(made), labels, places(open_to), count)
    return sorted(list(open_to[k][1:]) for k in chosen)


def _splits(
    recipe: Recipe, grids: Sequence[Grids], parts: Sequence[Sequence[Point]]
) -> dict[Point, str]:
    """The side of each grasp: of each object the test fraction, by the grasps' own draws.

    A grasp that a dataset grows by changes no side of those before it. Once grasps were chosen,
    those that are left are no random sample of the grid, and none of them is a test grasp.
    """
    sides: dict[Point, str] = {}
    counts: dict[str, tuple[int, int]] = {}  # grasps and test grasps of each object so far
    only_train: set[str] = set()
    for grid, part in zip(grids, parts, strict=True):
        records = {str(record["object"]): record for record in grid}
        for name, points in itertools.groupby(part, key=lambda point: point[0]):
            drawn = sorted(points, key=lambda point: _draw(recipe.seed, "split", point))
            n_before, tests = counts.get(name, (0, 0))
            n_total = n_before + len(drawn)
            more = records[name].get("tests", _test_grasps(recipe, n_total) - tests)
            more = 0 if name in only_train else min(max(more, 0), len(drawn))
            sides |= {point: "test" if k < more else "train" for k, point in enumerate(drawn)}
            counts[name] = n_total, tests + more
            only_train |= {name} if "tests" in records[name] else set()
    return sides


def _draw(seed: int, stream: str, point: Point) -> int:
    """A random number below 2⁶³ of the recipe's seed and the grasp's own content alone."""
    digest = hashlib.sha256(repr((seed, stream, *point)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def rng_of(seed: int, *key: int) -> np.random.Generator:
    """Random numbers by identity: the same seed and key give the same ones."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
