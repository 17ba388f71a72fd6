"""From a posed object and a force to the deformation of the gel."""

from tacgen.contact.gap import gap_map as gap_map
from tacgen.contact.gel import gel_map_mm as gel_map_mm
from tacgen.contact.indentation import contact_depth as contact_depth
from tacgen.contact.indentation import solve_indentation as solve_indentation
from tacgen.contact.law import ContactLaw as ContactLaw
from tacgen.contact.law import load_law as load_law
from tacgen.contact.law import save_law as save_law
