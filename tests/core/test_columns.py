"""Columns that resemble known ones, and values that seem to be in another unit, are named."""

import numpy as np
import pytest

from tacgen.core.errors import DatasetError
from tacgen.core.records import GRASPS, PRESS_LOG, similar_columns, unit_problems
from tacgen.dataset.real_grasps import read_real_grasps
from tests.messages import refused


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("yaw_deg", "yaw_rad"),
        ("z_m", "z_mm"),
        ("force", "force_n"),
        ("Failure_Mode", "failure_mode"),
    ],
)
def test_a_column_that_resembles_a_missing_one_is_named(written, meant):
    columns = ["grasp_id", "object", "label", "operator", "temperature_c", written]
    assert similar_columns(columns, GRASPS, "g.csv") == [
        f"g.csv: column {written!r} is not read as {meant!r}; rename it if it is that"
    ]


def test_known_columns_and_covariates_are_not_suspected():
    columns = [*PRESS_LOG, "temperature_c", "operator", "humidity_percent", "gel_age_days"]
    assert similar_columns(columns, PRESS_LOG, "log.csv") == []
    assert similar_columns([*GRASPS, "operator", "x_m"], GRASPS, "g.csv") == []


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("z_mm", [0.04, 0.12], "if it is in metres, times 1000"),
        ("z_mm", [40.0, 120.0], ""),
        ("z_mm", [np.nan], ""),
        ("yaw_rad", [0.0, 45.0], "if it is in degrees, divide by 57.3"),
        ("yaw_rad", [-np.pi, 2 * np.pi], ""),
    ],
)
def test_values_in_another_unit_are_named(name, values, words):
    problem = unit_problems(name, np.array(values))
    assert (words in problem) if words else not problem


def test_real_grasps_warn_of_columns_and_units(tmp_path):
    (tmp_path / "grasps.csv").write_text(
        "grasp_id,object,label,force_n,x_mm,y_mm,z_mm,yaw_deg\n"
        "a,can,1,5,0,0,0.05,30\nb,can,0,2,0,0,0.06,30\n"
    )
    text = "\n".join(read_real_grasps(tmp_path).warnings)
    assert "column 'yaw_deg' is not read as 'yaw_rad'" in text
    assert "z_mm is at most 0.06 mm above the table" in text


@pytest.mark.parametrize(
    "content",
    [
        b"grasp_id,object,label\na,can,1\nb,can,0,5,6\n",
        b"",
        b"grasp_id,object,label\n\xff\xfe\n",
    ],
)
def test_a_file_that_is_no_csv_is_refused_without_the_reader_s_own_words(tmp_path, content):
    (tmp_path / "grasps.csv").write_bytes(content)
    with refused(DatasetError):
        read_real_grasps(tmp_path, needs=())
