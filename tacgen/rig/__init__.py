"""A virtual ball-press rig: press logs and press images whose truth is known."""

from tacgen.rig.rig_recipe import RigRecipe, load_rig_recipe
from tacgen.rig.run import run_rig, simulate_session

__all__ = ["RigRecipe", "load_rig_recipe", "run_rig", "simulate_session"]
