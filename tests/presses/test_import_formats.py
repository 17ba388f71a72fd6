"""Press sets of other toolkits, made here in the layout that their own readers expect."""

import json

import cv2
import numpy as np
import pandas as pd
import pytest

from tacgen.core.errors import PressError, TacgenError
from tacgen.presses.import_formats import import_presses
from tacgen.presses.press_folder import read_presses

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
