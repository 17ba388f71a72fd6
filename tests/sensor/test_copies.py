"""Sensors that are copied, pickled and sent to other processes render the same there."""

import copy
import multiprocessing
import pickle
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tacgen.core.errors import SensorError
from tacgen.optics.image_models import Quadratic, Response, features
from tacgen.optics.table import load_table, save_table
from tacgen.sensor.simulated import Sensor
from tests.messages import refused

BALL = trimesh.creation.icosphere(subdivisions=3, radius=4.0)
WAYS = [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))]


def pressed(sensor, force_n=3.0):
    return sensor.render(BALL, np.eye(4), force_n, (0.4, 0.1))


def table_of(kind, path):
    """The DIGIT's table, rendered by that image model, with an effect of its own."""
    table = load_table(Sensor("digit").description.table)
    table = replace(table, model=None, response=None, contact=None)
    if kind is Response:
        v, u = np.meshgrid(np.linspace(-0.5, 0.5, 4), np.linspace(-0.5, 0.5, 5), indexing="ij")
        nodes = np.einsum("sdcf,vuf->sdvuc", table.coefficients, features(u, v))
        table = replace(table, response=nodes.astype(np.float32))
    assert isinstance(table.image_model, kind)
    save_table(replace(table, effects={"blur": {"sigma_mm": 0.2}}), path)
    return path


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", [Quadratic, Response])
def test_a_copy_renders_the_same(kind, way, tmp_path):
    sensor = Sensor("digit", table=table_of(kind, tmp_path / "table.npz"), shadows=True, seed=4)
    other = way(sensor)
    assert other is not sensor
    for force_n in (1.0, 6.0):
        wanted, found = pressed(sensor, force_n), pressed(other, force_n)
        np.testing.assert_array_equal(found.rgb, wanted.rgb)
        np.testing.assert_array_equal(found.markers_mm, wanted.markers_mm)
    pickle.loads(pickle.dumps(sensor.table))


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_draws_its_own_noise_from_where_it_was_taken(way):
    sensor = Sensor("digit", noise=True, seed=7)
    pressed(sensor)
    other = way(sensor)
    wanted = [pressed(sensor).rgb for _ in range(2)]
    np.testing.assert_array_equal([pressed(other).rgb for _ in range(2)], wanted)
    assert not np.array_equal(wanted[0], wanted[1])


@pytest.mark.parametrize("way", WAYS)
def test_an_attached_sensor_is_refused(way):
    sensor = Sensor("digit")
    sensor._simulation = object()
    with refused(SensorError):
        way(sensor)


@pytest.mark.slow
def test_it_renders_in_a_process_that_was_spawned():
    sensor = Sensor("gelsight_mini", markers=True)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        (found,) = pool.starmap(sensor.render, [(BALL, np.eye(4), 2.0)])
    wanted = sensor.render(BALL, np.eye(4), 2.0)
    np.testing.assert_array_equal(found.rgb, wanted.rgb)
    np.testing.assert_array_equal(found.markers_mm, wanted.markers_mm)
