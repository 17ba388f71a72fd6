"""Studies of the simulated grasp; see docs/physics.md."""
