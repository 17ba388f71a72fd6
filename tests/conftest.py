"""Fixtures that every part of the suite shares."""

from pathlib import Path

import hypothesis
import pytest

from tacgen.core.errors import missing_extra
from tacgen.core.processes import start_early

MEASURED_DATA = Path(__file__).resolve().parents[1].parent / "shared" / "data"
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.load_profile("repeatable")
NEED_LEARN = ("learning/*", "study/*", "validation/test_others.py")
HAS_LEARN = not missing_extra("learn", "")
collect_ignore_glob = [] if HAS_LEARN else list(NEED_LEARN)


def pytest_report_header() -> str:
    """What is left out where the networks' packages are missing."""
    return "" if HAS_LEARN else f"the extra `learn` is missing; not tested: {', '.join(NEED_LEARN)}"


LONGEST = ("test_docs.py", "test_slurm.py")
EXHAUSTIVE = ("fuzz", "slurm", "validation", "faults/test_random_kills.py")
"""Folders and files of ``tests/`` that ``make test`` leaves to ``make test-all``."""


@pytest.hookimpl(tryfirst=True)  # before ``-m`` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest tests first: one that starts last keeps a process waiting for the other."""
    items.sort(key=lambda item: item.path.name not in LONGEST)
    for item in items:
        place = item.path.relative_to(Path(__file__).parent).as_posix()
        if any(place == one or place.startswith(f"{one}/") for one in EXHAUSTIVE):
            item.add_marker("exhaustive")


@pytest.fixture(scope="session", autouse=True)
def process_to_copy_workers_from() -> None:
    """It imports what simulations need once; started by a smaller job, it would lack that."""
    start_early("tacgen.collection.run", "tacgen.collection.perturbed")


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """The folder of measured data beside the checkout, which is not part of the repository."""
    if not MEASURED_DATA.is_dir():
        pytest.skip("measured data not found beside the checkout (../shared/data)")
    return MEASURED_DATA
