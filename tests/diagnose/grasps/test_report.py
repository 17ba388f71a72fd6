"""The page of a grasp diagnosis, from the content of its JSON."""

from pathlib import Path

import numpy as np

from tacgen.core.records import GraspConfig
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.diagnose.grasps.report import write_grasp_report

FOUND = "grip_force at 0.80 ± 0.03 times the declared"


def test_the_page_shows_outcomes_candidates_and_next_grasps(tmp_path):
    grasps = tuple(
        RealGrasp(f"g{k}", GraspConfig(k, "mug", 5.0 + k, 0.0, 0.0, 80.0), k % 2, "", ())
        for k in range(6)
    )
    candidates = [
        {"description": FOUND, "log_evidence_gain": 9.3},
        {"description": "mass of mug", "log_evidence_gain": None},
    ]
    channel = {
        "verdict": "effect_found",
        "sentence": "The declared grip force is wrong.",
        "trials": {"fit": 6, "test": 6},
        "error_before": {"rmse": 0.5, "mislabels": 3},
        "error_after": {"rmse": 1 / 6, "mislabels": 1},
        "simulated_again": {"rate": 0.0, "mislabels": 0},
        "effects": [
            {
                "description": FOUND,
                "what_would_tell": ["grip_force or friction: lift"],
                "shared_with": [{"description": "grip_force at 0.9 beside mass of mug at 1.1"}],
            }
        ],
        "false_alarm_rate": 0.03,
        "ranking": candidates,
        "p_value": 0.002,
        "critical_gain": 3.0,
        "explanations": [
            {"causes": [FOUND, "mass of mug"], "probability": 0.25},
            {"causes": [], "probability": 0.125},
        ],
        "force_from_images": "",
        "next_grasps": [
            {
                "object": "mug", "force_n": 12.5, "x_mm": 0.0, "y_mm": 10.25, "z_mm": 80.0,
                "success": {"declared": 0.2, "grip_force": 0.9},
            }
        ],
    }  # fmt: skip
    labels = np.array([grasp.label for grasp in grasps])
    write_grasp_report(
        tmp_path / "report.html",
        {"notes": ["few grasps"], "channels": {"grasp": channel}},
        RealGrasps(Path("real"), grasps, ()),
        1 - labels,
        labels,
    )
    page = (tmp_path / "report.html").read_text()
    assert "3 of 6 (50.0 %)" in page
    assert "1 of 6 (16.7 %)" in page
    assert f"{FOUND}; mass of mug" in page
    assert "25.0 %" in page
    assert "grip_force at 0.9 beside mass of mug at 1.1" in page
    assert "flipped labels alone" in page
    assert "grip_force or friction: lift." in page
    assert "if grip_force" in page
    assert page.count("data:image/png") == 2
    assert "://" not in page
