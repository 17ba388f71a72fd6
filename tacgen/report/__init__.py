"""Self-contained HTML reports in one style."""

from tacgen.report.page import (
    Section,
    figure_section,
    image_section,
    table_section,
    text_section,
    write_page,
)

__all__ = [
    "Section",
    "figure_section",
    "image_section",
    "table_section",
    "text_section",
    "write_page",
]
