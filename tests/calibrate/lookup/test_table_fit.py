"""Fitting a table to presses of the virtual sensor and of a real one."""

from dataclasses import replace

import numpy as np
import pytest

from tacgen.calibrate.lookup.model_choice import fold_of
from tacgen.calibrate.lookup.score import TableScore, score_table
from tacgen.calibrate.lookup.table_fit import calibrate, fit_lookup
from tacgen.optics import load_table, render_rgb, save_table
from tacgen.presses.press_folder import read_presses
from tacgen.presses.screening import usable_presses
from tests.virtual_presses import repeated, virtual_presses


@pytest.mark.slow
def test_renders_unseen_balls_of_the_virtual_sensor():
    table = fit_lookup(virtual_presses(1, count=12, noise=0.5))
    score = score_table(table, virtual_presses(2, count=6, noise=0.0))
    assert score.rmse("labels")[0] < 1.5
    assert score.rmse("refined")[0] < 1.5


@pytest.mark.slow
def test_labels_that_are_off_are_mended():
    table = fit_lookup(virtual_presses(3, count=14, noise=0.5, center_scatter_px=1.0))
    clean = virtual_presses(4, count=6, noise=0.0)
    moved = replace(clean, center_px=clean.center_px + np.array([1.5, -1.0]))
    score = score_table(table, moved)
    assert score.rmse("refined")[0] < 2.0
    assert score.rmse("labels")[0] > 1.5 * score.rmse("refined")[0]


@pytest.mark.slow
def test_gel_at_rest_renders_the_reference():
    presses = virtual_presses(6, count=8, noise=0.0)
    table = fit_lookup(presses)
    rest = render_rgb(np.zeros(presses.shape_px), table)
    assert np.abs(rest.astype(float) - presses.background).mean() < 1.0


@pytest.mark.slow
def test_a_domed_gel_at_rest_renders_the_reference():
    presses = virtual_presses(7, count=12, noise=0.0, dome_mm=40.0)
    table = fit_lookup(presses)
    height, width = presses.shape_px
    rows, columns = np.mgrid[:height, :width]
    x = (columns - (width - 1) / 2) * presses.mm_per_px
    y = (rows - (height - 1) / 2) * presses.mm_per_px
    rest = render_rgb(np.sqrt(40.0**2 - x**2 - y**2) - 40.0, table)
    middle = (slice(4, -4), slice(4, -4))
    assert np.abs(rest.astype(float) - presses.background)[middle].mean() < 1.5


@pytest.mark.slow
def test_circles_are_found_where_none_are_labelled():
    truth = virtual_presses(8, count=16)
    blind = usable_presses(virtual_presses(8, count=16, labelled=False))
    assert len(blind) == 16
    assert blind.found.all()
    apart = np.hypot(*(blind.center_px - truth.center_px).T)
    assert np.median(apart) < 1.0
    assert fit_lookup(blind).provenance["n_presses"] == 16


@pytest.fixture(scope="module")
def calibrated():
    """Eight presses and their calibration in one process."""
    presses = virtual_presses(14, count=8)
    return presses, calibrate(presses, processes=1)


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_number_of_processes(calibrated):
    presses, one = calibrated
    two = calibrate(presses, processes=2)
    assert np.array_equal(one.table.coefficients, two.table.coefficients)
    assert one.heldout.rmse("refined") == two.heldout.rmse("refined")


@pytest.mark.exhaustive
@pytest.mark.slow
def test_rings_around_the_contact_are_scored_beside_the_bare_gel(calibrated):
    presses, result = calibrated
    heldout = result.heldout
    contact, rim, beside = heldout.rings()
    assert contact["rmse_labels"] == heldout.rmse("labels")[0]
    assert [rim["from_radii"], rim["to_radii"], beside["to_radii"]] == [1.0, 1.5, 2.5]
    assert rim["rmse_refined"] < 0.5 * rim["rmse_bare"]
    # The bare gel's error is the pictures' own change, whatever the table.
    change = presses.images[0].astype(float) - presses.background
    assert 0 < heldout.presses[0].rmse("bare") < np.abs(change).max()


@pytest.mark.slow
def test_a_table_survives_its_file(tmp_path, calibrated):
    presses, table = calibrated[0], calibrated[1].table
    save_table(table, tmp_path / "table.npz")
    read = load_table(tmp_path / "table.npz")
    assert score_table(read, presses).rmse("refined") == score_table(table, presses).rmse("refined")


@pytest.mark.slow
def test_measured_presses(measured_data):
    path = measured_data / "taxim_ball_presses" / "dataPack_small_37.npz"
    presses = usable_presses(read_presses(path))
    heldout = calibrate(presses).heldout
    assert isinstance(heldout, TableScore)
    # The figures that the calibration has to reach, on presses left out of everything.
    assert heldout.rmse("refined")[0] <= 5.8
    assert heldout.rmse("labels")[0] <= 7.5
    assert len(heldout.presses) == 37


def test_pictures_of_a_press_are_in_one_fold():
    assert fold_of(np.array([7, 7, 2, 3, 7, 3, 9]), 3).tolist() == [0, 0, 1, 2, 0, 2, 0]
    # Presses pictured once each are dealt out in turn.
    np.testing.assert_array_equal(fold_of(np.arange(12), 5), np.arange(12) % 5)
    assert fold_of(np.array([4, 4, 4, 1]), 5).max() == 1


@pytest.mark.slow
def test_several_pictures_of_each_press_state_the_error_of_the_presses():
    few = virtual_presses(11, count=6)
    once = calibrate(few)
    many = calibrate(usable_presses(repeated(few, 2)))
    assert many.heldout.n_presses == 6
    assert many.table.provenance["n_presses"] == 6
    # Five folds of six presses; the frames' own noise of 1 grey level is all that differs.
    stated, wanted = (made.heldout.rmse("labels")[0] for made in (many, once))
    assert stated == pytest.approx(wanted, rel=0.2)
    for fold, table in enumerate(many.fold_tables):
        held_out = many.presses.presses.select(many.folds == fold)
        own = [many.heldout.presses[k] for k in np.nonzero(many.folds == fold)[0]]
        again = score_table(table, held_out)
        assert TableScore(tuple(own), 1).rmse("labels") == again.rmse("labels")
