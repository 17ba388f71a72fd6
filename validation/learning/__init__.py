"""Studies of the networks: what augmentation the cameras call for, and transfer to other images."""
