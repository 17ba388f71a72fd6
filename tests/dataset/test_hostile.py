"""Files around the shards spoiled by a hand or a disk: told, and mended by the next run."""

import os
from dataclasses import replace

import numpy as np
import pytest

from tacgen.core.errors import DatasetError
from tacgen.dataset import DatasetFolder
from tacgen.dataset.gallery import write_gallery
from tacgen.dataset.verify import verify
from tests.messages import refused

from .conftest import make_sample
from .test_writer import digests

KINDS = {
    "cut in half": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "empty": lambda path: path.write_bytes(b""),
    "random bytes": lambda path: path.write_bytes(np.random.default_rng(0).bytes(3000)),
    "pipe": lambda path: (path.unlink(), os.mkfifo(path)),
    "link to itself": lambda path: (path.unlink(), path.symlink_to(path.name)),
    "endless": lambda path: (path.unlink(), path.symlink_to("/dev/zero")),
    "missing": lambda path: path.unlink(),
}


def run_again(folder, spec):
    """What ``collect`` does: the shards that it made."""
    again = DatasetFolder(folder.root)
    again.prepare(spec)
    made = []
    for shard in range(spec.n_shards):
        if not again.is_done(shard):
            with again.claim(shard) as mine:
                assert mine
                again.write_shard(
                    shard, (make_sample(i, spec) for i in spec.shard_range(shard)), spec
                )
            made.append(shard)
    again.merge()
    return made


RECORDS = ("shards/shard-00001.json", "manifest.jsonl", "dataset.json")


@pytest.mark.parametrize(
    ("name", "kind"),
    [(RECORDS[k % 3], kind) for k, kind in enumerate([*KINDS, "missing", "empty"])],
)
def test_a_spoiled_record_is_mended_by_the_next_run(toy, spec, name, kind):
    before = digests(toy.root)
    KINDS[kind](toy.root / name)
    verify(toy.root)
    made = run_again(toy, spec)
    needs_new = name.startswith("shards") and kind != "missing"
    assert made == ([1] if needs_new else [])
    assert digests(toy.root) == before
    assert not verify(toy.root).problems


def test_a_broken_line_is_its_shards_fault(toy):
    toy.line_path(1).write_text("{")
    found = verify(toy.root)
    assert found.bad_shards == (1,)
    with refused(DatasetError):
        toy.merge()


@pytest.mark.parametrize("kind", ["random bytes", "endless", "missing"])
def test_a_spoiled_recipe_is_told_and_written_again(toy, spec, kind):
    text = toy.recipe_path.read_text()
    KINDS[kind](toy.recipe_path)
    (problem,) = verify(toy.root).problems
    assert problem.file == "recipe.yaml"
    assert "`tacgen collect` with that recipe writes it again" in problem.reason
    write_gallery(toy.root)
    with refused(DatasetError):
        DatasetFolder(toy.root).prepare(replace(spec, recipe_sha256="ef"))
    toy.prepare(spec)
    assert toy.recipe_path.read_text() == text


@pytest.mark.parametrize(
    ("old", "new", "file"),
    [
        ("seed: 3", "seed: 2", "recipe.yaml"),
        ('"shard_size": 4', '"shard_size": 5', "dataset.json"),
        ('"n_shards": 3', '"n_shards": 2', "dataset.json"),
        ('"sensor": "gelsight"', '"sensor": "gelsighu"', "dataset.json"),
        ('"table": "c', '"table": "d', "dataset.json"),
    ],
)
def test_a_changed_byte_of_what_the_shards_have_in_common_is_found(toy, spec, old, new, file):
    path = toy.root / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    assert {problem.file for problem in verify(toy.root).problems} == {file}


@pytest.mark.parametrize("kind", ["missing", "empty"])
def test_without_a_plan_shards_of_another_recipe_are_not_taken_for_ones_own(toy, spec, kind):
    KINDS[kind](toy.plan_path)
    with refused(DatasetError):
        DatasetFolder(toy.root).prepare(replace(spec, recipe_sha256="ef"))


@pytest.mark.parametrize("name", ["shards/shard-00001.h5", "manifest.jsonl", "dataset.json"])
def test_a_folder_where_a_file_should_be_is_named(toy, spec, name):
    (toy.root / name).unlink()
    (toy.root / name).mkdir()
    with refused(DatasetError):
        run_again(toy, spec)


def test_shards_that_may_not_be_read_are_not_taken_for_none(toy, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, _: path != toy.root / "shards")
    toy.manifest_path.unlink()
    with refused(DatasetError):
        toy.manifest()
