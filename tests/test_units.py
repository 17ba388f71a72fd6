"""Values in another unit than is asked for: converted where they state it, refused or asked about
where no gel has them.
"""
# ruff: noqa: E501

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import tacgen
from tacgen.core.errors import TacgenError
from tacgen.presses.press_log import read_press_log


def _law(text: str) -> Callable[[Path], object]:
    def act(folder: Path) -> object:
        path = folder / "contact.yaml"
        path.write_text(f"law: volume_linear\n{text}\n")
        return f"k_n = {tacgen.load_law(path).k_n_mm3_per_n.value:g}"

    return act


def _recipe(text: str) -> Callable[[Path], object]:
    def act(folder: Path) -> object:
        path = folder / "own.yaml"
        path.write_text(f"name: own\nobjects: [sugar_box]\ngrid: {{sample: 3}}\n{text}\n")
        return tacgen.load_recipe(path)

    return act


def _log(force: str = "F", **factors: float) -> Callable[[Path], object]:
    """A log of three presses in other units; what its force, volume and time are times."""

    def act(folder: Path) -> object:
        force_n = np.tile(np.concatenate([np.linspace(0, 4, 20), np.linspace(4, 0, 20)]), 3)
        column = {"F": force_n, "V": 5.0 * force_n, "t": 0.1 * np.arange(120.0)}
        column = {name: values * factors.get(name, 1.0) for name, values in column.items()}
        rows = zip(np.repeat([1, 2, 3], 40), column["t"], column["F"], column["V"], strict=True)
        lines = [f"{k},{t},{f + 1e-4 * k},{v}" for k, t, f, v in rows]
        path = folder / "log.csv"
        path.write_text("\n".join([f"Press,Time,{force},Volume", *lines]))
        log = read_press_log(path)
        loaded = log["force_normal_n"] > 1.0
        k_n = np.median(log["volume_mm3"][loaded] / log["force_normal_n"][loaded])
        return "\n".join([f"k_n = {k_n:.2f}", *log.warnings])

    return act


CASES = {
    "k_n of a law in mm³/mN": (_law("k_n_mm3_per_n: 0.005135"), "= 0.005135: gels have 0.3 to 60 mm³/N"),
    "k_n of a law in px³/N": (_law("k_n_mm3_per_n: 200039"), "so another unit is likely"),
    "a law that states its unit": (_law("k_n_mm3_per_n: {value: 0.2, unit: mm3/N}"), "k_n = 0.2"),
    "a law in another unit": (_law("k_n_mm3_per_n: {value: 5.1e-9, unit: m3/N}"), "unit = 'm3/N' is not mm3/N; convert the value"),
    "k_n of a recipe in mm³/kN": (_recipe("contact: {k_n_mm3_per_n: 5135}"), "own.yaml:4: contact.k_n_mm3_per_n = 5135: gels have"),
    "forces in mN": (_log(F=1e3), "give --force-unit mn (millinewtons: 5 mm³/N)"),
    "forces in mN that the header states": (_log("Force [mN]", F=1e3), "k_n = 5.00"),
    "forces in kgf": (_log(F=1 / 9.80665), "If so, give --force-unit kgf (kg: 5 mm³/N)"),
    "volumes in m³": (_log(V=1e-9), '--column volume_mm3="Volume [m3]" (m3: 5 mm³/N)'),
    "times in ns": (_log(t=1e9), '--column time_s="Time [ns]"'),
    "times in ms": (_log(t=1e3), 'if it is in ms, say which it is: --column time_s="Time [ms]"'),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_another_unit_is_converted_refused_or_asked_about(tmp_path, case):
    act, says = CASES[case]
    try:
        found = str(act(tmp_path))
    except TacgenError as error:
        found = str(error)
    assert says in found
