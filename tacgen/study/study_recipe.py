"""Studies: a YAML file with variants to collect, train and test, for a table of them."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field, ValidationError

from tacgen.collection.recipe import Recipe
from tacgen.core.errors import RecipeError, TacgenError
from tacgen.core.schema import (
    UNKNOWN_KEY,
    Section,
    YamlSource,
    load_checked,
    problem_text,
    unknown_key_text,
)
from tacgen.learning.training_recipe import TrainRecipe

_OWN_KEYS = ("name", "description", "objects")


class Published(Section):
    """What the paper reports for a row: accuracy on simulated and on real grasps."""

    sim: float | None = None
    """Accuracy on simulated grasps."""
    real: float | None = None
    """Accuracy on real grasps."""


class Variant(Section):
    """Changes to the study: its objects, parts of ``data`` and of ``train``."""

    objects: tuple[Any, ...] | None = None
    """Objects instead of the study's."""
    data: dict[str, Any] = Field(default_factory=dict)
    """Changes to the study's ``data``."""
    train: dict[str, Any] = Field(default_factory=dict)
    """Changes to the study's ``train``."""


class Row(Variant):
    """A row of the table."""

    name: str = Field(min_length=1)
    """Name of the row."""
    published: Published = Published()
    """Accuracies that the paper reports."""
    test: Variant | None = None
    """What is other in the grasps to test on than in those to train on: ``objects`` and parts of
    ``data``; the row's own test grasps if not given."""
    calibrate_friction: bool = False
    """Fit μ to real grasps (``--calibrate-on``) before collecting."""
    calibrate_contact: bool = False
    """Use the contact law of the real sensor (``--contact``)."""


class Quick(Variant):
    """Changes to all rows with ``--quick``."""

    seeds: Annotated[int, Field(ge=1, le=100)] | None = None
    """Seeds instead of the study's."""


class Study(Section):
    """Variants of one experiment."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")
    """Name of the study."""
    description: str = ""
    """One sentence for the table."""
    objects: tuple[Any, ...] = Field(min_length=1)
    """Objects to grasp, as in a recipe for ``tacgen collect``."""
    data: dict[str, Any] = Field(default_factory=dict)
    """A recipe for ``tacgen collect`` without name and objects."""
    train: dict[str, Any] = Field(default_factory=dict)
    """A recipe for ``tacgen train`` without name and objects."""
    rows: tuple[Row, ...] = Field(min_length=1)
    """Rows of the table, each with its changes."""
    seeds: Annotated[int, Field(ge=1, le=100)] = 3
    """How many times each row is trained, with the seed of ``train`` and those after it."""
    quick: Quick = Quick()
    """Changes to all rows with ``--quick``."""
    notes: tuple[str, ...] = ()
    """Sentences below the table."""

    def data_recipe(self, row: Row, *, quick: bool) -> Recipe:
        """The recipe of the row's dataset."""
        objects = list(row.objects or self.objects)
        if quick and self.quick.objects is not None and row.objects is None:
            chosen = [_object_name(entry) for entry in self.quick.objects]
            objects = [entry for entry in objects if _object_name(entry) in chosen]
        merged = self._merged(self.data, row.data, self.quick.data if quick else {})
        return Recipe.model_validate(merged | {"objects": objects})

    def test_recipe(self, row: Row, *, quick: bool) -> Recipe:
        """The recipe of the dataset that the row is tested on."""
        if row.test is None:
            return self.data_recipe(row, quick=quick)
        changes = {
            "data": merged_mapping(row.data, row.test.data),
            "objects": row.test.objects or row.objects,
        }
        return self.data_recipe(row.model_copy(update=changes), quick=quick)

    def train_recipe(self, row: Row, *, quick: bool) -> TrainRecipe:
        """The training recipe of the row."""
        merged = self._merged(self.train, row.train, self.quick.train if quick else {})
        return TrainRecipe.model_validate(merged)

    def n_seeds(self, *, quick: bool) -> int:
        """How many times each row is trained."""
        return (self.quick.seeds if quick else None) or self.seeds

    def seeded(self, recipe: TrainRecipe, *, quick: bool) -> list[TrainRecipe]:
        """A training recipe with each of the study's seeds."""
        seeds = range(recipe.seed, recipe.seed + self.n_seeds(quick=quick))
        return [recipe.model_copy(update={"seed": seed}) for seed in seeds]

    def _merged(self, *parts: Mapping[str, Any]) -> dict[str, Any]:
        return reduce(merged_mapping, parts, {"name": self.name})


def load_study(name: str | Path) -> Study:
    """Read and check the study ``name`` (a path, or the name of a shipped one) and its rows.

    Raises ``RecipeError``, which lists everything that is wrong.
    """
    return load_checked(Study, name, _misplaced, _name_problems, _row_problems)


def run_folder_name(row_name: str) -> str:
    """The folder of a row's run: its name in small letters and digits; signs become words."""
    words = re.sub(r"(?<!\w)[-−](?=\d)", "minus ", row_name.lower()).replace("+", "plus ")
    return re.sub(r"[^a-z0-9]+", "_", words).strip("_")


def with_rows(study: Study, names: Sequence[str]) -> Study:
    """The study with these rows alone; all of them where none is named.

    Raises ``RecipeError``, which lists the names that no row has, and those there are.
    """
    known = [row.name for row in study.rows]
    unknown = [name for name in names if name not in known]
    if unknown:
        rows, wrong = (", ".join(map(repr, listed)) for listed in (known, unknown))
        msg = f"{study.name}: has no row {wrong}; its rows are {rows}"
        raise RecipeError(msg)
    if not names:
        return study
    return study.model_copy(update={"rows": tuple(row for row in study.rows if row.name in names)})


def reductions(study: Study, rows: Sequence[Row]) -> list[str]:
    """What ``--quick`` changes in these rows, such as ``epochs: 15 instead of 30``."""
    changes: dict[str, list[str]] = {}
    for row in rows:
        whole, quick = _sizes(study, row, quick=False), _sizes(study, row, quick=True)
        for name, size in quick.items():
            text = f"{size} instead of {whole[name]}"
            if size != whole[name] and text not in changes.setdefault(name, []):
                changes[name].append(text)
    return [f"{name}: {', '.join(texts)}" for name, texts in changes.items() if texts]


def _sizes(study: Study, row: Row, *, quick: bool) -> dict[str, str]:
    data, train = study.data_recipe(row, quick=quick), study.train_recipe(row, quick=quick)
    height, width = train.input.size_px
    return {
        "objects": str(len(data.objects)),
        "frames": str(data.frames.count if data.frames.mode == "sequence" else 1),
        "sampled grasps": str(data.grid.sample or "all"),
        "training grasps": str(train.training.grasps or "all"),
        "input": f"{width}×{height} px",
        "epochs": str(train.training.epochs),
        "seeds": str(study.n_seeds(quick=quick)),
    }


def merged_mapping(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """``above`` laid over ``below``: mappings key by key, anything else as a whole."""
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        if isinstance(old, Mapping) and isinstance(value, Mapping):
            value = merged_mapping(old, value)
        merged[key] = value
    return merged


def _misplaced(study: Study, source: YamlSource) -> Iterable[str]:
    owners: list[tuple[tuple[str | int, ...], Study | Row]] = [((), study)]
    owners += [(("rows", i), row) for i, row in enumerate(study.rows)]
    return [
        source.problem((*path, part, key), "belongs to the study or its row; move it there")
        for path, owner in owners
        for part in ("data", "train")
        for key in _OWN_KEYS
        if key in getattr(owner, part)
    ]


def _name_problems(study: Study, source: YamlSource) -> Iterator[str]:
    first: dict[str, str] = {}
    for i, row in enumerate(study.rows):
        folder = run_folder_name(row.name)
        if folder in first:
            problem = f"would be kept in the folder of {first[folder]!r}, {folder}; rename one"
            if first[folder] == row.name:
                problem = "is given twice; rename one"
            yield source.problem(("rows", i, "name"), f"= {row.name!r} {problem}")
        first.setdefault(folder, row.name)


def _row_problems(study: Study, source: YamlSource) -> Iterator[str]:
    makers: list[tuple[type[BaseModel], Callable[..., BaseModel]]]
    makers = [
        (Recipe, study.data_recipe),
        (Recipe, study.test_recipe),
        (TrainRecipe, study.train_recipe),
    ]
    for (i, row), (model, make), quick in product(enumerate(study.rows), makers, (False, True)):
        try:
            made = make(row, quick=quick)
            if isinstance(made, Recipe):
                made.robot.spec()
        except TacgenError as error:
            yield source.problem(("rows", i), f"cannot be used: robot: {error}")
        except ValidationError as error:
            for found in error.errors():
                where = ".".join(map(str, found["loc"])) or "the recipe"
                problem = f": {problem_text(found)}"
                if found["type"] in UNKNOWN_KEY:
                    problem = f" {unknown_key_text(model, found['loc'])}"
                yield source.problem(("rows", i), f"cannot be used: {where}{problem}")


def _object_name(entry: Any) -> str:
    """The name of a study's object entry, which is a name or a mapping with one."""
    return str(entry.get("name") if isinstance(entry, Mapping) else entry)
