"""Tracing what a table does not explain to optical effects, on pictures made by other formulas."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.core.errors import PressError
from tacgen.diagnose.optics.diagnose import diagnose_optics
from tacgen.diagnose.optics.sharpness import lost_noise
from tacgen.diagnose.rules import OPTICS
from tacgen.optics import render_rgb
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses
from tests.virtual_presses import repeated, virtual_presses
from validation.optics.optics_images import make


def presses(kind, effect="", strength=1.0, seed=0, count=16):
    made = make(kind, effect, strength, seed, count)
    return PressImages(
        images=made.images,
        background=made.background,
        names=tuple(f"{k}.png" for k in range(count)),
        center_px=made.center_px,
        radius_px=made.radius_px,
        ball_radius_mm=np.full(count, made.ball_mm),
        mm_per_px=made.mm_per_px,
    )


def names(diagnosis):
    return [effect.name for effect in diagnosis.effects]


@lru_cache
def table_of_before(kind):
    """A table of the same sensor, fitted to other presses without any effect."""
    return fit_lookup(presses(kind, seed=3))


@lru_cache
def diagnosed(kind, effect=""):
    """The diagnosis of presses with an effect beside the table of before; once for all tests."""
    return diagnose_optics(presses(kind, effect), table_of_before(kind))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["three", pytest.param("four", marks=pytest.mark.exhaustive)])
def test_clean_presses_need_no_effect(kind):
    diagnosis = diagnosed(kind)
    assert diagnosis.verdict == "sufficient"
    assert names(diagnosis) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "effect"),
    [
        pytest.param("three", "press_center", marks=pytest.mark.exhaustive),
        pytest.param("three", "scale", marks=pytest.mark.exhaustive),
        pytest.param("four", "illumination", marks=pytest.mark.exhaustive),
        pytest.param("three", "shadow", marks=pytest.mark.exhaustive),
        pytest.param("four", "blur", marks=pytest.mark.exhaustive),
        pytest.param("three", "background_gain", marks=pytest.mark.exhaustive),
        pytest.param("three", "vignetting", marks=pytest.mark.exhaustive),
        pytest.param("four", "vignetting", marks=pytest.mark.exhaustive),
        ("three", "saturation"),
        pytest.param("three", "cross_talk", marks=pytest.mark.exhaustive),
    ],
)
def test_an_effect_by_another_formula_is_named_and_lowers_the_heldout_error(kind, effect):
    diagnosis = diagnosed(kind, effect)
    first, *others = names(diagnosis)
    assert first == effect
    if effect != "vignetting":  # the pictures' falls off as cos⁴ and not as r²: that leaves a rest
        assert others == []
        assert diagnosis.verdict == "effect_found"
    assert diagnosis.effects[0].heldout_gain > diagnosis.effects[0].heldout_gain_stderr
    assert diagnosis.rmse_after < 0.97 * diagnosis.rmse_before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "covariate"),
    [
        pytest.param("ageing", "image_number", marks=pytest.mark.exhaustive),
        ("scratch", "place_on_gel"),
    ],
)
def test_what_is_on_no_list_is_unexplained_and_says_what_it_follows(effect, covariate):
    diagnosis = diagnose_optics(presses("three", effect, count=24), table_of_before("three"))
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.unexplained[0].covariate == covariate
    assert names(diagnosis) == []


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_pattern_around_contacts_is_unexplained_and_said_to_follow_them():
    """A ring that is bright on one side: no listed effect has its form."""
    clean = presses("three", count=24)
    rows, columns = np.mgrid[: clean.shape_px[0], : clean.shape_px[1]]
    images = clean.images.astype(float)
    for image, (x, y), radius in zip(images, clean.center_px, clean.radius_px, strict=True):
        distance = np.hypot(columns - x, rows - y) / radius
        side = (columns - x) / np.maximum(distance * radius, 1e-9)
        ring = np.exp(-(((distance - 1.7) / 0.2) ** 2))
        image += (8.0 * ring * side**2)[..., None] * [1.0, -1.0, 0.5]
    changed = replace(clean, images=np.rint(np.clip(images, 0, 255)).astype(np.uint8))
    diagnosis = diagnose_optics(changed, table_of_before("three"))
    assert diagnosis.verdict == "unexplained"
    assert "distance_and_direction" in [one.covariate for one in diagnosis.unexplained]
    # Of 8 grey levels, their mean over the ring's width and both sides, in three colours.
    assert diagnosis.unexplained[0].gain > 1.0


@pytest.mark.slow
def test_pictures_out_of_focus_are_blurred():
    clean = presses("three")
    images = gaussian_filter(clean.images.astype(float), (0, 1.5, 1.5, 0))
    blurred = replace(clean, images=np.rint(images).astype(np.uint8))
    diagnosis = diagnose_optics(blurred, table_of_before("three"))
    # Its width is a lower bound here: what that leaves may be named beside it.
    assert names(diagnosis)[0] == "blur"
    assert diagnosis.rmse_after < 1.02 * diagnosis.rmse_before
    assert "defocus" in diagnosis.table.effects
    assert lost_noise(blurred, blurred, diagnosis.table, OPTICS) is None


@pytest.mark.slow
def test_without_a_table_only_what_one_cannot_express_is_found():
    found = diagnose_optics(presses("three", "background_gain"))
    assert names(found) == ["background_gain"]
    assert "cross_talk" in " ".join(found.cannot_tell)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_without_a_table_lamps_near_the_gel_need_no_effect():
    near_lit = diagnose_optics(virtual_presses(0, count=16))
    assert near_lit.verdict == "sufficient"
    assert names(near_lit) == []


@pytest.mark.slow
def test_the_extended_table_renders_the_effect():
    found = diagnosed("three", "saturation")
    table = found.table
    level = found.effects[0].parameters["level_grey"]["value"]
    rows, columns = np.mgrid[: table.shape_px[0], : table.shape_px[1]]
    dent = -np.exp(-((rows - 60) ** 2 + (columns - 80) ** 2) / 150.0).astype(np.float32)
    bare = render_rgb(dent, replace(table, effects={}))
    rendered = render_rgb(dent, table)
    assert bare.max() > level + 2
    assert rendered.max() <= level + 1


@pytest.mark.slow
def test_the_json_has_the_contracts_fields():
    diagnosis = diagnosed("three")
    content = json.loads(json.dumps(diagnosis.as_dict()))
    channel = content["channels"]["rgb"]
    assert content["schema"] == 1
    assert channel["error_before"]["unit"] == "grey"
    assert channel["trials"] == {"fit": 12, "test": 4}
    assert {"verdict", "effects", "unexplained", "error_after", "noise_floor"} <= set(channel)


def test_many_pictures_of_few_presses_are_too_few():
    several = usable_presses(repeated(virtual_presses(1, count=5), 6))
    with pytest.raises(PressError, match="5 usable presses in 30 pictures are too few"):
        diagnose_optics(several)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_several_pictures_of_each_press_count_as_one():
    table = table_of_before("three")
    once = presses("three", "vignetting")
    several = replace(repeated(once, 3), experiment=np.repeat(np.arange(len(once)), 3))
    found, wanted = diagnose_optics(several, table), diagnosed("three", "vignetting")
    assert names(found) == names(wanted)
    trials = [one.as_dict()["channels"]["rgb"]["trials"] for one in (found, wanted)]
    assert trials[0] == trials[1] == {"fit": 12, "test": 4}
    # Frames that differ by noise alone make nothing surer: three of each would by a factor of 1.7.
    widths = [np.ptp(one.gain_interval) for one in (found, wanted)]
    assert widths[0] == pytest.approx(widths[1], rel=0.25)
    errors = [one.effects[0].heldout_gain_stderr for one in (found, wanted)]
    assert errors[0] == pytest.approx(errors[1], rel=0.25)


@pytest.mark.slow
def test_a_table_of_another_resolution_is_refused():
    with pytest.raises(PressError, match=r"\(150, 130\).*presses' own resolution"):
        diagnose_optics(presses("three", count=12), table_of_before("four"))


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_gain_that_drifts_is_named_where_lamps_differ_from_picture_to_picture():
    clean = presses("three", count=24)
    rng = np.random.default_rng(5)
    count = len(clean.images)
    # As on a measured sensor: green is steady, the two others scatter.
    gains = 1 + np.outer(np.linspace(-0.075, 0.075, count), np.ones(3))
    gains *= 1 + rng.normal(0.0, [0.04, 0.005, 0.04], (count, 3))
    images = np.clip(clean.images * gains[:, None, None], 0, 255)
    drifting = replace(clean, images=np.rint(images).astype(np.uint8))
    diagnosis = diagnose_optics(drifting, table_of_before("three"))
    assert names(diagnosis)[0] == "background_gain"
    drift = diagnosis.effects[0].parameters["drift_g"]["value"]
    assert drift == pytest.approx(0.15, abs=0.01)  # two standard errors of green's scatter
    assert diagnosis.rmse_after < 0.9 * diagnosis.rmse_before


@pytest.mark.exhaustive
@pytest.mark.slow
def test_labels_that_scatter_as_those_of_the_table_are_not_named():
    clean = presses("three")
    off = np.random.default_rng(6).normal(0.0, 0.12, (len(clean.images), 2))
    scattered = replace(clean, center_px=clean.center_px + off * clean.radius_px[:, None])
    table = table_of_before("three")
    assert names(diagnose_optics(scattered, table)) == ["press_center"]
    provenance = {**table.provenance, "label_scatter_radii": 0.1}
    assert diagnose_optics(scattered, replace(table, provenance=provenance)).effects == ()
