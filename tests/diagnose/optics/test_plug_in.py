"""One module and its registration make an effect: fitted, named, rendered, reported."""

import json
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from tacgen.core.errors import TableError
from tacgen.diagnose.optics.diagnose import diagnose_optics
from tacgen.optics import render_rgb
from tacgen.optics.effects import (
    OpticalEffect,
    OpticalParameter,
    Stage,
    check_effects,
    register,
    unregister,
)
from tests.diagnose.optics.test_diagnose import presses, table_of_before


class Glow(OpticalEffect):
    """What a contact changes is brighter, more so towards the top of the image."""

    name = "glow"
    stage = Stage.LIGHT
    parameters = MappingProxyType({"strength": OpticalParameter(0.0, -0.9, 0.9, step=0.02)})

    def apply(self, array, patch, *, strength=0.0, **_):
        brighter = np.exp(np.asarray(strength, array.dtype) * (1 - 4 * patch.v**3))
        change = array - patch.background
        return patch.background + change * np.broadcast_to(brighter, array.shape[:-1])[..., None]


@pytest.fixture
def glow():
    effect = register(Glow())
    yield effect
    unregister(effect.name)


def glowing_presses(strength):
    """The pictures of plain presses with that effect."""
    plain = presses("four")
    height, width = plain.shape_px
    u = ((np.arange(width) + 0.5) / width - 0.5)[None, :]
    v = ((np.arange(height) + 0.5) / height - 0.5)[:, None]
    background = plain.background.astype(float)
    brighter = np.exp(strength * (1 - 4 * v**3) + 0 * u)[..., None]
    images = background + (plain.images - background) * brighter
    return replace(plain, images=np.rint(np.clip(images, 0, 255)).astype(np.uint8))


@pytest.mark.slow
def test_an_effect_of_ones_own_is_fitted_named_rendered_and_reported(glow):
    given, table = presses("four"), table_of_before("four")
    glowing = glowing_presses(0.4)
    found = diagnose_optics(glowing, table)
    assert [effect.name for effect in found.effects] == ["glow"]
    assert found.rmse_after < 0.8 * found.rmse_before
    reported = json.loads(json.dumps(found.as_dict()))["channels"]["rgb"]["effects"][0]
    strength = reported["parameters"]["strength"]
    assert strength["value"] == pytest.approx(0.4, abs=0.06)
    assert strength["stderr"] < 0.05
    extended = found.table
    assert dict(extended.effects) == {"glow": {"strength": strength["value"]}}
    rows, columns = np.mgrid[: given.shape_px[0], : given.shape_px[1]]
    dent = -np.exp(-((rows - 60) ** 2 + (columns - 80) ** 2) / 150.0).astype(np.float32)
    plain, bright = (render_rgb(dent, t).astype(float) for t in (table, extended))
    contrast = [abs(image - table.background).sum() for image in (plain, bright)]
    assert contrast[1] > 1.2 * contrast[0]


def test_a_name_is_registered_once_and_known_only_while_it_is(glow):
    with pytest.raises(TableError, match="'glow' is registered twice: give the new one"):
        register(Glow())
    check_effects({"glow": {"strength": 0.1}})
    unregister("glow")
    with pytest.raises(TableError, match="'glow' is unknown"):
        check_effects({"glow": {}})
    register(Glow())
