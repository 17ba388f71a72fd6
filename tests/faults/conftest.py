"""A small dataset, collected without any trouble, to compare with."""

import hashlib
from pathlib import Path

import pytest

from tacgen.collection.recipe import load_recipe
from tacgen.collection.run import collect
from tests.dataset.conftest import finished, spec, toy  # noqa: F401
from tests.small_world import write_world


def digests(folder: Path) -> dict[str, str]:
    """sha256 of every finished-looking shard's file, by name."""
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.glob("shards/shard-*.h5"))
    }


@pytest.fixture(scope="session")
def untroubled(tmp_path_factory):
    """The digests of the small dataset: six grasps in three shards."""
    folder = tmp_path_factory.mktemp("untroubled")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        collect(load_recipe(write_world(folder)), folder / "out", progress=False)
    return digests(folder / "out")


@pytest.fixture
def world(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_world(tmp_path)
