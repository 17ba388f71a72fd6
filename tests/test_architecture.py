"""Imports run one way through the house: a walk over them."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "tacgen"
# Each folder may import those that stand after it.
ORDER = (
    "cli",
    "study",
    "envs",
    "diagnose",
    "cluster",
    "calibrate",
    "rig",
    "collection",
    "learning",
    "presses",
    "batch",
    "dataset",
    "objects",
    "sensor",
    "physics",
    "contact",
    "optics",
    "report",
    "core",
)


def imported_modules(path: Path) -> set[str]:
    """Dotted names of everything that the file imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@pytest.mark.parametrize("folder", ORDER)
def test_a_folder_imports_only_what_stands_below_it(folder):
    above = {("tacgen", name) for name in ORDER[: ORDER.index(folder)]}
    for path in (PACKAGE / folder).rglob("*.py"):
        back_up = {n for n in imported_modules(path) if tuple(n.split(".")[:2]) in above}
        assert not back_up, f"{path.relative_to(ROOT)} imports {sorted(back_up)}"


def test_every_folder_has_its_place():
    folders = {path.parent.name for path in PACKAGE.glob("*/__init__.py")}
    assert folders == set(ORDER)


def test_importing_tacgen_is_free_of_side_effects():
    code = (
        "import sys, tacgen.cli; "
        "heavy = {'pybullet', 'torch', 'cv2', 'numba', 'matplotlib'} & set(sys.modules); "
        "sys.exit(' '.join(heavy) or 0)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, f"importing tacgen.cli also imports {result.stderr}"
