"""What a study checks before it collects, keeps in its folder, and says of what failed."""

import json
import shutil
import sys

import pandas as pd
import pytest
import yaml

from tacgen import cli
from tacgen.collection.recipe_inputs import recipe_inputs
from tacgen.core.errors import LearningError, TacgenError
from tacgen.core.resources import find_object_folder
from tacgen.study.real_data import RealData
from tacgen.study.run import check_finished, run_study
from tacgen.study.study_recipe import load_study, reductions
from tests.learning.conftest import write_real
from tests.messages import refused
from tests.study.conftest import small_study

ROWS = ("single image", "one model for all")


def table_of(out) -> dict:
    return json.loads((out / "table.json").read_text())


def names_in(out) -> list[str]:
    return [row["name"] for row in table_of(out)["rows"]]


def without_images(folder):
    shutil.rmtree(write_real(folder) / "images")
    return folder


def run_cli(monkeypatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["tacgen", *map(str, arguments)])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    return int(stopped.value.code or 0)


@pytest.mark.slow
def test_real_grasps_of_other_objects_leave_the_simulated_result_in_the_table(
    tmp_path, toy_collect, small_backbone
):
    real, out = write_real(tmp_path / "real"), tmp_path / "out"
    table = pd.read_csv(real / "grasps.csv")
    table.assign(object="mug").to_csv(real / "grasps.csv", index=False)
    study = load_study(small_study(tmp_path))
    result = run_study(study, out, RealData(test=real), rows=[ROWS[0]])
    row = table_of(out)["rows"][0]
    assert row["sim"]["n"] > 0
    assert "real" not in row
    assert "has grasps of mug" in row["real_problem"]
    for name in ("table.md", "index.html"):
        text = (out / name).read_text()
        assert "single image: NOT tested for sim-to-real. " in text
        assert "NOT trained" not in text
        assert f"{row['sim']['accuracy']:.3f}" in text
    with refused(LearningError):
        check_finished(result)


@pytest.mark.parametrize(
    "make",
    [
        lambda folder: folder,
        without_images,
    ],
    ids=["no folder", "no images"],
)
def test_real_grasps_are_opened_before_anything_is_collected(tmp_path, toy_collect, make):
    real, out = make(tmp_path / "real"), tmp_path / "out"
    with refused(TacgenError):
        run_study(load_study(small_study(tmp_path)), out, RealData(test=real))
    assert not toy_collect
    assert not out.exists()


def test_real_data_that_cannot_be_read_are_all_listed_at_once(tmp_path, toy_collect):
    (tmp_path / "contact.yaml").write_text("law: none\n")
    given = RealData(tmp_path / "a", tmp_path / "b", tmp_path / "contact.yaml")
    with refused(TacgenError):
        run_study(load_study(small_study(tmp_path)), tmp_path / "out", given)
    assert not toy_collect


@pytest.mark.parametrize("first", [True, False])
def test_the_reduced_version_does_not_share_a_folder_with_the_whole(tmp_path, no_networks, first):
    study, out = load_study(small_study(tmp_path)), tmp_path / "out"
    run_study(study, out, RealData(), rows=[ROWS[0]], quick=first)
    before = (out / "table.md").read_bytes(), (out / "table.json").read_bytes()
    with refused(LearningError):
        run_study(study, out, RealData(), quick=not first)
    assert no_networks == ["single_image"]
    assert before == ((out / "table.md").read_bytes(), (out / "table.json").read_bytes())


def test_two_studies_do_not_share_a_folder_even_before_the_first_has_a_row(
    tmp_path, toy_collect, monkeypatch
):
    study, out = load_study(small_study(tmp_path)), tmp_path / "out"

    def fail(*_, **__):
        raise TacgenError("no simulator")

    monkeypatch.setattr("tacgen.study.run.collect", fail)
    with refused(TacgenError):
        run_study(study, out, RealData())
    with refused(LearningError):
        run_study(study.model_copy(update={"name": "t"}), out, RealData())


def test_rows_run_one_by_one_end_in_one_table_in_the_studys_order(tmp_path, no_networks):
    study, out = load_study(small_study(tmp_path)), tmp_path / "out"
    run_study(study, out, RealData(), rows=[ROWS[1]])
    assert names_in(out) == [ROWS[1]]
    run_study(study, out, RealData(), rows=[ROWS[0]])
    assert names_in(out) == list(ROWS)
    assert no_networks == ["one_model_for_all", "single_image"]
    text = (out / "table.md").read_text()
    assert text.index("| single image |") < text.index("| one model for all |")


def test_rows_of_an_object_that_has_changed_are_refused_and_stay(
    tmp_path, no_networks, monkeypatch
):
    monkeypatch.setattr("tacgen.study.run.recipe_inputs", recipe_inputs)
    monkeypatch.chdir(tmp_path)
    shutil.copytree(find_object_folder("cup"), tmp_path / "objects" / "cup")
    path, out = small_study(tmp_path), tmp_path / "out"
    path.write_text(path.read_text().replace("[can, cup]", "[cup]"))
    run_study(load_study(path), out, RealData(), rows=[ROWS[0]])
    about = tmp_path / "objects/cup/object.yaml"
    about.write_text(f"# a remark\n{about.read_text()}")
    run_study(load_study(path), out, RealData(), rows=[ROWS[0]])
    before = (out / "table.json").read_bytes()
    figures = yaml.safe_load(about.read_text())
    figures["friction"]["value"] = 0.05
    about.write_text(yaml.safe_dump(figures))
    for row in ROWS:
        with refused(LearningError):
            run_study(load_study(path), out, RealData(), rows=[row])
    assert (out / "table.json").read_bytes() == before


def test_rows_tested_on_different_grasps_say_on_which(tmp_path, no_networks):
    study, out = load_study(small_study(tmp_path)), tmp_path / "out"
    real, world = write_real(tmp_path / "real"), write_real(tmp_path / "world")
    run_study(study, out, RealData(test=real), rows=[ROWS[0]])
    run_study(study, out, RealData(test=world), rows=[ROWS[1]])
    text = (out / "table.md").read_text()
    column = "The column sim-to-real or other simulation of"
    assert f"{column} single image is measured on {real}.\n" in text
    assert (
        f"{column} one model for all is measured on {world}, grasps of another simulation" in text
    )
    assert "| single image | sim-to-real | 0.900 |" in text
    assert "| one model for all | other simulation | 0.900 |" in text


def test_a_row_that_stops_everything_leaves_the_table_of_those_before(
    tmp_path, no_networks, monkeypatch
):
    def stopped(recipe, data, run, **_):
        if run.parent.name == "one_model_for_all":
            raise KeyboardInterrupt
        model = {"weights": "none", "grasps_fit": 20, "grasps_validation": 4}
        return {"models": {"can": model}}

    out = tmp_path / "out"
    monkeypatch.setattr("tacgen.study.run.train", stopped)
    with pytest.raises(KeyboardInterrupt):
        run_study(load_study(small_study(tmp_path)), out, RealData())
    assert names_in(out) == [ROWS[0]]
    assert "| single image | single | 0.900 |" in (out / "table.md").read_text()


@pytest.mark.parametrize("text", ["{", '{"study": "s", "quick": false, "rows": 3}'])
def test_a_broken_record_is_reported_with_its_fix(tmp_path, no_networks, text):
    out = tmp_path / "out"
    out.mkdir()
    (out / "table.json").write_text(text)
    with refused(LearningError):
        run_study(load_study(small_study(tmp_path)), out, RealData())
    assert not no_networks


@pytest.mark.parametrize(
    ("quick", "changes"),
    [
        ("{}", []),
        ("{train: {training: {epochs: 1}}}", []),
        ("{objects: [cup]}", ["objects: 1 instead of 2"]),
        (
            "{data: {frames: {mode: sequence, count: 5}, grid: {sample: 9}}}",
            ["frames: 5 instead of 1", "sampled grasps: 9 instead of all"],
        ),
        (
            "{train: {input: {size_px: [34, 48]}, training: {epochs: 3, grasps: 7}}}",
            [
                "training grasps: 7 instead of all",
                "input: 48×34 px instead of 40×32 px",
                "epochs: 3 instead of 1",
            ],
        ),
    ],
)
def test_what_the_reduced_version_has_less_of_is_listed(tmp_path, quick, changes):
    study = load_study(small_study(tmp_path, quick=quick))
    assert reductions(study, study.rows) == changes


def test_the_command_prints_the_table_and_fails_where_a_row_did(
    tmp_path, no_networks, monkeypatch, capsys
):
    def fail(recipe, data, run, **_):
        raise LearningError("every grasp succeeded")

    path, out = small_study(tmp_path), tmp_path / "out"
    assert run_cli(monkeypatch, "study", path, "--out", out, "--row", ROWS[0]) == 0
    monkeypatch.setattr("tacgen.study.run.train", fail)
    capsys.readouterr()
    assert run_cli(monkeypatch, "study", path, "--out", out, "--row", ROWS[1]) == 2
    printed = capsys.readouterr()
    assert "| single image | single | 0.900 |" in printed.out
    assert "one model for all: NOT trained. every grasp succeeded" in printed.out
    assert "tacgen: not all rows could be trained and tested; fix these" in printed.err
    assert "\none model for all: every grasp succeeded" in printed.err
