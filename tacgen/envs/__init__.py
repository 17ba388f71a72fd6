"""Grasping and regrasping as environments of Gymnasium, and the policy that acts on touch.

Importing it registers ``tacgen/Grasp-v0`` and ``tacgen/Regrasp-v0`` where Gymnasium is installed:
``gymnasium.make("tacgen:tacgen/Grasp-v0", recipe="quickstart")`` does so by itself.
"""

from importlib import import_module
from typing import Any

from tacgen.core.errors import LearningError, missing_extra, require_extra

__all__ = ["GraspEnv", "Normalized", "RegraspEnv"]
_IDS = {"tacgen/Grasp-v0": ("GraspEnv", 2), "tacgen/Regrasp-v0": ("RegraspEnv", 100)}
"""Class and ``max_episode_steps``: one more than an episode can have. Gymnasium calls a step that
reaches it truncated, even where the episode has ended, and learners then add to its reward."""


def _register() -> None:
    from gymnasium.envs import registration  # an extra

    for name, (class_name, steps) in _IDS.items():
        if name not in registration.registry:
            registration.register(
                name, f"tacgen.envs.grasping:{class_name}", max_episode_steps=steps
            )


if not missing_extra("gym", ""):
    _register()


def __getattr__(name: str) -> Any:
    if name not in __all__:
        msg = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(msg)
    require_extra("gym", "environments need", LearningError)
    return getattr(import_module("tacgen.envs.grasping"), name)
