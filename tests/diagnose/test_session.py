"""``tacgen diagnose presses``: each channel as its own command has it, on one page."""

import json

import pytest

from tacgen.core.errors import PressError
from tacgen.diagnose.session import Session, diagnose_session
from tacgen.rig import RigRecipe, run_rig
from tests.messages import refused

EVERY_PRESS = {"presses": 16, "force_n": [1.0, 6.0]}


def recipe(output: str, **more: object) -> RigRecipe:
    sections = {"output": output, "schedule": EVERY_PRESS, "effects": ["creep"], **more}
    return RigRecipe.model_validate(sections)


@pytest.mark.slow
def test_a_log_alone_is_one_part(tmp_path):
    run_rig(recipe("log"), tmp_path / "session")
    found = diagnose_session(tmp_path / "session", tmp_path / "out")
    assert set(found["channels"]) == {"normal", "shear"}
    assert [one["name"] for one in found["channels"]["normal"]["effects"]] == ["creep"]
    alone = json.loads((tmp_path / "out/contact/diagnosis.json").read_text())
    assert json.loads((tmp_path / "out/diagnosis.json").read_text()) == alone
    page = (tmp_path / "out/report.html").read_text()
    assert "creep" in page
    assert 'href="contact/report.html"' in page
    assert "optics" not in page


@pytest.mark.slow
def test_pictures_and_forces_are_on_one_page(tmp_path):
    images = {"per_press": 1, "markers": False, "labels": True}
    run_rig(recipe("both", images=images, sensor="gelsight_mini"), tmp_path / "session")
    found = diagnose_session(tmp_path / "session", tmp_path / "out")
    assert set(found["channels"]) == {"rgb", "normal", "shear"}
    for part, names in (("optics", ["rgb"]), ("contact", ["normal", "shear"])):
        alone = json.loads((tmp_path / "out" / part / "diagnosis.json").read_text())["channels"]
        assert {name: found["channels"][name]["sentence"] for name in names} == {
            name: alone[name]["sentence"] for name in names
        }
    page = (tmp_path / "out/report.html").read_text()
    assert all(f"{one}: " in page for one in ("Pictures", "Volume and normal force"))


def test_what_a_session_holds(tmp_path):
    with refused(PressError):
        Session.of(tmp_path)
    (tmp_path / "presses.csv").write_text("file,radius_mm,force_normal_n\na.png,2,1\n")
    own = Session.of(tmp_path)
    assert (own.pictures, own.log, own.markers) == (tmp_path, tmp_path, None)
    (tmp_path / "press_log.csv").write_text("trial\n")
    (tmp_path / "markers.csv").write_text("trial\n")
    assert Session.of(tmp_path) == Session(
        tmp_path, tmp_path / "press_log.csv", tmp_path / "markers.csv"
    )
