"""Damaged and hostile files: one clear error, never a traceback, a hang or a heap of memory."""

import json
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tacgen.core.errors import DatasetError
from tacgen.dataset.manifest import parse_line
from tacgen.dataset.shard import open_shard
from tests.messages import refused

CHECKOUT = Path(__file__).parents[2]

# In a process of its own: a crash of the library, a hang or 2 GB of memory must fail the test.
FUZZ = """
import json, resource, sys
sys.path.insert(0, {checkout!r})
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
from tests.dataset.conftest import *
from tacgen.dataset import Dataset
from tacgen.dataset.verify import verify
from tacgen.core.errors import TacgenError
from tacgen.core.files import sha256_of

rng = np.random.default_rng(7)
toy = collect_toy(Path({root!r}), make_spec(n_grasps=4, depth=True))
path, line_path = toy.shard_path(0), toy.line_path(0)
sound, line = path.read_bytes(), json.loads(line_path.read_text())
refused = 0
for trial in range(150):
    data = bytearray(sound)
    if trial % 3 == 0:
        data = data[: rng.integers(len(data))]
    elif trial % 3 == 1:
        for place in rng.integers(0, 9000, 6):
            data[place] = rng.choice([0, 1, 127, 128, 255])
    else:
        place = rng.integers(len(data) - 64)
        data[place : place + 40] = rng.bytes(40)
    path.write_bytes(data)
    line_path.write_text(json.dumps(line | {{"sha256": sha256_of(path), "bytes": len(data)}}))
    try:
        dataset = Dataset(toy.root)
        for index in dataset.indices:
            dataset.read(int(index))
    except TacgenError as error:
        refused += 1
        assert str(toy.root) in str(error)
    verify(toy.root, decode=True)
# Of this program alone: what getrusage tells is inherited from the process that started it.
status = Path("/proc/self/status").read_text()
peak_mb = int(status.split("VmHWM:")[1].split()[0]) / 1024
print(json.dumps({{"refused": refused, "peak_mb": peak_mb}}))
"""


@pytest.mark.exhaustive
@pytest.mark.slow
def test_shards_damaged_at_random_are_refused(tmp_path):
    script = FUZZ.format(checkout=str(CHECKOUT), root=str(tmp_path / "toy"))
    run = subprocess.run(
        [sys.executable, "-c", script], cwd=CHECKOUT, capture_output=True, text=True, timeout=100
    )
    assert run.returncode == 0, run.stderr[-2000:]
    told = json.loads(run.stdout.splitlines()[-1])
    assert told["refused"] > 75
    assert told["peak_mb"] < 300


VALUES = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.just([[[]]])


@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_any_value_for_a_key_of_a_line(toy, data):
    line = json.loads(toy.line_path(0).read_text())
    key = data.draw(st.sampled_from(sorted(line)))
    line[key] = data.draw(VALUES | st.dictionaries(st.text(), VALUES) | st.lists(VALUES))
    try:
        parsed = parse_line(json.dumps(line), "x")
    except DatasetError:
        return
    assert parsed.file == f"shards/shard-{parsed.shard:05d}.h5"


@pytest.mark.parametrize(
    "attributes",
    [
        {},
        {"format": "tacgen"},
        {"format_version": np.int64(2)},
        {"sensor": np.bytes_(b"../../x")},
        {"pads": np.bytes_(b"left,middle")},
        {"index_range": np.array([0, 10**9])},
        {"format_version": "1" * 1000},
    ],
)
def test_attributes_that_are_not_the_schemas(toy, attributes):
    with h5py.File(toy.shard_path(0), "r+") as file:
        if not attributes:
            del file.attrs["format"]
        for name, value in attributes.items():
            file.attrs[name] = value
    with refused(DatasetError):
        open_shard(toy.shard_path(0))


def test_a_text_file_a_folder_and_a_stranger_are_no_shards(tmp_path):
    path = tmp_path / "shard.h5"
    path.write_text("hello")
    with refused(DatasetError):
        open_shard(path)
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = np.zeros(3)
    with refused(DatasetError):
        open_shard(tmp_path / "other.h5")
    with refused(DatasetError):
        open_shard(tmp_path)
