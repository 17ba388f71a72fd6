"""What presses say about mm/px and radii, and what they cannot say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacgen.calibrate.lookup.prepared import PreparedPresses
from tacgen.calibrate.lookup.press_fit import place_jointly
from tacgen.calibrate.lookup.scale import scale_evidence
from tacgen.calibrate.lookup.settings import FitSettings
from tacgen.presses.press_folder import read_presses
from tacgen.presses.screening import usable_presses
from validation.optics.press_images import draw_presses, gelsight_mini, write_folder

SENSOR = gelsight_mini(3, shape=(120, 160))
MM_PER_PX = SENSOR.mm_per_px


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two balls on a gel with dots, 2 mm apart, and the stage's places to 0.05 mm."""
    session = draw_presses(SENSOR, 51, count=16, balls_mm=(2.0, 4.0))
    path = write_folder(session, tmp_path_factory.mktemp("scale") / "p", markers={"pitch_mm": 2.0})
    rng = np.random.default_rng(0)
    lines = (path / "presses.csv").read_text().splitlines()
    rows = [lines[0] + ",x_mm,y_mm"]
    for line, press in zip(lines[1:], session.presses, strict=True):
        # The stage's axes are turned by a quarter against the picture's, its zero elsewhere.
        x, y = np.array(press.center_px) * MM_PER_PX + 0.05 * rng.normal(size=2)
        rows.append(f"{line},{100 - y:.3f},{x - 7:.3f}")
    (path / "presses.csv").write_text("\n".join(rows) + "\n")
    return path


def evidence(presses):
    prepared = PreparedPresses.of(presses)
    fit = place_jointly(prepared, presses.background.astype(np.float32), FitSettings(degree=5))
    return scale_evidence(prepared, fit)


def read(folder, **changes):
    raw = read_presses(folder, mm_per_px=changes.pop("mm_per_px", None))
    return usable_presses(replace(raw, **changes))


@pytest.fixture(scope="module")
def honest(folder):
    """What the presses say as they are."""
    return evidence(read(folder))


@pytest.mark.slow
def test_two_rulers_measure_the_scale(honest):
    found = honest
    assert [ruler.name for ruler in found.rulers] == ["the stage's places", "the printed dots"]
    for ruler in found.rulers:
        assert ruler.mm_per_px == pytest.approx(MM_PER_PX, rel=0.015)
        assert ruler.stderr < 0.01 * MM_PER_PX
    assert found.estimate is not None
    assert found.estimate.mm_per_px == pytest.approx(MM_PER_PX, rel=0.01)
    assert found.warnings == ()


@pytest.mark.slow
def test_a_stated_scale_that_is_off_is_said(folder):
    found = evidence(read(folder, mm_per_px=1.1 * MM_PER_PX))
    assert found.estimate.mm_per_px == pytest.approx(MM_PER_PX, rel=0.015)
    said = "\n".join(found.warnings)
    assert "the stage's places say 0.1" in said
    assert "the printed dots say 0.1" in said
    assert "--mm-per-px 0.1" in said


@pytest.mark.slow
def test_pixels_that_are_no_squares_are_said(folder, honest):
    """Pictures stretched by 8 % are as a stage whose axis along their width is shorter by it."""
    assert honest.stretch.factor == pytest.approx(1.0, abs=3 * honest.stretch.stderr)
    presses = read(folder, dot_pitch_mm=0.0)
    # The stage's y is along the picture's width.
    found = evidence(replace(presses, stage_mm=presses.stage_mm / np.array([1.0, 1.08])))
    assert found.stretch.factor == pytest.approx(1 / 1.08, abs=3 * found.stretch.stderr)
    said = "\n".join(found.warnings)
    assert "times as wide as high: the pictures were stretched" in said


@pytest.mark.slow
def test_on_a_dome_a_ball_touches_beside_its_centre(folder):
    """Places of a ball's centre are farther apart than its contacts: no reason for a warning."""
    presses = read(folder, dot_pitch_mm=0.0)
    nearer = 30.0 / (30.0 + presses.ball_radius_mm[:, None])
    middle = presses.stage_mm.mean(axis=0)
    balls = middle + (presses.stage_mm - middle) / nearer
    found = evidence(replace(presses, dome_radius_mm=30.0, stage_mm=balls))
    assert found.rulers[0].stderr > 0.03 * MM_PER_PX
    assert not [line for line in found.warnings if "the stage's places" in line]


@pytest.mark.slow
def test_a_ball_that_is_not_what_it_is_said_to_be(folder, honest):
    """The ball of 4 mm, stated 8 % too small, is 1.08 times larger than said."""
    assert honest.ratios[0].factor == pytest.approx(1.0, abs=0.03)
    presses = read(folder)
    wrong = np.where(presses.ball_radius_mm == 4.0, 4.0 / 1.08, 2.0)
    found = evidence(replace(presses, ball_radius_mm=wrong))
    assert found.ratios[0].factor == pytest.approx(1.08, abs=0.03)
    assert "the ball of 3.7037 mm looks like one of" in "\n".join(found.warnings)


@pytest.mark.slow
def test_without_a_ruler_there_is_only_a_bound(folder):
    presses = read(folder, stage_mm=None, dot_pitch_mm=0.0)
    one = presses.select(presses.ball_radius_mm == 2.0)
    found = evidence(one)
    assert found.estimate is None
    assert found.largest_mm_per_px > MM_PER_PX
    said = "\n".join(found.notes)
    assert "nothing in these presses measures the scale" in said
    assert "one ball only" in said


@pytest.mark.slow
def test_contacts_wider_than_their_ball(folder):
    found = evidence(read(folder, mm_per_px=1.8 * MM_PER_PX, stage_mm=None, dot_pitch_mm=0.0))
    said = "\n".join(found.warnings)
    assert "contacts are wider than their ball" in said
    assert "labelled contact radii exceed the ball's own radius" in said
