"""The meshes of the shipped objects: surfaces with the detail that a gel feels.

``python -m scripts.make_objects`` writes ``objects/<name>/surface.npz`` and ``collision.npz``
again and prints the inertia that ``object.yaml`` gives for an object of several materials.
"""

from __future__ import annotations

import sys

from scripts.make_objects.all_objects import OBJECTS, inertia_kg_mm2
from tacgen.core.resources import packaged
from tacgen.objects.load import write_meshes


def main() -> None:
    """Make every object again."""
    for name, build in OBJECTS.items():
        shape, folder = build(), packaged("objects") / name
        write_meshes(folder / "surface.npz", [shape.surface])
        write_meshes(folder / "collision.npz", shape.collision)
        if shape.bodies:
            inertia = inertia_kg_mm2(name, shape).tolist()
            sys.stdout.write(f"{name}: inertia_kg_mm2 {inertia}\n")


if __name__ == "__main__":
    main()
