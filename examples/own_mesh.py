"""One's own mesh pressed into a GelSight Mini: `python examples/own_mesh.py [MESH] [OUT.png]`."""

import sys

import cv2
import numpy as np
import trimesh

import tacgen

mesh = trimesh.load(sys.argv[1]) if len(sys.argv) > 1 else trimesh.creation.box((6, 6, 6))
pose = trimesh.transformations.rotation_matrix(np.radians(45), (1, 0, 0))  # an edge first
frame = tacgen.Sensor("gelsight_mini", shadows=True).render(mesh, pose, force_n=4.0)
cv2.imwrite(sys.argv[2] if len(sys.argv) > 2 else "own_mesh.png", frame.rgb[..., ::-1])
print(f"indented {frame.indentation_mm:.2f} mm deep, {frame.volume_mm3:.1f} mm³")  # noqa: T201
