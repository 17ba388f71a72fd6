"""A page that shows one grasp of a dataset: frames, depth with its scale, forces over time."""

from pathlib import Path

from tacgen.core.errors import DatasetError
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import GraspSample
from tacgen.report.figures import new_figure
from tacgen.report.page import Section, facts_section, figure_section, pictures_section, write_page


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
    config = sample.config
    facts = [
        ("outcome", outcome),
        ("force_n", config.force_n),
        ("x_mm, y_mm, z_mm", f"{config.x_mm:g}, {config.y_mm:g}, {config.z_mm:g}"),
        ("moment of grasp", f"frame {sample.grasp_frame}, {sample.grasp_time_s:.2f} s"),
        ("lift", f"{sample.lift_start_time_s:.2f} to {sample.lift_end_time_s:.2f} s"),
        ("split", sample.split),
    ]
    sections = [facts_section("Grasp", facts)]
    if sample.picture is not None:
        sections.append(pictures_section("Scene", [("simulated", sample.picture)]))
    times_s = [float(t) for t in dataset.times_s(index)]
    for pad, frames in sample.pads.items():
        shown = [(f"{t:.2f} s", rgb) for t, rgb in zip(times_s, frames.rgb, strict=True)]
        sections.append(pictures_section(f"Simulated images of the {pad} pad", shown))
    if sample.pads:
        sections += [_forces(sample, times_s), *_depths(sample)]
    title = f"Grasp {index} of {root.name}: {config.object}"
    write_page(path, title, sections, summary=f"{config.object}: {outcome}")


def _forces(sample: GraspSample, times_s: list[float]) -> Section:
    figure, grid = new_figure(7.5, 3.0)
    axes = grid[0, 0]
    for pad, frames in sample.pads.items():
        axes.plot(times_s, frames.force_normal_n, "o-", ms=3, label=f"{pad}, normal")
        for k, axis in enumerate("xy"):
            axes.plot(times_s, frames.force_shear_n[:, k], ".--", label=f"{pad}, shear {axis}")
    axes.set_xlabel("time, s")
    axes.set_ylabel("force on the gel, N")
    axes.legend(fontsize=8, frameon=False)
    return figure_section("Forces", figure)


def _depths(sample: GraspSample) -> list[Section]:
    sections = []
    for pad, frames in sample.pads.items():
        if frames.depth_mm is not None:
            figure, grid = new_figure(5.0, 3.4)
            shown = grid[0, 0].imshow(frames.depth_mm.astype(float), vmin=0.0, cmap="viridis")
            figure.colorbar(shown, label="indentation, mm")
            sections.append(figure_section(f"Depth at the moment of grasp, {pad} pad", figure))
    return sections
