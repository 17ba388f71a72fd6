"""The page of an optics diagnosis, from the content of its JSON."""

from types import SimpleNamespace

import numpy as np
import pytest

from tacgen.diagnose.optics.pictures import MEAN_GAIN, _mean_residual
from tacgen.diagnose.optics.report import write_optics_page


def channel(**changes):
    effect = {
        "name": "scale",
        "how": "ball over the stated",
        "parameters": {"ball_per_stated": {"value": 0.8562, "stderr": 0.0019, "unit": "1"}},
        "cv_gain": 1.9,
        "heldout_gain": 2.1,
        "heldout_gain_stderr": 0.3,
        "p_value": 1.4e-13,
        "runner_up": "blur",
        "runner_up_gain": 1.5,
        "as_good": ["blur"],
    }
    return {
        "verdict": "effect_found",
        "sentence": "Found scale.",
        "effects": [effect],
        "unexplained": [],
        "cannot_tell": [],
        "error_before": {"rmse": 11.3, "inside_circle": 14.0, "refined": 5.0},
        "error_after": {"rmse": 4.9, "inside_circle": 5.3, "refined": 4.8},
        "gain_interval_95": [5.7, 6.9],
        "noise_floor": {"rmse": 0.6},
        "trials": {"fit": 28, "test": 9},
        "steps": [{"error_before": 11.3, "chosen": "scale", "rmse": {"scale": 9.0, "blur": 10.0}}],
        **changes,
    }


def test_the_mean_residual_shows_where_around_contacts_the_model_is_off():
    """Two presses, red 5 grey levels too dark to the right of the rim, noise of their own."""
    rng, model = (
        np.random.default_rng(0),
        SimpleNamespace(places=[(1.0, 2.0, 1.5), (6.0, 3.0, 1.2)]),
    )
    views, residuals = [], []
    for x, y, radius in model.places:
        east, south = rng.uniform(-2.2, 2.2, (2, 20_000))
        pixels = SimpleNamespace(x_mm=x + radius * east, y_mm=y + radius * south)
        is_dark = (np.hypot(east, south) > 1.2) & (east > abs(south))
        noise = rng.normal(0.0, 2.0, (east.size, 3))
        residuals.append(noise + np.where(is_dark, -5.0, 0.0)[:, None] * [1.0, 0.0, 0.0])
        views.append(SimpleNamespace(pixels=pixels))
    fit = SimpleNamespace(views=views, residuals=lambda _: residuals)
    picture = _mean_residual(fit, model).astype(float)
    middle, far = picture.shape[0] // 2, int(0.9 * picture.shape[1])
    # Some 44 values a cell: their mean is known to 0.3 grey levels.
    assert picture[middle, far] == pytest.approx([128 - 5 * MEAN_GAIN, 128, 128], abs=10)
    assert picture[middle, -far] == pytest.approx(128, abs=10)
    assert picture[middle, middle] == pytest.approx(128, abs=10)


def write(folder, content):
    strip = np.full((20, 100, 3), 90, np.uint8)
    path = folder / "report.html"
    write_optics_page(
        path, content, [("p1.png", strip)], strip, applied=["blur"], excluded=["p2: dark"]
    )
    return path.read_text()


def test_the_page_shows_the_effects_with_their_errors(tmp_path):
    page = write(tmp_path, channel())
    assert "ball_per_stated" in page
    assert "0.8562 ± 0.0019" in page
    assert "5.7 to 6.9 grey levels" in page
    assert "1.4·10⁻¹³" in page
    assert "p2: dark" in page
    assert "Mean residual around the contact" in page
    assert page.index("Error before and after") < page.index("Test presses") < page.index("Effects")
    assert "://" not in page
