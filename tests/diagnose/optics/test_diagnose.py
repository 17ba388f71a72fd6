"""Tracing what a table leaves over to optical effects, on pictures made by other formulas."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from tacgen.core.errors import PressError
from tacgen.diagnose.optics.diagnose import diagnose_optics
from tacgen.diagnose.optics.extended_table import extended_table
from tacgen.optics import render_rgb
from tacgen.presses.press_images import PressImages
from tests.virtual_presses import virtual_presses
from validation.optics.optics_images import make


def presses(kind, effect="", strength=1.0, seed=0, count=24):
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


@lru_cache(maxsize=4)
def diagnosed(kind, effect="", count=24):
    """Several tests look at one diagnosis; nothing of it may be changed."""
    return diagnose_optics(presses(kind, effect, count=count))


def names(diagnosis):
    return [effect.name for effect in diagnosis.effects]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["three", "four"])
def test_clean_presses_need_no_effect(kind):
    diagnosis = diagnosed(kind)
    assert diagnosis.verdict == "sufficient"
    assert names(diagnosis) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "effect"),
    [
        ("three", "press_center"),
        ("three", "scale"),
        ("four", "illumination"),
        ("three", "shadow"),
        ("four", "blur"),
        ("three", "background_gain"),
        ("three", "vignetting"),
        pytest.param(
            *("four", "vignetting"),
            marks=pytest.mark.xfail(
                strict=True, reason="known gap: under four lamps a table hides the dimming"
            ),
        ),
        ("three", "saturation"),
    ],
)
def test_an_effect_by_another_formula_is_named_and_lowers_the_heldout_error(kind, effect):
    diagnosis = diagnosed(kind, effect)
    assert names(diagnosis) == [effect]
    assert diagnosis.verdict == "effect_found"
    # A table hides most of a clipped picture, so saturation gains little beside its pile.
    least = 1.0 if effect == "saturation" else 0.97
    assert diagnosis.rmse_after < least * diagnosis.rmse_before
    parameters = diagnosis.effects[0].parameters
    if effect == "scale":
        # Labels are 15 % too large; the skin's form is another, which costs some percent.
        assert parameters["contact_per_label"]["value"] == pytest.approx(1 / 1.15, rel=0.05)
    if effect == "blur":
        assert parameters["sigma_mm"]["value"] == pytest.approx(0.25, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "effect", "covariate"),
    [
        pytest.param(
            *("four", "scratch", "place_on_gel"),
            marks=pytest.mark.xfail(
                strict=True, reason="known gap: 24 presses may call a scratch background_gain"
            ),
        ),
        ("three", "ageing", "image_number"),
    ],
)
def test_what_is_on_no_list_is_unexplained_and_says_what_it_follows(kind, effect, covariate):
    diagnosis = diagnose_optics(presses(kind, effect))
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.unexplained[0].covariate == covariate
    assert names(diagnosis) == []


@pytest.mark.slow
def test_colours_that_leak_are_told_from_the_table_of_before_and_not_without():
    before, after = presses("three", seed=3), presses("three", "cross_talk", seed=4)
    plain = diagnose_optics(before)
    table = extended_table(before, plain.selection.chosen, plain.reference, None)
    # The lamps leak into the reference too, which is what a new photograph of it shows.
    leaking = diagnose_optics(after, replace(table, background=plain_reference(after)))
    assert names(leaking)[0] == "cross_talk"
    assert "cross_talk" not in names(diagnose_optics(after))
    assert "cross_talk" in " ".join(plain.cannot_tell)


def plain_reference(images):
    return images.background.astype(np.float32)


@pytest.mark.slow
def test_a_diagnosis_that_starts_from_its_own_table_finds_nothing_more():
    given, first = presses("three", "saturation"), diagnosed("three", "saturation")
    table = extended_table(given, first.selection.chosen, first.reference, None)
    again = diagnose_optics(given, table)
    assert names(again) == []
    assert again.rmse_before < 1.1 * first.rmse_after


@pytest.mark.slow
def test_the_extended_table_renders_the_effect():
    given, found = presses("three", "saturation"), diagnosed("three", "saturation")
    table = extended_table(given, found.selection.chosen, found.reference, None)
    level = found.effects[0].parameters["level_grey"]["value"]
    rows, columns = np.mgrid[: given.shape_px[0], : given.shape_px[1]]
    dent = -np.exp(-((rows - 60) ** 2 + (columns - 80) ** 2) / 150.0).astype(np.float32)
    bare = render_rgb(dent, replace(table, effects={}))
    rendered = render_rgb(dent, table)
    assert bare.max() > level + 2
    assert rendered.max() <= level + 1
    np.testing.assert_array_equal(rendered, render_rgb(dent, table))


@pytest.mark.slow
def test_lamps_close_by_are_illumination_by_place():
    assert names(diagnose_optics(virtual_presses(0)))[:1] == ["illumination"]


@pytest.mark.slow
def test_the_json_has_the_contracts_fields():
    content = json.loads(json.dumps(diagnosed("four", count=12).as_dict()))
    channel = content["channels"]["rgb"]
    assert content["schema"] == 1
    assert channel["error_before"]["unit"] == "grey"
    assert channel["trials"] == {"fit": 9, "test": 3}
    assert {"verdict", "effects", "unexplained", "error_after", "noise_floor"} <= set(channel)


def test_too_few_presses():
    with pytest.raises(PressError, match="5 usable presses are too few to hold any out"):
        diagnose_optics(presses("four", count=5))


@pytest.mark.slow
def test_a_table_of_another_resolution_is_refused():
    given, found = presses("four", count=12), diagnosed("four", count=12)
    table = extended_table(given, found.selection.chosen, found.reference, None)
    with pytest.raises(PressError, match=r"\(150, 130\).*presses' own resolution"):
        diagnose_optics(presses("three", count=12), table)
