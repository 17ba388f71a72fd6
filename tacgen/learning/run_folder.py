"""The folder of a training run: its paths, its identity and its metrics."""

import contextlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, Field, ValidationError

from tacgen.core.errors import LearningError
from tacgen.core.files import (
    alone,
    disk_message,
    read_small_text,
    refuse_foreign,
    refuse_other_page,
    write_text,
)
from tacgen.core.resources import newer_problem
from tacgen.dataset.folder import differences
from tacgen.learning.training_recipe import TrainRecipe

SCHEMA = 1
MAX_JSON_BYTES = 64 << 20
"""Some hundred times what a run of twelve objects writes; larger files are not tacgen's."""


class ModelFolder:
    """One model's files: ``model.safetensors``, the best so far, ``checkpoint.pt``, the state to
    resume from, ``metrics.jsonl``, with a line an epoch, and the lock of who trains it.
    """

    def __init__(self, root: Path) -> None:
        self.root = Path(root)
        self.model_path = self.root / "model.safetensors"
        self.checkpoint_path = self.root / "checkpoint.pt"
        self.metrics_path = self.root / "metrics.jsonl"
        self.board_path = self.root / "tensorboard"
        self.report_path = self.root / "index.html"

    def read_metrics(self, *, up_to_epoch: int) -> list[dict[str, Any]]:
        """The lines of the first epochs; later ones belong to an epoch that was not finished.

        Raises ``LearningError`` if the file is broken.
        """
        try:
            lines = self.metrics_path.read_text(encoding="utf-8").splitlines()
            metrics = [json.loads(line) for line in lines if line.strip()]
            return [line for line in metrics if line["epoch"] <= up_to_epoch]
        except FileNotFoundError:
            return []
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            msg = f"{self.metrics_path}: broken ({error}); remove {self.root} to start again"
            raise LearningError(msg) from error

    def write_metrics(self, metrics: Sequence[Mapping[str, Any]]) -> None:
        """Write all lines, whole or not at all."""
        write_text(self.metrics_path, "".join(f"{json.dumps(line)}\n" for line in metrics))

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from training this model; removes unfinished files of killed ones.

        Raises ``LearningError`` if another process holds it.
        """
        self.root.mkdir(parents=True, exist_ok=True)
        doing = "training this model"
        with alone(self.root / ".lock", self.root, doing, LearningError) as held:
            if held:
                for partial in self.root.glob(".*.part"):
                    partial.unlink(missing_ok=True)
            yield


class _Model(BaseModel):
    objects: list[str]
    configurations: list[str]
    labels: list[int] = Field(default_factory=list)


class _Plan(BaseModel):
    schema_: Literal[1] = Field(alias="schema")
    recipe: TrainRecipe
    dataset: dict[str, Any]
    equal_ranges: dict[str, dict[str, list[tuple[float, float]]]] = Field(default_factory=dict)
    test_groups: list[str] = Field(default_factory=list)
    models: dict[str, _Model]


class RunFolder:
    """A run: one folder a model, and what they have in common in ``run.json``."""

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root)
        self.plan_path = self.root / "run.json"
        self.recipe_path = self.root / "recipe.yaml"
        self.summary_path = self.root / "train.json"
        self.eval_path = self.root / "eval.json"
        self.eval_report_path = self.root / "index.html"

    def model(self, name: str) -> ModelFolder:
        """The folder of one model."""
        return ModelFolder(self.root / "models" / name)

    def source_eval_path(self, source: str) -> Path:
        """``eval_sim.json`` or ``eval_real.json``: the last evaluation on that source."""
        return self.root / f"eval_{source}.json"

    def prepare(self, plan: Mapping[str, Any], recipe: Mapping[str, Any]) -> bool:
        """Make the folder ready for this run; True where it resumes a run.

        Raises ``LearningError`` if it holds one of another recipe or dataset, with what differs.
        """
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            for name in plan.get("models", ()):
                refuse_other_page(self.model(name).report_path, "train")
            resumes = self.plan_path.is_file()
            if resumes:
                self._refuse_another(plan)
            else:
                refuse_foreign(self.root, self.plan_path.name, [self.recipe_path.name])
                write_text(self.plan_path, json.dumps(dict(plan), indent=1))
            if not self.recipe_path.is_file():
                write_text(self.recipe_path, yaml.safe_dump(dict(recipe), sort_keys=False))
        except OSError as error:
            msg = disk_message(error, self.root, "give a folder that you may write to")
            raise LearningError(msg) from error
        return resumes

    def plan(self) -> dict[str, Any]:
        """The content of ``run.json``; raises ``LearningError`` if the folder is not a run's."""
        plan = read_json(self.plan_path, "give the folder that `tacgen train --out` made")
        if newer := newer_problem(plan.get("schema"), SCHEMA):
            msg = f"{self.plan_path}: {newer}"
            raise LearningError(msg)
        try:
            _Plan.model_validate(plan)
        except ValidationError as error:
            msg = f"{self.plan_path}: not of this version of tacgen; train the models again"
            raise LearningError(msg) from error
        return plan

    def recipe(self) -> TrainRecipe:
        """The run's recipe; raises ``LearningError`` if the folder is not a run's."""
        return TrainRecipe.model_validate(self.plan()["recipe"])

    def _refuse_another(self, plan: Mapping[str, Any]) -> None:
        made = self.plan()
        wanted = json.loads(json.dumps(dict(plan)))
        differing = {key for key in {*made, *wanted} if made.get(key) != wanted.get(key)}
        if differing:
            settings = differences(made.get("recipe"), wanted.get("recipe"), "recipe")
            others = sorted(differing - {"recipe", "recipe_sha256"})
            msg = (
                f"{self.root}: holds another run, which differs in "
                f"{'; '.join([*settings, *others])}; give another --out, or remove the folder"
            )
            raise LearningError(msg)


def read_json(path: Path, fix: str) -> dict[str, Any]:
    """Read a JSON object.

    Raises ``LearningError`` if there is none; the message ends with ``fix``.
    """
    try:
        content = json.loads(read_small_text(path, MAX_JSON_BYTES))
    except (OSError, ValueError, RecursionError) as error:
        msg = f"{path}: cannot be read ({error}); {fix}"
        raise LearningError(msg) from error
    if not isinstance(content, dict):
        msg = f"{path}: is not a JSON object as tacgen writes it; {fix}"
        raise LearningError(msg)
    return content
