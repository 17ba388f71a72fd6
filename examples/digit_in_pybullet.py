"""A DIGIT in a PyBullet script: `python examples/digit_in_pybullet.py [OUT.png]`.

The sensor takes the four lines marked with `# sensor`.
"""

import sys

import cv2
import numpy as np
import pybullet as p

import tacgen  # sensor

p.connect(p.DIRECT)
p.setGravity(0, 0, -9.81)
finger = p.createMultiBody(0, p.createCollisionShape(p.GEOM_BOX, halfExtents=[0.02, 0.02, 0.01]))
ball = p.createMultiBody(
    0.4, p.createCollisionShape(p.GEOM_SPHERE, radius=0.006), basePosition=[0.001, 0, 0.0161]
)
gel = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 10], [0, 0, 0, 1.0]])  # on top, mm

digit = tacgen.Sensor("digit").attach_pybullet(finger, pose_link_gel=gel)  # sensor
digit.add_object(ball)  # sensor
for _ in range(240):
    p.stepSimulation()
frame = digit.read()  # sensor

cv2.imwrite(sys.argv[1] if len(sys.argv) > 1 else "digit.png", frame.rgb[..., ::-1])
print(f"{frame.force_n[2]:.2f} N, {frame.indentation_mm:.2f} mm")  # noqa: T201
