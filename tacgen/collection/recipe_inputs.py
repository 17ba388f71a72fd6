"""What a result of a recipe depends on; apart from the recipe, which is read without all this."""

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tacgen.collection.recipe import Recipe
from tacgen.contact.law import ContactLaw, load_law
from tacgen.core.files import sha256_of, sha256_of_content
from tacgen.core.resources import sensor_path
from tacgen.core.sensors import load_sensor
from tacgen.dataset.input_hashes import OBJECT, Inputs, library_versions
from tacgen.objects.description import read_description

_OF_THE_GRID = {"name", "description", "objects", "grid", "sensor"}
_ABOUT_AN_OBJECT = {"name", "description", "grasp_ranges", "dimensions_mm"}


def recipe_inputs(recipe: Recipe, objects: Iterable[str] | None = None) -> Inputs:
    """What a result of ``recipe`` depends on; of those ``objects``, by default of all its own.

    Raises ``TacgenError`` if one of the files cannot be used.
    """
    sensor, engine = load_sensor(recipe.sensor, needs_table=False), recipe.physics.engine
    sensor_file = sensor_path(recipe.sensor.name, beside=recipe.sensor.folder)
    gripper = recipe.robot.spec().gripper.model_dump(mode="json", exclude={"name", "source"})
    law_path, versions = recipe.contact.path(), library_versions(engine)
    found: dict[str, tuple[object, Path | None]] = {
        "recipe": (_settings(recipe.resolved(), law_path is not None), None),
        "sensor": ({**asdict(sensor), "table": ""}, sensor_file),
        "gripper": (gripper, recipe.robot.gripper_file()),
        "engine": ([engine, versions.get(engine, "")], None),
        "versions": ({k: v for k, v in versions.items() if k != engine}, None),
    }
    if law_path is not None:
        found["contact_law"] = (_law_content(load_law(law_path)), law_path)
    binary = {"table": Path(sensor.table)} if sensor.table else {}
    names = [entry.object_name for entry in recipe.objects] if objects is None else objects
    for name in names:
        entry = recipe.entry_of(name)
        folder = entry.object_folder()
        description = read_description(folder)
        figures = _without_sources(description.model_dump(mode="json", exclude=_ABOUT_AN_OBJECT))
        found[f"{OBJECT}{name}"] = (figures, folder / "object.yaml")
        found[f"{OBJECT}{name}/recipe"] = (entry.figures(), None)
        for part in ("mesh", "collision"):
            if (file := getattr(description.shape, part)) is not None:
                binary[f"{OBJECT}{name}/{part}"] = folder / file
    hashes = {role: sha256_of_content(content) for role, (content, _) in found.items()}
    hashes |= {role: sha256_of(path) for role, path in binary.items()}
    files = {role: str(path) for role, (_, path) in found.items() if path is not None}
    files |= {role: str(path) for role, path in binary.items()}
    return Inputs(dict(sorted(hashes.items())), files, engine, versions)


def _settings(recipe: Mapping[str, Any], law_is_a_file: bool) -> dict[str, Any]:
    """What a grasp depends on in a resolved recipe, whichever other grasps there are."""
    settings = {name: value for name, value in recipe.items() if name not in _OF_THE_GRID}
    settings["dataset"] = {k: v for k, v in recipe["dataset"].items() if k != "shard_size"}
    contact = recipe["contact"]
    kept = {"camera"} if law_is_a_file else contact.keys() - {"file"}
    settings["contact"] = {name: contact[name] for name in kept}
    return settings


def _law_content(law: ContactLaw) -> list[Any]:
    """What a law predicts by: neither the errors of its parameters nor where they come from."""
    k_depth = law.k_depth_mm_per_n
    effects = [
        [one.name, one.channel, dict(one.values), asdict(one.where) if one.where else None]
        for one in law.effects
    ]
    slopes = [law.k_n_mm3_per_n.value, law.k_s_mm_per_n.value, k_depth and k_depth.value]
    margin = [law.collision_margin_mm] if law.collision_margin_mm else []  # hashes of old stay
    return [law.law, *slopes, law.marker_pitch_mm, effects, *margin]


def _without_sources(figures: Any) -> Any:
    """An object's figures without the sentences that say where they come from."""
    if isinstance(figures, dict):
        return {k: _without_sources(v) for k, v in figures.items() if k != "source"}
    return figures
