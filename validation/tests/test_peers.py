"""Peers are run where they are, timed on the same presses, and their errors passed on."""

import sys

import numpy as np
import pytest

from validation.optics.peers import peer_ms, presses, write_presses

FAKE_TACTO = """
from types import SimpleNamespace
class Renderer:
    def __init__(self, width, height, background, config):
        assert (width, height) == (240, 320)
        gel = SimpleNamespace(origin=[0.022, 0, 0.015])
        self.conf = SimpleNamespace(sensor=SimpleNamespace(gel=gel))
        self.scene = SimpleNamespace(remove_node=lambda node: None)
        self.object_nodes = {}
    def add_object(self, mesh, name):
        # 20 mm3 are pressed in: some of the object lies behind the gel, and not far.
        assert -3e-3 < mesh.vertices[:, 0].min() - 0.022 < 0
        self.object_nodes[name] = name
    def render(self):
        pass
"""


@pytest.mark.slow
def test_a_peer_is_timed_on_every_press_and_an_error_is_its_last_line(tmp_path):
    (tmp_path / "tacto").mkdir()
    (tmp_path / "tacto/__init__.py").write_text("")
    (tmp_path / "tacto/renderer.py").write_text(FAKE_TACTO)
    found = peer_ms("tacto", tmp_path, sys.executable, 2)
    assert [(kind, len(times)) for kind, times in found.items()] == [("plain", 5)]
    assert all(0 <= one < 1000 for one in found["plain"])
    assert "No module named 'tactile_render'" in peer_ms("FOTS", tmp_path, sys.executable, 2)


def test_presses_lose_the_volume_that_was_asked_for(tmp_path):
    write_presses("tacto", tmp_path / "presses.npz")
    with np.load(tmp_path / "presses.npz") as file:
        volumes_mm3 = file["depth_mm"].sum(axis=(1, 2)) * float(file["mm_per_px"]) ** 2
        np.testing.assert_allclose(volumes_mm3, 20.0, rtol=1e-4)
        assert len(list(presses())) == len(volumes_mm3)
