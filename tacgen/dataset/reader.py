"""Reading a dataset: lazily, one grasp at a time, without pickle."""

from __future__ import annotations

import contextlib
import math
import os
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError, RecipeError, require_known
from tacgen.core.files import sha256_of
from tacgen.core.records import Camera, GraspConfig, SlipMargin, Until
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.manifest import ShardLine, manifest_problems, read_manifest, total
from tacgen.dataset.samples import (
    CameraSample,
    GraspSample,
    PadSample,
    frame_times_s,
    rgb_at_load,
)
from tacgen.dataset.schema import COLUMNS, FRAME_FIELDS, TOUCH, TOUCH_FIELDS, Field, Layout
from tacgen.dataset.shard import Shard, broken_as_error, open_shard, read_image

if TYPE_CHECKING:
    from tacgen.dataset.torch_dataset import TorchGrasps

WORLD = ("robot", "physics", "contact", "optics", "randomize")
"""Sections of a recipe that say what its simulated grasps and pictures are like."""
TIME_DIGITS = 3  # of a frame's time in s that count
ROUNDING_S = 1e-6  # by which a frame at the start of the lift may seem later
_MAX_OPEN = 8  # shards kept open; far below any limit on open files


class Dataset:
    """The grasps of a folder that ``tacgen collect`` made; ``partial``: of its finished shards.

    ``lines`` is the manifest, in the order of the shards, ``pads`` the tactile pads, ``sensor`` the
    sensor's name, ``n_frames`` the tactile frames of a grasp.
    Grasps are named by their index in the recipe's grid: ``indices`` lists those there are. Each
    shard is hashed once before it is first opened, so damage is reported rather than trained on;
    not with ``check_hashes=False``.
    The object can be pickled and used after a fork; every process opens files of its own.

    Raises ``DatasetError`` if there is no dataset, it is not complete (unless ``partial``), or
    shards of different recipes, calibrations or sensors are mixed.

    Examples
    --------
    >>> dataset = tacgen.Dataset("data")
    >>> grasp = dataset[0]
    >>> grasp["rgb"].shape, grasp["label"]
    ((1, 240, 320, 3), 1)
    >>> [float(item["force_n"]) for item in dataset[0:2]]
    [5.0, 30.0]
    """

    def __init__(
        self, root: Path | str, *, partial: bool = False, check_hashes: bool = True
    ) -> None:
        self.root = Path(root)
        self._check_hashes = check_hashes
        self.lines: tuple[ShardLine, ...] = tuple(read_manifest(self.root).values())
        folder = DatasetFolder(self.root)
        is_planned = not partial and folder.plan_path.is_file()
        n_grasps = folder.plan()["n_grasps"] if is_planned else None
        problems = manifest_problems(self.lines, n_grasps)
        if not self.lines:
            problems = ["no finished shard there; `tacgen collect --out` makes a dataset"]
        DatasetError.raise_if([f"{self.root}: {text}" for text in problems])
        self.pads, self.sensor = self.lines[0].pads, self.lines[0].sensor
        self.n_frames = self.lines[0].frames
        self._starts = [line.index_range[0] for line in self.lines]
        self._pid = os.getpid()
        self._open: OrderedDict[int, Shard] = OrderedDict()
        self._checked: set[int] = set()

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_open": OrderedDict(), "_pid": -1}

    def __len__(self) -> int:
        return sum(line.n_grasps for line in self.lines)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[place] for place in range(len(self)))

    def __repr__(self) -> str:
        counts = total(self.lines, "counts").items()
        outcomes = ", ".join(f"{count} {name}" for name, count in counts if count)
        height, width = self.shape_px
        return (
            f"Dataset({str(self.root)!r}: {len(self)} grasps ({outcomes}), {self.n_frames} frames "
            f"of {width}×{height} px from {self.sensor} on {', '.join(self.pads)})"
        )

    @overload
    def __getitem__(self, place: int) -> dict[str, Any]: ...

    @overload
    def __getitem__(self, place: slice) -> list[dict[str, Any]]: ...

    def __getitem__(self, place: int | slice) -> dict[str, Any] | list[dict[str, Any]]:
        """The grasp at a place of ``indices`` as plain values, or a list of them for a slice.

        ``rgb`` (T, H, W, 3) uint8 of the first pad, where there are two also ``rgb_left`` and
        ``rgb_right``; so too ``depth_mm``, ``markers_mm`` and ``force_field_n`` where the dataset
        has them (see ``touch``), ``camera/<name>/rgb``, ``…/depth_mm`` and ``…/segmentation`` of
        each camera (see ``view``), and every entry of ``columns``: ``label`` (1, 0, or -1 where it
        was not executed), ``object``, ``force_n``, ``x_mm`` …
        """
        indices = self.indices
        if isinstance(place, slice):
            return [self[k] for k in range(*place.indices(len(indices)))]
        index = int(indices[place])
        item: dict[str, Any] = {}
        for name in ("rgb", *self.touch_names):
            item[name] = self._of_pad(index, name, self.pads[0])
            if len(self.pads) > 1:
                item |= {f"{name}_{pad}": self._of_pad(index, name, pad) for pad in self.pads[1:]}
                item[f"{name}_{self.pads[0]}"] = item[name]
        return item | {name: self.view(index, name) for name in self.views} | self._row(index)

    def torch(
        self,
        split: Literal["train", "test"] | None = None,
        frames: Literal["grasp", "pair", "sequence"] = "grasp",
        pad: str | None = None,
        channels: Sequence[str] | None = None,
        transform: Callable[[Any], Any] | None = None,
    ) -> TorchGrasps:
        """The executed grasps for ``torch.utils.data.DataLoader``: (images, label) pairs.

        ``split`` is one side of the recipe's split, both by default. ``frames`` is the frame of the
        moment of ``grasp``, (3, H, W), a ``pair``, (6, H, W), or all, (T, 3, H, W); float32 in
        [0, 1]. The pair is that frame and the one before, each as (image − gel at rest)/255 + 0.5:
        what the encoders of Sparsh take (Higuera et al. 2024, arXiv 2410.24090; theirs are 80 ms
        apart, 320 px high and 240 wide: turn and resize in ``transform``). Of two pads both are
        given, stacked in front in the order of ``pads``: (2, 3, H, W), (2, 6, H, W) or
        (2, T, 3, H, W), of a camera the frame of the grasp;
        ``pad`` chooses one. With ``channels``, some of ``rgb``, ``depth_mm``, ``markers_mm`` and
        ``force_field_n`` and of ``views``, a sample is a dictionary of them and of ``label``: a
        camera's ``rgb`` as above, its segmentation int64, the others float32 as ``touch`` gives
        them. ``transform`` is applied to the images, or to the
        dictionary.
        """
        from tacgen.dataset.torch_dataset import TorchGrasps

        pads = self.pads if pad is None else (self._pad(pad),)
        return TorchGrasps(self, split, frames, pads, channels, transform)

    @property
    def indices(self) -> NDArray[np.int64]:
        """Index of every grasp there is, ascending."""
        return np.concatenate([np.arange(*line.index_range) for line in self.lines])

    @property
    def robot(self) -> str | None:
        """Name of the robot that grasped, where ``recipe.yaml`` says it."""
        with contextlib.suppress(RecipeError):
            robot = DatasetFolder(self.root).recipe().get("robot")
            return str(robot["name"]) if isinstance(robot, dict) and "name" in robot else None
        return None

    @property
    def inputs(self) -> dict[str, str]:
        """The hash of each input that the grasps depend on, by role (``input_hashes.py``)."""
        return {role: digest for line in self.lines for role, digest in line.inputs.items()}

    def taken_with(self, pad: str | None = None) -> dict[str, Any]:
        """What the images of a pad depend on beside the grasps, as plain data.

        ``sensor`` (name), ``sensor_sha256`` (of its description), ``table`` (hash), ``pad``,
        ``markers``, ``shadows``, ``time_s``, the frames' times, ``until``, where they end, and
        ``world``, what the recipe says of the simulation and its objects; None where it is not
        known.
        """
        recipe: dict[str, Any] = {}
        with contextlib.suppress(RecipeError):
            recipe = DatasetFolder(self.root).recipe()
        optics = recipe.get("optics") or {}
        return {
            "world": {name: recipe[name] for name in WORLD if name in recipe} | _objects_of(recipe),
            "sensor": self.sensor,
            "sensor_sha256": self.inputs.get("sensor"),
            "table": self.inputs.get("table"),
            "pad": self._pad(pad),
            "markers": optics.get("markers"),
            "shadows": optics.get("shadows"),
            "time_s": np.round(self.time_s, TIME_DIGITS).tolist(),
            "until": self.until,
        }

    @property
    def layout(self) -> Layout:
        """Where each array stands in the shards."""
        return self._shard(0).layout

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Times of the frames, (T,)."""
        return self._read(self._starts[0], "/time_s", whole=True)

    def times_s(self, index: int) -> NDArray[np.float64]:
        """When the frames of a grasp were taken, (T,): one of them at its moment of grasp."""
        names = ("grasp_frame", "grasp_time_s", "lift_start_time_s")
        frame, grasp_s, lift_s = (self._read(index, f"/grasp/{name}").item() for name in names)
        last_s = lift_s if self.until == "lift" else math.nan
        return frame_times_s(self.time_s, frame, grasp_s, last_s)

    @property
    def until(self) -> Until:
        """Where the frames of a grasp end: at the start of the lift, or when it is over."""
        return self._shard(0).until

    def lift_frames(self, columns: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
        """The last frame before the lift of the grasps of ``columns``, (N,); −1 where unknown."""
        start_s = columns["lift_start_time_s"]
        if self.until == "lift":
            return np.full(len(start_s), self.n_frames - 1)
        last = np.searchsorted(self.time_s, start_s + ROUNDING_S, side="right") - 1
        return np.where(np.isnan(start_s), -1, np.maximum(last, columns["grasp_frame"]))

    @property
    def shape_px(self) -> tuple[int, int]:
        """Height and width of the tactile images."""
        height, width, _ = self.reference().shape
        return height, width

    def columns(
        self,
        shards: Sequence[int] | None = None,
        *,
        contact: bool = False,
        pad: str | None = None,
    ) -> dict[str, NDArray[Any]]:
        """What is known of each grasp, by name, (N, …), in the order of ``indices``.

        ``shards`` limits it to those places in ``lines``; ``contact`` adds what the contact arrays
        of a ``pad``, the first by default, hold, (N, T) or (N, T, 2).
        """
        pad = self._pad(pad)
        parts: dict[str, list[NDArray[Any]]] = {}
        for place in range(len(self.lines)) if shards is None else shards:
            layout = self._shard(place).layout
            for field in (*COLUMNS, *(FRAME_FIELDS if contact else ())):
                path = layout.path(field, pad)
                values = self._read(self._starts[place], path, whole=True)
                parts.setdefault(field.name, []).append(_as_text(values))
        return {name: np.concatenate(values) for name, values in parts.items()}

    def rgb(
        self, index: int, pad: str | None = None, frame: int | None = None
    ) -> NDArray[np.uint8]:
        """Tactile images of a grasp, (T, H, W, 3), or one ``frame`` of them, (H, W, 3).

        They have the camera's noise, the same whenever they are read.
        """
        pad = self._pad(pad)
        if frame is None:
            return np.stack([self.rgb(index, pad, frame) for frame in range(self.n_frames)])
        shard = self._shard(self._place(index))
        rgb = self._image(index, shard.layout.tactile(pad, "rgb"), frame)
        seed = int(self._read(index, "/grasp/seed"))
        return rgb_at_load(rgb, shard.noise_at_load_grey, seed, pad, frame)

    @property
    def touch_names(self) -> tuple[str, ...]:
        """What the dataset keeps of the touch beside the images; see ``touch``."""
        return tuple(field.name for field in self.layout.fields if field in TOUCH_FIELDS)

    def touch(
        self, index: int, name: str, pad: str | None = None, frame: int | None = None
    ) -> NDArray[Any]:
        """``depth_mm``, ``markers_mm`` or ``force_field_n`` of a grasp's frames, or of one.

        (T, H, W) float16, or (H, W) of the moment of grasp where only that is kept; (T, M, 2)
        float32, from ``marker_rest_mm`` on; (T, rows, columns, 3) float32: shear x, shear y,
        normal.

        Raises ``DatasetError`` if the dataset does not keep it.
        """
        require_known("the touch's name", name, TOUCH, DatasetError)
        pad, layout = self._pad(pad), self._layout(index)
        field = layout.find(name)
        moment = None if field is None or field.is_of_frames else frame
        if moment is not None and moment == int(self._read(index, "/grasp/grasp_frame")):
            frame = moment = None
        if field is None or moment is not None:
            ways = [f.recipe for f in TOUCH_FIELDS if f.name == name]
            what = f"no {name}" if field is None else f"{name} of the moment of grasp alone"
            msg = f"{self.root}: has {what}; collect it with `dataset: {{{ways[-1]}}}`"
            raise DatasetError(msg)
        return self._frames(index, field, layout.path(field, pad), frame)

    @property
    def cameras(self) -> Mapping[str, Camera]:
        """The cameras that look at the scene, by name: size, intrinsics and pose of each."""
        return self._shard(0).cameras

    @property
    def views(self) -> tuple[str, ...]:
        """What the cameras give: ``camera/<name>/rgb``, ``…/depth_mm``, ``…/segmentation``."""
        layout = self.layout
        return tuple(f.known_as(name) for name in layout.cameras for f in layout.of_cameras)

    def view(self, index: int, name: str, frame: int | None = None) -> NDArray[Any]:
        """One of ``views`` of a grasp's frames, or of one ``frame``.

        ``rgb`` (T, h, w, 3) uint8, ``depth_mm`` (T, h, w) float32 along the camera's axis (0: there
        is nothing), ``segmentation`` (T, h, w) uint8, numbers of ``schema.SEGMENTS``; without the
        first axis where only the moment of grasp is kept.

        Raises ``DatasetError`` if the dataset does not keep it.
        """
        layout = self._layout(index)
        named = {f.known_as(c): (f, c) for c in layout.cameras for f in layout.of_cameras}
        if name not in named:
            there = f"it has {', '.join(named)}" if named else "it has no cameras"
            how = "collect it with `scene: {cameras: …}`"
            msg = f"{self.root}: no {name!r} in this dataset; {there}; {how}"
            raise DatasetError(msg)
        field, camera = named[name]
        if not field.is_of_frames and frame is not None:
            if frame != int(self._read(index, "/grasp/grasp_frame")):
                how = "collect it with `scene: {frames: all}`"
                msg = f"{self.root}: has {name} of the moment of grasp alone; {how}"
                raise DatasetError(msg)
            frame = None
        return self._frames(index, field, layout.path(field, camera), frame)

    def marker_rest_mm(self, pad: str | None = None) -> NDArray[np.float64]:
        """Places (M, 2) of the markers on a gel at rest, x and y of the gel frame.

        Raises ``DatasetError`` if the dataset does not keep how far they move.
        """
        self.touch(self._starts[0], "markers_mm", pad, 0)  # which says so
        return self._shard(0).rest_mm[self.layout.tactile(self._pad(pad), "markers_mm")]

    @property
    def mm_per_px(self) -> float:
        """Size of a pixel of the tactile images on the gel."""
        return self._shard(0).mm_per_px

    def reference(self, pad: str | None = None) -> NDArray[np.uint8]:
        """The image of the undeformed gel, (H, W, 3)."""
        shard = self._shard(0)
        with broken_as_error(shard.path):
            return read_image(shard.arrays[shard.layout.tactile(self._pad(pad), "reference")], ())

    def picture(self, index: int) -> NDArray[np.uint8] | None:
        """The scene from outside, (h, w, 3), if there are pictures."""
        has_pictures = "/scene/picture" in self._shard(self._place(index)).arrays
        return self._image(index, "/scene/picture") if has_pictures else None

    def read(self, index: int) -> GraspSample:
        """Everything there is about one grasp."""
        row = self._row(index)
        sample = {field.attribute: row[field.name] for field in COLUMNS}
        layout = self._layout(index)
        pads: dict[str, dict[str, Any]] = {pad: {} for pad in self.pads}
        cameras: dict[str, dict[str, Any]] = {name: {} for name in layout.cameras}
        for one in layout.placed():
            field, path = one.field, one.path
            if field.group != "grasp" and field.of != "spec" and not field.noisy:
                value = self._frames(index, field, path) if field.image else self._read(index, path)
                of = {"pad": pads, "camera": cameras}.get(field.of, {})
                of.get(one.owner, sample)[field.attribute] = value
        parts = {
            part: {name.partition(".")[2]: sample.pop(name) for name in names}
            for part in ("config", "margin")
            if (names := [name for name in sample if name.startswith(f"{part}.")])
        }
        limits = [parts["margin"][name] for name in ("translational", "rotational")]
        is_executed = sample["status"] == "executed"
        return GraspSample(
            config=GraspConfig(**parts["config"]),
            pads={
                pad: PadSample(rgb=self.rgb(index, pad), **values)
                for pad, values in pads.items()
                if is_executed
            },
            cameras={n: CameraSample(**values) for n, values in cameras.items() if is_executed},
            margin=None if np.isnan(limits).all() else SlipMargin(**parts["margin"]),
            **sample,
        )

    def close(self) -> None:
        """Close the files; they open again when they are needed."""
        while self._open:
            self._open.popitem()[1].close()

    def _row(self, index: int) -> dict[str, Any]:
        """The columns of one grasp as plain values, its directions as arrays."""
        layout = self._layout(index)
        return {field.name: _plain(self._read(index, layout.path(field))) for field in COLUMNS}

    def _pad(self, pad: str | None) -> str:
        if pad is None:
            return self.pads[0]
        if pad not in self.pads:
            msg = f"{self.root}: no {pad!r} pad in this dataset; it has {', '.join(self.pads)}"
            raise DatasetError(msg)
        return pad

    def _layout(self, index: int) -> Layout:
        return self._shard(self._place(index)).layout

    def _of_pad(self, index: int, name: str, pad: str) -> NDArray[Any]:
        return self.rgb(index, pad) if name == "rgb" else self.touch(index, name, pad)

    def _frames(
        self, index: int, field: Field, path: str, frame: int | None = None
    ) -> NDArray[Any]:
        """What an image array holds of a grasp: of each frame, or of the one there is."""
        if not field.is_of_frames:
            return self._image(index, path)
        frames = range(self.n_frames) if frame is None else (frame,)
        found = [self._image(index, path, k) for k in frames]
        return found[0] if frame is not None else np.stack(found)

    def _image(self, index: int, path: str, *then: int) -> NDArray[Any]:
        place = self._place(index)
        shard = self._shard(place)
        with broken_as_error(shard.path):
            return read_image(shard.arrays[path], (index - self._starts[place], *then))

    def _read(self, index: int, path: str, *, whole: bool = False) -> NDArray[Any]:
        """The array at ``path`` of a grasp's shard: the ``whole``, or the grasp's row of it."""
        place = self._place(index)
        shard = self._shard(place)
        with broken_as_error(shard.path):
            return shard.read(path) if whole else shard.arrays[path][index - self._starts[place]]

    def _place(self, index: int) -> int:
        place = bisect_right(self._starts, index) - 1
        if place < 0 or index >= self.lines[place].index_range[1]:
            msg = f"{self.root}: no grasp {index} in this dataset"
            raise DatasetError(msg)
        return place

    def _shard(self, place: int) -> Shard:
        if self._pid != os.getpid():
            # Files of the parent process are the parent's to close.
            self._open, self._pid = OrderedDict(), os.getpid()
        if place in self._open:
            self._open.move_to_end(place)
            return self._open[place]
        line = self.lines[place]
        path = self.root / line.file
        if self._check_hashes and place not in self._checked and path.is_file():
            if sha256_of(path) != line.sha256:
                msg = f"{path}: is not what was written; `tacgen collect --repair` remakes it"
                raise DatasetError(msg)
            self._checked.add(place)
        self._open[place] = open_shard(path)
        if len(self._open) > _MAX_OPEN:
            self._open.popitem(last=False)[1].close()
        return self._open[place]


def _plain(value: Any) -> Any:
    """A number or a text as Python has it; an array as it is."""
    value = _as_text(np.asarray(value))
    return value if value.ndim else value.item()


def _as_text(values: NDArray[Any]) -> NDArray[Any]:
    is_text = values.dtype.kind == "S"
    return np.char.decode(values, "utf-8", errors="replace") if is_text else values


def _objects_of(recipe: Mapping[str, Any]) -> dict[str, Any]:
    """What a resolved recipe says of its objects themselves, by name."""
    listed = [one for one in recipe.get("objects") or () if isinstance(one, Mapping)]
    found = {
        one.get("dataset_name") or str(one.get("name")): {
            key: value for key, value in one.items() if key not in ("name", "dataset_name", "grid")
        }
        for one in listed
    }
    return {"objects": found} if found else {}
