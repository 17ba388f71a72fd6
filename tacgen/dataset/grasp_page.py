"""A page that shows one grasp of a dataset: frames, depth with its scale, forces over time."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import GraspSample, PadSample
from tacgen.report.figures import new_figure
from tacgen.report.page import write_page


def write_grasp_page(root: Path, index: int, path: Path) -> None:
    """Write the page of the grasp of an index in the recipe's grid.

    Raises ``DatasetError`` if the dataset has no such grasp.
    """
    dataset = Dataset(root, partial=True)
    known = dataset.indices
    if index not in known:
        msg = f"{root}: no grasp {index}; it has {known[0]} to {known[-1]}"
        raise DatasetError(msg)
    sample = dataset.read(index)
    outcome = "success" if sample.label == 1 else sample.failure_mode or sample.status
    times_s = [float(t) for t in dataset.times_s(index)]
    times = [f"{t:.2f} s" for t in times_s]
    depths = {pad: frames.depth_mm for pad, frames in sample.pads.items()}
    write_page(
        path,
        f"Grasp {index} of {root.name}: {sample.config.object}",
        summary=f"{sample.config.object}: {outcome}",
        template="grasp.html",
        grasp=sample,
        outcome=outcome,
        images={pad: _captioned(times, frames) for pad, frames in sample.pads.items()},
        forces=_forces(sample, times_s) if sample.pads else None,
        depths={pad: _depth(depth) for pad, depth in depths.items() if depth is not None},
    )


def _captioned(times: list[str], frames: PadSample) -> list[tuple[str, NDArray[np.uint8]]]:
    """Each image with its time, and with what it does not show."""
    captions = [", ".join([time, *frames.flags(k)]) for k, time in enumerate(times)]
    return list(zip(captions, frames.rgb, strict=True))


def _forces(sample: GraspSample, times_s: list[float]) -> Figure:
    figure, grid = new_figure(7.5, 3.0)
    axes = grid[0, 0]
    for pad, frames in sample.pads.items():
        axes.plot(times_s, frames.force_normal_n, "o-", ms=3, label=f"{pad}, normal")
        for k, axis in enumerate("xy"):
            axes.plot(times_s, frames.force_shear_n[:, k], ".--", label=f"{pad}, shear {axis}")
    axes.set(xlabel="time, s", ylabel="force on the gel, N")
    axes.legend(fontsize=8, frameon=False)
    return figure


def _depth(depth_mm: NDArray[np.floating]) -> Figure:
    figure, grid = new_figure(5.0, 3.4)
    shown = grid[0, 0].imshow(depth_mm.astype(float), vmin=0.0, cmap="viridis")
    figure.colorbar(shown, label="indentation, mm")
    return figure
