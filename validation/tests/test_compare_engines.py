"""Both engines on one grid: rows, counts and files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tacgen.core.errors import TacgenError
from tests.messages import refused
from validation.physics.compare_engines import counts_of, main

RECIPE = """
name: two
objects: [golf_ball, wood_block]
grid: {sample: 2}
sensor: gelsight_mini
"""


def test_grasps_near_slipping_count_apart() -> None:
    found = pd.DataFrame(
        {
            "object": ["cup", "cup", "cup", "ball", "ball"],
            "pybullet_margin": [0.04, -0.2, np.nan, 3.0, np.nan],
            "pybullet_label": [1, 0, -1, 1, -1],
            "mujoco_label": [0, 0, 1, 1, -1],
            "agree": [False, True, False, True, True],
        }
    )
    counts = counts_of(found)
    assert counts.columns.tolist() == ["grasps", "executed", "agree", "far", "agree_far"]
    assert counts.loc["cup"].tolist() == [3, 3, 1, 2, 1]
    assert counts.loc["ball"].tolist() == [2, 1, 2, 1, 1], "no engine could make the last"
    assert counts.loc["all"].tolist() == [5, 4, 3, 3, 2]


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["wsg50", "ur5e_wsg50"])
def test_a_grid_in_both_engines(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pybullet", reason="PyBullet has no wheel for this Python")
    recipe, out = tmp_path / "recipe.yaml", tmp_path / "out"
    recipe.write_text(f"{RECIPE}robot: {{name: {robot}, tactile_pads: both}}\n")
    monkeypatch.setattr("sys.argv", ["compare_engines", str(recipe), "--out", str(out)])
    main()
    table = pd.read_csv(out / "grasps.csv")
    assert table["object"].tolist() == ["golf_ball"] * 2 + ["wood_block"] * 2
    assert {"pybullet_margin", "mujoco_margin", "mujoco_reason"} <= set(table.columns)
    record = json.loads((out / "comparison.json").read_text())
    assert record["counts"]["all"]["grasps"] == 4
    assert record["counts"]["all"]["agree"] == int(table["agree"].sum())
    with refused(TacgenError):
        main()
