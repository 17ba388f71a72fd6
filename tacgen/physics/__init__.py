"""Simulated grasps in PyBullet or MuJoCo: robots, bodies, phases, labels and slip margins."""

from tacgen.physics.grasp import GelModel, GraspSimulator, run_grasp
from tacgen.physics.settings import FrameRequest, PhysicsSettings

__all__ = ["FrameRequest", "GelModel", "GraspSimulator", "PhysicsSettings", "run_grasp"]
