"""One module and its registration make an effect: fitted, named, rendered, reported."""

import ast
import json
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

import tacgen
from tacgen.core.errors import TableError
from tacgen.diagnose.optics.diagnose import diagnose_optics
from tacgen.diagnose.optics.extended_table import extended_table
from tacgen.optics import render_rgb
from tacgen.optics.effects import (
    OpticalEffect,
    Parameter,
    Stage,
    check_effects,
    optical_effects,
    register,
    unregister,
)
from tests.diagnose.optics.test_diagnose import presses

PACKAGE = Path(tacgen.__file__).parent
ROOMS = ("optics", "diagnose/optics")
MODULES = [
    path
    for room in ROOMS
    for path in (PACKAGE / room).rglob("*.py")
    if path.parent != PACKAGE / "optics" / "effects"
]


class Haze(OpticalEffect):
    """What a contact changes fades towards the background, more towards the top of the image."""

    name = "haze"
    stage = Stage.LIGHT
    parameters = MappingProxyType({"thickness": Parameter(0.0, -0.9, 0.9, step=0.02)})

    def apply(self, array, patch, *, thickness=0.0, **_):
        kept = np.exp(-np.asarray(thickness, array.dtype) * (1 - 4 * patch.v**3))
        change = array - patch.background
        return patch.background + change * np.broadcast_to(kept, array.shape[:-1])[..., None]


@pytest.fixture
def haze():
    effect = register(Haze())
    yield effect
    unregister(effect.name)


def hazy_presses(effect, thickness):
    """The pictures of plain presses, seen through haze."""
    plain = presses("four")
    height, width = plain.shape_px
    u = ((np.arange(width) + 0.5) / width - 0.5)[None, :]
    v = ((np.arange(height) + 0.5) / height - 0.5)[:, None]
    background = plain.background.astype(float)
    kept = np.exp(-thickness * (1 - 4 * v**3) + 0 * u)[..., None]
    images = background + (plain.images - background) * kept
    return replace(plain, images=np.rint(np.clip(images, 0, 255)).astype(np.uint8))


def test_an_effect_of_ones_own_is_fitted_named_rendered_and_reported(haze):
    given = presses("four")
    first = diagnose_optics(given)
    table = extended_table(given, first.selection.chosen, first.reference, None)
    hazy = hazy_presses(haze, 0.6)
    found = diagnose_optics(hazy, table)
    assert [effect.name for effect in found.effects] == ["haze"]
    assert found.rmse_after < 0.8 * found.rmse_before
    reported = json.loads(json.dumps(found.as_dict()))["channels"]["rgb"]["effects"][0]
    thickness = reported["parameters"]["thickness"]
    assert thickness["value"] == pytest.approx(0.6, abs=0.06)
    assert thickness["stderr"] < 0.05
    extended = extended_table(hazy, found.selection.chosen, found.reference, table)
    assert extended.effects == {"haze": {"thickness": thickness["value"]}}
    rows, columns = np.mgrid[: given.shape_px[0], : given.shape_px[1]]
    dent = -np.exp(-((rows - 60) ** 2 + (columns - 80) ** 2) / 150.0).astype(np.float32)
    plain, faded = (render_rgb(dent, t).astype(float) for t in (table, extended))
    contrast = [abs(image - table.background).sum() for image in (plain, faded)]
    assert contrast[1] < 0.75 * contrast[0]


def test_a_name_is_registered_once_and_known_only_while_it_is(haze):
    with pytest.raises(TableError, match="'haze' is registered twice: give the new one"):
        register(Haze())
    check_effects({"haze": {"thickness": 0.1}})
    unregister("haze")
    with pytest.raises(TableError, match="'haze' is unknown"):
        check_effects({"haze": {}})
    register(Haze())


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_other_module_names_an_effect(path):
    names = {effect.name for effect in optical_effects()}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant):
            assert node.value not in names, f"line {node.lineno}"
        if isinstance(node, ast.ImportFrom):
            parts = {*(node.module or "").split("."), *(alias.name for alias in node.names)}
            assert not (parts & names), f"line {node.lineno}"
