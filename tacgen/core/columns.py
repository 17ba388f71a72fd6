"""Columns of the CSV files that tacgen reads, and hints on columns and units that look wrong."""

import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches

import numpy as np

from tacgen.core.arrays import FloatArray

SHORTEST_LIKELY_Z_MM = 1.0
"""A pad is 21 mm high: its centre is never so low, a height in metres always is."""
LARGEST_LIKELY_YAW_RAD = 2 * np.pi  # a full turn; larger angles are in degrees
SIMILAR = 0.7  # least similarity of two names (difflib's ratio): `yaw_deg` and `yaw_rad` have 0.71

_FORCES = {
    "force_normal_n": "normal force, N",
    "force_shear_x_n": "shear force along x, N",
    "force_shear_y_n": "shear force along y, N",
}
PRESS_LOG: Mapping[str, str] = {
    "trial": "number of the press, one integer a press",
    "time_s": "time on the session's clock, s",
    **_FORCES,
    "volume_mm3": "indented volume, mm³",
    "indenter": "name of the indenter",
    "radius_mm": "radius of the ball, mm; empty if the indenter is no ball",
    "x_mm": "centre of the contact along x, gel frame, mm",
    "y_mm": "centre of the contact along y, gel frame, mm",
    "shear_x_mm": "sum of the markers' motion along x, mm",
    "shear_y_mm": "sum of the markers' motion along y, mm",
}
PRESSES: Mapping[str, str] = {
    "file": "name of the press's image",
    "radius_mm": "radius of the ball, mm",
    "center_x_px": "centre of the contact, column, px; found in the image if not given",
    "center_y_px": "centre of the contact, row, px; found in the image if not given",
    "contact_radius_px": "radius of the contact, px; found in the image if not given",
    "x_mm": "position of the stage along x, mm",
    "y_mm": "position of the stage along y, mm",
    "trial": "number of the press, for several images of one press",
    "time_s": "time on the session's clock, s",
    **_FORCES,
}
GRASPS: Mapping[str, str] = {
    "grasp_id": "name of the grasp, and of its folder in images/",
    "object": "name of the object",
    "label": "1 success, 0 failure",
    "force_n": "force of each finger, N",
    "x_mm": "gripper's centre along world x, from the centre of the footprint, mm",
    "y_mm": "gripper's centre along world y, from the centre of the footprint, mm",
    "z_mm": "height of the pads' centre above the table, mm",
    "yaw_rad": "angle of the gripper about z, rad; 0 if not given",
    "failure_mode": "translational_slip, rotational_slip or empty",
    "grasp_frame": "number of the image at the moment of grasp, from 0; found in the images if not "
    "given",
    "lift_frame": "number of the last image before the lift, from 0",
}
DEPTH_CURVES: Mapping[str, str] = {
    "depth_mm": "indentation, mm",
    "force_normal_n": "normal force, N",
    "curve": "name of the curve; one curve if not given",
}


def similar_columns(columns: Iterable[str], known: Iterable[str], where: str) -> list[str]:
    """A warning for each column that is not known but resembles a known one that is missing."""
    columns, known = list(columns), list(known)
    missing = [name for name in known if name not in columns]
    near = {name: get_close_matches(name.lower(), missing, 1, SIMILAR) for name in columns}
    return [
        f"{where}: column {name!r} is not read as {near[name][0]!r}; rename it if it is that"
        for name in columns
        if near[name] and name not in known
    ]


def csv_problem(error: Exception) -> str:
    """Why a CSV file cannot be read, in plain words, from the error of its reader."""
    cells = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(error))
    if cells:
        expected, line, found = cells.groups()
        return f"line {line} has {found} cells, the header {expected}; quote cells with commas"
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start} is not UTF-8 text; save it as comma-separated UTF-8 text"
    if isinstance(error, OSError):
        return f"{error.strerror or error}; check the path and its permissions"
    known = {
        "an Excel workbook": "it is an Excel workbook; save its sheet as CSV",
        "quote that is not closed": f"there is {error}; close or delete it",
        "No columns to parse": "it is empty; write a header and one row each below it",
    }
    other = "it is not comma-separated text; save it as comma-separated UTF-8 text"
    return next((text for words, text in known.items() if words in str(error)), other)


def unit_problems(name: str, values: FloatArray) -> str:
    """What is suspicious about the unit of ``z_mm`` or ``yaw_rad``; empty if nothing is."""
    values = values[np.isfinite(values)]
    if not len(values):
        return ""
    if name == "z_mm" and 0 < values.max() < SHORTEST_LIKELY_Z_MM:
        return f"at most {values.max():g} mm above the table; if it is in metres, times 1000"
    if name == "yaw_rad" and np.abs(values).max() > LARGEST_LIKELY_YAW_RAD:
        largest = float(np.abs(values).max())
        return f"up to {largest:g} rad, more than a turn; if it is in degrees, divide by 57.3"
    return ""
