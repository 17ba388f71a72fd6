"""What `doctor` says of a machine."""

import pytest

from tacgen.cli import doctor
from tacgen.core.errors import PhysicsError


@pytest.mark.slow
def test_this_machine_can_run_the_default_path():
    needed = [finding for finding in doctor.examine() if finding.needed]
    assert {finding.name for finding in needed} == {"python", "engine", "free disk"}
    assert all(finding.ok for finding in needed)


@pytest.fixture
def no_gl(monkeypatch):
    """Leave the slow search for GL out."""
    none = doctor.Finding("GL", False, False, "not looked for")
    monkeypatch.setattr(doctor, "_gl_platform", lambda *_: none)


def test_a_pybullet_without_numpy_is_named_with_its_fix(monkeypatch, no_gl):
    def without_numpy():
        raise PhysicsError("PyBullet was built without numpy; reinstall it")

    monkeypatch.setattr("tacgen.physics.pybullet_import.load_bullet", without_numpy)
    finding = next(f for f in doctor.examine() if f.name == "pybullet")
    assert (finding.ok, finding.fix) == (False, "reinstall it")


def test_a_full_disk_is_named(monkeypatch, tmp_path, no_gl):
    monkeypatch.setattr(doctor, "MIN_FREE_GB", 1e9)
    finding = next(f for f in doctor.examine(tmp_path) if f.name == "free disk")
    assert not finding.ok
    assert "free some space" in finding.fix
