"""What tells the outcome of an object's grasps, and what does not.

``python -m validation.learning.why_missed DATA…`` takes datasets of sequences that show the outcome
(``frames: {until: outcome}``) and prints of each object how many failed grasps end with something
between the pads and how far it turned, how often "something is held at the end" is right, how often
"the imprint is that of the grasp" (``same_imprint_rule``), and the accuracy of trees that see the
force alone, and force and place. No network is trained.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tacgen.core.records import LABEL_NOT_EXECUTED
from tacgen.learning.controls import same_imprint_rule
from tacgen.learning.grasps import SimulatedGrasps
from tacgen.learning.network_input import InputSpec
from tacgen.learning.parameter_baseline import forest

SIZE_PX = (54, 72)  # of the networks of paper_table
SEEN_GREY = (
    5.0  # above the noise of a pixel, the largest change from the gel at rest shows a contact
)


def of_object(source: SimulatedGrasps, name: str) -> str:
    """A line on the grasps of one object."""
    table, own = source.table, np.flatnonzero(source.table.objects == name)
    columns = source.dataset.columns()
    turn_rad = columns["turn_rad"][columns["label"] != LABEL_NOT_EXECUTED][own]
    rest = source.reference.astype(float)
    last = [source.frames(int(row), [source.n_frames - 1])[0] - rest for row in own]
    held = np.array([np.abs(change).max() > SEEN_GREY for change in last])
    label, tests = table.label[own], table.split[own] == "test"
    stayed = (label == 0) & held
    turned = np.rad2deg(turn_rad[stayed])
    far = f"by {turned.min():.0f} to {turned.max():.0f} deg" if stayed.any() else ""
    spec = InputSpec("sequence", SIZE_PX, source.n_frames, "raw", source.shape_px)
    rule = same_imprint_rule(source, {name: (own, spec)})["accuracy"]
    known = table.commanded()[own]
    trees = [
        (forest().fit(known[~tests][:, :n], label[~tests]).predict(known[tests][:, :n]), n)
        for n in (1, 4)
    ]
    right = [f"{(found == label[tests]).mean():.3f}" for found, _ in trees]
    return (
        f"{name}: {len(own)} grasps, {(label == 0).sum()} failed, {stayed.sum()} of them held and "
        f"turned {far}; held at the end is right of {(held == label).mean():.3f}, same imprint of "
        f"{rule:.3f}; trees on force {right[0]}, on force and place {right[1]} of {tests.sum()}"
    )


def main() -> None:
    """Print a line for each object."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, nargs="+")
    for data in parser.parse_args().data:
        source = SimulatedGrasps(data)
        for name in source.table.object_names():
            print(of_object(source, name))  # noqa: T201


if __name__ == "__main__":
    main()
