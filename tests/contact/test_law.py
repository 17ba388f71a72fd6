"""The contact law: closed forms, the file, and what it says about wrong input."""

import math

import numpy as np
import pytest
import trimesh
import yaml

from tacgen.contact.effects import LoadHistory
from tacgen.contact.law import ContactLaw, FittedEffect, load_law, save_law
from tacgen.core.errors import ContactError
from tacgen.core.records import Estimate
from tests.messages import refused

COLUMNS = {
    "trial": np.zeros(5, int),
    "time_s": np.arange(5) * 0.5,
    "force_normal_n": np.array([0.0, 1.0, 2.0, 3.0, 4.0]),
    "force_shear_x_n": np.array([0.0, 0.0, 0.5, 1.0, 1.0]),
    "force_shear_y_n": np.array([0.0, 0.0, -0.5, 0.0, 1.0]),
}


def creeping(channel="normal", **parameters):
    given = {"amount": 0.2, "tau_s": 2.0} | parameters
    return FittedEffect("creep", channel, {k: Estimate(v, 0.01, "") for k, v in given.items()})


def effect(name, channel="normal", **parameters):
    return FittedEffect(name, channel, {k: Estimate(v, 0.0, "") for k, v in parameters.items()})


def law_with(*effects):
    return ContactLaw(
        "volume_linear", Estimate(5.0, 0.1, "mm3/N"), Estimate(0.8, 0.02, "mm/N"), 1.5, effects
    )


def test_a_linear_law_is_proportional():
    volume, shear = ContactLaw.linear(5.0, 0.8).predict(COLUMNS)
    np.testing.assert_allclose(volume, 5.0 * COLUMNS["force_normal_n"])
    np.testing.assert_allclose(shear[:, 1], 0.8 * COLUMNS["force_shear_y_n"])


def test_a_law_survives_its_file(tmp_path):
    law = law_with(creeping(), effect("slip", "shear", amount=0.3, exponent=2.0))
    save_law(law, tmp_path / "contact.yaml")
    again = load_law(tmp_path / "contact.yaml")
    assert again.k_n_mm3_per_n == law.k_n_mm3_per_n
    assert again.marker_pitch_mm == 1.5
    for left, right in zip(again.predict(COLUMNS), law.predict(COLUMNS), strict=True):
        np.testing.assert_array_equal(left, right)


def test_the_file_is_the_contract(tmp_path):
    save_law(law_with(creeping()), tmp_path / "contact.yaml")
    content = yaml.safe_load((tmp_path / "contact.yaml").read_text())
    assert content["law"] == "volume_linear"
    assert content["k_n_mm3_per_n"] == {"value": 5.0, "stderr": 0.1}
    assert content["effects"][0]["parameters"]["tau_s"] == {
        "value": 2.0,
        "stderr": 0.01,
        "unit": "",
    }
    assert set(content) >= {"k_s_mm_per_n", "marker_pitch_mm", "provenance"}


def test_a_simulated_grasp_feels_the_gel_and_not_the_measurement():
    columns = {name: COLUMNS[name] for name in ("trial", "time_s", "force_normal_n")}
    measured = law_with(
        creeping(),
        effect("zero_offset", force_n=0.4),
        effect("temperature", linear_per_c=0.02),
        effect("drift", linear=0.3, span_s=100.0),
    )
    simulated, _ = measured.predict(columns, simulate=True)
    gel_only, _ = law_with(creeping()).predict(columns)
    np.testing.assert_allclose(simulated, gel_only)


def test_a_log_without_the_thermometer_is_refused():
    with refused(ContactError):
        law_with(effect("temperature", linear_per_c=0.02)).predict(COLUMNS)


def depth_mm(law, k_factor=1.0):
    return law.simulated(LoadHistory(COLUMNS, measured=False), k_factor)[0]


def test_depth_of_the_linear_depth_law():
    law = ContactLaw("linear_depth", Estimate(5.0), k_depth_mm_per_n=Estimate(0.05, 0.0, "mm/N"))
    np.testing.assert_allclose(depth_mm(law), 0.05 * COLUMNS["force_normal_n"])


def tactos(margin_mm):
    k_depth = Estimate(0.05, 0.0, "mm/N")
    return ContactLaw(
        "linear_depth", Estimate(5.0), k_depth_mm_per_n=k_depth, collision_margin_mm=margin_mm
    )


def test_the_collision_margin_loses_the_contact_below_a_force(tmp_path):
    save_law(tactos(0.1), tmp_path / "contact.yaml")
    law = load_law(tmp_path / "contact.yaml")
    # max(0, c F − g): nothing up to g / c = 2 N, then c a newton.
    closed_form = [0.0, 0.0, 0.0, 0.05, 0.1]
    np.testing.assert_allclose(depth_mm(law), closed_form, atol=1e-12)
    np.testing.assert_allclose(depth_mm(law, 2.0), [0, 0, 0.1, 0.2, 0.3], atol=1e-12)
    memory = {}
    for k, expected_mm in enumerate(closed_form):
        row = {name: float(column[k]) for name, column in COLUMNS.items()}
        normal, _, memory = law.advance(row, memory)
        assert normal == pytest.approx(expected_mm, abs=1e-12)
    assert depth_mm(tactos(0.0))[1] == 0.05


@pytest.mark.parametrize("margin_mm", [-0.1, math.inf, math.nan])
def test_a_margin_that_cannot_be_is_refused(margin_mm):
    with refused(ContactError):
        tactos(margin_mm)


@pytest.mark.parametrize(("low", "up", "gap_mm"), [("m", "m", 2.0), ("m", "b", 1.0), ("b", "b", 0)])
def test_bullet_keeps_a_millimetre_around_each_mesh_of_a_urdf(tmp_path, low, up, gap_mm):
    """The margin that TACTO, which poses the meshes as the physics has them, does not take back."""
    pybullet = pytest.importorskip("pybullet")
    box = trimesh.creation.box((0.04, 0.04, 0.04))
    box.export(tmp_path / "cube.obj")
    shapes = {"m": '<mesh filename="cube.obj"/>', "b": '<box size="0.04 0.04 0.04"/>'}
    client = pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
        bodies = []
        for shape, height_m, mass_kg in ((low, 0.0, 0.0), (up, 0.045, 0.1)):
            inertial = f"""<mass value="{mass_kg}"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4"
                ixy="0" ixz="0" iyz="0"/>"""
            path = tmp_path / f"{mass_kg}.urdf"
            path.write_text(
                f"""<robot name="r"><link name="l"><inertial>{inertial}</inertial><collision>
                <geometry>{shapes[shape]}</geometry></collision></link></robot>"""
            )
            at = {"basePosition": [0, 0, height_m], "physicsClientId": client}
            bodies.append(pybullet.loadURDF(str(path), useFixedBase=not mass_kg, **at))
        for _ in range(1000):
            pybullet.stepSimulation(physicsClientId=client)
        (*_, height_m), _ = pybullet.getBasePositionAndOrientation(
            bodies[1], physicsClientId=client
        )
    finally:
        pybullet.disconnect(client)
    assert 1000 * (height_m - 0.04) == pytest.approx(gap_mm, abs=0.05)


def test_every_problem_of_a_law_is_listed_at_once():
    with refused(ContactError):
        ContactLaw(
            "volume_linear",
            Estimate(math.nan),
            effects=(
                effect("crep"),
                effect("creep", amount=-2.0, tau=3.0),
                effect("slip", "normal"),
            ),
        )


@pytest.mark.parametrize(
    "text",
    [
        "law: volume_linear",
        "law: cubic\nk_n_mm3_per_n: {value: 5}",
        "law: volume_linear\nk_n_mm3_per_n: many",
        "law: volume_linear\nk_n_mm3_per_n: 5\nk_q: 3",
        "law: volume_linear\nk_n_mm3_per_n: 5\neffects: [creep]",
        "[1, 2]",
        "{",
    ],
)
def test_a_wrong_file_says_what_and_where(tmp_path, text):
    path = tmp_path / "contact.yaml"
    path.write_text(text)
    with refused(ContactError):
        load_law(path)


def test_a_missing_file_names_the_command(tmp_path):
    with refused(ContactError):
        load_law(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    "columns",
    [
        {"trial": [0], "time_s": [0.0]},
        {**COLUMNS, "force_normal_n": np.full(5, np.nan)},
        {**COLUMNS, "x_mm": np.zeros(3)},
    ],
)
def test_columns_that_cannot_be_used(columns):
    with refused(ContactError):
        ContactLaw.linear(5.0).predict(columns)


@pytest.mark.parametrize(
    ("made_by", "newer"), [("999.1.0", True), ("999.1.dev3+g1", True), ("0.0.1", False), (3, False)]
)
def test_a_law_of_a_newer_tacgen_says_so_where_it_cannot_be_read(tmp_path, made_by, newer):
    path = tmp_path / "contact.yaml"
    content = {
        "law": "volume_linear",
        "k_n_mm3_per_n": {"value": 5.0, "stderr": 0.1},
        "provenance": {"versions": {"tacgen": made_by}},
    }
    path.write_text(yaml.safe_dump(content))
    assert load_law(path).k_n_mm3_per_n.value == 5.0
    odd = {"name": "telepathy", "channel": "normal", "parameters": {}}
    path.write_text(yaml.safe_dump(content | {"effects": [odd]}))
    with refused(ContactError):
        load_law(path)
