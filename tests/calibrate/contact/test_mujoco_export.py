"""A pad of pins in MuJoCo: the volume that a pressed body displaces is k_n F, whatever its shape.

Volumes are closed forms of how far the body went in, not of the pins.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from tacgen.calibrate.contact.mujoco_export import export_mujoco
from tacgen.cli import app
from tacgen.contact.law import ContactLaw, save_law
from tacgen.core.errors import ContactError
from tacgen.core.records import Estimate
from tacgen.core.sensors import load_sensor
from tests.messages import refused

mujoco = pytest.importorskip("mujoco")

K_N = 5.135
SENSOR = replace(load_sensor("gelsight"), dome_radius_mm=0.0, gel_size_mm=(1.0, 1.0))
RATE_N_PER_S, SETTLED_S, DAMPING_N_S_PER_M = 20.0, 0.3, 10.0


@pytest.fixture(scope="module")
def pads(tmp_path_factory):
    """A flat gel and a domed one."""
    folder = tmp_path_factory.mktemp("pads")
    for name, radius in (("flat", 0.0), ("dome", 30.0)):
        export_mujoco(ContactLaw.linear(K_N), replace(SENSOR, dome_radius_mm=radius), folder / name)
    return folder


def pressed(pad, geom, forces_n, *, touch_mm=0.0, at_mm=(0.0, 0.0), step_s=2e-3, assets=""):
    """How far a body goes in, mm, at each force; ``touch_mm`` is its height at first touch."""
    x, y = (1e-3 * one for one in at_mm)
    spec = mujoco.MjSpec.from_string(
        f'<mujoco><option timestep="{step_s}" gravity="0 0 0"/>{assets}<worldbody>'
        f'<body name="object" pos="{x} {y} {1e-3 * touch_mm}">'
        f'<joint name="down" type="slide" axis="0 0 -1" damping="{DAMPING_N_S_PER_M}"/>{geom}'
        "</body></worldbody></mujoco>"
    )
    body = mujoco.MjSpec.from_file(str(pad / "pad.xml")).body("pad")
    spec.worldbody.add_frame().attach_body(body, "left ", "")
    model = spec.compile()
    data, thing, force = mujoco.MjData(model), model.body("object").id, 0.0
    for goal in forces_n:
        ramp = np.linspace(force, goal, 2 + math.ceil((goal - force) / RATE_N_PER_S / step_s))
        for force in [*ramp, *[goal] * round(SETTLED_S / step_s)]:
            data.xfrc_applied[thing, 2] = -force
            mujoco.mj_step(model, data)
        assert abs(data.joint("down").qvel[0]) < 1e-4  # at rest, within 0.1 mm/s
        yield 1e3 * data.joint("down").qpos[0]


def cap_mm3(radius_mm, depth_mm):
    return math.pi * depth_mm**2 * (radius_mm - depth_mm / 3)


@pytest.mark.parametrize("step_s", [1e-3, 2e-3])
@pytest.mark.parametrize(("radius_mm", "forces_n"), [(2, (1, 2)), (4, (1, 4)), (8, (1, 20))])
def test_balls_of_any_radius_have_the_slope_of_the_law(pads, radius_mm, forces_n, step_s):
    ball = f'<geom type="sphere" size="{1e-3 * radius_mm}" mass="0.05"/>'
    for at_mm in ((0.0, 0.0), (1.17, -0.59)):
        depths = pressed(
            pads / "flat", ball, forces_n, touch_mm=radius_mm, at_mm=at_mm, step_s=step_s
        )
        for force_n, depth_mm in zip(forces_n, depths, strict=True):
            assert cap_mm3(radius_mm, depth_mm) == pytest.approx(K_N * force_n, rel=0.03)


def test_bodies_of_other_shapes_and_masses_too(pads):
    rod = '<geom type="cylinder" size=".003 .004" euler="0 90 0" mass="0.2"/>'
    for force_n, depth in zip((1, 4), pressed(pads / "flat", rod, (1, 4), touch_mm=3), strict=True):
        segment = 9 * math.acos(1 - depth / 3) - (3 - depth) * math.sqrt(6 * depth - depth**2)
        assert 8 * segment == pytest.approx(K_N * force_n, rel=0.05)
    assets = (
        '<asset><mesh name="pyramid" vertex="0 0 0 6e-3 6e-3 4e-3 -6e-3 6e-3 4e-3 6e-3 -6e-3 4e-3 '
        '-6e-3 -6e-3 4e-3" inertia="convex"/></asset>'
    )
    pyramid = '<geom type="mesh" mesh="pyramid" mass="0.05"/>'
    for force_n, depth in zip(
        (2, 6), pressed(pads / "flat", pyramid, (2, 6), assets=assets), strict=True
    ):
        assert (3 * depth) ** 2 * depth / 3 == pytest.approx(K_N * force_n, rel=0.05)


def test_a_plate_on_the_dome_displaces_its_cap(pads):
    plate = '<geom type="box" size=".02 .02 .001" mass="0.05"/>'
    depths = pressed(pads / "dome", plate, (1, 4, 10), touch_mm=1)
    for force_n, depth_mm in zip((1, 4, 10), depths, strict=True):
        assert cap_mm3(30, depth_mm) == pytest.approx(K_N * force_n, rel=0.03)


@pytest.mark.slow
def test_two_pads_squeeze_a_free_ball_by_the_law(pads):
    finger = (
        '<body name="{0}" pos="{1}4e-3 0 0"><joint name="{0}" type="slide" axis="{2}1 0 0" '
        'damping="20"/><inertial pos="0 0 0" mass="0.3" diaginertia="1e-3 1e-3 1e-3"/>'
        '<site name="{0}" euler="0 {3}90 0"/></body>'
    )
    spec = mujoco.MjSpec.from_string(
        '<mujoco><option gravity="0 0 0"/><worldbody>'
        + finger.format("left", "-", "", "")
        + finger.format("right", "", "-", "-")
        + '<body><freejoint/><geom type="sphere" size="4e-3" mass="0.05"/></body></worldbody>'
        '<actuator><motor joint="left"/><motor joint="right"/></actuator></mujoco>'
    )
    for side in ("left", "right"):
        body = mujoco.MjSpec.from_file(str(pads / "flat" / "pad.xml")).body("pad")
        spec.site(side).attach_body(body, f"{side} ", "")
    model = spec.compile()
    data = mujoco.MjData(model)
    for step in range(300):
        data.ctrl[:] = min(4.0, 0.02 * step)
        mujoco.mj_step(model, data)
    depth_mm = 500 * sum(data.joint(side).qpos[0] for side in ("left", "right"))
    assert cap_mm3(4, depth_mm) == pytest.approx(K_N * 4.0, rel=0.05)


def test_the_command_says_what_of_the_law_is_left_out(tmp_path):
    save_law(ContactLaw.linear(3.0, 0.8, 2.0), tmp_path / "contact.yaml")
    arguments = ["calibrate", "export", str(tmp_path / "contact.yaml"), "--format", "mujoco"]
    run = CliRunner().invoke(app, [*arguments, "--sensor", "digit", "--out", str(tmp_path / "pad")])
    assert run.exit_code == 0, run.output
    assert "k_n = 3 mm³/N, at time steps of up to 2 ms" in run.output
    assert "left out: k_s: pins do not give way sideways" in run.output
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "pad" / "pad.xml"))
    assert model.jnt_stiffness[0] == pytest.approx(0.25 / 3.0 * 1e3)


def test_a_law_of_depths_is_refused(tmp_path):
    law = ContactLaw("linear_depth", Estimate(5.0, 0.0), k_depth_mm_per_n=Estimate(0.1, 0.0))
    with refused(ContactError):
        export_mujoco(law, SENSOR, tmp_path / "pad")
