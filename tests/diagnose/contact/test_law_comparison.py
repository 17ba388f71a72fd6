"""The page that shows what an effect changes in the images of a grasp."""

from dataclasses import replace
from types import MappingProxyType

import pytest

from tacgen.collection.recipe import load_recipe
from tacgen.contact import ContactLaw
from tacgen.contact.law import FittedEffect
from tacgen.core.records import Estimate
from tacgen.diagnose.contact.law_comparison import write_law_comparison
from tests.small_world import write_world

LINEAR = ContactLaw.linear(5.0)
CREEP = FittedEffect(
    "creep",
    "normal",
    MappingProxyType({"amount": Estimate(0.4), "tau_s": Estimate(0.5), "recovery": Estimate(1.0)}),
)


@pytest.mark.slow
def test_the_page_says_how_far_the_laws_part(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = load_recipe(write_world(tmp_path, frames="{mode: sequence, count: 4}"))
    creeping = replace(LINEAR, effects=(CREEP,))
    write_law_comparison(recipe, LINEAR, creeping, tmp_path / "differs.html")
    write_law_comparison(recipe, LINEAR, LINEAR, tmp_path / "same.html")
    assert "differ by 0 grey levels" in (tmp_path / "same.html").read_text()
    assert "differ by 0 grey levels" not in (tmp_path / "differs.html").read_text()
