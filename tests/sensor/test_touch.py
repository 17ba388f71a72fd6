"""What is pressed is what touches, in a stranger's own simulation: of several links, bodies, geoms.

Every right answer is a balance: the weight that rests on the gel is the force, V = k_n F.
"""

import warnings

import numpy as np
import pytest
import trimesh

from tacgen.core.errors import SensorError
from tacgen.sensor.simulated import Sensor
from tests.messages import refused, warned

G_M_S2, K_N = 9.81, 5.135
GEL = np.eye(4)
GEL[2, 3] = 10.0  # mm: the block's upper face
BALL = '<geom type="sphere" size=".004" mass=".3"/>'


def check(frame, mass_kg, *, share=1.0, rel=0.02):
    """The force that the image shows is this share of the weight, and makes the imprint."""
    assert frame.force_n[2] == pytest.approx(share * mass_kg * G_M_S2, rel=rel)
    assert frame.volume_mm3 == pytest.approx(K_N * frame.force_n[2], rel=0.01)


def check_nothing(frame, status):
    """A gel at rest, and no force."""
    assert frame.status == status
    assert not frame.contact_mask.any()
    assert (frame.volume_mm3, frame.indentation_mm) == (0.0, 0.0)
    np.testing.assert_allclose(frame.force_n, 0.0, atol=1e-9)


def imprint_of_ball(frame, x_mm=0.0):
    """Whether the imprint is that of a ball of 4 mm, by its cap, at a place of the gel."""
    d_mm = frame.indentation_mm
    assert frame.volume_mm3 == pytest.approx(np.pi * d_mm**2 * (4.0 - d_mm / 3), rel=0.02)
    rows, columns = np.nonzero(frame.contact_mask)
    assert (columns.mean() + 0.5 - 160) * 0.0634 == pytest.approx(x_mm, abs=0.1)
    assert (rows.mean() + 0.5 - 120) * 0.0634 == pytest.approx(0.0, abs=0.1)


# --- MuJoCo ---------------------------------------------------------------------------------------


def mujoco_frame(bodies, *, watched=("obj",), name="gelsight_mini", extra="", pad="", mesh=None):
    """The frame after 3 s of the bodies on a block, whose upper face is the gel."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option timestep=".002"/><worldbody><body name="pad">'
        f'<geom name="gel" type="box" size=".05 .05 .01" {pad}/></body>{bodies}</worldbody>{extra}'
        "</mujoco>"
    )
    data = mujoco.MjData(model)
    for _ in range(1500):
        mujoco.mj_step(model, data)
    sensor = Sensor(name).attach_mujoco(model, data, "pad", pose_body_gel=GEL)
    for body in watched:
        sensor.add_object(body, mesh)
    return sensor.read()


def body(content, height_m, x_m=0.0, name="obj"):
    return f'<body name="{name}" pos="{x_m} 0 {height_m}"><freejoint/>{content}</body>'


def rib(x_m):
    return f'<geom type="box" size=".001 .015 .0015" pos="{x_m} 0 -.0015" mass=".01"/>'


CHILD = (
    '<geom type="box" size=".015 .015 .005" mass=".2"/><body name="handle" pos="0 0 -.02">'
    '{joint}<geom type="sphere" size=".004" mass=".2"/></body>'
)


@pytest.mark.parametrize("joint", ["", '<joint type="slide" axis="0 0 1" range="-.002 .002"/>'])
def test_a_child_body_that_touches_is_pressed(joint):
    frame = mujoco_frame(body(CHILD.format(joint=joint), 0.034))
    check(frame, 0.4)
    imprint_of_ball(frame)
    assert frame.status == "ok"


@pytest.mark.parametrize(
    "shown",
    [
        '<geom type="box" size=".02 .02 .008" contype="0" conaffinity="0" group="2" mass="0"/>',
        '<geom type="ellipsoid" size=".02 .02 .02" contype="0" conaffinity="0" mass="0"/>',
        '<geom type="box" size=".02 .02 .008" contype="2" conaffinity="2" mass="0"/>',
    ],
    ids=["a box for show", "an ellipsoid for show", "of another mask"],
)
def test_geoms_that_do_not_touch_the_gel_are_not_pressed(shown):
    frame = mujoco_frame(body(BALL + shown, 0.0141))
    check(frame, 0.3)
    imprint_of_ball(frame)


def test_geoms_that_touch_by_a_pair_are_pressed():
    ball = BALL.replace("/>", ' name="ball" contype="0" conaffinity="0"/>')
    pair = '<contact><pair geom1="gel" geom2="ball"/></contact>'
    frame = mujoco_frame(body(ball, 0.0141), extra=pair)
    check(frame, 0.3)
    imprint_of_ball(frame)


def test_a_body_that_can_touch_nothing_is_refused():
    ball = BALL.replace("/>", ' contype="0" conaffinity="0"/>')
    with refused(SensorError):
        mujoco_frame(body(ball, 0.0141))


def test_two_bodies_that_touch_are_both_pressed():
    both = body(BALL, 0.0141, -0.005, "one") + body(BALL, 0.0141, 0.005, "two")
    frame = mujoco_frame(both, watched=("one", "two"))
    check(frame, 0.6)
    assert frame.contact_mask[:, 150:170].sum() == 0


@pytest.mark.parametrize("x_m", [0.0115, 0.014, 0.03])
def test_a_plate_on_ribs_beside_the_window_leaves_no_imprint(x_m):
    plate = '<geom type="box" size=".04 .015 .002" pos="0 0 .002" mass=".3"/>'
    frame = mujoco_frame(body(plate + rib(x_m) + rib(-x_m), 0.0132))
    check_nothing(frame, "outside_window")


def test_a_ball_that_studs_hold_above_the_gel_leaves_no_imprint():
    studs = "".join(
        f'<geom type="box" size=".002 .002 .0015" pos="{x} {y} -.0055" mass=".01"/>'
        for x in (-0.02, 0.02)
        for y in (-0.02, 0.02)
    )
    check_nothing(mujoco_frame(body(BALL + studs, 0.0171)), "outside_window")


def test_a_box_larger_than_the_gel_shows_the_windows_part():
    """Its corners alone are the engine's contacts; it presses evenly on the gel, which is larger
    than the window by 5 mm on each side."""
    box = '<geom type="box" size=".025 .025 .005" mass=".3"/>'
    frame = mujoco_frame(body(box, 0.0151))
    width_mm, height_mm = 320 * 0.0634, 240 * 0.0634
    share = width_mm * height_mm / ((width_mm + 10) * (height_mm + 10))
    check(frame, 0.3, share=share, rel=0.03)
    assert frame.status == "outside_window"


def test_a_ball_across_the_windows_edge_shows_its_part():
    """Half of it, at the edge itself."""
    frame = mujoco_frame(body(BALL, 0.0141, 160 * 0.0634e-3))
    check(frame, 0.3, share=0.5, rel=0.05)
    assert frame.status == "outside_window"


def test_a_load_that_presses_the_gel_through_is_saturated():
    frame = mujoco_frame(body(BALL.replace(".3", "20"), 0.0141))
    assert frame.saturated
    assert frame.indentation_mm == 4.0
    assert frame.volume_mm3 < 0.2 * K_N * 20 * G_M_S2
    assert not mujoco_frame(body(BALL, 0.0141)).saturated


def test_a_mesh_of_the_whole_object_stands_for_its_child_bodies():
    """It is not pressed twice, nor replaced by what the engine collides."""
    whole = trimesh.util.concatenate(
        [
            trimesh.creation.box((30, 30, 10)),
            trimesh.creation.icosphere(subdivisions=6, radius=4.0).apply_translation([0, 0, -20]),
        ]
    )
    frame = mujoco_frame(body(CHILD.format(joint=""), 0.034), mesh=whole)
    check(frame, 0.4)
    imprint_of_ball(frame)


# --- PyBullet -------------------------------------------------------------------------------------


@pytest.fixture
def bullet():
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -G_M_S2, physicsClientId=client)
    yield client
    pybullet.disconnect(client)


def link(name, shapes, mass_kg=0.2):
    return (
        f'<link name="{name}"><inertial><mass value="{mass_kg}"/><inertia ixx="1e-4" iyy="1e-4" '
        f'izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>{shapes}</link>'
    )


def shape(geometry, x_m=0.0, y_m=0.0, z_m=0.0):
    origin = f'<origin xyz="{x_m} {y_m} {z_m}"/>'
    return f"<collision>{origin}<geometry>{geometry}</geometry></collision>"


BOX, SPHERE = '<box size="{} {} {}"/>', '<sphere radius="0.004"/>'


def bullet_world(client, tmp_path, links, height_m, x_m=0.0):
    """A block whose upper face is the gel, and a URDF's robot that has come to rest on it."""
    import pybullet as p

    block = p.createCollisionShape(
        p.GEOM_BOX, halfExtents=[0.05, 0.05, 0.01], physicsClientId=client
    )
    pad = p.createMultiBody(0, block, physicsClientId=client)
    path = tmp_path / "object.urdf"
    path.write_text(f'<robot name="object">{links}</robot>')
    robot = p.loadURDF(str(path), [x_m, 0, height_m], physicsClientId=client)
    for _ in range(480):
        p.stepSimulation(physicsClientId=client)
    return pad, robot


def bullet_frame(client, pad, robot, *, gel=GEL, **given):
    sensor = Sensor("gelsight_mini").attach_pybullet(pad, pose_link_gel=gel, client_id=client)
    return sensor.add_object(robot, **given).read()


HANDLE = (
    link("base", shape(BOX.format(0.03, 0.03, 0.01)))
    + link("handle", shape(SPHERE))
    + '<joint name="j" type="{kind}"><parent link="base"/><child link="handle"/>'
    '<origin xyz="0 0 -0.02"/><axis xyz="0 0 1"/>'
    '<limit lower="-0.001" upper="0.001" effort="100" velocity="1"/></joint>'
)


@pytest.mark.parametrize("kind", ["fixed", "prismatic"])
def test_a_child_link_that_touches_is_pressed(bullet, tmp_path, kind):
    pad, robot = bullet_world(bullet, tmp_path, HANDLE.format(kind=kind), 0.0341)
    base = trimesh.creation.box((0.03, 0.03, 0.01))
    for given in ({}, {"mesh": base, "scale": 1000.0}):
        frame = bullet_frame(bullet, pad, robot, **given)
        check(frame, 0.4)
        imprint_of_ball(frame)
        assert frame.status == "ok"


def test_a_link_whose_inertia_is_elsewhere_is_pressed_where_it_is(bullet, tmp_path):
    """Frames of shapes, of inertia and of links are three."""
    inertia = '<inertial><origin xyz="0 0 0.01" rpy="0.4 0 0.7"/>'
    links = HANDLE.format(kind="fixed").replace("<inertial>", inertia)
    pad, robot = bullet_world(bullet, tmp_path, links, 0.0341)
    frame = bullet_frame(bullet, pad, robot)
    check(frame, 0.4)
    imprint_of_ball(frame)


def test_a_urdfs_cylinder_is_pressed_as_the_hull_that_collides(bullet, tmp_path):
    """A flat end of 4 mm radius on a flat gel: V = π r² δ, of a polygon of 32 corners."""
    cylinder = shape('<cylinder radius="0.004" length="0.02"/>')
    pad, robot = bullet_world(bullet, tmp_path, link("base", cylinder), 0.0201)
    frame = bullet_frame(bullet, pad, robot)
    check(frame, 0.2)
    polygon_mm2 = 16 * 4.0**2 * np.sin(np.pi / 16)
    assert frame.contact_mask.sum() * 0.0634**2 == pytest.approx(polygon_mm2, rel=0.02)


def test_a_contact_that_is_not_at_the_gels_height_is_not_on_the_gel(bullet, tmp_path):
    pad, robot = bullet_world(bullet, tmp_path, link("base", shape(SPHERE), 0.3), 0.0141)
    for height_mm in (7.0, 18.0):
        gel = GEL.copy()
        gel[2, 3] = height_mm
        with warned():
            check_nothing(bullet_frame(bullet, pad, robot, gel=gel), "no_contact")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(bullet_frame(bullet, pad, robot), 0.3)


def test_an_object_of_which_no_link_collides_is_refused(bullet, tmp_path):
    pad, robot = bullet_world(bullet, tmp_path, link("base", ""), 0.02)
    with refused(SensorError):
        bullet_frame(bullet, pad, robot)
