"""Writing one shard: a stream of grasps into one HDF5 file whose bytes depend on nothing else."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tacgen.core.files import sha256_of
from tacgen.core.version import __version__
from tacgen.dataset.check import Outcome, tally
from tacgen.dataset.compression import storage_of, write_images
from tacgen.dataset.disk import DiskFile
from tacgen.dataset.inputs import library_versions
from tacgen.dataset.manifest import ShardLine, shard_file
from tacgen.dataset.samples import DatasetSpec, GraspSample, shard_range
from tacgen.dataset.schema import (
    CONTACT_NAMES,
    FORMAT_VERSION,
    MAX_REASON_BYTES,
    NOISE_AT_LOAD,
    Layout,
)

# The oldest file format that holds all this, so that a newer HDF5 writes the same bytes.
LIBRARY_VERSION = ("v110", "v110")
HOW_TO_READ = "Python: import hdf5plugin first (HDF5 filters 32026, Blosc2, and 32015, Zstandard)."


def write_shard_file(
    path: Path, samples: Iterable[GraspSample], spec: DatasetSpec, shard: int
) -> ShardLine:
    """Write the grasps of one shard to ``path`` and say what it holds.

    Grasps are taken one at a time, in the order of their indices; only one is in memory. Whether
    they fit is seen when the file is checked.
    """
    indices = spec.shard_range(shard)
    layout = Layout(spec.sensor.name, spec.pads, spec.depth, spec.picture_px is not None)
    lengths = (len(indices), len(spec.time_s), *spec.sensor.shape_px, *(spec.picture_px or (0, 0)))
    sizes = dict(zip("NTHWhw", lengths, strict=True))
    outcomes: list[Outcome] = []
    with DiskFile(path) as disk:
        with h5py.File(disk, "w", libver=LIBRARY_VERSION) as file:
            _write_attributes(file, spec, indices)
            small = _create_arrays(file, layout, sizes)
            noisy = {array.path for array in layout.arrays() if array.noisy}
            for row, (_, sample) in enumerate(zip(indices, samples, strict=True)):
                outcome = (sample.label, sample.status, sample.failure_mode, sample.split)
                outcomes.append((*outcome, sample.config.object))
                for place, values in grasp_values(sample, layout):
                    if place in small:
                        small[place][row] = values
                    elif place in noisy:
                        write_images(file[place], row, np.asarray(values))
                    else:
                        file[place][row] = values
                disk.raise_failure()
            small["/time_s"][:] = spec.time_s
            for place, values in small.items():
                file[place][...] = values
            for pad in spec.pads:
                file[layout.tactile(pad, "reference")][...] = spec.reference_rgb
        disk.raise_failure()
    raw = sum(np.dtype(a.dtype).itemsize * int(np.prod(a.resolve(sizes))) for a in layout.arrays())
    return ShardLine(
        shard=shard,
        file=shard_file(shard),
        index_range=(indices.start, indices.stop),
        sha256=sha256_of(path),
        bytes=path.stat().st_size,
        raw_bytes=raw,
        recipe=str(spec.recipe.get("name", "")),
        recipe_sha256=spec.recipe_sha256,
        calibration=dict(sorted(spec.calibration.items())),
        sensor=spec.sensor.name,
        pads=spec.pads,
        frames=len(spec.time_s),
        versions=library_versions(spec.inputs.engine),
        inputs=spec.inputs.of_objects({name for *_, name in outcomes}),
        engine=spec.inputs.engine,
        part=shard_range(spec.part_sizes, spec.shard_size, shard)[0],
        **tally(outcomes),
    )


def grasp_values(sample: GraspSample, layout: Layout) -> Iterator[tuple[str, object]]:
    """(path, values) of everything that one grasp contributes; what it lacks stays zero."""
    config, margin = sample.config, sample.margin
    yield "/grasp/index", config.index
    yield "/grasp/object", config.object.encode()
    for name in ("force_n", "x_mm", "y_mm", "z_mm", "yaw_rad"):
        yield f"/grasp/{name}", getattr(config, name)
    for name in ("seed", "label", "rise_mm", "turn_rad", "grasp_frame"):
        yield f"/grasp/{name}", getattr(sample, name)
    for name in ("split", "status", "failure_mode"):
        yield f"/grasp/{name}", getattr(sample, name).encode()
    reason = sample.reason.encode()[:MAX_REASON_BYTES]
    yield "/grasp/reason", reason.decode(errors="ignore").encode()
    yield "/grasp/margin_translational", margin.translational if margin else np.nan
    yield "/grasp/margin_rotational", margin.rotational if margin else np.nan
    yield "/grasp/first_slip_time_s", margin.first_slip_time_s if margin else np.nan
    yield "/grasp/label_confidence", sample.label_confidence
    if margin:
        yield "/grasp/first_slip_direction", margin.first_slip_direction
    if sample.object_pose is not None:
        yield "/object/pose", sample.object_pose
    if layout.picture and sample.picture is not None:
        yield "/scene/picture", sample.picture
    for pad, recorded in sample.pads.items():
        yield layout.tactile(pad, "rgb"), recorded.rgb
        if layout.depth and recorded.depth_mm is not None:
            yield layout.tactile(pad, "depth_mm"), recorded.depth_mm
        for name in CONTACT_NAMES:
            yield layout.contact(pad, name), getattr(recorded, name)


def _create_arrays(
    file: h5py.File, layout: Layout, sizes: Mapping[str, int]
) -> dict[str, NDArray[Any]]:
    """Create every array; those that are small are given back, to be filled and written last."""
    small = {}
    for array in layout.arrays():
        shape, dtype = array.resolve(sizes), np.dtype(array.dtype)
        stored = h5py.string_dtype("utf-8", dtype.itemsize) if dtype.kind == "S" else dtype
        storage = {"chunks": array.chunks(shape), **storage_of(array)} if array.image else {}
        dataset = file.create_dataset(array.path, shape, stored, track_times=False, **storage)
        for name in ("unit", "frame", "description"):
            dataset.attrs[name] = getattr(array, name)
        if not array.image:
            small[array.path] = np.zeros(dataset.shape, dataset.dtype)
    return small


def _write_attributes(file: h5py.File, spec: DatasetSpec, indices: range) -> None:
    """Write what a reader needs before it reads anything else; text has a fixed length.

    HDF5 can be made to loop for ever by a broken heap, where it keeps text of variable length.
    """
    texts = {
        "format": "tacgen",
        "tacgen_version": __version__,
        "recipe_sha256": spec.recipe_sha256,
        "sensor": spec.sensor.name,
        "pads": ",".join(spec.pads),
        "how_to_read": HOW_TO_READ,
    }
    for name, text in texts.items():
        file.attrs[name] = np.bytes_(text.encode())
    file.attrs["format_version"] = np.int64(FORMAT_VERSION)
    file.attrs["index_range"] = np.array([indices.start, indices.stop], np.int64)
    file.attrs["mm_per_px"] = spec.sensor.mm_per_px
    if spec.noise_at_load_grey > 0:
        file.attrs[NOISE_AT_LOAD] = spec.noise_at_load_grey
