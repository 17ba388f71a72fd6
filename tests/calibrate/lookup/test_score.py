"""Similarity of pictures against closed forms, and what a score reports of a table."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tacgen.calibrate.lookup.command import (
    contrast_warning,
    differs_by_more_than_noise,
    score_text,
)
from tacgen.calibrate.lookup.score import psnr_db, score_table, structural_similarity
from tacgen.calibrate.lookup.table_fit import fit_lookup
from tests.virtual_presses import virtual_presses


def test_psnr_is_the_ratio_of_full_scale_to_error():
    image = np.full((20, 30, 3), 100, np.uint8)
    assert psnr_db(image, image + np.uint8(10)) == pytest.approx(20 * np.log10(255 / 10))
    assert psnr_db(image, image) == 99.0


def test_similarity_of_even_pictures_is_that_of_their_means():
    """Without contrast Wang's index is (2ab + C)/(a² + b² + C) with C = (0.01 · 255)²."""
    a, b, c = 100.0, 130.0, (0.01 * 255) ** 2
    first, second = (np.full((20, 30, 3), value, np.uint8) for value in (a, b))
    expected = (2 * a * b + c) / (a * a + b * b + c)
    assert structural_similarity(first, second) == pytest.approx(expected)


@pytest.mark.slow
def test_a_score_names_similarity_and_the_error_of_normals():
    table = fit_lookup(virtual_presses(31, count=8))
    score = score_table(table, virtual_presses(32, count=3), gradients=True)
    found = json.loads(json.dumps(score.as_dict()))
    assert 0.9 < found["ssim_refined"] <= 1
    assert found["psnr_db_refined"] > 35
    assert found["gradient_error_deg"] < 10
    assert "SSIM" in score_text(score)
    assert "gradient_error_deg" in found["images"][0]


@pytest.mark.slow
def test_imprints_of_half_the_contrast_call_for_a_calibration():
    """Images halfway between the background and the press are those of lamps of half the contrast.

    The slope is that of a least-squares fit, so it halves up to rounding to grey levels.
    """
    table, presses = fit_lookup(virtual_presses(31, count=8)), virtual_presses(32, count=3)
    own = score_table(table, presses)
    assert own.as_dict()["contrast"] == pytest.approx(1, abs=0.05)
    assert contrast_warning(own) == []
    faint = np.rint((presses.images + presses.background.astype(float)) / 2).astype(np.uint8)
    found = score_table(table, replace(presses, images=faint))
    assert found.as_dict()["contrast"] == pytest.approx(0.5, abs=0.03)
    assert "of the table's: other lamps or another sensor" in contrast_warning(found)[0]


@pytest.mark.parametrize(
    ("inside", "beside", "is_more"), [(1.5, 1.6, False), (2.1, 0.9, True), (1.2, 2.1, True)]
)
def test_a_diagnosis_is_proposed_where_more_than_noise_is_left(inside, beside, is_more):
    """A grey level above the camera's 0.8 to 1.0, in the contact or on the ring beside it."""
    errors = {0: inside, 1: beside}
    heldout = SimpleNamespace(rmse=lambda picture, ring: (errors[ring], []))
    made = SimpleNamespace(heldout=heldout, table=SimpleNamespace(noise_grey=1.0))
    assert differs_by_more_than_noise(made) is is_more
