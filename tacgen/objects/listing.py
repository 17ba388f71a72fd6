"""What `tacgen objects list` and `tacgen objects show` say."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tacgen.core.errors import ObjectError
from tacgen.core.records import GraspObject
from tacgen.core.resources import object_folders, packaged
from tacgen.objects.description import ObjectDescription, read_description
from tacgen.objects.meshes import volume_mm3

COLUMNS = ("name", "mass_g", "size_mm", "friction", "force_n", "from", "description")
FIGURES = ("mass_kg", "center_of_mass_mm", "dimensions_mm", "friction", "spinning_friction_mm")


def object_rows() -> list[dict[str, Any]]:
    """One row an object; one that cannot be read has a ``problem`` in place of its figures."""
    rows = []
    shipped = packaged("objects").resolve()
    for name, folder in object_folders().items():
        origin = "tacgen" if folder.resolve().parent == shipped else str(folder)
        row: dict[str, Any] = {"name": name, "from": origin}
        try:
            found = read_description(folder)
        except ObjectError as error:
            rows.append(row | {"problem": str(error)})
            continue
        forces_n = found.grasp_ranges.force_n
        row |= {
            "mass_kg": found.mass_kg.value,
            "dimensions_mm": list(found.dimensions_mm.value),
            "friction": found.friction.value,
            "force_n": [min(forces_n), max(forces_n)],
            "description": found.description,
        }
        rows.append(row)
    return rows


def rows_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as a table for a terminal."""
    table = [COLUMNS]
    for row in rows:
        figures = ["–"] * 4
        if "problem" not in row:
            size = " × ".join(f"{extent:.3g}" for extent in row["dimensions_mm"])
            forces_n = "{:g}…{:g}".format(*row["force_n"])
            figures = [f"{1000 * row['mass_kg']:g}", size, f"{row['friction']:g}", forces_n]
        text = row.get("problem") or row["description"]
        table.append((row["name"], *figures, row["from"], text))
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    widths[-1] = 0
    lines = ["  ".join(map(str.ljust, line, widths)) for line in table]
    return "\n".join(line.rstrip() for line in lines)


def object_facts(obj: GraspObject, description: ObjectDescription) -> dict[str, Any]:
    """Every figure of an object with its source, and what was built from it."""
    facts: dict[str, Any] = {
        "name": obj.name,
        "description": description.description,
        "folder": str(obj.folder),
    }
    for key in FIGURES:
        if (stated := getattr(description, key)) is None:
            continue
        value = list(stated.value) if isinstance(stated.value, tuple) else stated.value
        facts[key] = {"value": value, "source": stated.source}
    given = description.inertia_kg_mm2
    facts["inertia_kg_mm2"] = {
        "value": [[round(float(value), 4) + 0.0 for value in row] for row in obj.inertia_kg_mm2],
        "source": given.source if given else "of the shape below, evenly filled with the mass",
    }
    facts["shape"] = {
        "value": description.shape.builder or description.shape.mesh,
        "source": description.shape.source,
    }
    facts["built"] = {
        "triangles": len(obj.surface.faces),
        "size_mm": [round(float(v), 2) for v in np.ptp(obj.surface.vertices_mm, axis=0)],
        "volume_mm3": round(volume_mm3(obj.surface), 1),
        "convex_parts": len(obj.collision),
    }
    ranges = {axis: list(values) for axis, values in obj.grasp_ranges.items()}
    facts["grasp_ranges"] = {"value": ranges, "source": description.grasp_ranges.source}
    return facts


def facts_text(facts: Mapping[str, Any]) -> str:
    """The facts for a terminal: one figure a line, its source below it."""
    lines = [f"{facts['name']}: {facts['description']}", f"  in {facts['folder']}"]
    for key, fact in facts.items():
        if not isinstance(fact, dict):
            continue
        value = fact.get("value", {k: v for k, v in fact.items() if k != "source"})
        if isinstance(value, dict):
            lines.append(f"  {key}")
            lines += [f"      {name}: {content}" for name, content in value.items()]
        else:
            lines.append(f"  {key}: {value}")
        if "source" in fact:
            lines.append(f"      ← {fact['source']}")
    return "\n".join(lines)
