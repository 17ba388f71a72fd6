"""Studies of the simulated grasp; see docs/results/physics.md."""
