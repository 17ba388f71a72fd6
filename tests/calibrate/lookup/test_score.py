"""Similarity of pictures against closed forms, and what a score reports of a table."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tacgen.calibrate.lookup.command import score_text
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


def test_similarity_of_equal_and_of_inverted_pictures():
    image = np.random.default_rng(0).integers(0, 256, (40, 40, 3)).astype(np.uint8)
    assert structural_similarity(image, image) == pytest.approx(1.0)
    assert structural_similarity(image, 255 - image) < -0.5


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
