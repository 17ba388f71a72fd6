"""Pictures of real grasps: all that have one order, in it; what is not used is named."""

import cv2
import numpy as np
import pandas as pd
import pytest

from tacgen.dataset.real_grasps import read_real_grasps

PICTURE = np.full((8, 8, 3), 120, np.uint8)


def images_of(tmp_path, names):
    folder = tmp_path / "images" / "g0"
    folder.mkdir(parents=True)
    for name in names:
        cv2.imwrite(str(folder / name), PICTURE)
    row = {"grasp_id": ["g0"], "object": ["can"], "label": [1]}
    pd.DataFrame(row).to_csv(tmp_path / "grasps.csv", index=False)
    found = read_real_grasps(tmp_path, needs=())
    unused = [warning for warning in found.warnings if "not used" in warning]
    return [path.name for path in found.grasps[0].images], unused


@pytest.mark.parametrize(
    "names",
    [
        ["0.png", "1.png", "10.png", "11.png"],
        ["frame2.jpg", "frame10.jpg"],
        ["1764234000.9731.png", "1764234001.0064.png", "1764234001.04.png"],
    ],
)
def test_pictures_are_taken_in_the_order_of_their_numbers(tmp_path, names):
    assert images_of(tmp_path, names[::-1]) == (names, [])


def test_of_names_that_do_not_fit_the_plain_numbers_are_taken_and_the_others_named(tmp_path):
    found, unused = images_of(tmp_path, ["0.png", "1.png", "2_.png", "3_.png"])
    assert found == ["0.png", "1.png"]
    assert "2_.png, 3_.png not used" in unused[0]


def test_names_without_any_order_give_no_pictures_and_say_why(tmp_path):
    found, unused = images_of(tmp_path, ["after.png", "before.png"])
    assert found == []
    assert "do not tell the order" in unused[0]
