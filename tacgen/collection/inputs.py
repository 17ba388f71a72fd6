"""What a result of a recipe depends on; apart from the recipe, which is read without all this."""

from collections.abc import Iterable

from tacgen.collection.recipe import Recipe
from tacgen.contact.law import load_law
from tacgen.core.resources import sensor_path
from tacgen.dataset.inputs import Inputs, result_inputs
from tacgen.sensor.description import load_sensor


def recipe_inputs(recipe: Recipe, objects: Iterable[str] | None = None) -> Inputs:
    """What a result of ``recipe`` depends on; of those ``objects``, by default of all its own.

    Raises ``TacgenError`` if one of the files cannot be used.
    """
    law_path, sensor = recipe.contact.path(), recipe.sensor
    gripper, gripper_file = recipe.robot.spec().gripper, recipe.robot.gripper_file()
    names = [entry.object_name for entry in recipe.objects] if objects is None else objects
    entries = {name: recipe.entry_of(name) for name in names}
    return result_inputs(
        recipe.resolved(),
        objects={name: (one.object_folder(), one.figures()) for name, one in entries.items()},
        sensor=load_sensor(sensor, needs_table=False),
        sensor_file=sensor_path(sensor.name, beside=sensor.folder),
        law=None if law_path is None else (load_law(law_path), law_path),
        gripper=(gripper.model_dump(mode="json", exclude={"name", "source"}), gripper_file),
        engine=recipe.physics.engine,
    )
