"""One self-contained HTML page out of sections of text, tables, figures and images."""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from tacgen.core.errors import TacgenError
from tacgen.core.files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_NUMBER = ' class="number"'
_FIGURE = re.compile(r"[-+−]?\d+(\.\d+)?|–")


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands under it; ``body`` is HTML that is safe to embed."""

    title: str
    body: str


def text_section(title: str, *paragraphs: str) -> Section:
    """Plain paragraphs; markup in them is shown, not interpreted."""
    return Section(title, "".join(f"<p>{html.escape(text)}</p>" for text in paragraphs))


def table_section(
    title: str, header: Sequence[str], rows: Sequence[Sequence[object]], note: str = ""
) -> Section:
    """A table; columns of numbers align right, their headings too."""
    numeric = [all(_is_number(row[k]) for row in rows) and bool(rows) for k in range(len(header))]
    head = "".join(
        f"<th{_NUMBER if number else ''}>{html.escape(name)}</th>"
        for name, number in zip(header, numeric, strict=True)
    )
    body = "".join("<tr>" + "".join(_cell(value) for value in row) + "</tr>" for row in rows)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return Section(title, table + _note(note))


def figure_section(title: str, figure: Figure, note: str = "") -> Section:
    """A matplotlib figure as an embedded PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, bbox_inches="tight")
    return Section(title, _img(buffer.getvalue(), title) + _note(note))


def image_section(title: str, rgb: np.ndarray, note: str = "", *, width_px: int = 0) -> Section:
    """An RGB uint8 image (H, W, 3) as an embedded PNG, shown ``width_px`` wide (0: as it is)."""
    return Section(title, _img(encode_png(rgb), title, width_px) + _note(note))


def encode_png(rgb: np.ndarray) -> bytes:
    """The bytes of an RGB uint8 image (H, W, 3) as PNG."""
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
    if not done:
        msg = f"an image of shape {rgb.shape} and type {rgb.dtype} cannot be encoded as PNG"
        raise TacgenError(msg)
    return encoded.tobytes()


def write_page(path: Path, title: str, sections: Sequence[Section], *, summary: str = "") -> None:
    """Write the page to ``path``, whole or not at all; it needs no network."""
    environment = Environment(
        loader=PackageLoader("tacgen.report"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.get_template("page.html")
    safe = [(section.title, Markup(section.body)) for section in sections]
    write_text(path, template.render(title=title, summary=summary, sections=safe))


def _cell(value: object) -> str:
    text = f"{value:.4g}" if isinstance(value, (float, np.floating)) else str(value)
    return f"<td{_NUMBER if _is_number(value) else ''}>{html.escape(text)}</td>"


def _is_number(value: object) -> bool:
    """Whether it is a number, or the text of one."""
    if isinstance(value, (int, float, np.integer, np.floating)):
        return not isinstance(value, bool)
    return isinstance(value, str) and _FIGURE.fullmatch(value) is not None


def _img(png: bytes, alt: str, width_px: int = 0) -> str:
    width = f' width="{width_px}"' if width_px else ""
    data = base64.b64encode(png).decode()
    return f'<img alt="{html.escape(alt)}"{width} src="data:image/png;base64,{data}">'


def _note(note: str) -> str:
    return f'<p class="note">{html.escape(note)}</p>' if note else ""
