"""One grasp on a page: what it shows, and what is refused."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import DatasetError
from tacgen.dataset import grasp_page, overlays
from tacgen.dataset.grasp_page import write_grasp_page
from tests.messages import refused

from .conftest import TOUCH, collect_toy, make_spec

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = collect_toy(tmp_path_factory.mktemp("page") / "data", make_spec(depth=True))
    folder.merge()
    return folder.root


def test_the_page_shows_frames_forces_and_depth(data, tmp_path):
    write_grasp_page(data, 1, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    for words in ("Simulated images of the left pad", "0.50 s", "Forces", "Depth at the moment"):
        assert words in text
    assert "can: success" in text


def test_the_command_names_the_page(data, tmp_path):
    result = CliRunner().invoke(app, ["view", str(data), "--grasp", "2", "--no-browser"])
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(data / "grasp-00002.html")
    with refused(DatasetError):
        write_grasp_page(data, 99, tmp_path / "page.html")


def test_a_dataset_without_a_gallery(data):
    (data / "index.html").unlink(missing_ok=True)
    result = CliRunner().invoke(app, ["view", str(data), "--no-browser"])
    assert isinstance(result.exception, DatasetError)
    assert "there is no gallery" in str(result.exception)


@pytest.fixture(scope="module")
def touched(tmp_path_factory):
    spec = make_spec(pads=("left", "right"), **TOUCH)
    folder = collect_toy(tmp_path_factory.mktemp("player") / "data", spec)
    folder.merge()
    return folder.root


def frames_of(page):
    text = page.read_text()
    found = [re.search(rf"const {name} = (.*);", text)[1] for name in ("FRAMES", "PADS")]
    return text, *map(json.loads, found)


def test_the_player_has_each_frame_of_each_pad_with_its_forces_and_fields(touched, tmp_path):
    write_grasp_page(touched, 1, tmp_path / "page.html")
    text, frames, pads = frames_of(tmp_path / "page.html")
    assert [one["text"] for one in frames] == [
        "frame 0 of 0 to 2, 0.00 s",
        "frame 1 of 0 to 2, 0.50 s, the moment of grasp",
        "frame 2 of 0 to 2, 1.00 s",
    ]
    # The cursor's places are as far apart as the times are.
    assert frames[1]["at"] - frames[0]["at"] == pytest.approx(frames[2]["at"] - frames[1]["at"])
    assert len(pads) == 2
    for pad in pads:
        assert [set(one) for one in pad] == [{"image", "text", "moved", "normal", "shear"}] * 3
        assert "6.00 N into the gel, shear +0.60, -1.20 N" in pad[2]["text"]
        assert pad[0]["moved"] == ""  # of frame 0 nothing has moved
        assert pad[2]["moved"].count("M") > 1
    assert 'name="motion" checked' in text
    assert not re.search(r"""(src|href)=(?!"data:)|@import|https?:(?!//www\.w3)""", text)


def test_a_long_grasp_has_frames_taken_evenly_and_a_page_of_bounded_size(
    touched, tmp_path, monkeypatch
):
    monkeypatch.setattr(grasp_page, "MAX_FRAMES", 2)
    write_grasp_page(touched, 1, tmp_path / "page.html")
    text, frames, _ = frames_of(tmp_path / "page.html")
    assert [one["text"][:7] for one in frames] == ["frame 0", "frame 2"]
    assert "Shown are 2 of 3 frames, taken evenly." in text
    monkeypatch.setattr(grasp_page, "MAX_PLAYER_BYTES", 100)
    write_grasp_page(touched, 1, tmp_path / "page.html")
    assert len(frames_of(tmp_path / "page.html")[1]) == 1


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_arrow_keys_step_and_the_cursor_follows(touched, tmp_path):
    page = tmp_path / "page.html"
    write_grasp_page(touched, 1, page)
    _, frames, pads = frames_of(page)
    for keys, wanted in (([], 1), (["ArrowRight"], 2), (["ArrowRight"] * 3, 2), (["Home"], 0)):
        presses = "".join(
            f"dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}));" for key in keys
        )
        pressed = tmp_path / "pressed.html"
        pressed.write_text(page.read_text().replace("</main>", f"<script>{presses}</script>"))
        command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
        command += [f"--user-data-dir={tmp_path / 'chromium'}", f"file://{pressed}"]
        dom = subprocess.run(command, capture_output=True, text=True, timeout=60).stdout
        assert f"<output>{frames[wanted]['text']}</output>" in dom
        left = float(re.search(r'class="cursor" style="left: ([\d.]+)%', dom)[1])
        assert left == pytest.approx(100 * frames[wanted]["at"], abs=0.01)
        shown = re.findall(r'<div class="view"><img alt="[^"]*" src="([^"]*)"', dom)
        assert shown == [pad[wanted]["image"] for pad in pads]


def test_paths_are_in_the_images_pixels():
    rest_mm = np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]])
    assert overlays.spacing_mm(rest_mm) == 2.0
    places = overlays.to_pixels(rest_mm, 0.5, (24, 32))
    np.testing.assert_array_equal(places[0], (14.0, 10.0))
    steps = np.array([[4.0, 0.0], [0.1, 0.1], [0.0, -4.0], [0.0, 0.0]])
    # A line, and a head whose barbs reach back by 0.35 of it and half as far aside.
    assert overlays.arrows_path(places, steps) == (
        "M14.0 10.0l4.0 0.0m-1.4 0.7l1.4 -0.7l-1.4 -0.7"
        "M14.0 14.0l0.0 -4.0m0.7 1.4l-0.7 -1.4l-0.7 1.4"
    )
    field_n = np.zeros((2, 4, 3))
    field_n[1, 2] = 0.5, 0.0, 2.0
    squares, arrows = overlays.field_paths(field_n, 2.0, (24, 32))
    # A cell of 8 × 12 px; the largest force fills a square of 8 px about its middle, (20, 18).
    assert squares == "M16.0 14.0h8.0v8.0h-8.0z"
    assert arrows.startswith("M20.0 18.0l2.0 0.0m-0.7 0.3")
