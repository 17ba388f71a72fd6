"""One grasp on a page: what it shows, and what is refused."""

import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import DatasetError
from tacgen.dataset.grasp_page import write_grasp_page

from .conftest import collect_toy, make_spec


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


def test_a_grasp_that_was_not_executed_has_its_status(data, tmp_path):
    write_grasp_page(data, 4, tmp_path / "page.html")
    assert "unreachable" in (tmp_path / "page.html").read_text()


def test_the_command_names_the_page(data, tmp_path):
    result = CliRunner().invoke(app, ["view", str(data), "--grasp", "2", "--no-browser"])
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(data / "grasp-00002.html")
    with pytest.raises(DatasetError, match="no grasp 99; it has 0 to 9"):
        write_grasp_page(data, 99, tmp_path / "page.html")


def test_a_dataset_without_a_gallery(data):
    (data / "index.html").unlink(missing_ok=True)
    result = CliRunner().invoke(app, ["view", str(data), "--no-browser"])
    assert isinstance(result.exception, DatasetError)
    assert "there is no gallery" in str(result.exception)
