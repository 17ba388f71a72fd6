"""Collecting, training and testing the rows of a study, and the table of what came out."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tacgen.collect import collect
from tacgen.dataset.real_grasps import read_real_grasps
from tacgen.errors import LearningError, TacgenError
from tacgen.files import write_text
from tacgen.friction import friction_json, mu_range, sweep_friction
from tacgen.learning.evaluate import evaluate
from tacgen.learning.progress import tell
from tacgen.learning.real_grasps import is_simulated
from tacgen.learning.recipe import TrainRecipe
from tacgen.learning.train import train
from tacgen.recipe import Recipe
from tacgen.study.recipe import Row, Study, run_folder_name
from tacgen.study.table import write_study

MU_VALUES = "0:1:0.05"


@dataclass(frozen=True, slots=True)
class Reality:
    """What is known of the real world: grasps to test on, others to calibrate on, a contact law.

    No grasp may be in both folders. ``contact`` is a ``contact.yaml`` of the real sensor.
    """

    test: Path | None = None
    calibration: Path | None = None
    contact: Path | None = None


def run_study(
    study: Study, out: Path, real: Reality, *, quick: bool = False, workers: int = 1
) -> dict[str, Any]:
    """Run every row of a study; what is finished in ``out`` is not done again.

    Returns
    -------
    dict
        ``rows`` with the scores on simulated and, where given, real grasps; also written as
        ``table.json``, ``table.md`` and ``table.html``.

    Raises
    ------
    TacgenError
        If a row cannot be collected, or none can be trained and tested; a row that cannot keeps
        its ``problem`` in the table.
    """
    _check_real(study, real)
    start_s = time.perf_counter()
    rows = [_run_row(study, row, out, real, quick, workers) for row in study.rows]
    problems = [f"{row['name']}: {row['problem']}" for row in rows if row["problem"]]
    if len(problems) == len(rows):
        raise LearningError.from_problems(problems)
    result = {
        "study": study.name,
        "description": study.description,
        "quick": quick,
        "notes": list(study.notes),
        "real": None if real.test is None else str(real.test),
        "stand_in": real.test is not None and is_simulated(real.test),
        "rows": rows,
        "took_s": time.perf_counter() - start_s,
    }
    write_text(out / "table.json", json.dumps(result, indent=1))
    write_study(result, out)
    return result


def _check_real(study: Study, real: Reality) -> None:
    if any(row.calibrate_friction for row in study.rows) and real.calibration is None:
        msg = (
            f"{study.name}: a row calibrates friction, which needs real grasps that are not "
            "tested on; give them with --calibrate-on DIR"
        )
        raise TacgenError(msg)
    if any(row.calibrate_contact for row in study.rows) and real.contact is None:
        msg = (
            f"{study.name}: a row takes the real sensor's contact law; give the contact.yaml that "
            "`tacgen calibrate contact` or `tacgen diagnose contact` wrote with --contact FILE"
        )
        raise TacgenError(msg)
    if real.test is None or real.calibration is None:
        return
    tested = {grasp.grasp_id for grasp in read_real_grasps(real.test).grasps}
    shared = tested & {grasp.grasp_id for grasp in read_real_grasps(real.calibration).grasps}
    if shared:
        msg = (
            f"{real.test} and {real.calibration} share grasps, such as {min(shared)}; "
            "calibrate on other grasps than those tested on"
        )
        raise TacgenError(msg)


def _run_row(
    study: Study, row: Row, out: Path, real: Reality, quick: bool, workers: int
) -> dict[str, Any]:
    data_recipe = study.data_recipe(row, quick=quick)
    train_recipe = study.train_recipe(row, quick=quick)
    friction: Mapping[str, Any] = {}
    if row.calibrate_contact and real.contact is not None:
        contact = data_recipe.contact.model_copy(update={"file": str(real.contact)})
        data_recipe = data_recipe.model_copy(update={"contact": contact})
    if row.calibrate_friction and real.calibration is not None:
        friction = _fitted_friction(data_recipe, real.calibration, out, workers)
        data_recipe = _with_friction(data_recipe, friction)
    data = out / "data" / data_recipe.sha256()[:12]
    run = out / "runs" / run_folder_name(row.name)
    tell(f"{row.name}: collects into {data}")
    collected = collect(data_recipe, data, workers=workers)
    result: dict[str, Any] = {
        "name": row.name,
        "published": row.published.model_dump(),
        "objects": [entry.name for entry in data_recipe.objects],
        "kind": train_recipe.model.kind,
        "contact_law": data_recipe.contact.law,
        "input_px": list(train_recipe.input.size_px),
        "epochs": train_recipe.training.epochs,
        "weights": [],
        "training_grasps": {},
        "not_executed": collected.summary()["not_executed"],
        "contact_file": data_recipe.contact.file,
        "friction": {name: fit["mu"] for name, fit in friction.items()},
        "problem": "",
    }
    try:
        return result | _learn(train_recipe, data, run, real.test, workers)
    except LearningError as error:
        # Such as grasps that all succeed: the other rows are worth having all the same.
        tell(f"{row.name}: {error}")
        return result | {"problem": str(error)}


def _learn(
    recipe: TrainRecipe, data: Path, run: Path, real: Path | None, workers: int
) -> dict[str, Any]:
    """Train a row's networks, test them, and what the table says of both."""
    models = train(recipe, data, run, workers=workers)["models"]
    learnt: dict[str, Any] = {
        "weights": sorted({model["weights"] for model in models.values()}),
        "training_grasps": {
            name: model["grasps_fit"] + model["grasps_validation"] for name, model in models.items()
        },
        "sim": evaluate(run, data=data),
    }
    if real is not None:
        learnt["real"] = evaluate(run, real=real)
    return learnt


def _fitted_friction(recipe: Recipe, real: Path, out: Path, workers: int) -> Mapping[str, Any]:
    """μ of each object of the recipe, as ``tacgen friction`` finds it."""
    folder = out / "friction" / recipe.sha256()[:12]
    found = read_real_grasps(real)
    wanted = {entry.name for entry in recipe.objects}
    missing = wanted - set(found.by_object())
    if missing:
        msg = (
            f"{real}: has no grasps of {', '.join(sorted(missing))}, whose friction is to be "
            "calibrated; add some, or take the objects out of the study"
        )
        raise TacgenError(msg)
    grasps = replace(found, grasps=tuple(g for g in found.grasps if g.config.object in wanted))
    fits, _ = sweep_friction(recipe, grasps, mu_range(MU_VALUES), folder, workers=workers)
    fitted = friction_json(fits)
    write_text(folder / "friction.json", json.dumps(fitted, indent=1))
    return fitted


def _with_friction(recipe: Recipe, friction: Mapping[str, Any]) -> Recipe:
    objects = tuple(
        entry.model_copy(update={"friction": friction[entry.name]["mu"]})
        if entry.name in friction
        else entry
        for entry in recipe.objects
    )
    return recipe.model_copy(update={"objects": objects})
