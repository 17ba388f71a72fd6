"""What a result depends on: the content that counts of each input, by role, as a hash.

A dataset, a shard, a kept simulation, a training run or a diagnosis of grasps is named by these
hashes, so none is ever taken for one of another world. Only content counts: a remark in a YAML
file, its path, its folder or its date change nothing.

The roles: ``recipe`` (every setting but the list of grasps), ``sensor``, ``table``,
``contact_law`` (where the recipe names a file), ``gripper``, ``engine``, ``versions`` (of the
libraries that the bytes of a shard depend on), and of each object ``object/<name>`` (its
``object.yaml``), ``object/<name>/recipe`` (what the recipe says of it), ``object/<name>/mesh`` and
``object/<name>/collision``. Those of a dataset have ``grid/<k>`` besides: the grids from the first
to the one with which the dataset grew the k-th time; where a recipe asks for a device to draw the
images (``optics.device``), those have ``device``.
"""

import contextlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib import metadata
from typing import Any

import h5py

from tacgen.core.files import sha256_of_content
from tacgen.core.resources import __version__

LIBRARIES = (
    *("numpy", "scipy", "numba", "opencv-python-headless", "manifold3d", "trimesh"),
    *("h5py", "hdf5plugin", "zstandard"),
)
OBJECT, GRID = "object/", "grid/"


@dataclass(frozen=True, slots=True)
class Inputs:
    """The inputs of a result: ``sha256`` of each role's content, ``files`` where it was read.

    ``engine`` is the physics engine, ``versions`` those of the libraries and of the engine;
    ``device`` what drew the images, empty where no device was asked for.
    """

    sha256: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    engine: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    device: str = ""

    def of_objects(self, names: Collection[str], part: int = 0) -> dict[str, str]:
        """The hashes that grasps of these objects depend on, in that part of a dataset."""
        return {
            role: digest
            for role, digest in self.sha256.items()
            if (not role.startswith(OBJECT) or role.split("/")[1] in names)
            and (not role.startswith(GRID) or role == f"{GRID}{part}")
        }

    def drawn_by(self, device: str) -> "Inputs":
        """The inputs of a dataset whose images that device draws."""
        if not device:
            return self
        digest = sha256_of_content([device])
        return replace(self, sha256={**self.sha256, "device": digest}, device=device)

    def with_grids(self, grids: Sequence[Any]) -> "Inputs":
        """The inputs of a dataset that has these grids, one after another."""
        listed = json.loads(json.dumps(grids))
        hashes = {f"{GRID}{k}": sha256_of_content(listed[: k + 1]) for k in range(len(listed))}
        return replace(self, sha256={**self.sha256, **hashes})


@cache
def library_versions(engine: str = "") -> dict[str, str]:
    """Versions of tacgen, the engine and the libraries that the bytes of a shard depend on."""
    versions = {"tacgen": __version__, "hdf5": h5py.version.hdf5_version}
    for name in (*LIBRARIES, *([engine] if engine else [])):
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return dict(sorted(versions.items()))


def changed_roles(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """The roles that both name and whose content differs."""
    return [role for role, digest in old.items() if new.get(role, digest) != digest]
