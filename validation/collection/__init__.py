"""Studies of collecting: how many grasps a given accuracy needs."""
