"""The report page: a table's numbers stand in line, under their headings."""

import re

from tacgen.report.page import table_section


def test_columns_of_numbers_align_with_their_headings_and_text_is_escaped():
    body = table_section("T", ("name", "share", "n"), [("<a>", "0.960", 7), ("b", "–", 12)]).body
    cells = re.findall(r"<t[hd]( class=\"number\")?>([^<]*)</t[hd]>", body)
    assert [(text, bool(number)) for number, text in cells] == [
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


def test_a_column_with_words_in_it_keeps_its_heading_to_the_left():
    body = table_section("T", ("AUROC",), [("one class",), (0.98,)]).body
    assert "<th>AUROC</th>" in body
    assert '<td class="number">0.98</td>' in body
