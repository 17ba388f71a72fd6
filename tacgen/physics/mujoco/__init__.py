"""MuJoCo as an engine of grasps."""

from tacgen.physics.mujoco.simulation import Engine

__all__ = ["Engine"]
