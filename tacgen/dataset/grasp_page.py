"""A page that shows one grasp of a dataset: a player of its frames, forces over time, depth."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError
from tacgen.core.images import evenly, jpeg_uri, no_wider
from tacgen.dataset import overlays
from tacgen.dataset.overlays import camera_panel
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import CameraSample, GraspSample, PadSample
from tacgen.report.figures import new_figure
from tacgen.report.page import figure_uri, write_page

MAX_FRAMES, IMAGE_WIDTH_PX = 120, 480
MAX_PLAYER_BYTES = 12_000_000  # of the frames; of a grasp with more fewer are shown
MAX_CELLS = 4096  # of a force field that is drawn: finer ones hide the image


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
    depths = {pad: _moment_depth(frames, sample) for pad, frames in sample.pads.items()}
    write_page(
        path,
        f"Grasp {index} of {root.name}: {sample.config.object}",
        summary=f"{sample.config.object}: {outcome}",
        template="grasp.html",
        made_by="view",
        grasp=sample,
        outcome=outcome,
        player=_player(dataset, sample) if sample.pads else None,
        stills=[
            (f"camera {name}: colours, depth, segments", camera_panel(*_views(seen)))
            for name, seen in sample.cameras.items()
            if seen.rgb.ndim == 3
        ],
        depths={pad: _depth(depth) for pad, depth in depths.items() if depth is not None},
    )


def _player(dataset: Dataset, sample: GraspSample) -> dict[str, Any]:
    """What the player of the page shows, by the names that its template uses."""
    times_s = [float(t) for t in dataset.times_s(sample.config.index)]
    curves, spots, (bottom, top) = _forces(sample, times_s)
    height, width = dataset.shape_px
    pads = [_Overlays(dataset, name, frames) for name, frames in sample.pads.items()]
    room_mm = pads[0].spacing_mm
    gain = overlays.gain_of(max(pad.largest_mm for pad in pads), room_mm)
    largest_n = max(pad.largest_n for pad in pads)
    shown = evenly(len(times_s), MAX_FRAMES)
    cameras = {name: seen for name, seen in sample.cameras.items() if seen.rgb.ndim == 4}
    names = [f"{pad.name} pad" for pad in pads] + [f"camera {name}" for name in cameras]
    dots = [pad.dots for pad in pads] + [""] * len(cameras)
    while True:
        drawn = [[pad.frame(k, times_s[k], gain, largest_n) for k in shown] for pad in pads]
        drawn += [[_camera_frame(seen, k) for k in shown] for seen in cameras.values()]
        n_bytes = sum(len(text) for frames in drawn for one in frames for text in one.values())
        if n_bytes <= MAX_PLAYER_BYTES or len(shown) == 1:
            break
        shown = [shown[k] for k in evenly(len(shown), max(1, len(shown) // 2))]
    moment = int(np.abs(np.array(shown) - sample.grasp_frame).argmin())
    return {
        "pads": [
            {"name": name, "dots": dots_of, "frames": frames, "is_camera": name[:6] == "camera"}
            for name, dots_of, frames in zip(names, dots, drawn, strict=True)
        ],
        "frames": [
            {
                "text": f"frame {k} of 0 to {len(times_s) - 1}, {times_s[k]:.2f} s"
                + (", the moment of grasp" if k == sample.grasp_frame else ""),
                "at": round(spots[k], 5),
            }
            for k in shown
        ],
        "first": moment,
        "n_frames": len(times_s),
        "has_field": any(pad.field_n is not None for pad in pads),
        "gain": gain,
        "largest_n": largest_n,
        "width_px": width,
        "height_px": height,
        "curves": curves,
        "top": round(100 * (1 - top), 3),
        "bottom": round(100 * bottom, 3),
    }


class _Overlays:
    """The frames of one pad with what is drawn over them."""

    def __init__(self, dataset: Dataset, name: str, frames: PadSample) -> None:
        self.name, self._frames = name, frames
        self._shape_px, self._mm_per_px = dataset.shape_px, dataset.mm_per_px
        self._moved_mm = frames.markers_mm
        self.dots, self.spacing_mm, self.largest_mm, self.largest_n = "", 1.0, 0.0, 0.0
        if self._moved_mm is not None:
            rest_mm = dataset.marker_rest_mm(name)
            self._rest_px = overlays.to_pixels(rest_mm, self._mm_per_px, self._shape_px)
            self.dots = overlays.dots_path(self._rest_px)
            self.spacing_mm = overlays.spacing_mm(rest_mm)
            self.largest_mm = float(np.linalg.norm(self._moved_mm, axis=-1).max())
        self.field_n = frames.force_field_n
        if self.field_n is not None and np.prod(self.field_n.shape[1:3]) > MAX_CELLS:
            self.field_n = None
        if self.field_n is not None:
            self.largest_n = float(np.abs(self.field_n).max())

    def frame(self, k: int, time_s: float, gain: float, largest_n: float) -> dict[str, str]:
        """Image, text and paths of a frame."""
        frames = self._frames
        shear_x, shear_y = np.round(frames.force_shear_n[k], 2) + 0.0  # no "-0.00"
        force = (
            f"{frames.force_normal_n[k]:.2f} N into the gel, shear {shear_x:+.2f}, {shear_y:+.2f} N"
        )
        found = {
            "image": jpeg_uri(no_wider(frames.rgb[k], IMAGE_WIDTH_PX)),
            "text": "; ".join([", ".join([f"{time_s:.2f} s", *frames.flags(k)]), force]),
        }
        if self._moved_mm is not None:
            steps_px = gain * self._moved_mm[k] / self._mm_per_px
            found["moved"] = overlays.arrows_path(self._rest_px, steps_px)
        if self.field_n is not None:
            paths = overlays.field_paths(self.field_n[k], largest_n, self._shape_px)
            found |= zip(("normal", "shear"), paths, strict=True)
        return found


def _views(seen: CameraSample) -> tuple[Any, Any, Any]:
    return seen.rgb, seen.depth_mm, seen.segmentation


def _camera_frame(seen: CameraSample, k: int) -> dict[str, str]:
    """Image and text of a camera's frame."""
    panel = camera_panel(*(one[k] for one in _views(seen)))
    return {"image": jpeg_uri(panel), "text": "colours, depth, segments"}


def _forces(
    sample: GraspSample, times_s: list[float]
) -> tuple[str, list[float], tuple[float, float]]:
    """The curves as a data URI; where times are along its width, and the axes along its height."""
    figure, grid = new_figure(7.5, 3.0)
    axes = grid[0, 0]
    for pad, frames in sample.pads.items():
        axes.plot(times_s, frames.force_normal_n, "o-", ms=3, label=f"{pad}, normal")
        for k, axis in enumerate("xy"):
            axes.plot(times_s, frames.force_shear_n[:, k], ".--", label=f"{pad}, shear {axis}")
    axes.set(xlabel="time, s", ylabel="force on the gel, N")
    axes.legend(fontsize=8, frameon=False)
    uri = figure_uri(figure)  # which places the axes
    places = axes.transData.transform([(time_s, 0.0) for time_s in times_s])
    box = axes.get_position()
    return uri, (places[:, 0] / figure.bbox.width).tolist(), (box.y0, box.y1)


def _moment_depth(frames: PadSample, sample: GraspSample) -> NDArray[np.floating] | None:
    depth_mm = frames.depth_mm
    return depth_mm if depth_mm is None or depth_mm.ndim == 2 else depth_mm[sample.grasp_frame]


def _depth(depth_mm: NDArray[np.floating]) -> Figure:
    figure, grid = new_figure(5.0, 3.4)
    shown = grid[0, 0].imshow(depth_mm.astype(float), vmin=0.0, cmap="viridis")
    figure.colorbar(shown, label="indentation, mm")
    return figure
