"""Training data for tactile robots: simulated grasps, GelSight images and their outcomes.

The names that ``__init__.pyi`` lists are loaded when they are first used, so that ``import
tacgen`` stays quick. Its environments are registered when Gymnasium is imported, before or after.
"""

import importlib.util
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _WhenGymnasiumIsImported:
    """A finder of modules that registers the environments as soon as Gymnasium is there."""

    @staticmethod
    def find_spec(name: str, *_: Any) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(_WhenGymnasiumIsImported)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module: ModuleType) -> None:
                load(module)
                importlib.import_module("tacgen.envs")

            spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec


if sys.modules.get("gymnasium"):
    importlib.import_module("tacgen.envs")
else:
    sys.meta_path.insert(0, _WhenGymnasiumIsImported)
