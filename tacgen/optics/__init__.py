"""From the deformed gel to the image that a vision-based tactile sensor takes."""

from tacgen.optics.deform import deform
from tacgen.optics.render import render_rgb
from tacgen.optics.table import LookupTable, load_table, save_table

__all__ = ["LookupTable", "deform", "load_table", "render_rgb", "save_table"]
