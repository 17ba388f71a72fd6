"""One self-contained HTML page out of sections of text, tables, figures and images."""

from __future__ import annotations

import base64
import functools
import io
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from tacgen.core.files import page_mark, refuse_other_page, write_text
from tacgen.core.progress import print_status
from tacgen.report.formatting import (
    estimate,
    fixed,
    interval,
    number,
    p_value,
    percent,
    typeset,
    unit_text,
    with_error,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from tacgen.core.images import Image

FIGURE_DPI = 110  # sharp at the page's width on common screens
_COLUMN_WIDTHS = ((2.0, "240px"), (4.5, "470px"), (math.inf, "100%"))
"""Least width of a column of pictures whose width over height is below a limit."""
_NUMBER_TEXT = re.compile(r"[-+−]?\d+(\.\d+)?(·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?( %)?|–")


@dataclass(frozen=True, slots=True)
class PageSection:
    """A heading and its content as HTML."""

    title: str
    body: Markup

    def __html__(self) -> str:
        return Markup("<section>\n<h2>{}</h2>\n{}\n</section>").format(self.title, self.body)


def text_section(title: str, *paragraphs: str) -> PageSection:
    """Plain paragraphs; markup in them is shown, not interpreted."""
    return _section(title, "paragraphs", [typeset(text) for text in paragraphs])


def table_section(
    title: str, header: Sequence[str], rows: Sequence[Sequence[object]], note: str = ""
) -> PageSection:
    """A table; a column's floats have as many decimals, columns of numbers align right."""
    columns = [_column([row[k] for row in rows]) for k in range(len(header))]
    cells = [[column[place] for column in columns] for place in range(len(rows))]
    heads = [
        (typeset(name), bool(rows) and all(numeric for _, numeric in column))
        for name, column in zip(header, columns, strict=True)
    ]
    return _section(title, "table", heads, cells, typeset(note))


def facts_section(title: str, facts: Iterable[tuple[str, object]], note: str = "") -> PageSection:
    """Names with their values, one pair a line."""
    pairs = [(typeset(name), _column([value])[0][0]) for name, value in facts]
    return _section(title, "facts", pairs, typeset(note))


def figure_section(title: str, figure: Figure, note: str = "") -> PageSection:
    """A matplotlib figure as an embedded PNG."""
    width_px = round(figure.get_figwidth() * 96)
    return _section(title, "image", figure_uri(figure), title, width_px, typeset(note))


def figure_uri(figure: Figure) -> str:
    """A matplotlib figure as a PNG data URI."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer = io.BytesIO()
    figure.set_dpi(FIGURE_DPI)
    # `savefig` would draw twice.
    FigureCanvasAgg(figure).print_png(buffer)  # type: ignore[no-untyped-call]
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"


def pictures_section(title: str, items: Iterable[tuple[str, Image]], note: str = "") -> PageSection:
    """Captions with their RGB images, in as many columns as their shapes leave room for."""
    from tacgen.core.images import jpeg_uri  # OpenCV: pages without pictures do without it

    shown = list(items)
    aspect = max((rgb.shape[1] / rgb.shape[0] for _, rgb in shown), default=1.0)
    column = next(width for limit, width in _COLUMN_WIDTHS if aspect < limit)
    captioned = [(typeset(caption), jpeg_uri(rgb)) for caption, rgb in shown]
    return _section(title, "pictures", captioned, column, typeset(note))


def write_page(
    path: Path,
    title: str,
    sections: Sequence[PageSection] = (),
    *,
    summary: str = "",
    template: str = "page.html",
    made_by: str = "",
    **values: Any,
) -> None:
    """Write the page to ``path``, whole or not at all, and print its path; it needs no network.

    ``summary`` is the result in a sentence or two; a ``verdict`` among the ``values`` colours it:
    ``sufficient`` and ``unexplained`` stand out. A ``template`` that extends ``page.html`` makes
    its own sections of them. ``made_by`` is the command; what it did not make is kept: the command
    asks ``refuse_other_page`` itself before it computes.

    Raises ``TacgenError`` if ``path`` is there, and not of this command.
    """
    refuse_other_page(path, made_by)
    page = templates().get_template(template)
    mark = Markup(page_mark(made_by))
    head = {"title": title, "summary": typeset(summary), "mark": mark}
    write_text(path, page.render(**head, sections=sections, **values))
    print_status(f"page: {path}")


@functools.cache
def templates(package: str = "tacgen.report", *, escaped: bool = True) -> Environment:
    """The templates of a package; HTML ones escape what is put into them."""
    found = Environment(
        loader=PackageLoader(package),
        autoescape=escaped,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
    )
    shown = (estimate, fixed, interval, number, p_value, percent, unit_text, with_error)
    found.filters |= {function.__name__: function for function in shown}
    parts = (facts_section, figure_section, pictures_section, table_section, text_section)
    found.globals |= {function.__name__.removesuffix("_section"): function for function in parts}
    return found


def _section(title: str, macro: str, *arguments: Any) -> PageSection:
    macros: Any = templates().get_template("macros.html").module
    return PageSection(typeset(title), Markup(getattr(macros, macro)(*arguments)))


def _column(values: Sequence[object]) -> list[tuple[str, bool]]:
    """Text of each value, and whether it is a number."""
    floats = [float(v) for v in values if isinstance(v, (float, np.floating)) and math.isfinite(v)]
    decimals = _shared_decimals(floats)
    return [_cell(value, decimals) for value in values]


def _shared_decimals(values: Sequence[float]) -> int | None:
    """Decimals that show four digits of the largest value, without zeros that all end in."""
    largest = max((abs(value) for value in values), default=0.0)
    power = math.floor(math.log10(largest)) if largest > 0 else 0
    if not -4 <= power < 6:
        return None
    decimals = max(0, 3 - power)
    while decimals and all(fixed(value, decimals).endswith("0") for value in values):
        decimals -= 1
    return decimals


def _cell(value: object, decimals: int | None) -> tuple[str, bool]:
    if isinstance(value, (float, np.floating)):
        return number(float(value)) if decimals is None else fixed(float(value), decimals), True
    text = typeset(str(value))
    is_whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return text, is_whole or _NUMBER_TEXT.fullmatch(text) is not None
