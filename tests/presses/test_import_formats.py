"""Press sets of other toolkits, made here in the layout that their own readers expect."""

import json
import weakref

import cv2
import numpy as np
import pandas as pd
import pytest

from tacgen.core.errors import PressError, TacgenError
from tacgen.presses import import_formats
from tacgen.presses.import_formats import import_presses
from tacgen.presses.press_folder import read_presses
from tacgen.presses.rules import IMAGES

BACKGROUND = np.full((48, 64, 3), (90, 120, 150), np.uint8)  # blue, green, red


def picture(x_px: int, y_px: int, radius_px: int) -> np.ndarray:
    image = BACKGROUND.copy()
    cv2.circle(image, (x_px, y_px), radius_px, (60, 160, 130), -1)
    return image


@pytest.fixture
def gs_sdk(tmp_path):
    root = tmp_path / "calibration"
    for k in range(4):
        folder = root / "9.470mm" / str(k)
        folder.mkdir(parents=True)
        cv2.imwrite(str(folder / "gelsight.png"), picture(20 + 5 * k, 24, 8))
        np.savez(folder / "label.npz", center=np.array([20.0 + 5 * k, 24.0]), radius=np.array(8))
    cv2.imwrite(str(root / "background.png"), BACKGROUND)
    rows = {"experiment_reldir": [f"9.470mm/{k}" for k in range(4)], "diameter(mm)": 9.47}
    pd.DataFrame(rows).to_csv(root / "catalog.csv", index=False)
    return root


def test_gs_sdk_keeps_labels_colours_and_scale(gs_sdk, tmp_path):
    found = import_presses("gs-sdk", gs_sdk, tmp_path / "out")
    assert "0.0634" in found.notes[0]
    presses = read_presses(tmp_path / "out")
    assert presses.names == tuple(f"9.470mm_{k}.png" for k in range(4))
    np.testing.assert_allclose(presses.center_px[:, 0], [20, 25, 30, 35])
    np.testing.assert_allclose(presses.radius_px, 8)
    np.testing.assert_allclose(presses.ball_radius_mm, 4.735)
    assert presses.mm_per_px == 0.0634
    assert presses.background[0, 0].tolist() == [150, 120, 90]
    assert presses.images[2][24, 30].tolist() == [130, 160, 60]


def test_gs_sdk_without_labels_leaves_circles_to_be_found(gs_sdk, tmp_path):
    for label in gs_sdk.rglob("label.npz"):
        label.unlink()
    import_presses("gs-sdk", gs_sdk, tmp_path / "out", mm_per_px=0.05)
    presses = read_presses(tmp_path / "out")
    assert np.isnan(presses.center_px).all()
    assert presses.mm_per_px == 0.05


def test_py3dcal_radius_of_contact_follows_from_the_depth(tmp_path):
    root = tmp_path / "dataset"
    for name in ("annotations", "probe_images", "blank_images"):
        (root / name).mkdir(parents=True)
    cv2.imwrite(str(root / "blank_images" / "blank.png"), BACKGROUND)
    rows = []
    for k, depth_mm in enumerate((0.0, 0.5, 1.0)):
        cv2.imwrite(str(root / "probe_images" / f"{k}_X1Y1Z{depth_mm}.png"), picture(30, 20, 6))
        rows.append(
            {"img_name": f"{k}_X1Y1Z{depth_mm}.png", "x_mm": 1, "y_mm": 1, "x_px": 30, "y_px": 20,
             "penetration_depth_mm": depth_mm}
        )  # fmt: skip
    pd.DataFrame(rows).to_csv(root / "annotations" / "annotations.csv", index=False)
    about = {"px_per_mm": 20.0, "probe_radius_mm": 2.0}
    (root / "annotations" / "metadata.json").write_text(json.dumps(about))
    import_presses("py3dcal", root, tmp_path / "out")
    presses = read_presses(tmp_path / "out")
    assert len(presses.names) == 2  # the probe that does not touch is no press
    # A sphere of 2 mm pressed 0.5 and 1 mm deep: a² = 2Rd − d².
    np.testing.assert_allclose(presses.radius_px, 20 * np.sqrt([1.75, 3.0]))
    assert presses.mm_per_px == 0.05


def test_9dtact_asks_for_what_its_folder_lacks(tmp_path):
    root = tmp_path / "depth_calibration"
    root.mkdir()
    cv2.imwrite(str(root / "rectify_crop_ref.png"), BACKGROUND)
    cv2.imwrite(str(root / "rectify_crop_sample.png"), picture(30, 20, 9))
    with pytest.raises(PressError, match=r"--mm-per-px(.|\n)*--ball-radius-mm"):
        import_presses("9dtact", root, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    import_presses("9dtact", root, tmp_path / "out", mm_per_px=0.06, ball_radius_mm=2.0)
    assert read_presses(tmp_path / "out").names == ("rectify_crop_sample.png",)


def test_gelsight_mini_pretrain_takes_spheres_and_their_forces(tmp_path):
    root = tmp_path / "parquet"
    root.mkdir()
    rows = []
    for k, indenter in enumerate(("sphere", "cube", "sphere", "sphere")):
        encoded = cv2.imencode(".png", picture(15 + 10 * k, 20, 5))[1].tobytes()
        rows.append({"image": encoded, "indenter": indenter, "f_z": -1.5 - k})
    pd.DataFrame(rows).to_parquet(root / "train-00000.parquet")
    import_presses(
        "gelsight-mini-pretrain", root, tmp_path / "out", mm_per_px=0.06, ball_radius_mm=2.0
    )
    presses = read_presses(tmp_path / "out")
    assert len(presses.names) == 3
    assert presses.background[24, 40].tolist() == [150, 120, 90]
    table = pd.read_csv(tmp_path / "out" / "presses.csv")
    assert table["force_normal_n"].tolist() == [1.5, 3.5, 4.5]


def dimple(x_px, y_px, radius_px, size=(120, 160)):
    """A gel of one colour with a shaded dimple, as a ball leaves it, and its background."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    gel = np.full((*size, 3), (90.0, 120.0, 150.0))
    dx, dy = (columns - x_px) / radius_px, (rows - y_px) / radius_px
    inside = np.hypot(dx, dy) < 1
    shade = np.stack([dx, dy, -dx - dy], axis=-1) * inside[..., None]
    return gel.astype(np.uint8), (gel + 70 * shade).astype(np.uint8)


def write_py3dcal(root, presses, *, probe_radius_mm=4.0, px_per_mm=10.0, frames=1):
    """py3DCal's folder of (x_mm, y_mm, depth_mm, seen radius in px), the stage's y upwards."""
    for name in ("annotations", "probe_images", "blank_images"):
        (root / name).mkdir(parents=True)
    rows = []
    for k, (x_mm, y_mm, depth_mm, seen_px) in enumerate(presses):
        x_px, y_px = 80 + px_per_mm * x_mm, 60 - px_per_mm * y_mm
        background, image = dimple(x_px, y_px, seen_px)
        for n in range(frames):
            name = f"{k}_{n}_X{x_mm}Y{y_mm}Z{depth_mm}.png"
            cv2.imwrite(str(root / "probe_images" / name), image[..., ::-1])
            rows.append((name, x_mm, y_mm, depth_mm, x_px, y_px))
    cv2.imwrite(str(root / "blank_images" / "blank.png"), background[..., ::-1])
    names = ["img_name", "x_mm", "y_mm", "penetration_depth_mm", "x_px", "y_px"]
    pd.DataFrame(rows, columns=names).to_csv(root / "annotations" / "annotations.csv", index=False)
    about = {"px_per_mm": px_per_mm, "probe_radius_mm": probe_radius_mm}
    (root / "annotations" / "metadata.json").write_text(json.dumps(about))


PLACES = [(-3.0, 1.0), (0.0, 0.0), (3.0, -1.0), (2.0, 2.0)]
DEPTHS_MM = np.array([0.6, 0.8, 1.0, 1.2])
SEEN_PX = 10.0 * np.sqrt(8 * DEPTHS_MM - DEPTHS_MM**2)  # a² = 2Rd − d², a ball of 4 mm


@pytest.mark.parametrize("sign", [1, -1])
def test_py3dcal_depth_counts_in_either_direction_and_places_are_kept(tmp_path, sign):
    presses = [(*p, sign * d, a) for p, d, a in zip(PLACES, DEPTHS_MM, SEEN_PX, strict=True)]
    write_py3dcal(tmp_path / "set", presses, frames=3)
    assert import_presses("py3dcal", tmp_path / "set", tmp_path / "out").notes == ()
    found = read_presses(tmp_path / "out")
    np.testing.assert_allclose(found.radius_px, np.repeat(SEEN_PX, 3))
    np.testing.assert_allclose(found.stage_mm, np.repeat(PLACES, 3, axis=0))
    # The stage's y points up, the picture's down.
    np.testing.assert_allclose(found.center_px[:, 1], 60 - 10 * found.stage_mm[:, 1])
    trial = pd.read_csv(tmp_path / "out" / "presses.csv")["trial"]
    assert trial.value_counts().tolist() == [3] * 4


@pytest.mark.parametrize(
    ("depths_mm", "said"),
    [
        (DEPTHS_MM + 5.0, "at least the ball's radius"),
        (DEPTHS_MM + 1.0, "all left out"),  # from a zero 1 mm above the gel
        (DEPTHS_MM / 10, "all left out"),  # cm
    ],
)
def test_py3dcal_labels_that_cannot_be_or_contradict_the_pictures_are_left_out(
    tmp_path, depths_mm, said
):
    presses = [(*p, d, a) for p, d, a in zip(PLACES, depths_mm, SEEN_PX, strict=True)]
    write_py3dcal(tmp_path / "set", presses)
    notes = import_presses("py3dcal", tmp_path / "set", tmp_path / "out").notes
    assert said in " ".join(notes)
    found = read_presses(tmp_path / "out")
    assert not found.labelled.any()
    np.testing.assert_allclose(found.stage_mm, PLACES)


def test_py3dcal_without_depths_finds_its_circles(tmp_path):
    presses = [(*p, np.nan, a) for p, a in zip(PLACES, SEEN_PX, strict=True)]
    write_py3dcal(tmp_path / "set", presses)
    notes = import_presses("py3dcal", tmp_path / "set", tmp_path / "out").notes
    assert "4 rows have no penetration_depth_mm" in notes[0]
    assert not read_presses(tmp_path / "out").labelled.any()


def test_py3dcal_one_wrong_label_is_left_out_alone(tmp_path):
    depths_mm = [*DEPTHS_MM[:3], 3.5]
    presses = [(*p, d, a) for p, d, a in zip(PLACES, depths_mm, SEEN_PX, strict=True)]
    write_py3dcal(tmp_path / "set", presses)
    notes = import_presses("py3dcal", tmp_path / "set", tmp_path / "out").notes
    assert "25% of the circles" in notes[0]
    assert read_presses(tmp_path / "out").labelled.tolist() == [True, True, True, False]


@pytest.mark.parametrize("name", ["../../secret", "/etc", "9.470mm/../../x"])
def test_names_that_lead_out_of_the_set_are_refused(gs_sdk, tmp_path, name):
    table = pd.read_csv(gs_sdk / "catalog.csv")
    table.loc[2, "experiment_reldir"] = name
    table.to_csv(gs_sdk / "catalog.csv", index=False)
    with pytest.raises(PressError, match="leads out of it; name files of this set"):
        import_presses("gs-sdk", gs_sdk, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("value", ["0", "-4", "1e999", "NaN", "9" * 400])
def test_py3dcal_scales_that_are_none_are_refused(tmp_path, value):
    write_py3dcal(tmp_path / "set", [(0.0, 0.0, 0.5, 12)])
    about = f'{{"px_per_mm": {value}, "probe_radius_mm": 4}}'
    (tmp_path / "set/annotations/metadata.json").write_text(about)
    with pytest.raises(PressError, match="needs the numbers px_per_mm, probe_radius_mm"):
        import_presses("py3dcal", tmp_path / "set", tmp_path / "out")


def test_gs_sdk_folders_that_come_to_the_same_name_are_all_kept(gs_sdk, tmp_path):
    names = ["day_1/x", "day/1_x", "Day/1_x"]
    for k, name in enumerate(names):
        (gs_sdk / name).mkdir(parents=True)
        cv2.imwrite(str(gs_sdk / name / "gelsight.png"), picture(15 + 9 * k, 20, 7))
    table = pd.DataFrame({"experiment_reldir": names, "diameter(mm)": 6.0, "operator": "A"})
    table.to_csv(gs_sdk / "catalog.csv", index=False)
    assert import_presses("gs-sdk", gs_sdk, tmp_path / "out").count == 3
    found = read_presses(tmp_path / "out")
    assert len({image.tobytes() for image in found.images}) == 3
    listed = pd.read_csv(tmp_path / "out" / "presses.csv")
    assert listed["experiment_reldir"].tolist() == names
    assert listed["operator"].tolist() == ["A"] * 3


def test_9dtact_joins_the_folders_of_a_sensor_and_says_when_there_are_too_few(tmp_path):
    for k in range(3):
        folder = tmp_path / "sensors" / f"take_{k}" / "depth_calibration"
        folder.mkdir(parents=True)
        cv2.imwrite(str(folder / "rectify_crop_ref.png"), BACKGROUND)
        cv2.imwrite(str(folder / "rectify_crop_sample.png"), picture(15 + 9 * k, 20, 7))
    given = {"mm_per_px": 0.06, "ball_radius_mm": 2.0}
    found = import_presses("9dtact", tmp_path / "sensors", tmp_path / "out", **given)
    assert (found.count, found.warnings) == (3, ())
    assert len({image.tobytes() for image in read_presses(tmp_path / "out").images}) == 3
    one = import_presses("9dtact", tmp_path / "sensors" / "take_0", tmp_path / "one", **given)
    assert "1 press is too few for a table, which needs at least 3" in one.warnings[0]


def write_pretrain(root, rows, *, kind="bytes", shards=1):
    """Shards with (indenter, indenter_param, f_z), as written by hand or by ``datasets``."""
    root.mkdir()
    records = []
    for k, (indenter, size, f_z) in enumerate(rows):
        data = cv2.imencode(".png", picture(10 + 6 * k, 20, 5))[1].tobytes()
        image = {"struct": {"bytes": data, "path": None}, "list": list(data)}.get(kind, data)
        about = {"source": "feats", "capture": f"c{k}", "height": 48, "width": 64, "x_mm": None}
        forces = {"f_x": 0.1 * k, "f_y": -0.2, "f_z": f_z}
        records.append({"image": image, "indenter": indenter, "indenter_param": size, **forces,
                        **about})  # fmt: skip
    for k in range(shards):
        pd.DataFrame(records[k::shards]).to_parquet(root / f"train-{k:05d}.parquet")


BALLS = [("sphere", "12", -1.0), ("sphere", "7", -2.0), ("cuboid", "3", -3.0),
         ("sphere", "12", -4.0), ("sphere", "7", 0.1), ("sphere", "12", -6.0)]  # fmt: skip


@pytest.mark.parametrize("kind", ["bytes", "struct", "list"])
@pytest.mark.parametrize(
    ("given", "radii"), [(6.0, {6.0, 3.5}), (3.5, {6.0, 3.5}), (12.0, {12.0, 7.0})]
)
def test_pretrain_radii_are_those_of_indenter_param_in_the_unit_of_the_given(
    tmp_path, kind, given, radii
):
    write_pretrain(tmp_path / "set", BALLS, kind=kind)
    found = import_presses(
        "gelsight-mini-pretrain", tmp_path / "set", tmp_path / "out", mm_per_px=0.06,
        ball_radius_mm=given,
    )  # fmt: skip
    assert (found.count, found.warnings) == (5, ())
    assert "cuboid (1)" in " ".join(found.notes)
    table = pd.read_csv(tmp_path / "out" / "presses.csv")
    assert set(table["radius_mm"]) == radii
    large = table["indenter_param"] == 12
    np.testing.assert_allclose(table["radius_mm"][large], max(radii))
    # A gauge that pulls a little at rest shows it; f_z is negative in contact.
    assert table["force_normal_n"].tolist() == [1.0, 2.0, 4.0, -0.1, 6.0]
    np.testing.assert_allclose(table["force_shear_x_n"], [0.0, 0.1, 0.3, 0.4, 0.5])
    assert table["capture"].tolist() == ["c0", "c1", "c3", "c4", "c5"]
    shown = read_presses(tmp_path / "out").images
    assert shown[3][20, 10 + 6 * 4].tolist() == [130, 160, 60]


def test_pretrain_one_radius_for_balls_of_several_sizes_is_refused(tmp_path):
    write_pretrain(tmp_path / "set", BALLS)
    with pytest.raises(PressError, match=r"indenter_param 7, 12(.|\n)*radius of the largest"):
        import_presses(
            "gelsight-mini-pretrain", tmp_path / "set", tmp_path / "out", mm_per_px=0.06,
            ball_radius_mm=5.0,
        )  # fmt: skip


def test_pretrain_presses_of_several_gels_are_said(tmp_path):
    write_pretrain(tmp_path / "set", [("sphere", "10", -1.0)] * 4)
    path = tmp_path / "set" / "train-00000.parquet"
    table = pd.read_parquet(path).assign(gel_variant=["black_dot", "black_dot", "different", "x"])
    table.to_parquet(path)
    found = import_presses(
        "gelsight-mini-pretrain", tmp_path / "set", tmp_path / "out", mm_per_px=0.06,
        ball_radius_mm=5.0,
    )  # fmt: skip
    assert "several gels (feats black_dot; feats different; feats x)" in found.warnings[0]


def test_pretrain_holds_few_pictures_at_once(tmp_path, monkeypatch):
    write_pretrain(tmp_path / "set", [("sphere", "10", -1.0)] * 300, shards=3)
    held = []
    original = import_formats.decode_rgb

    def counted(*args, **kwargs):
        image = original(*args, **kwargs)
        held.append(weakref.ref(image))
        assert sum(one() is not None for one in held) <= IMAGES.background_pictures + 60
        return image

    monkeypatch.setattr(import_formats, "decode_rgb", counted)
    found = import_presses(
        "gelsight-mini-pretrain", tmp_path / "set", tmp_path / "out", mm_per_px=0.06,
        ball_radius_mm=5.0,
    )  # fmt: skip
    assert found.count == 300


def test_names_that_look_like_numbers_stay_names(gs_sdk, tmp_path):
    (gs_sdk / "9.470mm" / "2").rename(gs_sdk / "0002")
    table = pd.read_csv(gs_sdk / "catalog.csv")
    rows = table[table["experiment_reldir"] == "9.470mm/2"].assign(experiment_reldir="0002")
    rows.to_csv(gs_sdk / "catalog.csv", index=False)
    assert import_presses("gs-sdk", gs_sdk, tmp_path / "out").count == 1
    assert (tmp_path / "out" / "0002.png").is_file()


def test_nothing_is_written_where_something_is_wrong(gs_sdk, tmp_path):
    (gs_sdk / "9.470mm" / "2" / "gelsight.png").unlink()
    with pytest.raises(PressError, match=r"2/gelsight\.png: missing"):
        import_presses("gs-sdk", gs_sdk, tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["calibration"]


def test_what_exists_is_not_written_over(gs_sdk, tmp_path):
    (tmp_path / "out").mkdir()
    with pytest.raises(TacgenError, match="exists already"):
        import_presses("gs-sdk", gs_sdk, tmp_path / "out")


def test_another_folder_is_told_apart(tmp_path):
    with pytest.raises(PressError, match=r"catalog\.csv: cannot be read"):
        import_presses("gs-sdk", tmp_path, tmp_path / "out")
