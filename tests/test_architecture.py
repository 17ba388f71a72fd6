"""The stages stay apart: a walk over the imports."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "tacgen"
STAGES = {"physics", "contact", "optics", "dataset", "calibration", "loop", "learning"}
# Calibration and the loop work on the models themselves, so they may import these stages.
MAY_IMPORT = {
    "physics": set(),
    "contact": set(),
    "optics": set(),
    "dataset": set(),
    "calibration": {"contact", "optics"},
    "loop": {"contact", "optics", "calibration"},
    "learning": {"dataset"},
}
MODULES = sorted(PACKAGE.rglob("*.py"))


def imported_modules(path: Path) -> set[str]:
    """Dotted names of everything that the file imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def parts_of_tacgen(path: Path) -> set[str]:
    """The first-level parts of tacgen that the file imports."""
    return {
        name.split(".")[1]
        for name in imported_modules(path)
        if name.startswith("tacgen.") and len(name.split(".")) > 1
    }


@pytest.mark.parametrize("stage", sorted(STAGES))
def test_a_stage_imports_only_what_it_may(stage):
    for path in (PACKAGE / stage).rglob("*.py"):
        foreign = parts_of_tacgen(path) & STAGES - {stage} - MAY_IMPORT[stage]
        assert not foreign, f"{path.relative_to(ROOT)} imports {sorted(foreign)}"


def test_nothing_imports_the_command_line():
    for path in MODULES:
        if path.name != "__main__.py" and path.parent.name != "cli":
            assert "cli" not in parts_of_tacgen(path), path.relative_to(ROOT)


def test_the_command_line_imports_no_stage_at_its_top():
    for path in (PACKAGE / "cli").glob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        top = {node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
        own = {name for name in top if name.startswith("tacgen")}
        assert own <= {"tacgen.errors", "tacgen.cli", "tacgen.cli.app"}, path.name


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


def test_modules_keep_one_purpose():
    """A file that outgrows 350 lines is asked to split."""
    long = {
        str(path.relative_to(ROOT)): n
        for path in MODULES
        if (n := len(path.read_text(encoding="utf-8").splitlines())) > 350
    }
    assert not long
