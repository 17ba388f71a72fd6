"""Size and time of a dataset's compressed images: ``python -m validation.cluster.compression DIR``.

Processor time of one thread, the least of three rounds; reading is through h5py and hdf5plugin.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np

from tacgen.dataset import Dataset
from tacgen.dataset.compression import encode_image, storage_of

MAX_IMAGES = 100
ROUNDS = 3


def compression_of(root: Path) -> dict[str, float]:
    """Raw bytes over compressed bytes, and ms to write and to read an image of the dataset."""
    grasps = Dataset(root, partial=True)
    samples = (grasps.read(int(index)) for index in grasps.indices)
    every = (rgb for grasp in samples for pad in grasp.pads.values() for rgb in pad.rgb)
    images = list(itertools.islice(every, MAX_IMAGES))
    chunks = [encode_image(rgb) for rgb in images]
    shape = images[0].shape
    with h5py.File("memory", "w", driver="core", backing_store=False) as file:
        array = file.create_dataset(
            "rgb", (len(images), *shape), "u1", chunks=(1, *shape), **storage_of(noisy=True)
        )
        for row, chunk in enumerate(chunks):
            array.id.write_direct_chunk((row, 0, 0, 0), chunk)
        write_ms = _least_ms(lambda: [encode_image(rgb) for rgb in images])
        read_ms = _least_ms(lambda: [array[row] for row in range(len(images))])
    return {
        "images": len(images),
        "smaller_by": float(np.sum([rgb.nbytes for rgb in images]) / sum(map(len, chunks))),
        "write_ms_per_image": write_ms / len(images),
        "read_ms_per_image": read_ms / len(images),
    }


def _least_ms(work: Callable[[], object]) -> float:
    times_ms = []
    for _ in range(ROUNDS):
        before_s = time.process_time()
        work()
        times_ms.append(1e3 * (time.process_time() - before_s))
    return min(times_ms)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("dataset", type=Path, help="a folder that `tacgen collect` wrote")
    sys.stdout.write(f"{json.dumps(compression_of(parser.parse_args().dataset))}\n")
