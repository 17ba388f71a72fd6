"""Writing one shard: a stream of grasps into one HDF5 file whose bytes depend on nothing else."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tacgen.core.files import DiskFile, sha256_of
from tacgen.core.resources import __version__
from tacgen.dataset.check import GraspFacts, tally, validity
from tacgen.dataset.compression import storage_of, write_images
from tacgen.dataset.input_hashes import library_versions
from tacgen.dataset.manifest import ShardLine, shard_file
from tacgen.dataset.samples import DatasetSpec, GraspSample, shard_range
from tacgen.dataset.schema import (
    CAMERAS,
    FORMAT_VERSION,
    FRAMES_UNTIL,
    NOISE_AT_LOAD,
    REST,
    SEGMENT_NAMES,
    SEGMENTS,
    T_WORLD_CAMERA,
    Field,
    K,
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
    part, indices = shard_range(spec.part_sizes, spec.shard_size, shard)
    layout, sizes = spec.layout, spec.sizes(len(indices))
    outcomes: list[GraspFacts] = []
    with DiskFile(path) as disk:
        with h5py.File(disk, "w", libver=LIBRARY_VERSION) as file:
            _write_attributes(file, spec, indices)
            small = _create_arrays(file, layout, sizes)
            for row, (_, sample) in enumerate(zip(indices, samples, strict=True)):
                outcome = (sample.label, sample.status, sample.failure_mode, sample.split)
                outcomes.append((*outcome, sample.config.object))
                for field, place, values in _grasp_values(sample, layout):
                    if field.noisy:
                        write_images(file[place], row, np.asarray(values))
                    elif place in small:
                        small[place][row] = values
                    else:
                        file[place][row] = values
                disk.raise_failure()
            for place, values in small.items():
                file[place][...] = values
            for one in layout.placed():
                if one.field.of == "spec":
                    file[one.path][...] = one.field.value(spec)
                if one.field.rest:
                    rest = np.asarray(getattr(spec, one.field.rest), np.float64)
                    file[one.path].attrs[REST] = rest
            _describe_cameras(file, spec)
        disk.raise_failure()
    raw = sum(one.n_bytes(sizes) for one in layout.placed())
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
        inputs=spec.inputs.of_objects({name for *_, name in outcomes}, part),
        engine=spec.inputs.engine,
        device=spec.inputs.device,
        part=part,
        validity=validity(small, layout),
        **tally(outcomes),
    )


def _grasp_values(sample: GraspSample, layout: Layout) -> Iterator[tuple[Field, str, Any]]:
    """(field, path, values) of everything that one grasp contributes; what it lacks stays zero."""
    for one in sorted(layout.placed(), key=lambda one: one.field.of == "pad"):
        field, name = one.field, one.owner
        owners = {
            "sample": sample,
            "pad": sample.pads.get(name),
            "camera": sample.cameras.get(name),
        }
        owner = owners.get(field.of)
        if owner is None:
            continue
        values = field.value(owner)
        if isinstance(values, str):
            # At a whole character: text of a fixed length in bytes.
            fitting = values.encode()[: np.dtype(field.dtype).itemsize]
            values = fitting.decode(errors="ignore").encode()
        if values is None and field.nan:
            values = np.nan
        if values is not None:
            yield field, one.path, values


def _create_arrays(
    file: h5py.File, layout: Layout, sizes: Mapping[str, int]
) -> dict[str, NDArray[Any]]:
    """Create every array; those that are small are given back, to be filled and written last."""
    small = {}
    for array in layout.placed():
        field, shape, dtype = array.field, array.resolve(sizes), np.dtype(array.field.dtype)
        stored = h5py.string_dtype("utf-8", dtype.itemsize) if dtype.kind == "S" else dtype
        storage: dict[str, Any] = {}
        if field.image:
            storage = {"chunks": array.chunks(shape), **storage_of(noisy=field.noisy)}
        dataset = file.create_dataset(array.path, shape, stored, track_times=False, **storage)
        for name in ("unit", "frame", "description"):
            dataset.attrs[name] = getattr(field, name)
        if not field.image:
            small[array.path] = np.zeros(dataset.shape, dataset.dtype)
    return small


def _describe_cameras(file: h5py.File, spec: DatasetSpec) -> None:
    """Write the intrinsics and the pose of each camera beside what it sees."""
    for camera in spec.cameras:
        for field in spec.layout.of_cameras:
            attributes = file[spec.layout.path(field, camera.name)].attrs
            attributes[K] = np.asarray(camera.k_px, np.float64)
            attributes[T_WORLD_CAMERA] = np.asarray(camera.t_world_camera_mm, np.float64)
            if field.name == "segmentation":
                attributes[SEGMENT_NAMES] = np.bytes_(",".join(SEGMENTS).encode())


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
        FRAMES_UNTIL: spec.until,
    }
    if spec.cameras:
        texts[CAMERAS] = ",".join(camera.name for camera in spec.cameras)
    for name, text in texts.items():
        file.attrs[name] = np.bytes_(text.encode())
    file.attrs["format_version"] = np.int64(FORMAT_VERSION)
    file.attrs["index_range"] = np.array([indices.start, indices.stop], np.int64)
    file.attrs["mm_per_px"] = spec.sensor.mm_per_px
    if spec.noise_at_load_grey > 0:
        file.attrs[NOISE_AT_LOAD] = spec.noise_at_load_grey
