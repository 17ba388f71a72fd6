"""Real grasps of other projects, made here in the layout that their own readers expect."""

import cv2
import h5py
import numpy as np
import pytest

from tacgen.core.errors import DatasetError
from tacgen.dataset.import_formats import import_grasps
from tacgen.dataset.real_grasps import read_real_grasps
from tests.messages import refused

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


SECOND = 1_612_630_000
PHASES = {"grasping": 50, "pose": 110, "stability": 170, "retract": 230}
"""Phases as PoseIt records them, each shown by a grey level of its own."""


def write_recorded(root, name, labels, *, seconds=4, rate=24):
    """A folder as PoseIt's: whole seconds for phases and pictures, ``rate`` pictures a second."""
    folder = root / f"{name}_{SECOND}_F40_pose3"
    (folder / "gelsight").mkdir(parents=True)
    (folder / "rgb").mkdir()
    starts = {phase: SECOND + seconds * k for k, phase in enumerate(PHASES)}
    (folder / "stages.csv").write_text("".join(f"{p},{s}\n" for p, s in starts.items()))
    (folder / "label.csv").write_text("".join(f"{p},{r}\n" for p, r in labels.items()))
    for frame in range(seconds * len(PHASES) * rate):
        second = SECOND + frame // rate
        grey = next(PHASES[p] for p, s in reversed(starts.items()) if second >= s)
        path = folder / "gelsight" / f"gelsight_{frame}_{second}.jpg"
        cv2.imwrite(str(path), np.full((8, 8, 3), grey, np.uint8))


def test_poseit_frames_end_with_the_second_before_the_next_phase(tmp_path):
    passed = dict.fromkeys(("grasp", "pose", "stability"), "pass")
    write_recorded(tmp_path / "set", "cup", passed)
    _, notes = import_grasps("poseit", tmp_path / "set", tmp_path / "out")
    assert notes == ("not imported: rgb",)
    (grasp,) = read_real_grasps(tmp_path / "out", needs=("force_n",)).grasps
    shown = [int(cv2.imread(str(path))[0, 0, 0]) for path in grasp.images]
    assert shown == [50] * (4 * 24)


@pytest.mark.parametrize(
    ("labels", "label"),
    [
        ({"grasp": "pass", "pose": "drop", "stability": ""}, 0),
        ({"grasp": "pass", "pose": "drop"}, 0),
        ({"grasp": "drop"}, 0),
        ({"grasp": "pass", "pose": "Slip", "stability": "pass"}, 0),
        ({"grasp": "pass", "pose": "pass", "stability": "pass"}, 1),
        ({"grasp": "pass", "pose": "pass"}, None),
        ({"grasp": "pass", "pose": "", "stability": "pass"}, None),
    ],
)
def test_poseit_a_phase_never_reached_after_a_failure_needs_no_result(tmp_path, labels, label):
    write_recorded(tmp_path / "set", "cup", labels, rate=2)
    write_recorded(tmp_path / "set", "can", {"grasp": "pass", "pose": "slip"}, rate=2)
    _, notes = import_grasps("poseit", tmp_path / "set", tmp_path / "out")
    found = {g.config.object: g.label for g in read_real_grasps(tmp_path / "out", needs=()).grasps}
    assert found == {"can": 0} | ({} if label is None else {"cup": label})
    assert any("no result for" in note for note in notes) == (label is None)


def test_poseit_without_a_phase_of_the_grasp_is_not_imported(tmp_path):
    write_poseit(tmp_path / "set", "cup_1_F20_pose1", "pass")
    other = write_poseit(tmp_path / "set", "cup_2_F20_pose2", "pass")
    (other / "stages.csv").write_text("approach,90\npose,105\n")
    count, notes = import_grasps("poseit", tmp_path / "set", tmp_path / "out")
    assert count == 1
    assert "no phase of the grasp" in notes[0]


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


@pytest.mark.parametrize(
    "stored",
    [
        lambda rgb: (rgb / 255).astype(np.float32),
        lambda rgb: rgb.astype(np.float64),
        lambda rgb: rgb.astype(np.uint16) * 257,
        lambda rgb: np.frombuffer(cv2.imencode(".png", rgb[..., ::-1])[1].tobytes(), np.uint8),
    ],
    ids=["0 to 1", "0 to 255", "16 bits", "encoded"],
)
def test_feeling_of_success_pictures_of_any_number_type_are_the_same(tmp_path, stored):
    rgb = np.random.default_rng(3).integers(0, 256, (12, 16, 3)).astype(np.uint8)
    write_feeling_of_success(tmp_path / "c.h5", [("mug", True)])
    with h5py.File(tmp_path / "c.h5", "a") as h5:
        group = h5["data/i0"]
        for name in [name for name in group if name.startswith("gelsight")]:
            del group[name]
            group[name] = stored(rgb)
        group["kinectA_rgb_before"] = rgb
    _, notes = import_grasps("feeling-of-success", tmp_path, tmp_path / "out")
    assert notes == ("not imported: kinectA_rgb_before",)
    for grasp in read_real_grasps(tmp_path / "out", needs=()).grasps:
        assert len(grasp.images) == 3
        np.testing.assert_array_equal(cv2.imread(str(grasp.images[0]))[..., ::-1], rgb)


def test_feeling_of_success_what_is_not_sure_is_named(tmp_path):
    write_feeling_of_success(tmp_path / "c.h5", [("mug", True), ("can", b"False"), ("box", b"?")])
    with h5py.File(tmp_path / "c.h5", "a") as h5:
        group = h5["data/i0"]
        del group["gelsightA_during"], group["gelsightB_after"]
        group["gelsightA_during"] = np.full((12, 16, 3), 1023.0)  # 10 bits
    count, notes = import_grasps("feeling-of-success", tmp_path, tmp_path / "out")
    assert count == 2
    grasps = read_real_grasps(tmp_path / "out", needs=()).grasps
    assert [(g.config.object, g.label) for g in grasps] == [("can", 0)] * 2
    assert "gelsightA_during: float64 from 1023 to 1023" in notes[0]
    assert "no gelsightB_after" in notes[1]
    assert "is_gripping is neither true nor false" in notes[2]


def test_what_needs_force_and_place_says_so(tmp_path):
    write_feeling_of_success(tmp_path / "calandra_000.h5", [("mug", True)])
    import_grasps("feeling-of-success", tmp_path, tmp_path / "out")
    with refused(DatasetError):
        read_real_grasps(tmp_path / "out")


def test_an_empty_source_writes_nothing(tmp_path):
    (tmp_path / "empty").mkdir()
    with refused(DatasetError):
        import_grasps("poseit", tmp_path / "empty", tmp_path / "out")
    assert not (tmp_path / "out").exists()
