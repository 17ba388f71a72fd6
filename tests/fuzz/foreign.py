"""Files of other projects' layouts, of rigs and of tools beside a dataset."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
import numpy as np

GEL = np.full((24, 32, 3), (90, 120, 150), np.uint8)


def _pictures(folder: Path, *names: str) -> None:
    rng = np.random.default_rng(0)
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / name), GEL + rng.integers(0, 20, GEL.shape, dtype=np.uint8))


def _gs_sdk(folder: Path) -> None:
    _pictures(folder, "background.png", *(f"p{k}/gelsight.png" for k in range(3)))
    for k in range(3):
        np.savez(folder / f"p{k}/label.npz", center=np.array([16.0, 12.0]), radius=4.0 + k)
    rows = "".join(f"p{k},8\n" for k in range(3))
    (folder / "catalog.csv").write_text(f"experiment_reldir,diameter(mm)\n{rows}")


def _py3dcal(folder: Path) -> None:
    _pictures(folder, "blank_images/blank.png", *(f"probe_images/{k}.png" for k in range(3)))
    (folder / "annotations").mkdir()
    rows = "".join(f"{k}.png,{k},1,0.{k + 3},{12 + k},10\n" for k in range(3))
    header = "img_name,x_mm,y_mm,penetration_depth_mm,x_px,y_px\n"
    (folder / "annotations/annotations.csv").write_text(header + rows)
    (folder / "annotations/metadata.json").write_text('{"px_per_mm": 5, "probe_radius_mm": 4}')


def _9dtact(folder: Path) -> None:
    _pictures(folder, "rectify_crop_ref.png", "rectify_crop_sample.png")


def _pretrain(folder: Path) -> None:
    import pandas as pd

    _pictures(folder, "a.png")
    image = (folder / "a.png").read_bytes()
    rows = [
        {"image": image, "indenter": "sphere", "indenter_param": str(12 - 5 * (k % 2)), "f_z": -k}
        for k in range(5)
    ]
    pd.DataFrame(rows).to_parquet(folder / "train-00000.parquet")


def _poseit(folder: Path) -> None:
    grasp = folder / "mug_1612630172_F80_pose8"
    _pictures(grasp, *(f"gelsight/gelsight_{k}_{100 + k}.jpg" for k in range(4)))
    (grasp / "stages.csv").write_text("phase,unix_timestamp\napproach,90\ngrasping,100\npose,103\n")
    (grasp / "label.csv").write_text("phase,result\npose,pass\nshaking,slip\n")


def _feeling(folder: Path) -> None:
    import h5py

    with h5py.File(folder / "grasps.h5", "w") as file:
        group = file.create_group("data/i0")
        group.attrs["is_gripping"] = True
        group["object_name"] = np.array([b"mug"])
        for name in (f"gelsight{f}_{m}" for f in "AB" for m in ("before", "during", "after")):
            group[name] = GEL


LAYOUTS: Mapping[str, tuple[Callable[[Path], None], str]] = {
    "gs-sdk catalog": (_gs_sdk, "catalog.csv"),
    "gs-sdk label": (_gs_sdk, "p0/label.npz"),
    "py3dcal annotations": (_py3dcal, "annotations/annotations.csv"),
    "py3dcal metadata": (_py3dcal, "annotations/metadata.json"),
    "9dtact picture": (_9dtact, "rectify_crop_sample.png"),
    "gelsight-mini-pretrain": (_pretrain, "train-00000.parquet"),
    "poseit stages": (_poseit, "mug_1612630172_F80_pose8/stages.csv"),
    "poseit label": (_poseit, "mug_1612630172_F80_pose8/label.csv"),
    "feeling-of-success": (_feeling, "grasps.h5"),
}
"""What writes a layout, and the file in it to spoil; the format is the first word."""


def make_layout(name: str) -> Callable[[Path], Path]:
    write, spoiled = LAYOUTS[name]

    def make(folder: Path) -> Path:
        root = folder / "source"
        root.mkdir()
        write(root)
        return root / spoiled

    return make


def read_layout(name: str) -> Callable[[Path], object]:
    known = name if name.startswith("feeling") or name.endswith("pretrain") else name.split()[0]
    sized = {"mm_per_px": 0.1, "ball_radius_mm": 6.0} if known[:1] in "9g" else {}

    def read(path: Path) -> object:
        from tacgen.dataset.import_formats import GRASP_FORMATS, import_grasps
        from tacgen.presses.import_formats import import_presses

        source = next(parent for parent in path.parents if parent.name == "source")
        out = source.with_name("imported")
        try:
            if known in GRASP_FORMATS:
                return import_grasps(known, source, out)
            return import_presses(known, source, out, **sized)
        finally:
            shutil.rmtree(out, ignore_errors=True)

    return read


def make_gripper(folder: Path) -> Path:
    from tacgen.core.resources import packaged

    return Path(shutil.copy(packaged("recipes") / "grippers/wsg50.yaml", folder / "own.yaml"))


def read_gripper(path: Path) -> object:
    from tacgen.physics.gripper import load_gripper

    return load_gripper(path)


def make_followed_presses(folder: Path) -> Path:
    from tacgen.rig.schedule import PRESS_COLUMNS

    row = ",".join("ball" if name == "indenter" else "1.5" for name in PRESS_COLUMNS)
    (folder / "next_presses.csv").write_text(f"{','.join(PRESS_COLUMNS)}\n{row}\n{row}\n")
    return folder / "next_presses.csv"


def read_followed_presses(path: Path) -> object:
    from tacgen.rig.schedule import read_presses

    return read_presses(path, ["ball"])


def make_background(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    names = ("grad_r", "grad_g", "grad_b")
    np.savez(
        folder / "polycalib.npz", bins=20, **{name: rng.normal(size=(20, 20, 6)) for name in names}
    )
    np.save(folder / "bg.npy", np.full((24, 32, 3), 110.0))
    return folder / "bg.npy"


def read_background(path: Path) -> object:
    from tacgen.calibrate.lookup.taxim_import import import_polycalib

    return import_polycalib(path.parent / "polycalib.npz", path, 0.1)


def make_about(folder: Path) -> Path:
    lines = ["grasp_id,object,force_n,x_mm,y_mm,z_mm,label", "g0,cup,5,0,0,40,1"]
    (folder / "grasps.csv").write_text("\n".join(lines) + "\n")
    _pictures(folder, "images/g0/0.png")
    about = {"simulated": True, "taken_with": {"recipe_sha256": "ab" * 32}}
    (folder / "about.json").write_text(json.dumps(about))
    return folder / "about.json"


def read_about(path: Path) -> object:
    from tacgen.dataset.real_grasps import read_real_grasps

    return read_real_grasps(path.parent)
