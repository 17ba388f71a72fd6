"""Write docs/results/cost.md: ``python -m validation.cost``, on a machine with nothing else to do.

Runs ``tacgen bench`` and, for the cost of a grasp, ``validation.cluster.cost``'s measurement, some
minutes in all. What was measured beside other simulators needs their code, and stays as it is.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tacgen.collection.recipe import Recipe, load_recipe
from validation.cluster.cost import cost_of

PAGE = Path(__file__).parents[1] / "docs" / "results" / "cost.md"
PEERS = "## Beside other simulators", "## One grasp"
REPEATS = 200
RECIPE = "stability"
WAYS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("1 frame", {"frames": {"mode": "single"}}),
    ("8 frames", {"frames": {"mode": "sequence", "count": 8}}),
    ("24 frames", {"frames": {"mode": "sequence", "count": 24}}),
    (
        "24 frames with `optics: {noise: at_load}`",
        {"frames": {"mode": "sequence", "count": 24}, "optics": {"noise": "at_load"}},
    ),
)
"""What a grasp of the recipe records, and the sections that say so."""

OF_A_MILLION = "8 frames"
WORKERS = (
    "Start-up takes 1.7 s, and 0.4 s for each worker. Two workers on two cores are 1.9 to 2.2 "
    "times as fast as one\n(`python -m validation.cluster.workers RECIPE 1 2 8`, 800 grasps, "
    "commit 9846041, 2026-11-26)."
)
"""Measured by the command that it names, which needs an idle machine."""

NAMES = {
    "frame_ms_640x480": "frame 640 × 480, ms",
    "frame_shadow_ms_640x480": "with shadows, ms",
    "frame_ms_320x240": "frame 320 × 240, ms",
    "gap_map_ms": "gap map 640 × 480 by itself, ms",
    "solve_ms": "V → δ by itself, ms",
    "batch_64_meshes_ms_320x240": "frame of a batch of 64 worlds, 320 × 240, both cores, ms",
    "batch_64_meshes_ms_640x480": "frame of a batch of 64 worlds, 640 × 480, both cores, ms",
    "grasp_s_single": "grasp with 1 picture, s",
    "grasp_s_sequence": "grasp with 24 pictures, s",
    "read_ms_320x240": "reading a picture of 320 × 240, ms",
    "read_ms_640x480": "reading a picture of 640 × 480, ms",
    "calibrate_lookup_s": "a table of 50 simulated pictures, fitted and scored, both cores, s",
    "diagnose_contact_s": "a diagnosis of a simulated log of 24 presses, s",
}


def commit() -> str:
    """The commit that is measured, and the day."""
    command = ["git", "-C", str(PAGE.parent), "rev-parse", "--short=7", "HEAD"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return f"commit {done.stdout.strip()}, {time.strftime('%Y-%m-%d')}"


def figures() -> dict[str, float]:
    """What ``tacgen bench`` finds."""
    command = [sys.executable, "-m", "tacgen", "bench", "--repeats", str(REPEATS), "--json"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout)
    return found


def grasp_rows() -> Iterator[str]:
    """A row for each way to record the grasps."""
    yield "| | simulate and render | write | size | raw |"
    yield "|---|---:|---:|---:|---:|"
    asked = load_recipe(RECIPE).model_dump(exclude_unset=True, mode="json")
    million = ""
    for name, sections in WAYS:
        cost = cost_of(Recipe.model_validate(asked | sections))
        megabytes = (cost[key] / 1e6 for key in ("bytes", "raw_bytes"))
        sizes = " | ".join(f"{size:.2f} MB" for size in megabytes)
        yield f"| {name} | {cost['grasp_s']:.3f} s | {cost['write_s']:.3f} s | {sizes} |"
        if name == OF_A_MILLION:
            hours = 1e6 * (cost["grasp_s"] + cost["write_s"]) / 3600
            million = (
                f"A million grasps of {name} need {hours:.0f} core hours and "
                f"{cost['bytes'] / 1e6:.1f} TB. "
            )
    yield ""
    yield million + WORKERS


def main() -> None:
    """Measure, and write the page."""
    first, last = PEERS
    peers = first + PAGE.read_text(encoding="utf-8").split(first)[1].split(last)[0]
    found, grasps = figures(), list(grasp_rows())
    lines = [
        "# Speed, size and cost",
        "",
        "Measured on two virtual cores of an AMD EPYC server without a GPU, unless stated "
        "otherwise; all but the comparison with other simulators by `python -m validation.cost`. "
        "`tacgen bench` measures your machine.",
        "",
        "## One of each",
        "",
        f"Medians of {REPEATS} on one thread, the last two once (`tacgen bench --repeats {REPEATS}`"
        f", {commit()}):",
        "",
        "| | |",
        "|---|---:|",
        *(f"| {what} | {found[name]:.3g} |" for name, what in NAMES.items()),
        "",
        peers + last,
        "",
        f"A hundred grasps of `{RECIPE}`, GelSight 640 × 480, one pad, seconds of one core "
        f"({commit()}):",
        "",
        *grasps,
    ]
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
