"""What must not matter to a sensor in a user's own simulation, in either engine."""

from types import MappingProxyType

import numpy as np
import pytest
import trimesh

from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.core.records import ContactFrame, Estimate
from tacgen.sensor.gel_response import GelCourse
from tacgen.sensor.simulated import Sensor, as_mesh

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


@pytest.mark.parametrize("clock_s", [100.0, -3.0])
def test_the_clocks_zero_does_not_matter(clock_s):
    plain, later = frame_of(Mujoco()), frame_of(Mujoco(clock_s))
    # The weight comes on within some steps of the first, then the gel creeps for a second.
    assert plain.volume_mm3 / K_N / plain.force_n[2] == pytest.approx(1.107, abs=0.002)
    same(plain, later)


def test_a_clock_that_is_given_may_have_any_zero():
    """PyBullet has none: what was before the first reading is not known."""
    found = []
    for zero_s in (0.0, 1000.0):
        simulation = Bullet()
        sensor = simulation.attach(Sensor("gelsight_mini", contact=LAW))
        volumes = []
        for k in range(4):
            simulation.step(100)
            volumes.append(sensor.read(time_s=zero_s + (k + 1) / 2.4).volume_mm3)
        found.append(volumes)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)
    assert found[0][0] == pytest.approx(K_N * 0.3 * 9.81, rel=0.01)


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


@pytest.mark.parametrize("make", [Mujoco, Bullet])
def test_the_order_of_bodies_does_not_matter(make):
    same(
        frame_of(make(), ContactLaw.default()),
        frame_of(make(first="ball"), ContactLaw.default()),
        grey=1,
    )


def test_a_pull_beside_the_gels_middle_does_not_turn_the_object():
    """Its moment about the gel's origin is that of the place alone."""
    simulation = Mujoco(at_mm=(5.0, 0.0), pull_n=(0.0, 1.0))
    sensor = simulation.attach(Sensor("gelsight_mini", contact=ContactLaw.default()))
    simulation.step(20)
    found = sensor._attached().contact()
    assert found.force_n[1] > 0.5
    assert abs(found.torsion_n_mm) < 0.02 * 5.0 * found.force_n[1]


def test_a_mesh_is_made_ready_once():
    """The meshes of a simulation cannot change, so nothing is checked or sorted twice."""
    simulation = Mujoco()
    sensor = simulation.attach(Sensor("gelsight_mini"))
    simulation.step(100)
    sensor.read()
    mapper = sensor._pad.indenter._mapper
    uses = mapper._uses
    sensor.read()
    assert mapper._uses > uses >= 1


def test_a_mesh_of_ours_is_made_ready_once():
    sensor = Sensor("gelsight_mini")
    mesh = as_mesh(trimesh.creation.icosphere(subdivisions=3, radius=4.0))
    assert as_mesh(mesh) is mesh
    for _ in range(2):
        sensor.render(mesh, np.eye(4), 2.0)
    assert sensor._pad.indenter._mapper._uses == 2


def test_twenty_thousand_readings_remember_no_more_than_ten():
    course = GelCourse(LAW)
    sizes = []
    for k in range(2000):
        force_n = 3.0 + np.sin(0.1 * k)
        course.load(ContactFrame(0.01 * k, force_n, np.zeros(2), 0.0, np.eye(4)), 0.0)
        sizes.append(len(course._after))
    assert sizes[9] == sizes[-1]
