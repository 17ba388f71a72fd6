"""The sensor for one's own script: closed forms, and the same frame from a running simulation."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import tacgen
import tacgen.contact
from tacgen.core.errors import ContactError, SensorError, TableError
from tacgen.sensor.simulated import Sensor, as_mesh
from tests.messages import refused, warned

BALL = trimesh.creation.icosphere(subdivisions=5, radius=4.0)
GRAVITY_M_S2 = 9.81


@pytest.fixture(scope="module")
def sensor():
    return Sensor("gelsight_mini")


@pytest.mark.slow
def test_the_gel_gives_way_by_k_n_f(sensor):
    for force_n in (1.0, 3.0, 6.0):
        frame = sensor.render(BALL, np.eye(4), force_n=force_n)
        assert frame.volume_mm3 == pytest.approx(5.135 * force_n, rel=0.01)
        assert frame.depth_mm.sum() * sensor.description.pixel_area_mm2 == pytest.approx(
            frame.volume_mm3, rel=1e-5
        )
        assert frame.contact_mask.sum() == (frame.depth_mm > 0).sum()
        assert frame.force_n.tolist() == [0.0, 0.0, force_n]


def test_trimesh_pairs_and_meshes_are_one(sensor):
    frames = [
        sensor.render(mesh, np.eye(4), 2.0).rgb
        for mesh in (BALL, (BALL.vertices, BALL.faces), as_mesh(BALL))
    ]
    assert np.array_equal(frames[0], frames[1])
    assert np.array_equal(frames[0], frames[2])


def test_shear_moves_the_markers():
    sensor = Sensor("gelsight_mini", markers=True)
    still = sensor.render(BALL, np.eye(4), 3.0)
    pulled = sensor.render(BALL, np.eye(4), 3.0, shear_n=(1.0, 0.0))
    motion_mm = (pulled.markers_px - still.markers_px) * sensor.description.mm_per_px
    assert motion_mm[:, 0].sum() == pytest.approx(1.0, rel=0.02)  # D = k_s F_s
    assert abs(motion_mm[:, 1].sum()) < 0.02


@pytest.mark.parametrize("force_n", [-1.0, np.nan])
def test_a_force_that_cannot_be_is_refused(sensor, force_n):
    with refused(ContactError):
        sensor.render(BALL, np.eye(4), force_n=force_n)


def turned(**changes):
    """A pose turned by 0.3 rad, with some of it changed."""
    pose = trimesh.transformations.rotation_matrix(0.3, (0.2, 0.3, 1.0))
    for change in changes.values():
        pose = change(pose)
    return pose


@pytest.mark.parametrize(
    "change",
    [
        lambda p: p @ np.diag([2.0, 2.0, 2.0, 1.0]),
        lambda p: p @ np.diag([1.01, 1.0, 1.0, 1.0]),
        lambda p: p @ np.diag([1.0, 1.0, -1.0, 1.0]),
        lambda p: np.zeros((4, 4)),
        lambda p: p @ np.diag([0.0, 0.0, 0.0, 1.0]),
        lambda p: p + np.outer(np.eye(4)[0], np.eye(4)[1]) * 0.01,
        lambda p: (p + np.outer(np.eye(4)[0], np.eye(4)[3])).T,
        lambda p: p[:3],
    ],
    ids=["scaled", "stretched", "mirrored", "zero", "no rotation", "sheared", "transposed", "3×4"],
)
def test_a_pose_that_is_none_is_refused_wherever_it_enters(sensor, change):
    pose = turned(change=change)
    with refused(ContactError):
        sensor.render(BALL, pose)
    with refused(ContactError):
        tacgen.contact.gap_map(BALL.vertices, BALL.faces, pose, sensor.description)
    with refused(SensorError):
        sensor.attach_pybullet(0, pose_link_gel=pose)
    with refused(SensorError):
        sensor.attach_mujoco(None, None, 0, pose_body_gel=pose)


def test_a_translation_in_metres_is_warned_of(sensor):
    moved = np.eye(4)
    moved[:3, 3] = 0.003, -0.002, 0.01
    with warned():
        sensor.render(BALL, moved)
    moved[:3, 3] = 3.0, -2.0, 1e-9
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        sensor.render(BALL, moved)


def test_a_mesh_in_metres_is_warned_of_or_refused(sensor):
    small = trimesh.creation.icosphere(subdivisions=3, radius=0.004)
    with (
        warned(),
        refused(ContactError),
    ):
        sensor.render(small, np.eye(4))  # the gel's middle is a corner of four pixels
    with warned():
        sensor.render(trimesh.creation.box((0.3, 0.1, 0.1)), np.eye(4))


@pytest.mark.parametrize("x_mm", [20.0, 100.0])
def test_an_object_beside_the_gel_is_refused(sensor, x_mm):
    moved = np.eye(4)
    moved[0, 3] = x_mm
    with refused(ContactError):
        sensor.render(BALL, moved)
    assert sensor.render(BALL, moved, force_n=0.0).status == "no_contact"


def test_a_frame_says_what_its_image_shows(sensor):
    """Ball presses: in the window, across its edge (10.14 mm), pressed through, not at all."""

    def frame(force_n, x_mm=0.0):
        moved = np.eye(4)
        moved[0, 3] = x_mm
        return sensor.render(BALL, moved, force_n, (0.5, -0.2))

    shown = frame(5.0)
    assert (shown.status, shown.saturated) == ("ok", False)
    assert shown.force_n.tolist() == [0.5, -0.2, 5.0]
    half = frame(5.0, 10.144)
    assert (half.status, half.saturated) == ("outside_window", False)
    assert half.force_n[2] == pytest.approx(2.5, rel=0.05)
    assert half.volume_mm3 == pytest.approx(5.135 * half.force_n[2], rel=0.01)
    np.testing.assert_allclose(half.force_n / half.force_n[2], shown.force_n / 5.0)
    beside = frame(5.0, 13.9)
    assert beside.status == "outside_window"
    assert not beside.contact_mask.any()
    assert beside.force_n.tolist() == [0.0, 0.0, 0.0]
    assert np.array_equal(beside.rgb, sensor.at_rest_rgb())
    through = frame(500.0)
    assert through.saturated
    # A cap as deep as the ball's radius: its half, 2/3 π R³.
    assert through.volume_mm3 == pytest.approx(2 / 3 * np.pi * 4.0**3, rel=0.01)
    none = frame(0.0)
    assert (none.status, none.saturated) == ("no_contact", False)


def test_shear_of_what_the_window_shows_moves_its_markers():
    sensor = Sensor("gelsight_mini", markers=True)
    edge = np.eye(4)
    edge[0, 3] = 160 * sensor.description.mm_per_px
    still, pulled = (sensor.render(BALL, edge, 3.0, (x_n, 0.0)) for x_n in (0.0, 1.0))
    motion_mm = (pulled.markers_px - still.markers_px) * sensor.description.mm_per_px
    # Of a contact that the window's border halves, with dots 2 mm apart beside it.
    assert motion_mm[:, 0].sum() == pytest.approx(pulled.force_n[0], rel=0.15)
    assert pulled.force_n[0] == pytest.approx(0.5, abs=0.1)


def test_markers_of_a_sensor_without_any_are_refused():
    with refused(SensorError):
        Sensor("digit", markers=True)
    assert Sensor("digit").render(BALL, np.eye(4)).markers_px is None


def test_a_table_of_another_dome_is_refused(tmp_path):
    """At rest its picture would be another: of a flat gel with the shading of a dome."""
    from tacgen.optics.table import ContactLight, save_table

    own = Sensor("gelsight")
    flat = replace(
        own.table,
        response=np.zeros((2, 3, 2, 2, 3), np.float32),
        contact=ContactLight(np.zeros((2, 2, 3, 3), np.float32), 0.3, 0.0),
    )
    save_table(flat, tmp_path / "flat.npz")
    with refused(TableError):
        Sensor("gelsight", table=tmp_path / "flat.npz")


def test_what_is_no_mesh_is_refused(sensor):
    with refused(ContactError):
        sensor.render("ball.stl", np.eye(4))


def test_reading_before_attaching_is_refused(sensor):
    with refused(SensorError):
        sensor.read()


@pytest.fixture
def bullet():
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -GRAVITY_M_S2, physicsClientId=client)
    yield client
    pybullet.disconnect(client)


def rest_on_pad(client, mass_kg, *, at_m=(0.0, 0.0), box=False):
    """A ball, or a box, at rest on a fixed block whose upper face is the gel."""
    import pybullet as p

    block = p.createCollisionShape(
        p.GEOM_BOX, halfExtents=[0.05, 0.05, 0.01], physicsClientId=client
    )
    pad = p.createMultiBody(0, block, physicsClientId=client)
    if box:
        half = {"shapeType": p.GEOM_BOX, "halfExtents": [0.004, 0.004, 0.004]}
    else:
        half = {"shapeType": p.GEOM_SPHERE, "radius": 0.004}
    sphere = p.createCollisionShape(**half, physicsClientId=client)
    ball = p.createMultiBody(mass_kg, sphere, basePosition=[*at_m, 0.0141], physicsClientId=client)
    for _ in range(480):
        p.stepSimulation(physicsClientId=client)
    return pad, ball


def gel_on_top():
    pose = np.eye(4)
    pose[2, 3] = 10.0  # mm: the block's upper face
    return pose


def test_a_ball_at_rest_in_pybullet_is_a_ball_pressed_by_its_weight(bullet):
    pad, ball = rest_on_pad(bullet, 0.3)
    sensor = Sensor("gelsight_mini")
    sensor.attach_pybullet(pad, pose_link_gel=gel_on_top(), client_id=bullet).add_object(ball)
    frame = sensor.read()
    assert frame.force_n[2] == pytest.approx(0.3 * GRAVITY_M_S2, rel=0.01)
    assert frame.volume_mm3 == pytest.approx(5.135 * frame.force_n[2], rel=0.01)
    found = sensor._attached().contact()
    again = sensor.render(
        *(found.mesh, found.pose_gel_object, found.force_n[2], found.force_n[:2]),
        torsion_n_mm=found.torsion_n_mm,
    )
    assert np.array_equal(frame.rgb, again.rgb)
    assert np.array_equal(frame.depth_mm, again.depth_mm)


@pytest.mark.parametrize("substeps", [0, 1, 3, 10])
def test_substeps_of_pybullet_do_not_divide_the_force(bullet, substeps):
    import pybullet as p

    p.setPhysicsEngineParameter(numSubSteps=substeps, physicsClientId=bullet)
    # On a slope of 3 in 5 the weight acts as 4/5 into the gel and 3/5 along it.
    p.setGravity(0.2 * GRAVITY_M_S2, 0, -GRAVITY_M_S2, physicsClientId=bullet)
    pad, box = rest_on_pad(bullet, 0.3, box=True)
    sensor = Sensor("gelsight_mini")
    sensor.attach_pybullet(pad, pose_link_gel=gel_on_top(), client_id=bullet).add_object(box)
    force_n = sensor.read().force_n
    assert force_n[2] == pytest.approx(0.3 * GRAVITY_M_S2, rel=0.02)
    assert force_n[0] == pytest.approx(0.06 * GRAVITY_M_S2, rel=0.05)


@pytest.mark.parametrize("changed", [{"fixedTimeStep": 1 / 60}, {"numSubSteps": 8}])
def test_what_is_set_after_a_step_does_not_change_its_force(bullet, changed):
    import pybullet as p

    pad, ball = rest_on_pad(bullet, 0.3)
    sensor = Sensor("gelsight_mini")
    sensor.attach_pybullet(pad, pose_link_gel=gel_on_top(), client_id=bullet).add_object(ball)
    before = sensor.read().force_n[2]
    p.setPhysicsEngineParameter(**changed, physicsClientId=bullet)
    assert sensor.read().force_n[2] == pytest.approx(before, rel=1e-9)
    for _ in range(240):
        p.stepSimulation(physicsClientId=bullet)
    assert sensor.read().force_n[2] == pytest.approx(before, rel=0.02)


@pytest.mark.parametrize("read_before", [False, True])
@pytest.mark.parametrize("what", ["object", "gel"])
def test_what_was_moved_away_since_the_step_does_not_press(bullet, what, read_before):
    import pybullet as p

    pad, ball = rest_on_pad(bullet, 0.3)
    sensor = Sensor("gelsight_mini")
    sensor.attach_pybullet(pad, pose_link_gel=gel_on_top(), client_id=bullet).add_object(ball)
    if read_before:
        assert sensor.read().force_n[2] > 2.0
    body, at = (ball, [0.0, 0.0, 0.03]) if what == "object" else (pad, [0.0, 0.0, -0.03])
    p.resetBasePositionAndOrientation(body, at, [0, 0, 0, 1], physicsClientId=bullet)
    frame = sensor.read()
    assert frame.force_n.tolist() == [0.0, 0.0, 0.0]
    assert not frame.contact_mask.any()
    p.resetBasePositionAndOrientation(pad, [0, 0, 0], [0, 0, 0, 1], physicsClientId=bullet)
    p.resetBasePositionAndOrientation(ball, [0, 0, 0.0141], [0, 0, 0, 1], physicsClientId=bullet)
    for _ in range(480):
        p.stepSimulation(physicsClientId=bullet)
    assert sensor.read().force_n[2] == pytest.approx(0.3 * GRAVITY_M_S2, rel=0.02)


def test_what_was_moved_and_still_touches_has_no_known_force(bullet):
    import pybullet as p

    pad, ball = rest_on_pad(bullet, 0.3)
    sensor = Sensor("gelsight_mini")
    sensor.attach_pybullet(pad, pose_link_gel=gel_on_top(), client_id=bullet).add_object(ball)
    sensor.read()
    at, turned = p.getBasePositionAndOrientation(ball, physicsClientId=bullet)
    p.resetBasePositionAndOrientation(ball, [0.005, 0.0, at[2]], turned, physicsClientId=bullet)
    with refused(SensorError):
        sensor.read()
    p.stepSimulation(physicsClientId=bullet)
    sensor.read()


def test_a_joint_that_was_reset_takes_the_gel_away(bullet):
    import pybullet as p

    block = p.createCollisionShape(
        p.GEOM_BOX, halfExtents=[0.05, 0.05, 0.01], physicsClientId=bullet
    )
    slide = p.createMultiBody(
        0, linkMasses=[1.0], linkCollisionShapeIndices=[block], linkVisualShapeIndices=[-1],
        linkPositions=[[0, 0, 0]], linkOrientations=[[0, 0, 0, 1]],
        linkInertialFramePositions=[[0, 0, 0]], linkInertialFrameOrientations=[[0, 0, 0, 1]],
        linkParentIndices=[0], linkJointTypes=[p.JOINT_PRISMATIC], linkJointAxis=[[0, 0, 1]],
        physicsClientId=bullet,
    )  # fmt: skip
    held = {"controlMode": p.POSITION_CONTROL, "targetPosition": 0.0, "force": 500.0}
    p.setJointMotorControl2(slide, 0, **held, physicsClientId=bullet)
    sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=0.004, physicsClientId=bullet)
    ball = p.createMultiBody(0.3, sphere, basePosition=[0, 0, 0.0141], physicsClientId=bullet)
    for _ in range(480):
        p.stepSimulation(physicsClientId=bullet)
    sensor = Sensor("gelsight_mini")
    sensor.attach_pybullet(slide, 0, pose_link_gel=gel_on_top(), client_id=bullet)
    sensor.add_object(ball)
    assert sensor.read().force_n[2] == pytest.approx(0.3 * GRAVITY_M_S2, rel=0.02)
    p.resetJointState(slide, 0, -0.02, physicsClientId=bullet)
    assert sensor.read().force_n.tolist() == [0.0, 0.0, 0.0]


def test_an_object_that_is_not_there_is_refused(bullet):
    pad, _ = rest_on_pad(bullet, 0.1)
    sensor = Sensor("gelsight_mini").attach_pybullet(pad, client_id=bullet)
    with refused(SensorError):
        sensor.read()
    with refused(SensorError):
        sensor.add_object(77)
    with refused(SensorError):
        Sensor("gelsight_mini").attach_pybullet(pad, 5, client_id=bullet)


def test_the_same_ball_in_mujoco():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.001"/><worldbody>
        <body name="pad"><geom type="box" size=".05 .05 .01"/></body>
        <body name="ball" pos=".003 -.002 .0141"><freejoint/>
        <geom type="sphere" size=".004" mass=".3"/></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    for _ in range(2000):
        mujoco.mj_step(model, data)
    sensor = Sensor("gelsight_mini")
    sensor.attach_mujoco(model, data, "pad", pose_body_gel=gel_on_top()).add_object("ball")
    frame = sensor.read()
    assert frame.force_n[2] == pytest.approx(0.3 * GRAVITY_M_S2, rel=0.01)
    assert frame.volume_mm3 == pytest.approx(5.135 * frame.force_n[2], rel=0.01)
    found = sensor._attached().contact()
    again = sensor.render(
        *(found.mesh, found.pose_gel_object, found.force_n[2], found.force_n[:2]),
        torsion_n_mm=found.torsion_n_mm,
    )
    assert np.array_equal(frame.rgb, again.rgb)
    with refused(SensorError):
        sensor.attach_mujoco(model, data, "finger")


@pytest.fixture
def mujoco_drop():
    """A ball at rest on a pad: 0.2 kg, of whose weight MuJoCo compensates a quarter."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.002"/><worldbody>
        <body name="pad"><geom type="box" size=".05 .05 .01"/></body>
        <body name="ball" pos="0 0 .0141" gravcomp=".25"><freejoint/>
        <geom type="sphere" size=".004" mass=".2"/></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    for _ in range(1000):
        mujoco.mj_step(model, data)
    sensor = Sensor("gelsight_mini")
    sensor.attach_mujoco(model, data, "pad", pose_body_gel=gel_on_top()).add_object("ball")
    return mujoco, model, data, sensor


def test_what_mujoco_was_moved_to_is_computed_before_it_is_read(mujoco_drop):
    mujoco, model, data, sensor = mujoco_drop
    assert sensor.read().force_n[2] == pytest.approx(0.15 * GRAVITY_M_S2, rel=0.01)
    resting = data.qpos.copy()
    for place, value in ((2, 0.2), (0, resting[0] + 1e-3), (4, 0.5)):
        data.qpos[:] = resting
        data.qpos[place] = value
        with refused(SensorError):
            sensor.read()
    data.qpos[:] = resting
    data.qpos[2] = 0.2
    mujoco.mj_forward(model, data)
    assert sensor.read().force_n.tolist() == [0.0, 0.0, 0.0]
    for _ in range(80):  # it falls at up to 1.6 m/s and spins: no step looks like a reset
        data.qvel[3:] = (30.0, -20.0, 10.0)
        mujoco.mj_step(model, data)
        sensor.read()


def test_mujocos_forces_are_in_newtons_at_every_setting(mujoco_drop):
    """The balance of forces, at another step, integrator and softness."""
    mujoco, model, data, sensor = mujoco_drop
    kinds = mujoco.mjtIntegrator
    for change in (
        lambda: setattr(model.opt, "timestep", 0.0005),
        lambda: setattr(model.opt, "integrator", kinds.mjINT_RK4),
        lambda: setattr(model.opt, "integrator", kinds.mjINT_IMPLICITFAST),
        lambda: model.geom_solref.__setitem__(slice(None), (0.1, 1.0)),
    ):
        change()
        for _ in range(4000):
            mujoco.mj_step(model, data)
        found = sensor.read()
        assert found.force_n[2] == pytest.approx(0.15 * GRAVITY_M_S2, rel=0.01)
        assert found.volume_mm3 == pytest.approx(5.135 * found.force_n[2], rel=0.02)


def test_a_pull_that_friction_cannot_hold_is_said(sensor):
    with warned():
        sensor.render(BALL, np.eye(4), 2.0, (1.7, 0.0))
