"""What `doctor` says of a machine."""

from tacgen.cli import doctor
from tacgen.core.errors import PhysicsError


def test_this_machine_can_run_the_default_path():
    needed = [finding for finding in doctor.examine() if finding.needed]
    assert {finding.name for finding in needed} == {"python", "engine", "free disk"}
    assert all(finding.ok for finding in needed)


def test_a_pybullet_without_numpy_is_named_with_its_fix(monkeypatch):
    def without_numpy():
        raise PhysicsError("PyBullet was built without numpy; reinstall it")

    monkeypatch.setattr("tacgen.physics.pybullet_import.load_bullet", without_numpy)
    finding = next(f for f in doctor.examine() if f.name == "pybullet")
    assert (finding.ok, finding.fix) == (False, "reinstall it")


def test_a_full_disk_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(doctor, "MIN_FREE_GB", 1e9)
    finding = next(f for f in doctor.examine(tmp_path) if f.name == "free disk")
    assert not finding.ok
    assert "free some space" in finding.fix
