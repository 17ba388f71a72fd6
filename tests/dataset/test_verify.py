import json
import re
import shutil

import h5py
import numpy as np
import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import DatasetError, VerificationError
from tacgen.dataset import Dataset
from tacgen.dataset.manifest import parse_line
from tacgen.dataset.verify import verify
from tests.messages import refused

from .conftest import collect_toy, make_sample, make_spec, vouch_for


def reasons(root) -> str:
    return "\n".join(f"{problem.file}: {problem.reason}" for problem in verify(root).problems)


def test_a_sound_dataset_has_no_problems(toy):
    found = verify(toy.root, decode=True)
    assert found.problems == ()
    assert (found.n_shards, found.n_grasps) == (3, 10)


@pytest.mark.slow
def test_one_flipped_byte_anywhere_is_found_in_that_shard(toy):
    path = toy.shard_path(1)
    sound = path.read_bytes()
    places = np.random.default_rng(0).integers(0, len(sound), 40).tolist()
    for place in [0, 8, len(sound) // 2, len(sound) - 1, *places]:
        path.write_bytes(sound[:place] + bytes([sound[place] ^ 0x10]) + sound[place + 1 :])
        found = verify(toy.root)
        assert found.bad_shards == (1,), f"byte {place}"
    path.write_bytes(sound)
    assert not verify(toy.root).problems


def test_truncated_missing_and_foreign_shards_are_named(toy):
    toy.shard_path(0).write_bytes(toy.shard_path(0).read_bytes()[:-100])
    toy.shard_path(2).unlink()
    shutil.copy(toy.shard_path(1), toy.shard_path(7))
    text = reasons(toy.root)
    assert "shards/shard-00000.h5: has" in text
    assert "shards/shard-00002.h5: is missing" in text
    assert "shards/shard-00007.h5: is not in the manifest" in text


@pytest.mark.parametrize(
    ("path", "row", "value", "words"),
    [
        ("/contact/force_normal_n", (1, 2), np.nan, "row 1 is not finite"),
        ("/object/pose", (3, 0, 1), np.inf, "row 3 is not finite"),
        ("/grasp/label", 1, 0, r"counts are"),
        ("/grasp/label", 1, 7, "grasp 1: label 7 is not 1, 0 or -1"),
        ("/grasp/status", 2, b"no_contact", "does not go with status no_contact"),
        ("/grasp/failure_mode", 1, b"rotational_slip", "does not go with label 1"),
        ("/grasp/split", 0, b"valid", "split 'valid' is not one of"),
        ("/grasp/index", 2, 1, "/grasp/index is not 0 to 3, each once"),
        ("/grasp/seed", 2, 77, "row 0, 2 is the same grasp again"),
        ("/grasp/grasp_frame", 0, 3, "row 0 is no frame"),
    ],
)
def test_wrong_values_are_found_even_where_the_hash_vouches(toy, path, row, value, words):
    with h5py.File(toy.shard_path(0), "r+") as file:
        file[path][row] = value
    vouch_for(toy, 0)
    found = verify(toy.root)
    assert found.bad_shards == (0,)
    assert re.search(words, found.problems[0].reason)


def test_wrong_shape_type_and_missing_arrays_are_all_listed(toy):
    with h5py.File(toy.shard_path(0), "r+") as file:
        del file["/time_s"], file["/object/pose"], file["/grasp/force_n"]
        file["/object/pose"] = np.zeros((4, 3, 6))
        file["/grasp/force_n"] = np.zeros(4, np.float32)
    vouch_for(toy, 0)
    text = reasons(toy.root)
    assert "/time_s is missing" in text
    assert "/object/pose has shape (4, 3, 6), not (4, 3, 7)" in text
    assert "/grasp/force_n is float32, not float64" in text


def test_links_to_other_files_are_refused(toy, tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as other:
        other["pose"] = np.zeros((4, 3, 7))
    for link in (h5py.ExternalLink(str(tmp_path / "secret.h5"), "/pose"), h5py.SoftLink("/x")):
        with h5py.File(toy.shard_path(0), "r+") as file:
            del file["/object/pose"]
            file["/object/pose"] = link
        vouch_for(toy, 0)
        assert "/object/pose is missing, or a link" in reasons(toy.root)
        with refused(DatasetError):
            Dataset(toy.root).read(0)
    with h5py.File(toy.shard_path(1), "r+") as file:
        del file["/object/pose"]
        file.create_dataset(
            "/object/pose", (4, 3, 7), "f8", external=[(str(tmp_path / "raw"), 0, 672)]
        )
    vouch_for(toy, 1)
    assert "/object/pose lies in another file" in reasons(toy.root)


# Where a Blosc2 frame, its chunk, and a Zstandard frame state their size.
@pytest.mark.parametrize(
    ("path", "place", "start"),
    [
        ("/tactile/gelsight/rgb", (1, 0), 30),
        ("/tactile/gelsight/rgb", (1, 0), 97 + 4),
        ("/tactile/gelsight/depth_mm", (1,), 5),
        ("/scene/picture", (1,), 5),
    ],
)
def test_an_image_that_claims_another_size_is_not_decompressed(tmp_path, path, place, start):
    toy = collect_toy(tmp_path, make_spec(n_grasps=4, depth=True))
    with h5py.File(toy.shard_path(0), "r+") as file:
        images = file[path]
        corner = place + (0,) * (images.ndim - len(place))
        _, raw = images.id.read_direct_chunk(corner)
        images.id.write_direct_chunk(corner, raw[:start] + b"\x7f\x7f" + raw[start + 2 :])
    vouch_for(toy, 0)
    assert f"the image {place} of {path} is damaged" in reasons(toy.root)
    with refused(DatasetError):
        Dataset(toy.root).read(1)


def test_a_manifest_at_odds_with_a_shards_own_line_is_told(toy):
    text = toy.manifest_path.read_text().splitlines()
    line = json.loads(text[1]) | {"sha256": "0" * 64}
    toy.manifest_path.write_text("\n".join([text[0], json.dumps(line), text[2]]) + "\n")
    assert "manifest.jsonl: shards/shard-00001.json says otherwise" in reasons(toy.root)
    toy.merge()
    assert not verify(toy.root).problems


def test_command_verify(toy):
    run = CliRunner().invoke(app, ["verify", str(toy.root)])
    assert (run.exit_code, run.stdout.strip()) == (
        0,
        "10 grasps in 3 shards, all intact",
    )
    toy.shard_path(2).write_bytes(b"")
    run = CliRunner().invoke(app, ["verify", str(toy.root)])
    assert isinstance(run.exception, VerificationError)
    assert run.exception.exit_code == 1
    assert "shards/shard-00002.h5: has 0 bytes" in str(run.exception)
    run = CliRunner().invoke(app, ["verify", str(toy.root), "--json"])
    assert run.exit_code == 1
    told = json.loads(run.stdout)
    assert (told["ok"], told["bad_shards"]) == (False, [2])


@pytest.mark.parametrize(
    "text",
    [
        "{",
        "[" * 100_000,
        "{}",
        '{"schema": 2}',
    ],
)
def test_lines_that_are_none(text):
    with refused(DatasetError):
        parse_line(text, "manifest.jsonl:1")


@pytest.mark.parametrize(
    "change",
    [
        {"shard": "1"},
        {"file": "../../etc/passwd"},
        {"index_range": [4, 2]},
        {"index_range": [0, 1e9]},
        {"index_range": [10**15, 10**15 + 4]},
        {"raw_bytes": 0},
        {"pads": []},
        {"frames": 0},
        {"counts": {"success": "many"}},
        {"objects": {"can": 3}},
        {"bytes": True},
    ],
)
def test_lines_that_lie_are_refused(toy, change):
    line = json.loads(toy.manifest_path.read_text().splitlines()[0]) | change
    with refused(DatasetError):
        parse_line(json.dumps(line), "manifest.jsonl:1")


def test_a_plan_of_another_version_is_neither_sound_nor_replaced(toy, spec):
    plan = json.loads(toy.plan_path.read_text()) | {"schema": 2}
    toy.plan_path.write_text(json.dumps(plan))
    assert any("made by a newer tacgen" in p.reason for p in verify(toy.root).problems)
    with refused(DatasetError):
        toy.prepare(spec)
    assert json.loads(toy.plan_path.read_text()) == plan


@pytest.mark.parametrize("of_version", [True, False])
def test_what_verify_finds_of_a_shard_is_what_a_repair_makes_again(toy, spec, of_version):
    if of_version:
        line = json.loads(toy.line_path(1).read_text())
        line["versions"]["tacgen"] = "0.0.1"
        toy.line_path(1).write_text(json.dumps(line))
    else:
        for path in (toy.shard_path, toy.line_path):
            path(1).write_bytes(path(0).read_bytes())
    toy.manifest_path.unlink()
    assert verify(toy.root).bad_shards == (1,)
    with toy.claim(1, redo=True) as mine:
        assert mine
        toy.write_shard(1, (make_sample(i, spec) for i in spec.shard_range(1)), spec)
    toy.merge()
    assert not verify(toy.root).problems
