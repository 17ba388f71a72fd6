"""The list of grasps a recipe asks for, its train and test sides, and its division into shards."""

import hashlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tacgen.collection.recipe import Grid, ObjectEntry, Recipe
from tacgen.core.errors import RecipeError
from tacgen.core.progress import print_once
from tacgen.core.records import AXES, GraspConfig, GraspPoint, unit_problems
from tacgen.objects.description import read_description
from tacgen.physics.settings import force_problem

Grids = Sequence[Mapping[str, Any]]
"""The grids of a recipe's objects, a record each."""
MAX_GRASPS = 10_000_000  # years of one machine: a misspelt axis
SAME_YAW_RAD = 0.005  # after a whole turn: π is also written as 3.14


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

    Each of ``grids`` holds a record an object: its name, with its axes and how many of its points
    there are, or with the ``points`` of a list and their ``split``; each of ``parts`` is the number
    of grasps that a grid added to those before it.
    """

    grasps: tuple[PlannedGrasp, ...]
    grids: tuple[Grids, ...]
    parts: tuple[int, ...]


def plan_recipe(recipe: Recipe) -> tuple[PlannedGrasp, ...]:
    """Every grasp of ``recipe``, in order; axes left out are those of its objects' ``object.yaml``.

    Raises ``RecipeError`` if a force exceeds the gripper's, the grid is too large or its file
    cannot be used.
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
    there = set().union(*parts)
    wanted = _points(recipe.seed, own, _by_object(parts))
    if not there <= set(wanted):
        grids, parts, there = [], [], set()
        wanted = _points(recipe.seed, own, {})
    if more := [point for point in wanted if point not in there]:
        grids, parts = [*grids, own], [*parts, more]
    planned: list[PlannedGrasp] = []
    entries = {entry.object_name: k for k, entry in enumerate(recipe.objects)}
    splits, shard = _splits(recipe, grids, parts), 0
    for part in parts:
        for k, point in enumerate(part):
            config = GraspConfig(len(planned), *point)
            number = shard + k // recipe.dataset.shard_size
            seed = draw(recipe.seed, "grasp", point)
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
    if (file := common.path()) is not None:
        return _listed(file, recipe, entry)
    ranges = read_description(entry.object_folder()).grasp_ranges
    gripper = recipe.robot.spec().gripper
    axes = {
        axis: getattr(own, axis)
        or getattr(common, axis)
        or _scaled(axis, getattr(ranges, axis), entry.scale, gripper.lowest_mm)
        for axis in AXES[:-1]
    }
    if problem := _force_problem(recipe, max(axes["force_n"])):
        msg = f"objects/{entry.name}: grasp force_n {problem}; give grid.force_n in the recipe"
        raise RecipeError(msg)
    has_yaw = entry.grid and "yaw_rad" in own.model_fields_set
    yaws = _turned_once(entry.name, own.yaw_rad if has_yaw else common.yaw_rad).values()
    axes["yaw_rad"] = tuple(dict.fromkeys(yaws))
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


def _force_problem(recipe: Recipe, force_n: float) -> str:
    settings, pad = recipe.physics_settings, recipe.robot.spec().gripper.pad
    problem = force_problem(force_n, settings.max_force_n)
    return problem or settings.compliance_problem(force_n, pad.depth_mm) or ""


def _listed(file: Path, recipe: Recipe, entry: ObjectEntry) -> dict[str, Any]:
    """The grasps of one object in the list ``grid.file``, as plain data.

    Columns: ``force_n``, ``y_mm`` and ``z_mm``; where they are given ``object`` (needed with
    several objects), ``x_mm`` and ``yaw_rad`` (0), and ``split``; others are left aside.
    """
    table = _read_list(file, tuple(one.object_name for one in recipe.objects))
    own = table[table["object"] == entry.object_name]
    if own.empty:
        msg = f"{file}: has no grasp of {entry.object_name}; add some, or take it out of `objects`"
        raise RecipeError(msg)
    checks: dict[str, Callable[[float], str]] = {
        "force_n": partial(_force_problem, recipe),
        **{axis: partial(_unit_problem, axis) for axis in ("z_mm", "yaw_rad")},
    }
    RecipeError.raise_if(
        [
            f"{file}, line {line}: {name} {problem}"
            for name, problem_of in checks.items()
            for line, value in zip(own.index + 2, own[name], strict=True)
            if (problem := problem_of(value))
        ]
    )
    own = own.replace({"yaw_rad": _turned_once(entry.name, own["yaw_rad"].unique())})
    own = own.drop_duplicates(list(AXES))
    return {
        "object": entry.object_name,
        "points": own[list(AXES)].to_numpy(float).tolist(),
        "split": own["split"].tolist() if "split" in own else None,
    }


def _unit_problem(axis: str, value: float) -> str:
    problem = unit_problems(axis, np.array([value]))
    return f"is {problem}" if problem else ""


def _read_list(file: Path, names: tuple[str, ...]) -> pd.DataFrame:
    """The list of grasps with all columns that a plan needs, in their types."""
    try:
        table = pd.read_csv(file, skipinitialspace=True)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        msg = f"{file}: cannot be read as a CSV of grasps ({why}); `tacgen grid` prints one"
        raise RecipeError(msg) from error
    if len(names) == 1 and "object" not in table:
        table["object"] = names[0]
    missing = [name for name in ("object", "force_n", "y_mm", "z_mm") if name not in table]
    if missing or table.empty or len(table) > MAX_GRASPS:
        what = f"lacks the columns {', '.join(missing)}" if missing else f"has {len(table)} rows"
        msg = f"{file}: {what}; `tacgen grid` prints such a list"
        raise RecipeError(msg)
    for axis in AXES:
        table[axis] = pd.to_numeric(table.get(axis, 0.0), errors="coerce") + 0.0
    allowed = {"object": set(names)} | ({"split": {"train", "test"}} if "split" in table else {})
    wrong = {
        **{axis: ~np.isfinite(table[axis]) for axis in AXES},
        **{name: ~table[name].isin(values) for name, values in allowed.items()},
    }
    RecipeError.raise_if(
        [
            f"{file}, line {rows.index[rows][0] + 2}: {name} is not "
            f"{'a number' if name in AXES else ' or '.join(sorted(allowed[name]))}"
            for name, rows in wrong.items()
            if rows.any()
        ]
    )
    return table


def _turned_once(name: str, yaw_rad: Sequence[float]) -> dict[float, float]:
    """By angle: the first of them that is the same after whole turns, the rounding of π aside."""
    first = dict[float, float]()
    for angle in yaw_rad:
        turns = {other: (angle - other) / math.tau for other in first.values()}
        same = [
            other
            for other, one in turns.items()
            if round(one) and abs(one - round(one)) * math.tau < SAME_YAW_RAD
        ]
        first[angle] = next(iter(same), angle)
        if same and angle != same[0]:
            print_once(f"the yaw_rad of {name!r}: {angle:g} is {same[0]:g} after a whole turn")
    return first


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


def _points(seed: int, grids: Grids, there: Mapping[str, Sequence[GraspPoint]]) -> list[GraspPoint]:
    """Every grasp of some objects' grids, in order; a sample holds those that are ``there``."""
    found: list[GraspPoint] = []
    for grid in grids:
        name, sample = str(grid["object"]), grid.get("sample")
        points = whole_grid(grid)
        if sample is not None and sample < len(points):
            kept = set(there.get(name, ()))
            left = [point for point in points if point not in kept]
            left.sort(key=lambda point: draw(seed, "sample", point))
            kept |= set(left[: max(0, sample - len(kept))])
            points = [point for point in points if point in kept]
        found += points
    return found


def whole_grid(grid: Mapping[str, Any]) -> list[GraspPoint]:
    """Every point of an object's grid, or of its list, in order."""
    name = str(grid["object"])
    axes = [[float(value) + 0.0 for value in grid.get(axis, ())] for axis in AXES]
    points = grid["points"] if "points" in grid else itertools.product(*axes)
    return [(name, *map(float, point)) for point in points]  # type: ignore[misc]


def _parts(seed: int, grids: Sequence[Grids]) -> list[list[GraspPoint]]:
    """The grasps that each of a dataset's grids added."""
    parts: list[list[GraspPoint]] = []
    for grid in grids:
        there = _by_object(parts)
        before = {point for points in there.values() for point in points}
        parts.append([point for point in _points(seed, grid, there) if point not in before])
    return parts


def _by_object(parts: Sequence[Sequence[GraspPoint]]) -> dict[str, list[GraspPoint]]:
    found: dict[str, list[GraspPoint]] = {}
    for part in parts:
        for point in part:
            found.setdefault(point[0], []).append(point)
    return found


def _splits(
    recipe: Recipe, grids: Sequence[Grids], parts: Sequence[Sequence[GraspPoint]]
) -> dict[GraspPoint, str]:
    """The side of each grasp: a list's own, else of each object the test fraction by draws.

    A grasp that a dataset grows by changes no side of those before it.
    """
    sides: dict[GraspPoint, str] = {}
    counts: dict[str, tuple[int, int]] = {}  # grasps and test grasps of each object so far
    for grid, part in zip(grids, parts, strict=True):
        records = {str(record["object"]): record for record in grid}
        for name, points in itertools.groupby(part, key=lambda point: point[0]):
            record = records[name]
            drawn = sorted(points, key=lambda point: draw(recipe.seed, "split", point))
            n_before, tests = counts.get(name, (0, 0))
            n_total = n_before + len(drawn)
            more = round(recipe.split.test_fraction * n_total) - tests
            more = min(max(more, 0), len(drawn))
            own = {point: "test" if k < more else "train" for k, point in enumerate(drawn)}
            if record.get("split"):
                listed = dict(zip(whole_grid(record), record["split"], strict=True))
                own = {point: listed[point] for point in drawn}
            sides |= own
            counts[name] = n_total, tests + list(own.values()).count("test")
    return sides


def draw(seed: int, stream: str, point: GraspPoint) -> int:
    """A random number below 2⁶³ of the recipe's seed and the grasp's own content alone."""
    digest = hashlib.sha256(repr((seed, stream, *point)).encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1
