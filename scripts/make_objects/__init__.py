"""The meshes of the shipped objects, made from their dimensions."""
