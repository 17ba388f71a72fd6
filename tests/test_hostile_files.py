"""Files made to harm: refused with one message, before they take time or memory.

Readers by kind; spoiled at random they are read in ``tests/fuzz``.
"""

from __future__ import annotations

import json
import pickle
import struct
import time
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from tacgen.collection.recipe import load_recipe
from tacgen.core.errors import (
    DatasetError,
    ObjectError,
    PressError,
    RecipeError,
    TableError,
    TacgenError,
)
from tacgen.core.safe_io import read_rgb
from tacgen.core.schema import read_yaml
from tacgen.dataset import Dataset, DatasetFolder
from tacgen.objects.mesh_import import import_surface
from tacgen.optics import load_table, save_table
from tacgen.presses import lab_table
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_log import read_press_log
from tests.dataset.conftest import collect_toy, make_spec
from tests.fuzz.readers import LEARNED, READERS
from tests.messages import refused
from tests.small_world import slope_table, write_world

SECONDS = 5.0
"""Of this machine's processor, for a file that is refused; without a check they took 30 to 90."""


@pytest.mark.parametrize(
    "text",
    [
        "!!bool foo",
        "!!timestamp 2024-13-45",
        '!!int ""',
        "!!float ''",
        "!!set {a, b}",
        "!!str [1]",
        "!!python/name:os.system x",
        "9" * 5000,
        "1" + ":59" * 3000,
        "1:30",
        '"\\uD800"',
        '"\\0"',
        '"\\UFFFFFFFF"',
        "{? [a, b] : 1}",
        '{"\\uD800": 1}',
        "[" * 3000,
        "*a",
        "&a [*a]",
    ],
    ids=lambda text: text[:20],
)
def test_yaml(tmp_path, text):
    path = tmp_path / "a.yaml"
    path.write_text(f"name: {text}\n")
    start = time.process_time()
    with refused(RecipeError) as caught:
        read_yaml(path)
    assert time.process_time() - start < SECONDS
    str(caught.value).encode()


def test_yaml_that_is_odd_and_sound(tmp_path):
    (tmp_path / "a.yaml").write_text("name: !!null x y\n")
    read_yaml(tmp_path / "a.yaml")


@pytest.mark.parametrize("force_n", [1e308, 1001.0])
def test_forces_beyond_any_gripper(tmp_path, monkeypatch, force_n):
    monkeypatch.chdir(tmp_path)
    grid = f"{{force_n: [{force_n}], y_mm: [0], z_mm: [60]}}"
    path = write_world(tmp_path, grid=grid, robot=f"{{max_force_n: {force_n}}}")
    with refused(RecipeError):
        load_recipe(path)


HEADERS = {
    "broken": "{",
    "empty": "",
    "a list": "[]",
    "null": "null",
    "too deep": "[" * 100_000,
    "not text": b"\xff\xfe\x00",
    "surrogate": '{"sensor": "\\ud800"}',
}
CHANGES = {
    "mm_per_px": ["x", None, 0, -1.0, float("nan"), float("inf"), True, [0.1], "0.1"],
    "max_slope_rad": ["x", None, 0, 2.0, float("nan")],
    "noise_grey": ["1", None, -1.0, float("inf")],
    "interpolation": ["cubic", None, 3],
    "sensor": [None, 3, ["a"]],
    "effects": [None, [], "blur", {"blur": None}, {"blur": {"sigma": "x"}}, {"blur": 3}],
    "provenance": [None, "x", []],
    "model": [None, [], {"kind": ["quadratic"]}, {"kind": "response"}],
    "contact": ["x", {"depth_mm": "a"}, {"depth_mm": 0.0}],
    "gel_of_tomorrow": [1],
}


def table_file(folder: Path, header: bytes | str | None = None, **arrays) -> Path:
    """A sound table with another header or other arrays; None leaves one out."""
    path = folder / "table.npz"
    save_table(slope_table((24, 32), 0.3), path)
    with np.load(path) as archive:
        members = {name: archive[name] for name in archive.files}
    if header is not None:
        data = header.encode() if isinstance(header, str) else header
        members["meta"] = np.frombuffer(data or b" ", np.uint8)
    members |= arrays
    np.savez(path, **{name: array for name, array in members.items() if array is not None})
    return path


@pytest.mark.parametrize("kind", HEADERS)
def test_table_headers(tmp_path, kind):
    with refused(TableError):
        load_table(table_file(tmp_path, HEADERS[kind]))


def header_of(folder: Path) -> dict:
    with np.load(table_file(folder)) as archive:
        return json.loads(archive["meta"].tobytes())


@pytest.mark.parametrize("key", CHANGES)
def test_values_in_table_headers(tmp_path, key):
    sound = header_of(tmp_path)
    for value in CHANGES[key]:
        with refused(TableError):
            load_table(table_file(tmp_path, json.dumps({**sound, key: value})))


def test_a_table_of_a_newer_tacgen_says_so(tmp_path):
    header = {**header_of(tmp_path), "lens": 1}
    with refused(TableError):
        load_table(table_file(tmp_path, json.dumps(header)))


@pytest.mark.parametrize(
    "arrays",
    [
        {"coefficients": np.full((4, 5, 3, 6), "x")},
        {"coefficients": np.full((4, 5, 3, 6), np.nan)},
        {"coefficients": np.ones((4, 5, 3, 6), complex)},
        {"coefficients": np.zeros((0, 5, 3, 6))},
        {"coefficients": np.zeros((4, 5))},
        {"background": np.zeros((24, 32))},
        {"background": np.full((24, 32, 3), np.inf)},
        {"response": np.zeros((2, 2))},
        {"response": np.zeros((3, 3, 2, 2, 3)), "contact": np.zeros((2, 2, 3, 3))},
    ],
)
def test_arrays_of_tables(tmp_path, arrays):
    header = header_of(tmp_path)
    if "response" in arrays:
        header["model"] = {"kind": "response"}
    with refused(TableError):
        load_table(table_file(tmp_path, json.dumps(header), **arrays))


def test_a_table_that_unpacks_to_gigabytes_is_refused_before_it_is_unpacked(tmp_path):
    path = tmp_path / "table.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("background.npy", "w", force_zip64=True) as file,
    ):
        np.lib.format.write_array_header_1_0(
            file, {"descr": "<f4", "fortran_order": False, "shape": (20000, 20000, 3)}
        )
        for _ in range(70):
            file.write(bytes(4 << 20))
    start = time.process_time()
    with refused(TableError):
        load_table(path)
    assert time.process_time() - start < 1.0


@pytest.mark.parametrize(
    "changes",
    [
        {"n_shards": 10**10},
        {"n_grasps": 10**15},
        {"parts": ["x"]},
        {"parts": float("inf")},
        {"grids": 3},
        {"schema": 2},
    ],
)
def test_plans_of_datasets(tmp_path, changes):
    folder = collect_toy(tmp_path / "data", make_spec(n_grasps=4))
    plan = json.loads(folder.plan_path.read_text()) | changes
    folder.plan_path.write_text(json.dumps(plan))
    with refused(DatasetError):
        DatasetFolder(folder.root).plan()


def test_a_plan_of_a_newer_tacgen_says_so_whatever_it_holds(tmp_path):
    folder = collect_toy(tmp_path / "data", make_spec(n_grasps=4))
    folder.plan_path.write_text('{"schema": 3, "grasps": "elsewhere"}')
    with refused(DatasetError):
        DatasetFolder(folder.root).plan()
    folder.plan_path.write_text("[1]")
    with refused(DatasetError):
        DatasetFolder(folder.root).plan()
    with pytest.raises(TacgenError):
        Dataset(folder.root)


def test_an_obj_with_one_endless_line(tmp_path):
    path = tmp_path / "line.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + " 1 2 3" * 2_000_000)
    start = time.process_time()
    with refused(ObjectError):
        import_surface(path)
    assert time.process_time() - start < SECONDS


def glb(tree: dict) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text))
    return head + struct.pack("<I4s", len(text), b"JSON") + text


MESHES = {
    "accessors": [{"count": 36, "componentType": 5126, "type": "VEC3"}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
}


@pytest.mark.parametrize(
    "tree",
    [
        {**MESHES, "nodes": [{"mesh": 0}] * 200_000},
        {**MESHES, "accessors": [{"count": 10**9}], "nodes": [{"mesh": 0}]},
        {**MESHES, "nodes": [{"mesh": 7}]},
        {**MESHES, "nodes": [{"mesh": "a"}]},
        {"meshes": [{}], "nodes": []},
    ],
)
def test_glb_scenes_that_unfold(tmp_path, tree):
    path = tmp_path / "scene.glb"
    path.write_bytes(glb(tree))
    start = time.process_time()
    with refused(ObjectError):
        import_surface(path)
    assert time.process_time() - start < SECONDS


class Harm:
    """What unpickling runs."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


ARRAYS = {
    "lookup table": "coefficients",
    "polycalib": "grad_r",
    "dataPack": "imgs",
    "gs-sdk label": "center",
    "added parts": "vertices_0",
    "polycalib's background": None,
    "checkpoint": None,
    "weights": None,
    "model": None,
}
"""Readers, and the array of theirs that is made one of Python objects."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name in LEARNED else ()) for name in ARRAYS],
)
def test_no_pickle_is_run(tmp_path, name):
    if name in LEARNED:
        pytest.importorskip("torch")
    path, harmed = READERS[name].make(tmp_path), tmp_path / "harmed"
    objects = np.array([Harm(harmed)], dtype=object)
    if ARRAYS[name] is None:
        path.write_bytes(pickle.dumps({"epoch": Harm(harmed), "weights": {}}))
        if path.suffix == ".npy":
            np.save(path, objects, allow_pickle=True)
    else:
        with np.load(path) as archive:
            members = {key: archive[key] for key in archive.files}
        np.savez(path, **{**members, ARRAYS[name]: objects})
    with pytest.raises(TacgenError):
        READERS[name].read(path)
    assert not harmed.exists()


def test_files_without_end(tmp_path, monkeypatch):
    """The limits are lowered: files beyond them take seconds to write."""
    small = replace(lab_table.LOG, max_cells=60, max_bytes=1000)
    monkeypatch.setattr(lab_table, "LOG", small)
    header, row = "trial,time_s,force_normal_n,volume_mm3\n", "1,0.5,1,5\n"
    path = tmp_path / "log.csv"
    for rows in (100 * row, 20 * row, 40 * "1\n"):
        path.write_text(header + rows)
        with refused(PressError):
            read_press_log(path)
    path = tmp_path / "large.png"
    head = struct.pack(">IIBBBBB", 8192, 8192, 16, 6, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + head + struct.pack(">I", zlib.crc32(b"IHDR" + head))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with refused(TacgenError):
        read_rgb(path)


def test_a_list_of_grasps_with_endless_columns(tmp_path):
    path = READERS["real grasps"].make(tmp_path)
    path.write_text(",".join(f"c{k}" for k in range(200_000)) + "\n")
    start = time.process_time()
    with refused(DatasetError):
        READERS["real grasps"].read(path)
    assert time.process_time() - start < 1.0


def test_a_datapack_that_unfolds_is_refused_before_it_does(tmp_path):
    path = tmp_path / "dataPack.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("imgs.npy", "w", force_zip64=True) as file,
    ):
        shape = {"descr": "|u1", "fortran_order": False, "shape": (200 << 20,)}
        np.lib.format.write_array_header_1_0(file, shape)
        for _ in range(50):
            file.write(bytes(4 << 20))
    with refused(PressError):
        read_presses(path)


def test_a_parquet_log_without_end(tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")
    path = READERS["press log parquet"].make(tmp_path)
    monkeypatch.setattr(lab_table, "LOG", replace(lab_table.LOG, max_cells=60))
    with refused(PressError):
        read_press_log(path)


def _links(group, name):
    group[name] = h5py.SoftLink(f"/{name}")


def _leads_elsewhere(group, name):
    group[name] = h5py.ExternalLink("/etc/hostname", "/x")


def _lies_elsewhere(group, name):
    group.create_dataset(name, (1, 1, 3), "u1", external=[("/etc/hostname", 0, 3)])


def _swells(group, name):
    group.create_dataset(name, (10**6, 10**6, 3), "u1", chunks=(100, 100, 3))


def _is_a_group(group, name):
    group.create_group(name)


def _is_empty(group, name):
    group[name] = h5py.Empty("u1")


@pytest.mark.parametrize(
    ("name", "replace"),
    [
        *(("data", one) for one in (_links, _is_a_group)),
        *(("data/i0", one) for one in (_leads_elsewhere, _is_empty)),
        *(("data/i0/gelsightA_after", one) for one in (_lies_elsewhere, _swells, _is_empty)),
    ],
)
def test_pictures_in_hdf5_that_are_none(tmp_path, replace, name):
    path = READERS["feeling-of-success"].make(tmp_path)
    with h5py.File(path, "r+") as file:
        del file[name]
        replace(file, name)
    if "gelsight" in name:
        count, notes = READERS["feeling-of-success"].read(path)
        assert count == 1, "the other finger's"
        assert any("no gelsightA_after as a picture in this file" in note for note in notes)
    else:
        with refused(DatasetError):
            READERS["feeling-of-success"].read(path)


def test_messages_neither_steer_the_terminal_nor_fill_it():
    text = str(TacgenError("a.csv: '\x1b]0;title\x07\x9b31m\u202e' of " + "x" * 10**6))
    assert "\\x1b]0;title\\x07\\x9b31m\\u202e" in text
    assert len(text) < 2000
    assert len(str(TacgenError("\n".join("line" for _ in range(10**4)))).splitlines()) == 201
    assert str(TacgenError("Fläche in µm³,\nzwei Zeilen")) == "Fläche in µm³,\nzwei Zeilen"
