"""Import folders of meshes as a stranger would, and execute the grasps that are suggested.

    python -m validation.objects.public_meshes --out OUT NAME=FOLDER[:PATTERN][@SCALE] …

writes ``OUT/table.md`` and the picture of each imported object. Each collection is a folder with
mesh files (those of PATTERN, such as ``**/*.urdf``), one unit of which is SCALE mm; without a scale
the largest extent becomes 100 mm. An object weighs 0.5 g for each cm³ of its convex hull; each
place is tried with the least and the largest suggested force.
"""

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh

from tacgen.core.errors import ObjectError
from tacgen.core.records import GraspConfig, GraspObject
from tacgen.objects.add import MeshFacts, add_object
from tacgen.objects.mesh_import import FORMATS
from tacgen.objects.picture import write_picture
from tacgen.objects.urdf import read_urdf
from tacgen.physics import FrameRequest, GraspSimulator, PhysicsSettings, run_grasp

G_CM3, LARGEST_MM = 0.5, 100.0
LIFT_MM = 20.0  # whether a grasp is executed is known before


@dataclass(frozen=True)
class Row:
    """What became of one mesh; ``reason`` is the refusal, or the notes."""

    collection: str
    mesh: str
    triangles: int
    imported: bool
    cpu_s: float
    executed: int = 0
    suggested: int = 0
    parts: int = 0
    reason: str = ""


def size_of(path: Path) -> tuple[int, float, float]:
    """Triangles, the largest extent and the hull's volume, in the file's unit."""
    if path.suffix == ".urdf":
        mesh, _ = read_urdf(path, lambda part: trimesh.load_mesh(part, process=False))
    else:
        mesh = trimesh.load_mesh(path, process=False)
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    flat = np.ptp(mesh.vertices, axis=0).min() <= 0
    return len(mesh.faces), extent, 0.0 if flat else float(mesh.convex_hull.volume)


def executed(simulator: GraspSimulator, obj: GraspObject) -> tuple[int, int]:
    """How many of the suggested grasps are executed, and of how many."""
    settings = PhysicsSettings(
        engine=simulator.engine, lift_mm=LIFT_MM, success_rise_mm=LIFT_MM / 2
    )
    ranges, done, tried = obj.grasp_ranges, 0, 0
    forces = {min(ranges["force_n"]), max(ranges["force_n"])}
    places = [(y, z) for y in ranges["y_mm"] for z in ranges["z_mm"]]
    for force_n in sorted(forces):
        for y_mm, z_mm in places:
            config = GraspConfig(tried, obj.name, force_n, ranges["x_mm"][0], y_mm, z_mm)
            trace = run_grasp(simulator, obj, config, settings, frames=FrameRequest())
            done, tried = done + (trace.label >= 0), tried + 1
    return done, tried


def rows(name: str, folder: Path, pattern: str, scale: float | None, out: Path) -> Iterator[Row]:
    """One a mesh of a collection."""
    with GraspSimulator() as simulator:
        for path in sorted(p for p in folder.glob(pattern) if p.suffix.lower()[1:] in FORMATS):
            label, start = str(path.relative_to(folder)), time.process_time()
            triangles, extent, volume = size_of(path)
            mm = scale or LARGEST_MM / extent
            key = f"{name}_{label}".replace("/", "_").replace(".", "_").replace(" ", "_")[:64]
            try:
                added = add_object(
                    path,
                    MeshFacts(max(G_CM3 * volume * mm**3 / 1e6, 0.001), scale=mm, name=key),
                    into=out / "objects",
                    force=True,
                )
            except ObjectError as error:
                cpu_s = time.process_time() - start
                reason = str(error).replace(str(path), label)
                yield Row(name, label, triangles, False, cpu_s, reason=reason)
                continue
            cpu_s = time.process_time() - start
            write_picture(added.object, out / f"{key}.png", added.toppled_from)
            yield Row(
                name,
                label,
                triangles,
                True,
                cpu_s,
                *executed(simulator, added.object),
                parts=len(added.object.collision),
                reason=" · ".join(added.notes),
            )


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("collections", nargs="+", metavar="NAME=FOLDER[:PATTERN][@SCALE]")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    lines = ["| collection | mesh | triangles | CPU s | executed | parts | notes or refusal |"]
    lines.append("|---|---|---|---|---|---|---|")
    found = []
    for collection in arguments.collections:
        name, _, place = collection.partition("=")
        place, _, scale = place.partition("@")
        folder, _, pattern = place.partition(":")
        mm = float(scale) if scale else None
        for row in rows(name, Path(folder), pattern or "**/*", mm, arguments.out):
            found.append(row)
            result = f"{row.executed}/{row.suggested}" if row.imported else "refused"
            lines.append(
                f"| {row.collection} | {row.mesh} | {row.triangles} | {row.cpu_s:.1f} | {result} | "
                f"{row.parts or ''} | {row.reason} |"
            )
            print(json.dumps(asdict(row), ensure_ascii=False), flush=True)  # noqa: T201
    taken = [row for row in found if row.imported]
    share = sum(row.executed for row in taken) / max(sum(row.suggested for row in taken), 1)
    lines.append(
        f"\n{len(taken)} of {len(found)} imported; {100 * share:.0f} % of their suggested grasps "
        "executed"
    )
    (arguments.out / "table.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(lines[-1])  # noqa: T201


if __name__ == "__main__":
    main()
