"""Plain solids that ``object.yaml`` names by ``shape.builder`` instead of a mesh file."""

from collections.abc import Mapping

import numpy as np
import trimesh
from trimesh import creation

from tacgen.core.records import Mesh
from tacgen.objects.meshes import hull, rounded_mesh

FACET_MM = 0.5  # a gel hardly shows narrower facets
COLLISION_SECTIONS = 18  # around a part; PyBullet's time a step grows with a part's vertices


def build_solid(name: str, dimensions_mm: Mapping[str, float]) -> tuple[Mesh, Mesh]:
    """Surface and convex collision part of a solid, standing on the table at the origin."""
    around = np.pi * dimensions_mm.get("diameter_mm", 0.0)
    fine = max(int(np.ceil(around / FACET_MM)), COLLISION_SECTIONS)
    surface = _solid(name, dimensions_mm, fine)
    return (
        rounded_mesh(surface.vertices, surface.faces),
        hull(_solid(name, dimensions_mm, COLLISION_SECTIONS).vertices),
    )


def _solid(name: str, dimensions_mm: Mapping[str, float], sections: int) -> trimesh.Trimesh:
    made: trimesh.Trimesh
    if name == "box":
        made = creation.box([dimensions_mm[key] for key in ("x_mm", "y_mm", "z_mm")])
    elif name == "cylinder":
        radius_mm = dimensions_mm["diameter_mm"] / 2
        made = creation.cylinder(radius_mm, dimensions_mm["height_mm"], sections=sections)
    elif name == "sphere":
        radius_mm = dimensions_mm["diameter_mm"] / 2
        made = creation.uv_sphere(radius_mm, count=[sections // 2 + 1, sections])
    else:
        msg = f"no solid is named {name!r}"
        raise ValueError(msg)
    made.apply_translation([0.0, 0.0, -made.bounds[0, 2]])
    return made
