"""Fixtures that every part of the suite shares."""

import os
import re
from pathlib import Path

import hypothesis
import pytest

from tacgen.core.errors import missing_extra
from tacgen.core.processes import start_early
from tests import messages

ROOT = Path(__file__).resolve().parents[1]
MEASURED_DATA = ROOT.parent / "shared" / "data"
hypothesis.settings.register_profile("repeatable", derandomize=True)
hypothesis.settings.load_profile("repeatable")
NEED_LEARN = ("learning/*", "study/*")
HAS_LEARN = not missing_extra("learn", "")
collect_ignore_glob = [] if HAS_LEARN else list(NEED_LEARN)


def pytest_report_header() -> str:
    """What is left out where the networks' packages are missing."""
    return "" if HAS_LEARN else f"the extra `learn` is missing; not tested: {', '.join(NEED_LEARN)}"


LONGEST = (
    "test_docs.py", "slurm/test_slurm.py", "batch/test_batch_sensor.py", "test_packaging.py",
    "invariance/test_placement.py", "diagnose/optics/test_diagnose.py",
    "diagnose/contact/test_diagnose.py", "learning/test_train.py", "learning/test_evaluate.py",
    "envs/test_grasping.py", "collection/test_run.py", "physics/test_closed_forms.py",
)  # fmt: skip
"""Files that start first, since one that starts last keeps a process waiting for the other."""
EXHAUSTIVE = (
    "fuzz", "slurm", "validation", "faults/test_processors.py", "faults/test_random_kills.py",
)  # fmt: skip
"""Folders and files that ``make test`` leaves to ``make test-all``; those of studies, too."""
ENGINES = ("batch", "collection", "envs", "faults", "invariance", "physics/test_closed_forms.py",
           "physics/test_grasp.py", "physics/test_repeatability.py")  # fmt: skip
"""Whose slow tests ``make test`` runs in PyBullet alone, where both engines are tested."""


def is_in(place: str, places: tuple[str, ...]) -> bool:
    return any(place == one or place.startswith(f"{one}/") for one in places)


@pytest.hookimpl(tryfirst=True)  # before ``-m`` chooses
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest files first, what ``make test`` leaves out marked, and no message left over."""
    if not any("::" in argument for argument in config.args) and (left := messages.stale(items)):
        if os.environ.get(messages.APPROVE):
            messages.approve({}, left)
        else:
            raise pytest.UsageError(f"tests/messages.txt has rows of no test: {left}")
    places = {item: item.path.relative_to(ROOT).as_posix().removeprefix("tests/") for item in items}
    items.sort(key=lambda item: LONGEST.index(places[item]) if places[item] in LONGEST else 99)
    for item in items:
        given = item.callspec.params if hasattr(item, "callspec") else {}
        is_mujoco = any(isinstance(value, str) and value == "mujoco" for value in given.values())
        is_twice = is_mujoco and item.get_closest_marker("slow") and is_in(places[item], ENGINES)
        if is_twice or is_in(places[item], EXHAUSTIVE):
            item.add_marker("exhaustive")


@pytest.fixture(scope="session", autouse=True)
def places_in_messages(tmp_path_factory: pytest.TempPathFactory) -> None:
    """A test's own folder is TMP in the approved messages."""
    base = re.escape(str(tmp_path_factory.getbasetemp()))
    messages.PLACES = {rf"{base}/[^/\s'\":;,)`]+": "TMP", **messages.PLACES}


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
