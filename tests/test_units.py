"""Values in another unit than is asked for: converted where they state it, refused or asked about
where no gel has them.
"""
# ruff: noqa: E501

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import tacgen
from tacgen.core.errors import TacgenError


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


CASES = {
    "k_n of a law in mm³/mN": (_law("k_n_mm3_per_n: 0.005135"), "= 0.005135: gels have 0.3 to 60 mm³/N"),
    "k_n of a law in px³/N": (_law("k_n_mm3_per_n: 200039"), "so another unit is likely"),
    "a law that states its unit": (_law("k_n_mm3_per_n: {value: 0.2, unit: mm3/N}"), "k_n = 0.2"),
    "a law in another unit": (_law("k_n_mm3_per_n: {value: 5.1e-9, unit: m3/N}"), "unit = 'm3/N' is not mm3/N; convert the value"),
    "k_n of a recipe in mm³/kN": (_recipe("contact: {k_n_mm3_per_n: 5135}"), "own.yaml:4: contact.k_n_mm3_per_n = 5135: gels have"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_another_unit_is_converted_refused_or_asked_about(tmp_path, case):
    act, says = CASES[case]
    try:
        found = str(act(tmp_path))
    except TacgenError as error:
        found = str(error)
    assert says in found
