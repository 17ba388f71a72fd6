"""What must not matter to a batch: calls that were refused, and worlds that nothing presses on."""

from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
import trimesh

import tacgen
from tacgen.contact.law import ContactLaw, FittedEffect
from tacgen.core.errors import ContactError, SensorError
from tacgen.core.records import Estimate
from tests.messages import refused

CREEP = FittedEffect(
    "creep",
    "normal",
    MappingProxyType({"amount": Estimate(0.5), "tau_s": Estimate(2.0), "recovery": Estimate(1.0)}),
)
CREEPING = replace(ContactLaw.linear(5.135, 1.0, 2.0), effects=(CREEP,))
BALL = trimesh.creation.icosphere(subdivisions=4, radius=4.0)
POSES = np.stack([np.eye(4)] * 2)
NOWHERE = np.nan * POSES


def course(law, call):
    """The frame of a third call, after one between that is refused."""
    batch = tacgen.BatchSensor(
        "gelsight_mini", 2, "cpu", contact=law, markers=True, noise=True, seed=3
    )
    ball = batch.add_mesh(BALL)
    for time_s, shear_n in ((0.0, 1.5), (1.0, 2.0)):
        batch.render_meshes([ball] * 2, POSES, 4.0, [[shear_n, 0.0]] * 2, time_s=time_s)
    if call is not None:
        with refused((ContactError, SensorError)):
            call(batch)
    found = batch.render_meshes([ball] * 2, POSES, 4.0, time_s=2.0)
    return found.markers_mm.copy(), found.depth_mm.copy(), found.rgb.copy()


@pytest.fixture(scope="module")
def undisturbed():
    """The course that no refused call is in."""
    return course(CREEPING, None)


GAP_MM = np.full((2, 240, 320), np.nan, np.float32)
PULL = [[3.0, 0.0]] * 2


@pytest.mark.parametrize(
    "call",
    [
        lambda b: b.render_meshes([0, 0], POSES, [-1.0, 1.0], time_s=100.0),
        lambda b: b.render_meshes([0, 0], POSES, [-1.0, 1.0]),
        lambda b: b.render_meshes([0, 0], NOWHERE, 4.0, PULL, time_s=100.0),
        lambda b: b.render_meshes([0, 0], NOWHERE, 4.0, PULL, time_s=1.5),
        lambda b: b.render_meshes([0, 0], NOWHERE, 4.0, time_s=0.5),
        lambda b: b.render_meshes([0, 0], POSES, np.ones(3), time_s=0.5),
        lambda b: b.render_meshes([0, 7], POSES, 4.0, PULL, time_s=[0.5, 3.0]),
        lambda b: b.render(0.0 * GAP_MM, 4.0),
        lambda b: b.render(np.zeros_like(GAP_MM), 4.0, PULL),
        lambda b: b.render(np.zeros_like(GAP_MM), 4.0, time_s=0.5),
        lambda b: b.render_depth(GAP_MM),
    ],
)
def test_a_call_that_is_refused_changes_nothing(undisturbed, call):
    for found, right in zip(course(CREEPING, call), undisturbed, strict=True):
        np.testing.assert_array_equal(found, right)


@pytest.mark.parametrize("name", ["gelsight", "gelsight_mini", "digit"])
def test_a_gel_that_nothing_presses_on_is_not_saturated(name):
    """Of a box that touches beside the window first."""
    box = trimesh.creation.box((60.0, 60.0, 5.0))
    pose = trimesh.transformations.rotation_matrix(np.pi / 4, (0, 1, 0))
    forces_n = [0.0, 1e-4, 4.0]
    batch, single = tacgen.BatchSensor(name, 3, "cpu"), tacgen.Sensor(name)
    shown = batch.render_meshes([batch.add_mesh(box)] * 3, np.stack([pose] * 3), forces_n)
    expected = [single.render(box, pose, force_n).saturated for force_n in forces_n]
    assert shown.saturated.tolist() == expected
    assert not shown.saturated[0]
