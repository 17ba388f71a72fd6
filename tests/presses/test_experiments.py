"""Pictures of one press count as one, whatever tells that they are."""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest

from tacgen.core.errors import PressError
from tacgen.presses.experiments import experiments_of, per_experiment
from tacgen.presses.press_folder import WITH_FORCES, read_press_folder
from tacgen.presses.press_forces import measure_presses
from tacgen.presses.screening import usable_presses
from tests.virtual_presses import repeated, virtual_presses

FRAMES = 4
WANTED = np.repeat(np.arange(5), FRAMES).tolist()


def frames_of(**columns):
    presses = repeated(virtual_presses(3, count=5), FRAMES)
    unknown = {
        "center_px": np.full((len(presses), 2), np.nan),
        "radius_px": np.full(len(presses), np.nan),
    }
    return replace(presses, **{**unknown, **columns})


def other_pictures(presses):
    """As many pictures that are not alike: only what is listed can tell."""
    return replace(presses, images=virtual_presses(8, count=len(presses)).images)


def test_a_number_that_two_balls_share_is_two_presses():
    balls = np.tile([2.0, 3.0], 10)
    presses = other_pictures(frames_of(trial=np.repeat([0.0, 1.0], 10), ball_radius_mm=balls))
    assert experiments_of(presses).tolist() == [0, 1] * 5 + [2, 3] * 5


@pytest.mark.parametrize("known", ["circle", "stage"])
def test_one_place_one_ball_and_one_radius_are_a_press(known):
    labelled = repeated(virtual_presses(3, count=5), FRAMES)
    jitter = np.random.default_rng(0).uniform(-0.4, 0.4, (len(labelled), 2))
    places, radius = labelled.center_px + jitter, labelled.radius_px
    if known == "circle":
        presses = frames_of(center_px=places, radius_px=radius)
    else:
        presses = frames_of(stage_mm=places * labelled.mm_per_px, radius_px=radius)
    assert experiments_of(other_pictures(presses)).tolist() == WANTED
    deeper = replace(other_pictures(presses), radius_px=radius + 2 * np.arange(len(radius)))
    assert len(set(experiments_of(deeper))) == len(radius)


@pytest.mark.parametrize("noise", [0.5, 1.5])
def test_pictures_that_are_alike_but_for_noise_and_light_are_a_press(noise):
    presses = repeated(virtual_presses(3, count=5, noise=0.0), FRAMES, noise=noise)
    lamps = np.random.default_rng(1).integers(-3, 4, (len(presses), 1, 1, 3))
    images = np.clip(presses.images + lamps, 0, 255).astype(np.uint8)
    assert experiments_of(frames_of(images=images)).tolist() == WANTED


def test_presses_of_their_own_stay_so():
    for seed in range(5):
        presses = virtual_presses(seed, count=40)
        nearest = [np.partition(np.hypot(*(presses.center_px - c).T), 1)[1]
                   for c in presses.center_px]  # fmt: skip
        apart = np.array(nearest) > 3.0  # px, of contacts of 10
        found = experiments_of(presses)
        assert np.bincount(found)[found][apart].max() == 1


def test_too_few_presses_in_many_pictures_are_refused():
    presses = repeated(virtual_presses(3, count=2), 10)
    with pytest.raises(PressError, match="2 usable presses in 20 pictures, at least 3 are needed"):
        usable_presses(presses)


def test_means_over_experiments():
    values = np.array([[1.0, 2.0], [3.0, 4.0], [10.0, 20.0], [5.0, 6.0]])
    np.testing.assert_allclose(
        per_experiment(values, np.array([4, 4, 1, 4])), [[3.0, 4.0], [10.0, 20.0]]
    )


def test_a_log_from_pictures_without_trials_has_those_of_the_presses(tmp_path):
    presses = repeated(virtual_presses(4, count=4), 3)
    for name, image in [("background", presses.background), *zip(
        map(str, range(12)), presses.images, strict=True
    )]:  # fmt: skip
        cv2.imwrite(str(tmp_path / f"{name}.png"), image[..., ::-1])
    rows = {"file": [f"{k}.png" for k in range(12)], "radius_mm": 2.0, "force_normal_n": 1.0}
    circles = {"contact_radius_px": presses.radius_px}
    pd.DataFrame(rows | circles).to_csv(tmp_path / "presses.csv", index=False)
    (tmp_path / "sensor.yaml").write_text(f"mm_per_px: {presses.mm_per_px}\n")
    log = measure_presses(read_press_folder(tmp_path, WITH_FORCES)).frame
    assert log["trial"].tolist() == np.repeat(range(4), 3).tolist()
