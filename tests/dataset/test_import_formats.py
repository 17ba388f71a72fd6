"""Real grasps of other projects, made here in the layout that their own readers expect."""

import cv2
import h5py
import numpy as np
import pytest

from tacgen.core.errors import DatasetError
from tacgen.dataset.import_formats import import_grasps
from tacgen.dataset.real_grasps import read_real_grasps

GEL = np.full((24, 32, 3), (90, 120, 150), np.uint8)  # blue, green, red


def write_poseit(root, name, result, *, frames=((99, 0), (100, 1), (101, 2), (104, 3), (120, 4))):
    folder = root / name
    (folder / "gelsight").mkdir(parents=True)
    stages = "phase,unix_timestamp\napproach,90\ngrasping,100\npose,105\nshaking,110\n"
    (folder / "stages.csv").write_text(stages)
    (folder / "label.csv").write_text(f"phase,result\npose,pass\nshaking,{result}\n")
    for second, number in frames:
        image = GEL + np.uint8(10 * number)
        cv2.imwrite(str(folder / "gelsight" / f"gelsight_{number}_{second}.jpg"), image)
    return folder


def test_poseit_frames_from_the_grasp_to_the_next_phase(tmp_path):
    root = tmp_path / "poseit"
    write_poseit(root, "bangle_1612630172_F80_pose8", "pass")
    write_poseit(root, "toy_duck_1612630199_F40_pose2", "drop")
    count, notes = import_grasps("poseit", root, tmp_path / "out")
    assert (count, notes) == (2, ())
    grasps = read_real_grasps(tmp_path / "out", needs=("force_n",)).grasps
    assert [grasp.config.object for grasp in grasps] == ["bangle", "toy_duck"]
    assert [grasp.config.force_n for grasp in grasps] == [80.0, 40.0]
    assert [grasp.label for grasp in grasps] == [1, 0]
    assert np.isnan(grasps[0].config.x_mm)
    shown = [int(cv2.imread(str(path))[0, 0, 0]) for path in grasps[0].images]
    # JPEG keeps a flat picture's grey level within one.
    np.testing.assert_allclose(shown, [100, 110, 120], atol=1.5)


def test_poseit_folders_that_cannot_be_used_are_named(tmp_path):
    root = tmp_path / "poseit"
    write_poseit(root, "cup_1_F20_pose1", "pass")
    write_poseit(root, "cup_2_F20_pose2", "perhaps")
    write_poseit(root, "cup_3_F20_pose3", "pass", frames=())
    (root / "cup_4_F20_pose4").mkdir()
    count, notes = import_grasps("poseit", root, tmp_path / "out")
    assert count == 1
    assert len(notes) == 3
    assert "perhaps" in notes[0]
    assert "no readable picture" in notes[1]
    assert "stages.csv" in notes[2]


def write_feeling_of_success(path, entries):
    """As deepdish writes a list of dictionaries: /data/i0, /data/i1, …, scalars as attributes."""
    with h5py.File(path, "w") as h5:
        data = h5.create_group("data")
        for k, (name, held) in enumerate(entries):
            group = data.create_group(f"i{k}")
            group.attrs["is_gripping"] = held
            group.create_dataset("object_name", data=np.array([name.encode()]))
            for finger, level in (("A", 10), ("B", 60)):
                for step, moment in enumerate(("before", "during", "after")):
                    rgb = np.zeros((12, 16, 3), np.uint8)
                    rgb[..., 0] = level + step  # red
                    group.create_dataset(f"gelsight{finger}_{moment}", data=rgb)


def test_feeling_of_success_gives_one_grasp_a_finger(tmp_path):
    write_feeling_of_success(tmp_path / "calandra_000.h5", [("mug", True), ("duck", False)])
    count, _ = import_grasps("feeling-of-success", tmp_path, tmp_path / "out")
    assert count == 4
    grasps = read_real_grasps(tmp_path / "out", needs=()).grasps
    assert [(g.config.object, g.label) for g in grasps] == [("mug", 1)] * 2 + [("duck", 0)] * 2
    assert [grasp.grasp_id[-1] for grasp in grasps] == ["A", "B", "A", "B"]
    red = [int(cv2.imread(str(path))[0, 0, 2]) for path in grasps[1].images]
    assert red == [60, 61, 62]


def test_what_needs_force_and_place_says_so(tmp_path):
    write_feeling_of_success(tmp_path / "calandra_000.h5", [("mug", True)])
    import_grasps("feeling-of-success", tmp_path, tmp_path / "out")
    with pytest.raises(DatasetError, match="without force and place a grasp cannot be simulated"):
        read_real_grasps(tmp_path / "out")


def test_an_empty_source_writes_nothing(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="no grasps of the layout poseit"):
        import_grasps("poseit", tmp_path / "empty", tmp_path / "out")
    assert not (tmp_path / "out").exists()
