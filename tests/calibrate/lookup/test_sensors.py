"""Tables of sensors of other kinds, whose pictures share no code with the package."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tacgen.calibrate.lookup.command import calibrate_lookup
from tacgen.calibrate.lookup.score import score_table
from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.optics import load_table, render_rgb
from tacgen.optics.reconstruct import Reconstructor
from tacgen.presses.press_folder import read_presses
from tacgen.presses.screening import usable_presses
from validation.optics.press_images import digit, draw_presses, gelsight_mini, write_folder

SMALL = (120, 160)

SENSORS = {
    "Mini, 3 lamps, dots": gelsight_mini(3, shape=SMALL),
    "Mini, 4 lamps, dots": gelsight_mini(4, shape=SMALL),
    "Mini, no dots": gelsight_mini(3, dots=False, shape=SMALL),
    "DIGIT": digit((160, 120)),
}


def read(session, folder, **options):
    return usable_presses(read_presses(write_folder(session, folder, **options)), least=1)


def change_in_contact(presses):
    """RMS change of grey level inside the circles: the error of rendering the background alone."""
    height, width = presses.shape_px
    rows, columns = np.mgrid[:height, :width]
    squares = []
    for k in range(len(presses)):
        disc = np.hypot(columns - presses.center_px[k, 0], rows - presses.center_px[k, 1])
        inside = disc < presses.radius_px[k]
        if presses.hidden is not None:
            inside &= ~presses.hidden[k]
        squares.append((presses.images[k].astype(float) - presses.background)[inside] ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("Mini, 4 lamps, dots", True),
        ("DIGIT", False),
        pytest.param("Mini, 3 lamps, dots", False, marks=pytest.mark.exhaustive),
        pytest.param("Mini, no dots", False, marks=pytest.mark.exhaustive),
    ],
)
def test_unseen_balls_are_rendered(name, labels, tmp_path):
    """Nine tenths of the change at least, 12 presses, found or roughly labelled circles."""
    sensor, rough = SENSORS[name], {"labels": labels, "scatter_px": 0.7}
    train = read(draw_presses(sensor, 41, count=12), tmp_path / "a", **rough)
    test = read(draw_presses(sensor, 42, count=6), tmp_path / "b", **rough)
    assert len(train) == 12, [str(press) for press in train.dropped]
    error = score_table(fit_lookup(train), test).rmse("refined")[0]
    assert error < 0.25 * change_in_contact(test)


@pytest.mark.slow
def test_labels_that_are_all_off_by_the_same_do_not_move_the_table(tmp_path):
    """The circles that are seen say where the balls are: the true surface renders as well."""
    sensor = gelsight_mini(4, dots=False, shape=SMALL)
    session = draw_presses(sensor, 43, count=12)
    truth = read(session, tmp_path / "a")
    moved = replace(truth, center_px=truth.center_px + np.array([2.0, 1.5]))
    held = draw_presses(sensor, 44, count=6).presses
    errors = []
    for presses in (truth, moved):
        table = fit_lookup(presses)
        apart = [
            (render_rgb(press.surface_mm, table) - press.clean)[_contact(press)] for press in held
        ]
        errors.append(float(np.sqrt(np.mean(np.concatenate(apart) ** 2))))
    assert errors[1] < 1.2 * errors[0]


def _contact(press):
    rows, columns = np.indices(press.surface_mm.shape)
    away = np.hypot(columns - press.center_px[0], rows - press.center_px[1])
    return away < press.contact_px


@pytest.mark.slow
def test_volume_by_shape_leaves_out_the_gel_that_sinks_around_the_contact(tmp_path):
    """A tensed skin sinks by a fifth of the volume beside the ball, which is none of the ball's."""
    sensor = SENSORS["Mini, no dots"]
    table = fit_lookup(read(draw_presses(sensor, 47, balls_mm=(2.0, 4.0)), tmp_path / "a"))
    held = draw_presses(sensor, 48, count=10, balls_mm=(2.0, 4.0))
    reconstructor = Reconstructor(table, held.background)
    ratios, sunk = [], []
    for press in held.presses:
        depth = -float(press.surface_mm.min())
        volume = np.pi * depth**2 * (press.ball_mm - depth / 3)
        ratios.append(reconstructor.shape_of(press.image).volume_mm3 / volume)
        sunk.append(-press.surface_mm.sum() * sensor.mm_per_px**2 / volume)
    assert np.median(sunk) > 1.1
    assert np.median(ratios) == pytest.approx(1.0, abs=0.06)


@pytest.mark.slow
def test_dots_stay_in_the_background_unless_they_are_to_be_drawn(tmp_path):
    session = draw_presses(gelsight_mini(3, shape=SMALL), 45, count=4)
    folder = write_folder(session, tmp_path / "p")
    middle = np.s_[5:-5, 5:-5]
    spread = []
    for without in (False, True):
        out = tmp_path / f"{without}.npz"
        calibrate_lookup(folder, out, without_dots=without)
        table = load_table(out)
        rest = render_rgb(np.zeros(SMALL), table).astype(float)
        # Dots reflect 15 % of the light: the darkest pixels tell.
        spread.append((rest / np.median(rest, axis=(0, 1)))[middle].mean(axis=2).min())
    assert spread[0] < 0.4
    assert spread[1] > 0.6
