"""MuJoCo as an engine of grasps."""

from tacgen.physics.mujoco.simulation import MujocoEngine

__all__ = ["MujocoEngine"]
