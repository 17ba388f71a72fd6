"""A recipe extended by what a diagnosis found, for ``tacgen collect``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from tacgen.collection.perturbed import Alteration, altered_object, altered_settings
from tacgen.collection.pipeline import recipe_object
from tacgen.collection.recipe import ObjectEntry, Recipe
from tacgen.core.files import write_text
from tacgen.diagnose.grasps.model_comparison import Standing
from tacgen.diagnose.grasps.perturbed_worlds import combined_world, declared_object

_SETTINGS = (
    "delivered_force_scale",
    "delivered_force_offset_n",
    "height_offset_mm",
    "pad_stiffness_n_mm",
)


def extended_recipe(recipe: Recipe, found: Sequence[Standing], objects: Sequence[str]) -> Recipe:
    """The recipe in whose world everything that was found holds.

    Objects that were grasped but are not in the recipe are added to it, so that what was found
    about them is not lost.
    """
    if not found:
        return recipe
    content = recipe.resolved()
    names = [entry["name"] for entry in content["objects"]]
    content["objects"] += [
        declared_object(recipe, name).model_dump(mode="json")
        for name in objects
        if name not in names
    ]
    for entry in content["objects"]:
        world = combined_world(found, entry["name"])
        entry.update(_changed_figures(recipe, entry["name"], world))
    everywhere = altered_settings(recipe.physics_settings, combined_world(found, ""))
    content["physics"] |= {name: getattr(everywhere, name) for name in _SETTINGS}
    content["name"] = f"{recipe.name}_extended"
    return Recipe.model_validate(content)


def write_extended_recipe(recipe: Recipe, path: Path) -> None:
    """Write a recipe as YAML that ``load_recipe`` reads back."""
    text = yaml.safe_dump(recipe.resolved(), sort_keys=False, allow_unicode=True)
    write_text(path, text)


def _changed_figures(recipe: Recipe, name: str, world: Alteration) -> dict[str, Any]:
    """What an object's entry must say for the altered world to hold."""
    entry: ObjectEntry = declared_object(recipe, name)
    before = recipe_object(entry)
    after = altered_object(before, world)
    changes: dict[str, Any] = {}
    if after.mass_kg != before.mass_kg:
        changes["mass_kg"] = round(after.mass_kg, 6)
    if after.friction != before.friction:
        changes["friction"] = round(after.friction, 6)
    if world.object_scale != 1.0:
        changes["scale"] = round(entry.scale * world.object_scale, 6)
    if world.spinning_friction_factor != 1.0:
        changes["spinning_friction_mm"] = round(after.spinning_friction_mm, 6)
    shift = (world.center_of_mass_x_mm, world.center_of_mass_y_mm, world.center_of_mass_z_mm)
    if any(shift):
        changes["center_of_mass_offset_mm"] = [
            round(old + new, 4)
            for old, new in zip(entry.center_of_mass_offset_mm, shift, strict=True)
        ]
    return changes
