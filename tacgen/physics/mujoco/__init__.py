"""MuJoCo as an engine of grasps, with the methods of ``tacgen.physics.bullet.Engine``."""

from tacgen.physics.mujoco.simulation import Engine

__all__ = ["Engine"]
