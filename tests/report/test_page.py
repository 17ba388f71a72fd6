"""The report page: a table's numbers stand in line, text is escaped, nothing is fetched."""

import re

import numpy as np

from tacgen.core.images import difference, evenly, side_by_side
from tacgen.report.page import (
    facts_section,
    pictures_section,
    table_section,
    text_section,
    write_page,
)


def cells_of(body):
    cells = re.findall(r"<t[hd]( class=\"number\")?>([^<]*)</t[hd]>", body)
    return [(text, bool(number)) for number, text in cells]


def test_columns_of_numbers_align_with_their_headings_and_text_is_escaped():
    body = table_section("T", ("name", "share", "n"), [("<a>", "0.960", 7), ("b", "–", 12)]).body
    assert cells_of(body) == [
        ("name", False),
        ("share", True),
        ("n", True),
        ("&lt;a&gt;", False),
        ("0.960", True),
        ("7", True),
        ("b", False),
        ("–", True),
        ("12", True),
    ]


def test_a_page_is_whole_and_needs_no_network(tmp_path):
    rgb = np.full((4, 6, 3), 90, np.uint8)
    sections = [
        text_section("Words", "<b>5 mm3</b>"),
        facts_section("Facts", [("k", 1.5), ("by", "ball")], "A note."),
        pictures_section("Pictures", [("a", rgb), ("b", rgb)]),
    ]
    write_page(tmp_path / "p.html", "Title", sections, summary="3 mm2", verdict="sufficient")
    page = (tmp_path / "p.html").read_text()
    assert "&lt;b&gt;5 mm³&lt;/b&gt;" in page
    assert '<p class="summary sufficient">3 mm²</p>' in page
    assert page.count("data:image/") == 2
    assert "://" not in page


def test_a_difference_is_about_middle_grey():
    before = np.full((2, 2, 3), 100, np.uint8)
    assert (difference(before, before, 4) == 128).all()
    assert (difference(before + 10, before, 4) == 168).all()
    assert (difference(before, before + 100, 4) == 0).all()


def test_a_strip_holds_its_images_at_the_asked_width():
    image = np.zeros((30, 40, 3), np.uint8)
    assert side_by_side([image, image, image]).shape == (30, 128, 3)
    assert side_by_side([image, image], 20).shape == (15, 44, 3)
    assert evenly(3, 5) == [0, 1, 2]
    assert evenly(100, 3) == [0, 50, 99]
