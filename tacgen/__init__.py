"""Training data for tactile robots: simulated grasps, GelSight images and their outcomes.

The names that ``__init__.pyi`` lists are loaded when they are first used, so that ``import
tacgen`` stays quick. Where Gymnasium is imported already, its environments are registered.
"""

import importlib
import sys

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

if sys.modules.get("gymnasium"):
    importlib.import_module("tacgen.envs")
