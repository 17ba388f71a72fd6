"""Commands for recipes: show one with all of its settings, JSON schemas, a new project."""

import json
import re
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from pydantic import BaseModel
from typer import Argument

from tacgen.cli import common
from tacgen.cli.common import quoted
from tacgen.core.errors import RecipeError, require_known

PROJECT_FILES = {
    "recipe.yaml": "recipe.yaml",
    "object.yaml": "objects/ball/object.yaml",
    "README.md": "README.md",
}
"""Files of a new project, by the template of each."""


def recipe_kinds() -> dict[str, tuple[type[BaseModel], Callable[[str], BaseModel]]]:
    """Model and loader of each kind of recipe, by the command that runs it."""
    from tacgen.collection.recipe import Recipe, load_recipe
    from tacgen.learning.training_recipe import TrainRecipe, load_train_recipe
    from tacgen.rig.rig_recipe import RigRecipe, load_rig_recipe
    from tacgen.study.study_recipe import Study, load_study

    return {
        "collect": (Recipe, load_recipe),
        "rig": (RigRecipe, load_rig_recipe),
        "train": (TrainRecipe, load_train_recipe),
        "study": (Study, load_study),
    }


@common.recipe_app.command("show")
def recipe_show(recipe: common.RecipeArgument, json_output: common.JsonFlag = False) -> None:
    """Print a recipe with every setting: what it extends and all defaults filled in."""
    from tacgen.collection.recipe import Recipe
    from tacgen.core.resources import find_recipe
    from tacgen.core.schema import kind_of, read_yaml

    path = find_recipe(recipe)
    kinds = {model.__name__: (name, load) for name, (model, load) in recipe_kinds().items()}
    name, load = kinds.get(kind_of(read_yaml(path).data), kinds["Recipe"])
    loaded = load(str(path))
    settings = loaded.model_dump(mode="json")
    if isinstance(loaded, Recipe):
        settings |= loaded.resolved()
    text = yaml.safe_dump(settings, sort_keys=False, allow_unicode=True, default_flow_style=None)
    common.print_result(settings, text.rstrip("\n"), json_output)
    options = {"collect": "--out data", "train": "--data data --out run"}
    common.hand_over(f"tacgen {name} {quoted(recipe)} {options.get(name, f'--out {name}')}")


@common.recipe_app.command("schema")
def recipe_schema(
    kind: Annotated[
        str, Argument(help="collect, rig, train or study: the command that runs the recipe.")
    ] = "collect",
) -> None:
    """Print the JSON schema of a kind of recipe, with which editors complete and check keys."""
    typer.echo(json.dumps(schema_of(kind), indent=2, ensure_ascii=False))
    common.hand_over(
        f"tacgen recipe schema {kind} > .{kind}.schema.json",
        "and as the first line of the recipe (VS Code with the YAML extension, PyCharm, …):",
        f"# yaml-language-server: $schema=.{kind}.schema.json",
    )


def schema_of(kind: str) -> dict[str, Any]:
    """The JSON schema of the recipes that ``tacgen <kind>`` runs; ``RecipeError`` if none does."""
    kinds = recipe_kinds()
    require_known("kind of recipe", kind, kinds, RecipeError)
    schema = kinds[kind][0].model_json_schema()
    schema["properties"]["extends"] = {
        "description": "Recipes (names or paths) whose settings this one changes.",
        "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}],
    }
    # A recipe that extends another may leave out what the other one has.
    schema.pop("required", None)
    return schema


@common.app.command(rich_help_panel=common.DATASETS)
def init(name: Annotated[str, Argument(help="Name of the project and of its new folder.")]) -> None:
    """Write a project to start from: a commented recipe, an object and a README."""
    folder = Path(name)
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", folder.name):
        msg = f"{folder.name!r}: use letters, digits, `_`, `.` and `-` in the name of a project"
        raise RecipeError(msg)
    if folder.exists():
        msg = f"{folder}: exists already; give a new name"
        raise RecipeError(msg)
    templates = files("tacgen.cli") / "templates"
    for template, target in PROJECT_FILES.items():
        text = (templates / template).read_text(encoding="utf-8")
        (folder / target).parent.mkdir(parents=True, exist_ok=True)
        (folder / target).write_text(text.replace("PROJECT", folder.name), encoding="utf-8")
        typer.echo(folder / target)
    common.hand_over(f"cd {quoted(folder)}", "tacgen collect recipe.yaml --out data")
