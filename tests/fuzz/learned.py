"""The files of training and evaluation that somebody else may have made."""

from __future__ import annotations

import json
from pathlib import Path


def make_checkpoint(folder: Path) -> Path:
    import torch

    from tacgen.learning.checkpoint import save_state

    save_state(folder / "last.pt", {"epoch": 3, "weights": {"a": torch.zeros(5)}})
    return folder / "last.pt"


def read_checkpoint(path: Path) -> object:
    from tacgen.learning.checkpoint import load_state

    return load_state(path, ("epoch", "weights"))


def make_model(folder: Path) -> Path:
    import torch
    from safetensors.torch import save_file

    # Loaded before memory is measured: libraries are no part of what a file takes.
    import tacgen.learning.checkpoint  # noqa: F401

    save_file({"a": torch.zeros(7)}, folder / "model.safetensors", metadata={"card": "{}"})
    return folder / "model.safetensors"


def read_model(path: Path) -> object:
    from tacgen.learning.checkpoint import load_model

    return load_model(path)


def make_weights(folder: Path) -> Path:
    import torch

    torch.save({"conv1.weight": torch.zeros(3)}, folder / "resnet.pth")
    return folder / "resnet.pth"


def read_weights(path: Path) -> object:
    from tacgen.learning.backbone import read_weights

    return read_weights(path)


def make_run(folder: Path) -> Path:
    plan = {
        "schema": 1,
        "models": {"cup": {"objects": ["cup"], "configurations": ["cup 5 0 0 40 0"]}},
        "dataset": {"recipe_sha256": "ab" * 32},
        "recipe": {"name": "run", "seed": 1},
    }
    (folder / "run.json").write_text(json.dumps(plan))
    return folder / "run.json"


def read_run(path: Path) -> object:
    from tacgen.learning.run_folder import RunFolder

    run = RunFolder(path.parent)
    return run.plan(), run.recipe()


def make_metrics(folder: Path) -> Path:
    from tacgen.learning.run_folder import ModelFolder

    model = ModelFolder(folder)
    model.write_metrics([{"epoch": k, "loss": 1 / k} for k in (1, 2, 3)])
    return model.metrics_path


def read_metrics(path: Path) -> object:
    from tacgen.learning.run_folder import ModelFolder

    return ModelFolder(path.parent).read_metrics(up_to_epoch=2)


def read_real_images(path: Path) -> object:
    from tacgen.learning.grasps import RealGraspImages

    images = RealGraspImages(path.parents[2])
    return images.frames(0, [0]), images.reference
