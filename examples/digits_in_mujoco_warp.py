"""A DIGIT in each of 64 worlds of MuJoCo Warp, on the CPU or a GPU.

`pip install mujoco-warp 'tacgen[batch]'`, `python examples/digits_in_mujoco_warp.py [PNG] [DEVICE]`
"""

import sys

import cv2
import mujoco
import mujoco_warp
import numpy as np
import trimesh
import warp as wp

import tacgen

N = 64
MODEL = """<mujoco><option timestep="0.002"/><worldbody>
  <body name="finger"><geom type="box" size=".02 .02 .01"/>
    <site name="gel" type="box" size=".02 .02 .012"/></body>
  <body name="ball" pos="0 0 .0161">
    <freejoint/><geom type="sphere" size=".006" mass=".1"/>
  </body>
</worldbody><sensor><touch site="gel"/></sensor></mujoco>"""

model = mujoco.MjModel.from_xml_string(MODEL)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
ball = model.body("ball").id
wp.set_device(sys.argv[2] if len(sys.argv) > 2 else "cpu")

# Each world has its ball in a place of its own, pressed by a force of its own.
along = np.linspace(-1, 1, 8)
places = np.stack(np.meshgrid(along, along), axis=-1).reshape(N, 2)
model_warp, data_warp = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data, nworld=N)
start, push = data_warp.qpos.numpy(), data_warp.xfrc_applied.numpy()
start[:, :2] += 1e-3 * np.array([4.0, 5.0]) * places  # m
push[:, ball, 2] = -np.linspace(0.0, 6.0, N)  # N
data_warp.qpos.assign(start)
data_warp.xfrc_applied.assign(push)

digits = tacgen.BatchSensor("digit", N, str(wp.get_device()))
sphere = digits.add_mesh(trimesh.creation.icosphere(subdivisions=4, radius=6.0))  # mm
for _ in range(150):
    mujoco_warp.step(model_warp, data_warp)

# The gel lies on top of the finger: world to gel frame is a step along z, in mm.
poses = np.tile(np.eye(4), (N, 1, 1))
poses[:, :3, :3] = data_warp.xmat.numpy()[:, ball].reshape(N, 3, 3)
poses[:, :3, 3] = 1e3 * (data_warp.xpos.numpy()[:, ball] - [0, 0, 0.01])
ids = wp.full(N, sphere, dtype=wp.int32)
forces = wp.clone(data_warp.sensordata[:, 0])  # N, of the engine's contacts
frames = digits.render_meshes(ids, wp.array(poses, dtype=wp.float64), forces)

rgb = frames.rgb.numpy().reshape(8, 8, *digits.description.shape_px, 3)
sheet = rgb.transpose(0, 2, 1, 3, 4).reshape(8 * rgb.shape[2], -1, 3)
cv2.imwrite(sys.argv[1] if len(sys.argv) > 1 else "digits.png", sheet[::2, ::2, ::-1])
force_n, depth_mm = forces.numpy(), frames.indentation_mm.numpy()
print(f"{force_n.min():.2f} to {force_n.max():.2f} N, {depth_mm.max():.2f} mm")  # noqa: T201
