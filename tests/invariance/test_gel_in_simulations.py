"""What must not matter to a sensor in a user's own simulation, in either engine."""

from types import MappingProxyType

import numpy as np
import pytest
import trimesh

from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.core.errors import SensorError
from tacgen.core.records import Estimate
from tacgen.sensor.simulated import Sensor
from tests.messages import refused

K_N, STEP_S = 5.135, 0.002
CREEP = FittedEffect(
    "creep",
    "normal",
    MappingProxyType({"amount": Estimate(0.5), "tau_s": Estimate(2.0), "recovery": Estimate(1.0)}),
)
LAW = ContactLaw("volume_linear", Estimate(K_N), Estimate(1.0), 2.0, effects=(CREEP,))
GEL = np.eye(4)
GEL[2, 3] = 10.0  # mm: the block's upper face
TURN = trimesh.transformations.rotation_matrix(0.9, (0.3, -1.0, 0.5))
TURN[:3, 3] = 0.4, -0.3, 0.7  # m


class Mujoco:
    """A ball that gravity presses on a block, somewhere in the world, pulled along the block."""

    def __init__(self, clock_s=0.0, world=None, first="pad", at_mm=(3.0, -2.0), pull_n=(0.0, 0.0)):
        mujoco = pytest.importorskip("mujoco")
        world = np.eye(4) if world is None else world
        x, y, z, w = trimesh.transformations.quaternion_from_matrix(world)[[1, 2, 3, 0]]
        pad_m = world[:3, 3]
        ball_m = (world @ [at_mm[0] / 1e3, at_mm[1] / 1e3, 0.01395, 1.0])[:3]
        bodies = {
            "pad": f'<body name="pad" pos="{_text(pad_m)}" quat="{w} {x} {y} {z}">'
            '<geom type="box" size=".05 .05 .01"/></body>',
            "ball": f'<body name="ball" pos="{_text(ball_m)}" quat="{w} {x} {y} {z}"><freejoint/>'
            '<geom type="sphere" size=".004" mass=".3"/></body>',
        }
        order = [first, *({"pad", "ball"} - {first})]
        down = world[:3, :3] @ [0.0, 0.0, -9.81]
        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{STEP_S}" gravity="{_text(down)}" cone="elliptic"/>'
            f"<worldbody>{''.join(bodies[name] for name in order)}</worldbody></mujoco>"
        )
        self.data = mujoco.MjData(self.model)
        self.data.time = clock_s
        ball = self.model.body("ball").id
        self.data.xfrc_applied[ball, :3] = world[:3, :3] @ [*pull_n, 0.0]
        # It does not roll: friction turns it by as much the other way.
        roll_n_m = [4e-3 * pull_n[1], -4e-3 * pull_n[0], 0.0]
        self.data.xfrc_applied[ball, 3:] = world[:3, :3] @ roll_n_m
        self._mujoco = mujoco

    def attach(self, sensor):
        """The sensor on the block, watching the ball."""
        return sensor.attach_mujoco(self.model, self.data, "pad", pose_body_gel=GEL).add_object(
            "ball"
        )

    def step(self, count):
        """Advance."""
        for _ in range(count):
            self._mujoco.mj_step(self.model, self.data)

    def read(self, sensor):
        """A reading of this time."""
        return sensor.read()


class Bullet:
    """The same in PyBullet, which keeps no clock."""

    def __init__(self, world=None, first="pad", at_mm=(3.0, -2.0)):
        self._p = p = pytest.importorskip("pybullet")
        self.client = p.connect(p.DIRECT)
        world = np.eye(4) if world is None else world
        down = world[:3, :3] @ [0.0, 0.0, -9.81]
        p.setGravity(*down, physicsClientId=self.client)
        turn = trimesh.transformations.quaternion_from_matrix(world)[[1, 2, 3, 0]].tolist()
        box = p.createCollisionShape(
            p.GEOM_BOX, halfExtents=[0.05, 0.05, 0.01], physicsClientId=self.client
        )
        sphere = p.createCollisionShape(p.GEOM_SPHERE, radius=0.004, physicsClientId=self.client)
        ball_m = (world @ [at_mm[0] / 1e3, at_mm[1] / 1e3, 0.0141, 1.0])[:3].tolist()
        made = {}
        for name in [first, *({"pad", "ball"} - {first})]:
            mass, shape, at = (
                (0, box, world[:3, 3].tolist()) if name == "pad" else (0.3, sphere, ball_m)
            )
            made[name] = p.createMultiBody(mass, shape, -1, at, turn, physicsClientId=self.client)
        self.bodies, self.steps = made, 0

    def attach(self, sensor):
        """The sensor on the block, watching the ball."""
        sensor.attach_pybullet(self.bodies["pad"], pose_link_gel=GEL, client_id=self.client)
        return sensor.add_object(self.bodies["ball"])

    def step(self, count):
        """Advance."""
        self.steps += count
        for _ in range(count):
            self._p.stepSimulation(physicsClientId=self.client)

    def read(self, sensor):
        """A reading of this time."""
        return sensor.read(time_s=self.steps / 240)


def _text(values):
    return " ".join(f"{value:.17g}" for value in values)


def frame_of(simulation, law=LAW, steps=500):
    """The first frame, ``steps`` after the sensor is attached."""
    sensor = simulation.attach(Sensor("gelsight_mini", contact=law))
    simulation.step(steps)
    return sensor.read()


def same(one, other, grey=0):
    """Whether two frames agree but for rounding."""
    np.testing.assert_allclose(other.force_n, one.force_n, rtol=2e-3, atol=2e-3)
    assert other.volume_mm3 == pytest.approx(one.volume_mm3, rel=2e-3)
    assert np.abs(other.rgb.astype(int) - one.rgb).max() <= grey


def test_reset_begins_a_new_press_and_so_does_a_clock_that_goes_back():
    simulation = Mujoco(7.0)
    sensor = simulation.attach(Sensor("gelsight_mini", contact=LAW))
    simulation.step(1000)
    crept = sensor.read()
    sensor.reset()
    new = K_N * crept.force_n[2]
    assert crept.volume_mm3 > 1.1 * new
    assert sensor.read().volume_mm3 == pytest.approx(new, rel=1e-3)
    simulation.step(1000)
    # Held for 2 s, a time constant.
    assert sensor.read().volume_mm3 == pytest.approx(new * (1 + 0.5 * (1 - np.exp(-1))), rel=2e-3)
    simulation.data.time = 0.5
    assert sensor.read().volume_mm3 == pytest.approx(new, rel=1e-3)


@pytest.mark.parametrize("make", [Mujoco, Bullet])
def test_reading_twice_does_not_matter_nor_does_reading_in_between(make):
    simulations = make(), make()
    often, seldom = (one.attach(Sensor("gelsight_mini", contact=LAW)) for one in simulations)
    for simulation, sensor in zip(simulations, (often, seldom), strict=True):
        simulation.step(200)  # the weight is on
        simulation.read(sensor)
    for _ in range(10):
        simulations[0].step(50)
        once, twice = (simulations[0].read(often) for _ in range(2))
        same(once, twice)
    simulations[1].step(500)
    same(simulations[1].read(seldom), once)


@pytest.mark.parametrize("make", [Mujoco, Bullet])
def test_the_world_turned_and_moved_is_the_same_press(make):
    same(
        frame_of(make(), ContactLaw.default()),
        frame_of(make(world=TURN), ContactLaw.default()),
        grey=2,
    )


@pytest.fixture
def bullet():
    """PyBullet with a fixed block, of which the upper face is the gel."""
    p = pytest.importorskip("pybullet")
    client = p.connect(p.DIRECT)
    yield p, client
    p.disconnect(client)


def bullet_pad(p, client):
    p.resetSimulation(p.RESET_USE_DEFORMABLE_WORLD, physicsClientId=client)
    p.setGravity(0, 0, -9.81, physicsClientId=client)
    half_m = [0.05, 0.05, 0.01]
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half_m, physicsClientId=client)
    return p.createMultiBody(0, shape, physicsClientId=client)


def bullet_shapes(p):
    """Of bodies that are loaded one after the other."""
    corners_m = trimesh.creation.box((0.006, 0.003, 0.012)).vertices
    return (
        {"shapeType": p.GEOM_SPHERE, "radius": 0.006},
        {"shapeType": p.GEOM_BOX, "halfExtents": [0.004, 0.002, 0.006]},
        {"shapeType": p.GEOM_MESH, "vertices": corners_m.tolist()},
        {"shapeType": p.GEOM_MESH, "vertices": (corners_m * [2, 1, 1]).tolist()},
        {
            "shapeType": p.GEOM_SPHERE,
            "radius": 0.006,
            "collisionFramePosition": [0.002, 0.0, 0.0],
        },
    )


@pytest.mark.parametrize("how", ["removed", "everything reset", "added again"])
def test_a_body_with_the_number_of_a_removed_one_is_seen_as_it_is(bullet, how):
    p, client = bullet
    pad = bullet_pad(p, client)

    def attached():
        one = Sensor("gelsight_mini", force_field=(2, 2))
        return one.attach_pybullet(pad, pose_link_gel=GEL, client_id=client)

    used, shown = attached(), []
    for number, shape in enumerate(bullet_shapes(p)):
        if how == "everything reset":
            bullet_pad(p, client)
        made = p.createCollisionShape(**shape, physicsClientId=client)
        body = p.createMultiBody(0.3, made, -1, [0, 0, 0.0161], physicsClientId=client)
        used.reset()
        if number == 0 or how == "added again":
            used.add_object(body)
        for _ in range(240):
            p.stepSimulation(physicsClientId=client)
        fresh, again = attached().add_object(body).read(), used.read()
        assert fresh.contact_mask.any()
        np.testing.assert_array_equal(again.depth_mm, fresh.depth_mm)
        assert not any(np.array_equal(fresh.depth_mm, one) for one in shown)
        shown.append(fresh.depth_mm)
        if how != "everything reset":
            p.removeBody(body, physicsClientId=client)


def test_a_soft_body_is_refused_by_name(bullet, tmp_path):
    p, client = bullet
    pad, file = bullet_pad(p, client), str(tmp_path / "jelly.obj")
    trimesh.creation.icosphere(subdivisions=2, radius=1.0).export(file)
    rigid = p.createMultiBody(
        0.3, p.createCollisionShape(p.GEOM_SPHERE, radius=0.01, physicsClientId=client), -1,
        [0, 0, 0.0201], physicsClientId=client,
    )  # fmt: skip
    sensor = Sensor("gelsight_mini").attach_pybullet(pad, pose_link_gel=GEL, client_id=client)
    sensor.add_object(rigid)
    p.removeBody(rigid, physicsClientId=client)
    soft = p.loadSoftBody(
        file, basePosition=[0, 0, 0.022], scale=0.01, mass=0.3, useMassSpring=1,
        springElasticStiffness=40, useBendingSprings=1, collisionMargin=0.001,
        physicsClientId=client,
    )  # fmt: skip
    assert soft == rigid
    ball = trimesh.creation.icosphere(subdivisions=3, radius=10.0)
    for mesh in (None, ball):
        with refused(SensorError):
            sensor.add_object(soft, mesh)
    with refused(SensorError):
        Sensor("gelsight_mini").attach_pybullet(soft, client_id=client)
    for _ in range(400):
        p.stepSimulation(physicsClientId=client)
    with refused(SensorError):
        sensor.read()


def test_a_flex_is_refused_by_name():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="pad"><geom type="box" size=".05 .05 .01"/></body>
        <body name="bag" pos="0 0 .03"><flexcomp name="jelly" type="grid" dim="2"
        count="4 4 1" spacing=".004 .004 .004" mass=".1" radius=".001"/></body>
        </worldbody></mujoco>"""
    )
    sensor = Sensor("gelsight_mini")
    sensor.attach_mujoco(model, mujoco.MjData(model), "pad", pose_body_gel=GEL)
    for mesh in (None, trimesh.creation.box((8, 8, 1))):
        with refused(SensorError):
            sensor.add_object("bag", mesh)


WEDGE = """<mujoco><option timestep="0.001"/><asset>
<mesh name="wedge" vertex="-3 -2 -4  3 -2 -4  -3 2 -4  3 2 -4  0 0 6" scale=".001 .001 .001"/>
</asset><worldbody><body name="pad"><geom type="box" size=".05 .05 .01"/></body>
<body name="peg" pos="0 0 .0165"><joint type="slide" axis="0 0 1"/>
<geom name="peg" mass=".3" {shape}/></body></worldbody></mujoco>"""


def _turned_geom(model, geom):
    model.geom_quat[geom] = 0.6, 0.8, 0.0, 0.0


def _other_mesh(model, geom):
    model.mesh_vert[:] *= [0.5, 1.0, 1.0]


@pytest.mark.parametrize(
    ("shape", "change"),
    [
        ('type="sphere" size=".006"', lambda m, g: m.geom_size.__setitem__(g, 0.0055)),
        ('type="box" size=".002 .004 .006"', lambda m, g: m.geom_pos.__setitem__(g, 0.0004)),
        ('type="capsule" size=".003 .003"', _turned_geom),
        ('type="mesh" mesh="wedge"', _other_mesh),
    ],
    ids=["size", "place", "turn", "mesh"],
)
def test_a_geom_that_is_changed_between_episodes_is_seen_as_it_is(shape, change):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(WEDGE.format(shape=shape))
    data, geom = mujoco.MjData(model), model.geom("peg").id

    def attached(mesh=None):
        one = Sensor("gelsight_mini").attach_mujoco(model, data, "pad", pose_body_gel=GEL)
        return one.add_object("peg", mesh)

    used, given = attached(), attached(trimesh.creation.icosphere(subdivisions=3, radius=6.0))
    shown = []
    for episode in range(2):
        if episode:
            change(model, geom)
            mujoco.mj_resetData(model, data)
        for _ in range(600):
            mujoco.mj_step(model, data)
        used.reset()
        frame, fresh = used.read(), attached().read()
        assert fresh.contact_mask.any()
        np.testing.assert_array_equal(frame.depth_mm, fresh.depth_mm)
        shown.append(fresh.depth_mm)
        if not episode:
            assert given.read().contact_mask.any()
    assert not np.array_equal(*shown)
    with refused(SensorError):
        given.read()


@pytest.mark.parametrize("condim", [3, 4, 6])
@pytest.mark.parametrize(
    ("pad", "peg"),
    [('type="box" size=".02 .02 .01"', 'type="sphere" size=".006"'),
     ('type="sphere" size=".01"', 'type="box" size=".004 .004 .006"')],
    ids=["the gel's geom second", "the gel's geom first"],
)  # fmt: skip
def test_the_moment_of_a_contact_is_that_by_which_a_peg_is_turned(condim, pad, peg):
    """A peg that rests on one point and does not turn: the contact balances its motor."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.001" cone="elliptic"/><worldbody>
        <body name="pad"><geom {pad}/></body>
        <body name="peg" pos="0 0 .0159"><joint type="slide" axis="0 0 1"/>
        <joint name="yaw" axis="0 0 1" damping=".05"/>
        <geom {peg} mass=".5" condim="{condim}" friction="1 .005 .0001"/></body>
        </worldbody><actuator><motor joint="yaw"/></actuator></mujoco>"""
    )
    data = mujoco.MjData(model)
    sensor = Sensor("gelsight_mini").attach_mujoco(model, data, "pad", pose_body_gel=GEL)
    sensor.add_object("peg")
    for torque_n_mm in (-12.0, 0.0, 8.0):
        data.ctrl[0] = torque_n_mm / 1e3
        for _ in range(800):
            mujoco.mj_step(model, data)
        held_n_mm = torque_n_mm - 1e3 * 0.05 * data.qvel[1] if condim > 3 else 0.0
        assert abs(held_n_mm) >= 0.4 * abs(torque_n_mm) or condim == 3
        found = sensor._attached().contact()
        assert found.torsion_n_mm == pytest.approx(held_n_mm, abs=0.05)
