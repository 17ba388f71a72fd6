"""What a result depends on: the content that counts of each input, by role, as a hash.

A dataset, a shard, a kept simulation, a training run or a diagnosis of grasps is named by these
hashes, so none is ever taken for one of another world. Only content counts: a remark in a YAML
file, its path, its folder or its date change nothing.

The roles: ``recipe`` (every setting but the list of grasps), ``sensor``, ``table``,
``contact_law`` (where the recipe names a file), ``gripper``, ``engine``, ``versions`` (of the
libraries that the bytes of a shard depend on), and of each object ``object/<name>`` (its
``object.yaml``), ``object/<name>/recipe`` (what the recipe says of it), ``object/<name>/mesh`` and
``object/<name>/collision``. Those of a dataset have ``grid/<k>`` besides: the grids from the first
to the one with which the dataset grew the k-th time.
"""

import contextlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import h5py

from tacgen.contact.law import ContactLaw
from tacgen.core.files import sha256_of, sha256_of_content
from tacgen.core.records import Sensor
from tacgen.core.version import __version__
from tacgen.objects.description import read_description

LIBRARIES = (
    *("numpy", "scipy", "numba", "opencv-python-headless", "manifold3d", "trimesh"),
    *("h5py", "hdf5plugin", "zstandard"),
)
_OBJECT, GRID = "object/", "grid/"
_OF_THE_GRID = {"name", "description", "objects", "grid", "sensor"}
_ABOUT_AN_OBJECT = {"name", "description", "grasp_ranges", "dimensions_mm"}


@dataclass(frozen=True, slots=True)
class Inputs:
    """The inputs of a result: ``sha256`` of each role's content, ``files`` where it was read.

    ``engine`` is the physics engine, ``versions`` those of the libraries and of the engine.
    """

    sha256: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    engine: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)

    def of_objects(self, names: Collection[str], part: int = 0) -> dict[str, str]:
        """The hashes that grasps of these objects depend on, in that part of a dataset."""
        return {
            role: digest
            for role, digest in self.sha256.items()
            if (not role.startswith(_OBJECT) or role.split("/")[1] in names)
            and (not role.startswith(GRID) or role == f"{GRID}{part}")
        }

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


def result_inputs(
    recipe: Mapping[str, Any],
    *,
    objects: Mapping[str, tuple[Path, Mapping[str, Any]]],
    sensor: Sensor,
    sensor_file: Path,
    law: tuple[ContactLaw, Path] | None,
    gripper: tuple[Mapping[str, Any], Path],
    engine: str,
) -> Inputs:
    """What a result of a recipe depends on.

    Parameters
    ----------
    recipe : mapping
        The resolved recipe.
    objects : mapping
        The folder of each object, and what the recipe says of it, by name.
    sensor, sensor_file
        The sensor with the recipe's changes, its table found, and its YAML file.
    law : (ContactLaw, Path), optional
        The law of a file, and the file; without it the recipe's own coefficients count.
    gripper : (mapping, Path)
        What the gripper's YAML file says, and the file.
    engine : str
        The physics engine, ``pybullet`` or ``mujoco``.
    """
    versions = library_versions(engine)
    found: dict[str, tuple[object, Path | None]] = {
        "recipe": (_settings(recipe, law is not None), None),
        "sensor": ({**asdict(sensor), "table": ""}, sensor_file),
        "gripper": gripper,
        "engine": ([engine, versions.get(engine, "")], None),
        "versions": ({k: v for k, v in versions.items() if k != engine}, None),
    }
    if law is not None:
        found["contact_law"] = (_law_content(law[0]), law[1])
    binary = {"table": Path(sensor.table)} if sensor.table else {}
    for name, (folder, said) in objects.items():
        description = read_description(folder)
        figures = _without_sources(description.model_dump(mode="json", exclude=_ABOUT_AN_OBJECT))
        found[f"{_OBJECT}{name}"] = (figures, folder / "object.yaml")
        found[f"{_OBJECT}{name}/recipe"] = (said, None)
        for part in ("mesh", "collision"):
            if (file := getattr(description.shape, part)) is not None:
                binary[f"{_OBJECT}{name}/{part}"] = folder / file
    hashes = {role: sha256_of_content(content) for role, (content, _) in found.items()}
    hashes |= {role: sha256_of(path) for role, path in binary.items()}
    files = {role: str(path) for role, (_, path) in found.items() if path is not None}
    files |= {role: str(path) for role, path in binary.items()}
    return Inputs(dict(sorted(hashes.items())), files, engine, versions)


def changed_roles(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """The roles that both name and whose content differs."""
    return [role for role, digest in old.items() if new.get(role, digest) != digest]


def _settings(recipe: Mapping[str, Any], law_is_a_file: bool) -> dict[str, Any]:
    """What a grasp depends on in a resolved recipe, whichever other grasps there are."""
    settings = {name: value for name, value in recipe.items() if name not in _OF_THE_GRID}
    settings["dataset"] = {k: v for k, v in recipe["dataset"].items() if k != "shard_size"}
    contact = recipe["contact"]
    kept = {"camera"} if law_is_a_file else contact.keys() - {"file"}
    settings["contact"] = {name: contact[name] for name in kept}
    return settings


def _law_content(law: ContactLaw) -> list[Any]:
    """What a law predicts by: neither the errors of its parameters nor where they come from."""
    k_depth = law.k_depth_mm_per_n
    effects = [
        [one.name, one.channel, dict(one.values), asdict(one.where) if one.where else None]
        for one in law.effects
    ]
    slopes = [law.k_n_mm3_per_n.value, law.k_s_mm_per_n.value, k_depth and k_depth.value]
    return [law.law, *slopes, law.marker_pitch_mm, effects]


def _without_sources(figures: Any) -> Any:
    """An object's figures without the sentences that say where they come from."""
    if isinstance(figures, dict):
        return {k: _without_sources(v) for k, v in figures.items() if k != "source"}
    return figures
