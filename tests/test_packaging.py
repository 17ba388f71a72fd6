"""What travels in the wheel: every package, and the recipes and objects as data."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_the_lock_file_pins_every_dependency():
    pinned = {
        line.split("==")[0].lower()
        for lock in ("requirements.lock", "requirements-learn.lock")
        for line in (ROOT / lock).read_text(encoding="utf-8").splitlines()
    }
    tables = re.findall(
        r"^(?:dependencies|learn|parquet|cluster|docs|dev) = \[(.*?)\]", PYPROJECT, re.M | re.S
    )
    assert len(tables) == 6
    named = {
        re.split(r"[><=\[]", name)[0].lower().replace("_", "-")
        for table in tables
        for name in re.findall(r'"([^"]+)"', table)
    }
    assert named <= pinned


def test_no_registry_is_named():
    for lock in ("requirements.lock", "requirements-learn.lock"):
        assert "://" not in (ROOT / lock).read_text(encoding="utf-8")
