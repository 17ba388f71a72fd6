"""Training data for robots that feel: grasps, GelSight images and their outcomes."""

__version__ = "0.1.0"
