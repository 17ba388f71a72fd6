"""From a posed object and a force to the deformation of the gel."""

from tacgen.contact.gap import gap_map
from tacgen.contact.gel import gel_map_mm
from tacgen.contact.indentation import contact_depth, solve_indentation
from tacgen.contact.law import ContactLaw, load_law, save_law

__all__ = [
    "ContactLaw",
    "contact_depth",
    "gap_map",
    "gel_map_mm",
    "load_law",
    "save_law",
    "solve_indentation",
]
