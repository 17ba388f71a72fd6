"""One table of a shard's arrays: an entry is all that a new one takes."""

import io
import json
import subprocess
import sys
import tarfile
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest

from tacgen.dataset import Dataset

CHECKOUT = Path(__file__).parents[2]

WITH_ONE_MORE = """
import importlib.util, sys
from pathlib import Path
sys.path.insert(0, {checkout!r})
path = Path({checkout!r}) / "tacgen/dataset/schema.py"
entry = '_of_pad("slide_mm", ("N", "T", 2), "mm", "how far it slid", source="pad.force_shear_n"),'
before = '    _of_pad("indentation_mm"'
source = path.read_text()
assert source.count(before) == 1
spec = importlib.util.spec_from_file_location("tacgen.dataset.schema", path)
module = importlib.util.module_from_spec(spec)
sys.modules["tacgen.dataset.schema"] = module
source = source.replace(before, f"    {{entry}} {{before}}")
exec(compile(source, str(path), "exec"), module.__dict__)

from tests.dataset.conftest import collect_toy, make_spec
from tacgen.dataset.export import FORMATS, export_dataset
from tacgen.dataset.reader import Dataset
from tacgen.dataset.summary import write_card
from tacgen.dataset.verify import verify
root = Path({root!r})
toy = collect_toy(root / "data", make_spec(pads=("left", "right"), depth=True))
toy.merge()
assert not verify(toy.root, decode=True).problems
columns = Dataset(toy.root).columns(contact=True)
assert (columns["slide_mm"] == columns["force_shear_n"]).all()
assert "slide_mm" in write_card(toy.root).read_text()
for name in FORMATS:
    export_dataset(toy.root, root / name, name)
"""


@pytest.mark.slow
def test_an_entry_is_written_checked_read_shown_and_exported(tmp_path):
    script = WITH_ONE_MORE.format(checkout=str(CHECKOUT), root=str(tmp_path))
    subprocess.run([sys.executable, "-c", script], check=True, cwd=CHECKOUT)
    with h5py.File(tmp_path / "data/shards/shard-00000.h5") as file:
        for pad in ("left", "right"):
            there = file[f"/contact/gelsight_{pad}/slide_mm"]
            assert (there.attrs["unit"], there.attrs["frame"]) == ("mm", "gel")
            shear_n = file[f"/contact/gelsight_{pad}/force_shear_n"][:]
            np.testing.assert_array_equal(there[:], shear_n)
    with h5py.File(tmp_path / "robomimic/grasps.hdf5") as file:
        assert file["data/demo_0/obs/right_slide_mm"].shape == (3, 2)
    frames = pd.read_csv(tmp_path / "images/contact/g00000.csv")
    np.testing.assert_array_equal(frames["slide_x_mm"], frames["force_shear_x_n"])
    info = json.loads((tmp_path / "lerobot/meta/info.json").read_text())
    assert "left.slide_y_mm" in info["features"]["observation.state"]["names"]
    with tarfile.open(tmp_path / "webdataset/grasps-000000.tar") as archive:
        content = archive.extractfile("g00000.right.slide_mm.npy").read()
    assert np.load(io.BytesIO(content)).shape == (3, 2)


def test_every_array_of_a_shard_is_an_entry_and_the_other_way_round(toy):
    def paths(group, where=""):
        for name, one in group.items():
            yield from (
                paths(one, f"{where}/{name}")
                if isinstance(one, h5py.Group)
                else [f"{where}/{name}"]
            )

    layout = Dataset(toy.root).layout
    with h5py.File(toy.shard_path(0)) as file:
        assert set(paths(file)) == {one.path for one in layout.placed()}
    assert "/tactile/gelsight/depth_mm" not in {one.path for one in layout.placed()}
