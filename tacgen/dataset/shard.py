"""Opening a shard that somebody else may have made: nothing in it is believed before it is checked.

HDF5 holds no code, but a file can name other files, ask for plugins, or claim sizes that exhaust
the memory. Such a file is refused before any array is read; the limits are stated here. The
checks use h5py's low-level interface, which takes a tenth of the time.
"""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5s, h5t
from numpy.typing import NDArray

from tacgen.core.errors import DatasetError
from tacgen.core.files import require_readable
from tacgen.core.records import PADS, Camera, Until
from tacgen.core.resources import newer_problem
from tacgen.dataset.compression import ALLOWED_FILTERS, ends_of, is_sound
from tacgen.dataset.schema import (
    CAMERAS,
    FIELDS,
    FORMAT_VERSION,
    FRAMES_UNTIL,
    MAX_CAMERAS,
    MAX_CELLS,
    NOISE_AT_LOAD,
    REST,
    T_WORLD_CAMERA,
    K,
    Layout,
    Placed,
)

MAX_GRASPS, MAX_FRAMES, MAX_SIDE_PX = 1_000_000, 10_000, 8192
MAX_TEXT_BYTES = 256  # of a name or status; more is damage
# What h5py raises on a file that is damaged, truncated or not one at all.
_BROKEN = (OSError, RuntimeError, KeyError, ValueError, TypeError, UnicodeError, MemoryError)


@dataclass(frozen=True, slots=True)
class Shard:
    """An open shard whose structure is what the schema says.

    ``arrays`` maps the paths of ``layout`` to what stands there, ``rest_mm`` (M, 2) those of arrays
    that say how far something is from its place at rest to those places, ``cameras`` the names of
    cameras to what is known of them.
    """

    path: Path
    file: h5py.File
    layout: Layout
    arrays: Mapping[str, h5py.Dataset]
    index_range: tuple[int, int]
    recipe_sha256: str
    noise_at_load_grey: float
    until: Until
    mm_per_px: float
    rest_mm: Mapping[str, NDArray[np.float64]]
    cameras: Mapping[str, Camera]

    def read(self, path: str) -> NDArray[Any]:
        """The whole of a small array."""
        dataset = self.arrays[path]
        stored = dataset.id.get_type()
        values = np.empty(dataset.id.shape, stored.dtype)
        dataset.id.read(h5s.ALL, h5s.ALL, values, stored)
        return values

    def small_arrays(self) -> dict[str, NDArray[Any]]:
        """All arrays but images, by path."""
        placed = self.layout.placed()
        return {one.path: self.read(one.path) for one in placed if not one.field.image}

    def close(self) -> None:
        """Close the file."""
        self.file.close()


@contextlib.contextmanager
def broken_as_error(path: Path) -> Iterator[None]:
    """Turn what h5py raises on a damaged file into one ``DatasetError``."""
    try:
        yield
    except _BROKEN as error:
        reason = str(error).strip("'\"") or type(error).__name__
        msg = f"{path}: cannot be read as a shard ({reason}); `tacgen collect --repair` remakes it"
        raise DatasetError(msg) from error


def open_shard(path: Path) -> Shard:
    """Open a shard for reading once its structure is what the schema says.

    Raises ``DatasetError``, naming every array that is missing or otherwise than the schema says,
    or what is forbidden in it.
    """
    if not path.is_file():
        msg = f"{path}: the shard is missing; `tacgen collect` remakes it"
        raise DatasetError(msg)
    require_readable(path, DatasetError)
    with broken_as_error(path):
        file = h5py.File(path, "r")
        try:
            return _checked(path, file)
        except BaseException:
            file.close()
            raise


def read_image(dataset: h5py.Dataset, place: tuple[int, ...]) -> NDArray[Any]:
    """One image of an image array: the one at ``place``, its leading indices; zeros if unwritten.

    What is compressed has a header of its own, with a size of its own: one that lies would have
    the codec take any amount of memory, so it is read first. Raises ``ValueError`` if it is not
    that of an image of this size.
    """
    is_image_sound(dataset, place)
    return np.asarray(dataset[place])


def is_image_sound(dataset: h5py.Dataset, place: tuple[int, ...]) -> bool:
    """Look at the image at ``place`` without decompressing it; False if it was never written.

    Raises ``ValueError`` if its header is not that of an image of this size.
    """
    ends = ends_of(dataset, place)
    if ends is not None and not is_sound(dataset, ends):
        msg = f"the image {place} of {dataset.name} is damaged"
        raise ValueError(msg)
    return ends is not None


def _checked(path: Path, file: h5py.File) -> Shard:
    layout = _layout_of(path, file)
    span = _attribute(file, "index_range", "i", (2,))
    start, stop = (0, -1) if span is None else map(int, span)
    sizes = _sizes_of(path, file, layout, start, stop)
    found = {array.path: _array_at(file, array.path) for array in layout.placed()}
    problems = [
        text
        for array in layout.placed()
        for text in _array_problems(found[array.path], array, array.resolve(sizes))
    ]
    noise_grey = 0.0
    if h5a.exists(file.id, NOISE_AT_LOAD.encode()):
        stored = _attribute(file, NOISE_AT_LOAD, "f", ())
        noise_grey = np.nan if stored is None else float(stored)
        if not 0 < noise_grey < np.inf:
            problems.append(f"{NOISE_AT_LOAD} is not a standard deviation")
    rest_mm: dict[str, NDArray[np.float64]] = {}
    for one in layout.placed():
        place, array = one.path, found[one.path]
        if one.field.rest and array is not None:
            stored = _attribute(array, REST, "f", (sizes[str(one.shape[2])], 2))
            if stored is None or not np.isfinite(stored).all():
                problems.append(f"{place} has no attribute {REST}: where each is at rest")
            else:
                rest_mm[place] = stored
    cameras: dict[str, Camera] = {}
    for name in layout.cameras:
        place = layout.path(layout.of_cameras[0], name)
        if (array := found[place]) is None:
            continue
        k_px, pose = (
            _attribute(array, K, "f", (3, 3)),
            _attribute(array, T_WORLD_CAMERA, "f", (4, 4)),
        )
        if k_px is None or pose is None or not np.isfinite([k_px.sum(), pose.sum()]).all():
            problems.append(f"{place} has no attributes {K} (3, 3) and {T_WORLD_CAMERA} (4, 4)")
        else:
            height, width = (sizes[f"{name} {axis}"] for axis in ("height", "width"))
            cameras[name] = Camera(name, height, width, k_px, pose)
    if problems:
        _refuse(path, problems)
    scale = _attribute(file, "mm_per_px", "f", ())
    mm_per_px = np.nan if scale is None else float(scale)
    arrays = {name: h5py.Dataset(ident) for name, ident in found.items()}
    recipe_sha256 = _text(file, "recipe_sha256")
    until: Until = "lift" if _text(file, FRAMES_UNTIL) == "lift" else "outcome"
    about = (recipe_sha256, noise_grey, until, mm_per_px, rest_mm, cameras)
    return Shard(path, file, layout, arrays, (start, stop), *about)


def _refuse(path: Path, problems: Sequence[str]) -> NoReturn:
    raise DatasetError.from_problems([f"{path}: {text}" for text in problems])


def _array_at(file: h5py.File, path: str) -> h5d.DatasetID | None:
    """The array at ``path``, by hard links alone; None where there is none, or a link or group."""
    found: h5g.GroupID | h5d.DatasetID = h5g.open(file.id, b"/")
    for name in path.encode().strip(b"/").split(b"/"):
        if not isinstance(found, h5g.GroupID) or not found.links.exists(name):
            return None
        if found.links.get_info(name).type != h5l.TYPE_HARD:
            return None
        found = h5o.open(found, name)
    return found if isinstance(found, h5d.DatasetID) else None


def _layout_of(path: Path, file: h5py.File) -> Layout:
    kind, sensor, pads = (_text(file, name) for name in ("format", "sensor", "pads"))
    version, names = _attribute(file, "format_version", "i", ()), tuple(pads.split(","))
    if kind != "tacgen" or version is None:
        _refuse(path, ["not a shard of tacgen"])
    elif problem := newer_problem(int(version), FORMAT_VERSION):
        _refuse(path, [problem])
    elif not sensor or "/" in sensor or not set(names) <= set(PADS):
        _refuse(path, [f"sensor {sensor!r} with pads {pads!r} is not known"])
    cameras = tuple(name for name in _text(file, CAMERAS).split(",") if name)
    is_twice = len(set(cameras)) < len(cameras)
    if is_twice or len(cameras) > MAX_CAMERAS or not all(map(str.isidentifier, cameras)):
        problem = f"cameras {cameras} are not names, not all different, or more than {MAX_CAMERAS}"
        _refuse(path, [problem])
    whole = Layout(sensor, names, cameras=cameras)
    return replace(whole, absent=frozenset(_absent(file, whole)))


def _absent(file: h5py.File, whole: Layout) -> Iterator[str]:
    """What the dataset was not asked for, by what is there; of two in one place the rank tells."""
    optional = [field for field in FIELDS if field.asked_by]
    for field in optional:
        if field.of != "camera":
            found = _array_at(file, whole.path(field, whole.pads[0]))
            same = [f for f in optional if (f.group, f.name) == (field.group, field.name)]
            if found is None or found.rank in {len(f.axes) for f in same} - {len(field.axes)}:
                yield field.asked_by
    yield from _absent_of_cameras(file, whole)


def _absent_of_cameras(file: h5py.File, whole: Layout) -> Iterator[str]:
    """A camera that is named has all arrays, in one of the two ways, which any of them shows."""
    fields = [field for field in FIELDS if field.of == "camera"]
    ways = list(dict.fromkeys(field.asked_by for field in fields))
    kept = ways[0]
    for field in fields if whole.cameras else ():
        found = _array_at(file, whole.path(field, whole.cameras[0]))
        if found is not None and found.rank == len(field.axes):
            kept = field.asked_by
            break
    yield from (way for way in ways if way != kept or not whole.cameras)


def _text(file: h5py.File, name: str) -> str:
    """An attribute of fixed-length text; empty where it is missing or anything else."""
    values = _attribute(file, name, "S", ())
    return "" if values is None else bytes(values[()]).decode("utf-8", "replace")


def _attribute(
    owner: h5py.File | h5d.DatasetID, name: str, kind: str, shape: tuple[int, ...]
) -> NDArray[Any] | None:
    """An attribute of that kind of type and shape, its type looked at before it is read."""
    ident = owner.id if isinstance(owner, h5py.File) else owner
    if not h5a.exists(ident, name.encode()):
        return None
    attribute = h5a.open(ident, name.encode())
    dtype = attribute.get_type().dtype
    if dtype.kind != kind or dtype.itemsize > MAX_TEXT_BYTES or attribute.shape != shape:
        return None
    values = np.empty(shape, dtype)
    attribute.read(values)
    return values


def _sizes_of(path: Path, file: h5py.File, layout: Layout, start: int, stop: int) -> dict[str, int]:
    """What the letters of the layout stand for here, within the limits."""
    name = layout.tactile(layout.pads[0], "rgb")
    rgb = _array_at(file, name)
    if rgb is None or rgb.rank != 5:
        _refuse(path, [f"{name} is missing, or a link, or not of five axes"])
    sizes = dict(zip("NTHW", rgb.shape, strict=False))
    for array in layout.placed():
        found = _array_at(file, array.path)
        if found is not None and found.rank == len(array.shape):
            for letter, length in zip(array.shape, found.shape, strict=True):
                sizes.setdefault(str(letter), length)
    axes = {axis for array in layout.placed() for axis in array.shape if isinstance(axis, str)}
    sizes = {axis: sizes.get(axis, 0) for axis in sorted(axes)}
    limits = dict.fromkeys(sizes, MAX_SIDE_PX) | {"N": MAX_GRASPS, "T": MAX_FRAMES}
    limits |= dict.fromkeys([k for k in ("rows", "columns") if k in sizes], MAX_CELLS)
    problems = [
        f"{k} = {sizes[k]} exceeds {limit}" for k, limit in limits.items() if sizes[k] > limit
    ]
    if stop - start != sizes["N"]:
        problems.append(f"index range {start} to {stop} does not go with {sizes['N']} grasps")
    if problems:
        _refuse(path, problems)
    return sizes


def _array_problems(
    found: h5d.DatasetID | None, array: Placed, shape: tuple[int, ...]
) -> Iterator[str]:
    if found is None:
        yield f"{array.path} is missing, or a link"
        return
    creation, stored_shape = found.get_create_plist(), found.shape
    kind = creation.get_layout()
    filters = [creation.get_filter(i)[0] for i in range(creation.get_nfilters())]
    if stored_shape != shape:
        yield f"{array.path} has shape {stored_shape}, not {shape}"
    elif not _is_type(found.get_type(), array.field.dtype):
        yield f"{array.path} is {found.dtype}, not {array.field.dtype}"
    elif kind == h5d.VIRTUAL or creation.get_external_count():
        yield f"{array.path} lies in another file"
    elif len(filters) > 1 or not ALLOWED_FILTERS.issuperset(filters):
        yield f"{array.path} is stored by filters {filters}, not by one that is known here"
    elif (kind == h5d.CHUNKED) != array.field.image or (
        array.field.image and creation.get_chunk() != array.chunks(shape)
    ):
        yield f"{array.path} is not stored as the schema says"


def _is_type(stored: h5t.TypeID, dtype: str) -> bool:
    wanted = np.dtype(dtype)
    if wanted.kind == "S":
        is_fixed_text = isinstance(stored, h5t.TypeStringID) and not stored.is_variable_str()
        return is_fixed_text and stored.get_size() == wanted.itemsize
    return bool(stored.dtype == wanted)
