"""The page of an optics diagnosis, from the content of its JSON."""

import numpy as np

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


def write(folder, content):
    strip = np.full((20, 100, 3), 90, np.uint8)
    path = folder / "report.html"
    write_optics_page(path, content, [("p1.png", strip)], applied=["blur"], excluded=["p2: dark"])
    return path.read_text()


def test_the_page_shows_the_effects_with_their_errors(tmp_path):
    page = write(tmp_path, channel())
    assert "ball_per_stated" in page
    assert "0.8562 ± 0.0019" in page
    assert "5.7 to 6.9 grey levels" in page
    assert "1.4·10⁻¹³" in page
    assert "p2: dark" in page
    assert page.index("Error before and after") < page.index("Test presses") < page.index("Effects")
    assert "://" not in page
