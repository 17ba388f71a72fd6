"""Grasp-stability networks: trained on datasets of simulated grasps, tested on those and real ones.

Everything that needs torch is imported where it is used, after ``require_learning_extra`` has said
plainly what is missing; recipes can be checked without it.
"""
