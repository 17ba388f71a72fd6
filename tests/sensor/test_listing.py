"""What is listed, shown and added of sensors."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

import tacgen
from tacgen.cli import app
from tacgen.core.errors import TacgenError
from tacgen.core.resources import packaged
from tacgen.core.safe_io import read_rgb
from tacgen.optics import load_table
from tacgen.sensor.listing import add_sensor, sensor_rows, write_picture
from tests.messages import refused


def said(*words: str) -> str:
    run = CliRunner().invoke(app, ["sensors", *words])
    assert run.exit_code == 0, run.output
    return run.stdout


def test_what_is_virtual_is_called_so():
    rows = {row["name"]: row for row in sensor_rows()}
    assert "virtual sensor" in rows["virtual_gelsight"]["colors_from"]
    for name, count in {"gelsight": 48, "digit": 49, "gelsight_mini": 49}.items():
        assert f"{count} real ball presses of" in rows[name]["colors_from"]
        assert json.loads(said("show", name, "--json"))["license"] == "MIT"
        assert name in (packaged("recipes") / "sensors/NOTICE.txt").read_text()
        table = Path(tacgen.Sensor(name).description.table)
        assert table.stat().st_size <= 1.5e6
    listed = said("list").splitlines()
    assert len(listed) == 1 + len(rows)
    facts = json.loads(said("show", "gelsight", "--json"))
    assert facts["license"] == "MIT"
    assert "extrapolates" in facts["note"]
    assert facts["error_grey"] == pytest.approx(
        load_table(tacgen.Sensor("gelsight").description.table).provenance["heldout"]["rmse_labels"]
    )


def test_a_picture_shows_the_rendered_and_the_real_press(tmp_path):
    write_picture("gelsight", tmp_path / "real.png")
    write_picture("virtual_gelsight", tmp_path / "virtual.png")
    real, virtual = (read_rgb(tmp_path / f"{name}.png") for name in ("real", "virtual"))
    assert real.shape[1] > virtual.shape[1]  # one more picture


def test_every_sensor_with_real_colours_ships_a_real_press_in_its_own_size():
    folder = packaged("recipes") / "sensors"
    real = sorted(path.name.removesuffix(".press.jpg") for path in folder.glob("*.press.jpg"))
    assert real == ["digit", "gelsight", "gelsight_mini"]
    for name in real:
        background = tacgen.Sensor(name).at_rest_rgb().astype(float)
        press = read_rgb(folder / f"{name}.press.jpg")
        assert press.shape == background.shape
        # Most of it is bare gel, in the colours of the table; some of it is pressed.
        change = np.abs(press - background).max(axis=2)
        assert np.median(change) < 8
        assert np.percentile(change, 99) > 30


def test_a_calibrated_table_becomes_a_sensor(tmp_path, monkeypatch):
    table = Path(tacgen.Sensor("virtual_gelsight").description.table).resolve()
    monkeypatch.chdir(tmp_path)
    said("add", str(table), "--name", "my_digit", "--gel-depth-mm", "2.5", "--dome-radius-mm", "55")
    folder = tmp_path / "recipes/sensors"
    content = yaml.safe_load((folder / "my_digit.yaml").read_text())
    assert content["table"] == "my_digit.table.npz"
    assert (folder / "my_digit.table.npz").read_bytes() == Path(table).read_bytes()
    sensor = tacgen.Sensor("my_digit").description
    given = load_table(table)
    assert sensor.shape_px == given.shape_px
    assert sensor.mm_per_px == pytest.approx(given.mm_per_px, abs=1e-6)
    assert (sensor.gel_depth_mm, sensor.dome_radius_mm) == (2.5, 55.0)
    assert np.ptp(tacgen.Sensor("my_digit").at_rest_rgb()) > 0
    assert "my_digit" in said("list")
    (folder / "broken.yaml").write_text("name: broken\n")
    assert "broken" in said("list")  # one that cannot be read does not hide the others
    with refused(TacgenError):
        add_sensor(Path(table), "my_digit", gel_depth_mm=2, dome_radius_mm=None, force=False)
    with refused(TacgenError):
        add_sensor(Path(table), "other", gel_depth_mm=2, dome_radius_mm=5.0, force=False)
    assert not list(folder.glob("other*"))
    with refused(TacgenError):
        add_sensor(Path(table), "../x", gel_depth_mm=2, dome_radius_mm=None, force=False)


def test_images_of_several_folders_may_have_one_name(tmp_path):
    from tacgen.core.images import encode_png
    from tacgen.sensor.read_image import ImageReader, read_files

    sensor = tacgen.Sensor("digit")
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "0.png").write_bytes(encode_png(sensor.at_rest_rgb()))
    paths = [tmp_path / "a/0.png", tmp_path / "b/0.png"]
    rows = read_files(ImageReader(sensor), paths, tmp_path / "out")
    assert [row["file"] for row in rows] == ["a_0.png", "b_0.png"]
    assert (tmp_path / "out/b_0.npz").is_file()
    with refused(TacgenError):
        read_files(ImageReader(sensor), [paths[0]] * 2, tmp_path / "again")
