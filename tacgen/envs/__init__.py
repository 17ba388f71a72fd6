"""Grasping and regrasping as environments of Gymnasium, and the policy that acts on touch."""
