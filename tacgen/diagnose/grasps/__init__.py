"""The loop on grasp labels: candidates, their evidence, and what the labels choose."""
