"""Everything that reads a file which somebody else may have made, and a sound file for each."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tests.fuzz import foreign, learned

Read = Callable[[Path], object]


@dataclass(frozen=True)
class Reader:
    """``make`` writes what is read into a folder and says which file to spoil; ``read`` reads.

    Unless ``sound``, that file is one of its kind but refused for what it holds.
    """

    make: Callable[[Path], Path]
    read: Read
    sound: bool = True


def _text(name: str, text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / name
        path.write_text(text, encoding="utf-8")
        return path

    return make


def _shipped(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        from tacgen.core.resources import packaged

        return Path(shutil.copy(packaged("recipes") / name, folder / Path(name).name))

    return make


def _read_recipe(path: Path) -> object:
    from tacgen.collection.recipe import load_recipe

    return load_recipe(path)


def _read_train_recipe(path: Path) -> object:
    from tacgen.learning.training_recipe import load_train_recipe

    return load_train_recipe(path)


def _read_rig_recipe(path: Path) -> object:
    from tacgen.rig.rig_recipe import load_rig_recipe

    return load_rig_recipe(path)


def _read_study(path: Path) -> object:
    from tacgen.study.study_recipe import load_study

    return load_study(path)


def _make_object(folder: Path) -> Path:
    from tacgen.core.resources import packaged

    shutil.copytree(packaged("objects") / "sugar_box", folder / "sugar_box")
    return folder / "sugar_box/object.yaml"


def _read_object(path: Path) -> object:
    from tacgen.objects import load_object

    return load_object(path.parent)


CUBE_FACES = (
    *("1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2"),
    *("3 4 8", "3 8 7", "1 3 7", "1 7 5", "2 6 8", "2 8 4"),
)
CUBE_OBJ = "".join(
    [f"v {x} {y} {z}\n" for x in (0, 30) for y in (0, 30) for z in (0, 30)]
    + [f"f {face}\n" for face in CUBE_FACES]
)

CUBE_URDF = """<robot name="cube"><link name="a"><visual><origin xyz="0 0 0.1" rpy="0 0 1"/>
<geometry><box size="0.03 0.03 0.03"/></geometry></visual></link><link name="b"><collision>
<geometry><cylinder radius="0.01" length="0.05"/></geometry></collision></link>
<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>
"""


def _box(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        import trimesh

        trimesh.creation.box(extents=(30.0, 40.0, 50.0)).export(folder / name)
        return folder / name

    return make


def _read_mesh(path: Path) -> object:
    from tacgen.objects.mesh_import import import_surface

    return import_surface(path)


def _added_object(pattern: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        from tacgen.objects.add import MeshFacts, add_object

        added = add_object(_box("box.stl")(folder), MeshFacts(0.1), into=folder)
        (path,) = added.object.folder.glob(pattern)
        return path

    return make


PRESS_LOG = "trial,time_s,force_normal_n,volume_mm3,operator\n" + "".join(
    f"{k // 4},{0.1 * k:.2f},{k % 4 + 0.5},{10.0 * (k % 4):.3f},ann\n" for k in range(20)
)

LAB_LOG = "# rig 2\nTimestamp;Press #;Fz [mN];Depth [mm]\n" + "".join(
    f"2024-03-05 10:00:{k:02d},50;P{k // 10};{k % 10 * 300},5;0,{k % 10}\n" for k in range(30)
)


def _read_depth_log(path: Path) -> object:
    from tacgen.presses.press_log import read_press_log

    return read_press_log(path, radius_mm=4.0)


def _make_parquet(folder: Path) -> Path:
    import io

    import pandas as pd

    pd.read_csv(io.StringIO(PRESS_LOG)).to_parquet(folder / "log.parquet")
    return folder / "log.parquet"


def _read_press_log(path: Path) -> object:
    from tacgen.presses.press_log import read_press_log

    return read_press_log(path)


def _presses(spoiled: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        image = np.random.default_rng(0).integers(90, 120, (24, 32, 3), dtype=np.uint8)
        for name in ("background.png", "a.png", "b.png"):
            cv2.imwrite(str(folder / name), image)
        (folder / "presses.csv").write_text("file,radius_mm\na.png,2\nb.png,2\n")
        (folder / "sensor.yaml").write_text("mm_per_px: 0.5\n")
        return folder / spoiled

    return make


def _read_presses(path: Path) -> object:
    from tacgen.presses.press_folder import read_presses

    return read_presses(path if path.suffix == ".npz" else path.parent)


def _force_images(spoiled: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        _presses(spoiled)(folder)
        lines = ["file,trial,time_s,force_normal_n,radius_mm", "a.png,0,0.5,1.5,2", "b.png,1,2,3,2"]
        (folder / "presses.csv").write_text("\n".join(lines) + "\n")
        sensor = "mm_per_px: 0.5\ndome_radius_mm: 30\nmarkers: {pitch_mm: 1.5}\n"
        (folder / "sensor.yaml").write_text(sensor)
        return folder / spoiled

    return make


def _read_force_images(path: Path) -> object:
    from tacgen.presses.press_folder import WITH_FORCES, read_press_folder

    found = read_press_folder(path.parent, WITH_FORCES)
    return [found.picture(k) for k in range(len(found.table))]


def _make_datapack(folder: Path) -> Path:
    image = np.random.default_rng(0).integers(90, 120, (24, 32, 3), dtype=np.uint8)
    np.savez(
        folder / "dataPack.npz",
        f0=image,
        imgs=np.stack([image, image]),
        touch_center=np.array([[12.0, 16.0], [10.0, 9.0]]),
        touch_radius=np.array([4.0, 5.0]),
        names=np.array(["a", "b"]),
        img_size=np.array([24, 32]),
    )
    return folder / "dataPack.npz"


def _make_table(folder: Path) -> Path:
    from tacgen.optics import save_table
    from tests.small_world import slope_table

    save_table(slope_table((24, 32), 0.3), folder / "table.npz")
    return folder / "table.npz"


def _read_table(path: Path) -> object:
    from tacgen.optics import load_table

    return load_table(path)


def _make_polycalib(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    names = ("grad_r", "grad_g", "grad_b")
    np.savez(
        folder / "polycalib.npz", bins=20, **{name: rng.normal(size=(20, 20, 6)) for name in names}
    )
    np.save(folder / "bg.npy", np.full((24, 32, 3), 110.0))
    return folder / "polycalib.npz"


def _read_polycalib(path: Path) -> object:
    from tacgen.calibrate.lookup.taxim_import import import_polycalib

    return import_polycalib(path, path.parent / "bg.npy", 0.1)


def _make_sensor(folder: Path) -> Path:
    from tests.small_world import write_world

    write_world(folder)
    return folder / "recipes/sensors/coarse.yaml"


def _read_sensor(path: Path) -> object:
    from tacgen.core.sensors import load_sensor

    return load_sensor(str(path))


LAW = """
law: volume_linear
k_n_mm3_per_n: {value: 8.0, stderr: 0.1}
k_s_mm_per_n: {value: 0.5, stderr: 0.01}
marker_pitch_mm: 1.5
effects: []
provenance: {}
"""


def _read_law(path: Path) -> object:
    from tacgen.contact import load_law

    return load_law(path)


def _make_real_grasps(folder: Path) -> Path:
    lines = ["grasp_id,object,force_n,x_mm,y_mm,z_mm,label", "g0,cup,5,0,0,40,1"]
    (folder / "grasps.csv").write_text("\n".join([*lines, "g1,cup,2.5,1,-1,42.5,0"]) + "\n")
    for grasp in ("g0", "g1"):
        (folder / "images" / grasp).mkdir(parents=True)
        cv2.imwrite(str(folder / f"images/{grasp}/0.png"), np.full((8, 8, 3), 99, np.uint8))
    return folder / "grasps.csv"


def _read_real_grasps(path: Path) -> object:
    from tacgen.dataset.real_grasps import read_real_grasps

    return read_real_grasps(path.parent)


def _make_real_image(folder: Path) -> Path:
    _make_real_grasps(folder)
    return folder / "images/g0/0.png"


def _dataset(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        from tests.dataset.conftest import TOUCH, collect_toy, make_spec

        collect_toy(folder / "data", make_spec(n_grasps=4, **TOUCH)).merge()
        return folder / "data" / name

    return make


def _read_shard(path: Path) -> object:
    """As from a stranger, whose manifest vouches for whatever there is."""
    from tacgen.core.files import sha256_of
    from tacgen.dataset import Dataset

    line = path.with_suffix(".json")
    said = json.loads(line.read_text())
    told = said | {"sha256": sha256_of(path), "bytes": path.stat().st_size}
    line.write_text(json.dumps(told))
    return list(Dataset(path.parents[1], partial=True))


def _read_dataset(path: Path) -> object:
    from tacgen.dataset import Dataset
    from tacgen.dataset.verify import verify

    root = path.parent if path.parent.name == "data" else path.parents[1]
    verify(root)
    return Dataset(root, partial=True)


def _read_dataset_recipe(path: Path) -> object:
    """Shown by the page, and compared with where another recipe is refused."""
    from tacgen.dataset import DatasetFolder
    from tacgen.dataset.gallery import write_gallery
    from tests.dataset.conftest import make_spec

    write_gallery(path.parent)
    DatasetFolder(path.parent).prepare(make_spec(n_grasps=4, recipe={"name": "another"}))
    return path


def _make_jobs(folder: Path) -> Path:
    from tacgen.cluster.records import JobsFolder, Submission, Task, write_record

    jobs = JobsFolder(folder).create()
    path = jobs / "submission.json"
    write_record(path, Submission("slurm", "here", (Task(0, "7_0", (0, 1)),)))
    return path


def _read_jobs(path: Path) -> object:
    from tacgen.cluster.records import JobsFolder, read_note

    read_note(path)
    return JobsFolder(path.parents[2]).submissions()


READERS = {
    "recipe": Reader(_shipped("stability.yaml"), _read_recipe),
    "training recipe": Reader(_shipped("train_single.yaml"), _read_train_recipe),
    "rig recipe": Reader(_shipped("rig_two_effects.yaml"), _read_rig_recipe),
    "study": Reader(_shipped("paper_table.yaml"), _read_study),
    "object folder": Reader(_make_object, _read_object),
    "mesh urdf": Reader(_text("cube.urdf", CUBE_URDF), _read_mesh),
    "mesh obj": Reader(_text("cube.obj", CUBE_OBJ), _read_mesh),
    "mesh stl": Reader(_box("box.stl"), _read_mesh),
    "mesh ply": Reader(_box("box.ply"), _read_mesh),
    "mesh glb": Reader(_box("box.glb"), _read_mesh),
    "added surface": Reader(_added_object("*.ply"), _read_object),
    "added parts": Reader(_added_object("*.npz"), _read_object),
    "press log csv": Reader(_text("log.csv", PRESS_LOG), _read_press_log),
    "press log of a lab": Reader(_text("lab.csv", LAB_LOG), _read_depth_log),
    "press log parquet": Reader(_make_parquet, _read_press_log),
    "press list": Reader(_presses("presses.csv"), _read_presses),
    "press image": Reader(_presses("a.png"), _read_presses),
    "press sensor": Reader(_presses("sensor.yaml"), _read_presses),
    "force images": Reader(_force_images("presses.csv"), _read_force_images),
    "force images' sensor": Reader(_force_images("sensor.yaml"), _read_force_images),
    "sensor": Reader(_make_sensor, _read_sensor),
    "dataPack": Reader(_make_datapack, _read_presses),
    "lookup table": Reader(_make_table, _read_table),
    "polycalib": Reader(_make_polycalib, _read_polycalib),
    "contact law": Reader(_text("contact.yaml", LAW), _read_law),
    "real grasps": Reader(_make_real_grasps, _read_real_grasps),
    "shard": Reader(_dataset("shards/shard-00000.h5"), _read_shard),
    "manifest": Reader(_dataset("manifest.jsonl"), _read_dataset),
    "shard's line": Reader(_dataset("shards/shard-00000.json"), _read_dataset),
    "dataset plan": Reader(_dataset("dataset.json"), _read_dataset),
    "dataset recipe": Reader(_dataset("recipe.yaml"), _read_dataset_recipe, sound=False),
    "batch jobs": Reader(_make_jobs, _read_jobs),
    "gripper": Reader(foreign.make_gripper, foreign.read_gripper),
    "presses to follow": Reader(foreign.make_followed_presses, foreign.read_followed_presses),
    "polycalib's background": Reader(foreign.make_background, foreign.read_background),
    "real grasps' origin": Reader(foreign.make_about, foreign.read_about),
    **{
        name: Reader(foreign.make_layout(name), foreign.read_layout(name))
        for name in foreign.LAYOUTS
    },
}
LEARNED = {
    "checkpoint": Reader(learned.make_checkpoint, learned.read_checkpoint),
    "model": Reader(learned.make_model, learned.read_model, sound=False),
    "weights": Reader(learned.make_weights, learned.read_weights),
    "training run": Reader(learned.make_run, learned.read_run),
    "training metrics": Reader(learned.make_metrics, learned.read_metrics),
    "real grasps' image": Reader(_make_real_image, learned.read_real_images),
}
"""Those that need PyTorch."""
READERS |= LEARNED
