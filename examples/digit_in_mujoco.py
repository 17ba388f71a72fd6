"""A DIGIT in a MuJoCo script (`pip install mujoco`): `python examples/digit_in_mujoco.py [PNG]`."""

import sys

import cv2
import mujoco
import numpy as np

import tacgen

MODEL = """<mujoco><worldbody>
  <body name="finger"><geom type="box" size=".02 .02 .01"/></body>
  <body name="ball" pos=".001 0 .0161">
    <freejoint/><geom type="sphere" size=".006" mass=".4"/>
  </body>
</worldbody></mujoco>"""

model = mujoco.MjModel.from_xml_string(MODEL)
data = mujoco.MjData(model)
gel = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 10], [0, 0, 0, 1.0]])  # on top, mm

digit = tacgen.Sensor("digit").attach_mujoco(model, data, "finger", pose_body_gel=gel)
digit.add_object("ball")
for _ in range(500):
    mujoco.mj_step(model, data)
frame = digit.read()

cv2.imwrite(sys.argv[1] if len(sys.argv) > 1 else "digit.png", frame.rgb[..., ::-1])
print(f"{frame.force_n[2]:.2f} N, {frame.indentation_mm:.2f} mm")  # noqa: T201
