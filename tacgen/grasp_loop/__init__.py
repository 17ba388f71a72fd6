"""Real grasps against simulated worlds: the joint of physics, images and the loop on labels."""
