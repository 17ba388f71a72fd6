"""How many of the suggested grasps show their contact, and how their labels are mixed.

    python -m validation.objects.visible_grasps --out OUT [--sample N] WHAT …

collects N grasps of each with each of the shipped sensors, and writes ``OUT/visible.md``. WHAT is
an object with its own ranges, a recipe, or a mesh, MESH:KG[:SCALE], which is imported as a stranger
would, with SCALE mm to its unit. A grasp shows
its contact where ``VISIBLE.contact_share`` of the picture of the pad that carries the sensor, at
the moment of grasp, differs visibly from that at rest.
"""

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import yaml

from tacgen.collection.grid import plan_recipe
from tacgen.collection.pipeline import GraspPipeline, tactile_pad
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.core.resources import object_folders
from tacgen.core.sensors import SensorChoice
from tacgen.objects.add import MeshFacts, add_object
from tacgen.objects.showing import SENSORS
from tacgen.optics.visible import VISIBLE, visible_share

HEADER = ("object", "sensor", "grasps", "executed", "visible", "successes")


@dataclass(frozen=True)
class Row:
    """What became of the grasps of one object with one sensor."""

    name: str
    sensor: str
    grasps: int
    executed: int
    visible: int
    successes: int

    def cells(self) -> tuple[str, ...]:
        """The row of a table; shares are of the executed grasps."""
        shares = [
            f"{100 * n / max(self.executed, 1):.0f} %" for n in (self.visible, self.successes)
        ]
        return (self.name, self.sensor, str(self.grasps), str(self.executed), *shares)


def measured(recipe: Recipe) -> Iterator[Row]:
    """A row an object of a recipe."""
    at_rest = tactile_pad(recipe).at_rest_rgb
    pad = recipe.physics_settings.sensing_pads[0]
    with GraspPipeline(recipe) as pipeline:
        samples = [(planned, pipeline.sample(planned)) for planned in plan_recipe(recipe)]
    for entry in recipe.objects:
        own = [sample for planned, sample in samples if planned.config.object == entry.object_name]
        done = [sample for sample in own if sample.status == "executed"]
        pictures = [sample.pads[pad].rgb[sample.grasp_frame] for sample in done]
        shares = [visible_share(rgb, at_rest) for rgb in pictures]
        visible = sum(share >= VISIBLE.contact_share for share in shares)
        successes = sum(sample.label == 1 for sample in done)
        yield Row(entry.object_name, recipe.sensor.name, len(own), len(done), visible, successes)


def recipe_of(what: str, sample: int, sensor: str) -> Recipe:
    """The recipe of an object or of that name, with that sensor; in the current folder."""
    if what in object_folders():
        path = Path(f"{what}.yaml")
        sections = {"name": what, "seed": 3, "objects": [what], "grid": {"sample": sample}}
        path.write_text(
            yaml.safe_dump({**sections, "frames": {"mode": "single"}}), encoding="utf-8"
        )
        what = str(path)
    return load_recipe(what).model_copy(update={"sensor": SensorChoice(name=sensor)})


def imported(mesh: str, kg: str, scale: str = "1") -> str:
    """The name of the object that a mesh becomes."""
    return add_object(Path(mesh), MeshFacts(float(kg), scale=float(scale)), force=True).object.name


def main() -> None:
    """Print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sample", type=int, default=16)
    parser.add_argument("--sensors", default=",".join(SENSORS))
    parser.add_argument("what", nargs="+", metavar="WHAT")
    arguments = parser.parse_args()
    what = [
        os.path.abspath(one) if os.path.exists(one.split(":")[0]) else one for one in arguments.what
    ]
    arguments.out.mkdir(parents=True, exist_ok=True)
    os.chdir(arguments.out)
    rows = list[Row]()
    for one in what:
        name = imported(*one.split(":")) if ":" in one else one
        for sensor in arguments.sensors.split(","):
            for row in measured(recipe_of(name, arguments.sample, sensor)):
                rows.append(row)
                print(*row.cells(), sep="  ", flush=True)  # noqa: T201
    for sensor in arguments.sensors.split(","):
        own = [row for row in rows if row.sensor == sensor]
        totals = [sum(getattr(row, key) for row in own) for key in HEADER[2:]]
        rows.append(Row("all", sensor, *totals))
    lines = [" | ".join(HEADER), "|".join(["---"] * len(HEADER))]
    lines += [" | ".join(row.cells()) for row in rows]
    text = "\n".join(f"| {line} |" for line in lines)
    Path("visible.md").write_text(text + "\n", encoding="utf-8")
    print(text)  # noqa: T201


if __name__ == "__main__":
    main()
