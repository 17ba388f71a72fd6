"""Training data for robots that feel: grasps, GelSight images and their outcomes.

The names below are loaded when they are first used, so that ``import tacgen`` stays quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tacgen.collection.recipe import load_recipe
    from tacgen.collection.run import collect
    from tacgen.contact.law import load_law
    from tacgen.dataset.reader import Dataset
    from tacgen.learning.predictor import Predictor
    from tacgen.optics.table import load_table
    from tacgen.presses.read_image import read_image
    from tacgen.sensor.simulated import Sensor

__version__: str
"""That of the installed package, which follows the git tags."""

_HOMES = {
    "Dataset": "tacgen.dataset.reader",
    "Predictor": "tacgen.learning.predictor",
    "Sensor": "tacgen.sensor.simulated",
    "collect": "tacgen.collection.run",
    "load_law": "tacgen.contact.law",
    "load_recipe": "tacgen.collection.recipe",
    "load_table": "tacgen.optics.table",
    "read_image": "tacgen.presses.read_image",
}

__all__ = [
    "Dataset",
    "Predictor",
    "Sensor",
    "collect",
    "load_law",
    "load_recipe",
    "load_table",
    "read_image",
]


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module("tacgen.core.version").VERSION
    if name not in _HOMES:
        msg = f"module 'tacgen' has no attribute {name!r}; it has {', '.join(__all__)}"
        raise AttributeError(msg)
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
