"""The golden guard sees a changed number, in an array as in a file that holds the time too."""

import h5py
import numpy as np

from validation.golden import differences, folder_hashes


def written(folder, value):
    folder.mkdir()
    with h5py.File(folder / "grasps.h5", "w") as file:
        file["group/values"] = np.array([1.0, value])
    (folder / "about.json").write_text("{}")
    return dict(folder_hashes(folder, "data"))


def test_what_differs_is_listed(tmp_path):
    first, same, other = (
        written(tmp_path / str(k), value) for k, value in enumerate((2.0, 2.0, 2.5))
    )
    assert sorted(first) == ["data/about.json", "data/grasps.h5:group/values"]
    assert differences(first, same) == []
    assert differences(other, first) == ["data/grasps.h5:group/values"]
    assert differences(first | {"new": "0"}, first) == ["new"]
