"""Pages that another command, or the user, wrote are kept, and said before anything is computed."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from tacgen.cli import app
from tacgen.core.errors import TacgenError
from tacgen.report.page import write_page
from tests.messages import refused

COMMANDS = {
    "calibrate lookup": ("calibrate lookup presses --out table.npz --report DIR", "index.html"),
    "calibrate contact": ("calibrate contact log.csv --out law.yaml --report DIR", "index.html"),
    "diagnose contact": ("diagnose contact log.csv --out DIR --force", "report.html"),
    "diagnose optics": ("diagnose optics presses --out DIR --force", "report.html"),
    "eval": ("eval DIR --data data", "index.html"),
}


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("content", ["my own page", None])
def test_a_page_of_another_maker_is_kept_before_anything_is_read(
    tmp_path, monkeypatch, command, content
):
    """None of the inputs exists: that is found out later."""
    if command == "eval":
        pytest.importorskip("torch")  # without the extra `learn`, its absence is what is said
    monkeypatch.chdir(tmp_path)
    words, name = COMMANDS[command]
    page = tmp_path / "DIR" / name
    if content is None:
        write_page(page, "Title", made_by="friction")
    else:
        page.parent.mkdir()
        page.write_text(content)
    before = page.read_bytes()
    result = CliRunner().invoke(app, words.split())
    assert isinstance(result.exception, (TacgenError, SystemExit))
    said = f"{result.exception} {result.output}"
    assert f"is there already, and not from `tacgen {command}`" in said
    assert page.read_bytes() == before


def test_a_command_replaces_its_own_page_and_no_other(tmp_path):
    page = tmp_path / "report.html"
    write_page(page, "Old", made_by="eval")
    write_page(page, "New", made_by="eval")
    assert "New" in page.read_text()
    with refused(TacgenError):
        write_page(page, "Newer", made_by="train")
    assert "New</title>" in page.read_text()
