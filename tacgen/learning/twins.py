"""Grasps that are one grasp under several names: where an axis of a grid changes nothing.

Fingers centre a round object, wherever it is asked for along their closing direction; a can is the
same all along its height. A test grasp
that differs from a training grasp in such an axis alone tells nothing new.
"""

import itertools
import zlib
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tacgen.core.images import evenly
from tacgen.core.records import AXES, LABEL_NOT_EXECUTED
from tacgen.learning.grasps import EqualRanges, GraspTable, SimulatedGrasps

MIN_PAIRS, MAX_PAIRS = 3, 10  # of grasps at two values of an axis; fewer tell nothing
EQUAL_SHARE = 0.9  # of the pairs: simulated contact is chaotic, and a few end otherwise
RELATIVE = (
    0.01  # of force, indentation and margin; the same grasp repeats to 0.001, asked elsewhere
)
BLOCK_PX = 8
NOISE_RATIO = 1.25
"""Largest root mean square of blocks' means over that of white noise: 1 ± 0.09 where images differ
in their noise alone, and 6 or more where a can is turned by half a turn."""
MIN_GREY = 0.1  # less is rounding of images without noise
_COMPARED = ("force_normal_n", "indentation_mm")


def equal_ranges(source: SimulatedGrasps) -> EqualRanges:
    """By object and axis the ranges in which the axis changes nothing that counts.

    That is the contact and the image at the moment of grasp, and the outcome: grasps that agree in
    all other axes are compared. Objects and axes without such a range are left out.
    """
    table, columns = source.table, source.dataset.columns(contact=True)
    executed = np.flatnonzero(columns["label"] != LABEL_NOT_EXECUTED)
    moment = np.maximum(table.grasp_frame, 0)
    margins = [columns[f"margin_{name}"][executed] for name in ("translational", "rotational")]
    contacts = [columns[name][executed, moment] for name in _COMPARED]
    figures = np.stack([table.label, *margins, *contacts], axis=1)
    found: dict[str, dict[str, list[tuple[float, float]]]] = {}
    for name, axis in itertools.product(table.object_names(), AXES):
        levels = list(_levels(table, name, axis).items())
        while levels:
            (low, rows), *others = levels
            alike = (_are_equal(source, figures, rows, other) for _, other in others)
            n_same = len(list(itertools.takewhile(bool, alike)))
            if n_same:
                found.setdefault(name, {}).setdefault(axis, []).append((low, others[n_same - 1][0]))
            levels = others[n_same:]
    return found


def one_sided(table: GraspTable, equal: EqualRanges) -> tuple[GraspTable, list[str]]:
    """The table with every group of equal grasps on one side of the split, and notes on it.

    Of each object as large a share of the groups is tested as there were test grasps, and at least
    one: those with the most test grasps.
    """
    keys, split = np.array(table.configurations(equal)), table.split.copy()
    for name in table.object_names():
        own = table.objects == name
        groups, tested = np.unique(keys[own]), set(keys[own & (split == "test")].tolist())
        mixed = tested & set(keys[own & (split == "train")].tolist())
        share = (split[own] == "test").mean()
        count = max(round(share * len(groups)), 1) - len(tested - mixed)
        n_tests = Counter(keys[own & (split == "test")].tolist())
        drawn = sorted(mixed, key=lambda key: (-n_tests[key], zlib.crc32(key.encode())))
        chosen = drawn[: max(count, 0)]
        split[np.isin(keys, list(mixed))] = "train"
        split[np.isin(keys, chosen)] = "test"
    notes = [
        f"{name}: {axis} from {low:g} to {high:g} changes neither contact, image nor outcome; "
        "grasps that differ in nothing else count as one"
        for name, axes in equal.items()
        for axis, ranges in axes.items()
        for low, high in ranges
    ]
    if moved := int((split != table.split).sum()):
        notes.append(f"{moved} grasps change sides: a training grasp is the same as a test grasp")
    return replace(table, split=split), notes


def equal_within_noise(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> bool:
    """Whether two images (H, W, 3) differ by noise without structure alone.

    Means over blocks of n pixels of white noise are √n smaller than its pixels.
    """
    difference = one.astype(np.float32) - other.astype(np.float32)
    height, width = (length // BLOCK_PX * BLOCK_PX for length in difference.shape[:2])
    blocks = difference[:height, :width].reshape(
        height // BLOCK_PX, BLOCK_PX, width // BLOCK_PX, BLOCK_PX, -1
    )
    structure = float(np.sqrt(np.square(blocks.mean(axis=(1, 3))).mean()))
    noise = float(np.sqrt(np.square(difference).mean())) / BLOCK_PX
    return structure <= max(NOISE_RATIO * noise, MIN_GREY)


def _levels(table: GraspTable, name: str, axis: str) -> dict[float, dict[str, int]]:
    """By value of an axis, ascending, the rows of an object's grasps by their other axes."""
    rows = np.flatnonzero(table.objects == name)
    k, found = AXES.index(axis), dict[float, dict[str, int]]()
    for row, text in zip(rows.tolist(), table.take(rows).configurations(), strict=True):
        _, *values = text.rsplit(" ", len(AXES))
        found.setdefault(float(values.pop(k)), {})[" ".join(values)] = row
    return dict(sorted(found.items()))


def _are_equal(
    source: SimulatedGrasps,
    figures: NDArray[np.float64],
    rows: Mapping[str, int],
    others: Mapping[str, int],
) -> bool:
    """Whether grasps of two values of an axis are equal; first their ``figures`` (N, n)."""
    pairs = [(row, others[key]) for key, row in rows.items() if key in others]
    if len(pairs) < MIN_PAIRS:
        return False
    pairs = [pairs[k] for k in evenly(len(pairs), MAX_PAIRS)]
    different = 0
    for one, other in pairs:
        same = np.allclose(figures[one], figures[other], RELATIVE, RELATIVE, equal_nan=True)
        if not (same and equal_within_noise(_image(source, one), _image(source, other))):
            different += 1
        if different > (1 - EQUAL_SHARE) * len(pairs):
            return False
    return True


def _image(source: SimulatedGrasps, row: int) -> NDArray[np.uint8]:
    image: NDArray[np.uint8] = source.frames(row, [max(int(source.table.grasp_frame[row]), 0)])[0]
    return image
