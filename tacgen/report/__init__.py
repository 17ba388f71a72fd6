"""Self-contained HTML reports in one style."""

from tacgen.report.page import (
    Section,
    facts_section,
    figure_section,
    image_section,
    pictures_section,
    table_section,
    text_section,
    write_page,
)

__all__ = [
    "Section",
    "facts_section",
    "figure_section",
    "image_section",
    "pictures_section",
    "table_section",
    "text_section",
    "write_page",
]
