"""The gel of a recipe: its contact law, and the patch in which it presses on an object."""

import math
from dataclasses import replace

from tacgen.collection.recipe import Contact, Recipe
from tacgen.contact.gel_response import gel_loads
from tacgen.contact.indenter import Indenter
from tacgen.contact.law import USUAL_PITCH_MM, ContactLaw, load_law
from tacgen.core.records import ContactFrame, ContactPatch, Estimate, Mesh, Sensor
from tacgen.core.sensors import load_sensor

SETTLED_PRESS = 1_000_000
"""The number of a simulated grasp on its gel: the first presses, which differ, are long past."""


def contact_law(contact: Contact) -> ContactLaw:
    """The law that a recipe names: a calibrated file, or its own figures.

    Raises ``ContactError`` if the file is not a contact law.
    """
    if (path := contact.path()) is not None:
        return load_law(path)
    k_s = contact.k_s_mm_per_n or math.nan
    law = ContactLaw.linear(contact.k_n_mm3_per_n, k_s, USUAL_PITCH_MM)
    if contact.law == "linear_depth":
        k_depth = Estimate(contact.k_depth_mm_per_n, 0.0, "mm/N")
        law = replace(law, law="linear_depth", k_depth_mm_per_n=k_depth)
        return replace(law, collision_margin_mm=contact.collision_margin_mm)
    return law


def mounted_sensor(recipe: Recipe, *, needs_table: bool = True) -> Sensor:
    """The sensor of a recipe on its gripper: its gel, if nothing else is said, is the pad."""
    sensor = load_sensor(recipe.sensor, needs_table=needs_table)
    pad = recipe.physics_settings.sensing_pads[0]
    return recipe.robot.spec().gripper.carrying(sensor, pad)


def gel_patch(
    indenter: Indenter,
    law: ContactLaw,
    surface: Mesh,
    frame: ContactFrame,
    *,
    k_n_factor: float = 1.0,
) -> ContactPatch:
    """Where the gel presses on ``surface`` under the load of ``frame``, as its image shows it.

    Contacts that a collision margin loses are lost to the image alone.
    """
    law = replace(law, collision_margin_mm=0.0)
    (load,) = gel_loads(law, [frame], grasp_index=SETTLED_PRESS, k_n_factor=k_n_factor)
    return indenter.patch(surface, frame.pose_gel_object, load)
