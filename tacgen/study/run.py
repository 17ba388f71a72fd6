"""Collecting, training and testing the rows of a study, and the table of what came out."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tacgen.calibrate.friction.sweep import friction_json, mu_range, sweep_friction
from tacgen.collection.recipe import Recipe
from tacgen.collection.run import collect
from tacgen.core.errors import LearningError, TacgenError
from tacgen.core.files import write_text
from tacgen.core.progress import print_status
from tacgen.dataset.real_grasps import read_real_grasps
from tacgen.learning.evaluate import evaluate
from tacgen.learning.train import train
from tacgen.learning.training_recipe import TrainRecipe
from tacgen.study.reality import Reality, calibration_grasps, check_reality
from tacgen.study.record import RECORD, declaration_sha256, kept_rows
from tacgen.study.reduced import reductions
from tacgen.study.study_recipe import Row, Study, run_folder_name, with_rows
from tacgen.study.table import write_study

MU_VALUES = "0:1:0.05"


def run_study(
    study: Study,
    out: Path,
    real: Reality,
    *,
    rows: Sequence[str] = (),
    quick: bool = False,
    workers: int = 1,
) -> dict[str, Any]:
    """Run the rows of a study; what is finished in ``out`` is not done again.

    The table is written anew after each row; rows that earlier runs finished stay in it.

    Parameters
    ----------
    rows : sequence of str
        Names of the rows to run; all of them if empty.

    Returns
    -------
    dict
        ``rows`` with the scores on simulated and, where given, real grasps, and ``problems`` of
        this run; also written as ``table.json``, ``table.md`` and ``table.html``.

    Raises
    ------
    TacgenError
        If what is given cannot be used, the folder holds another study or version, or a row
        cannot be collected. A row that cannot be trained or tested keeps its ``problem`` in the
        table; ``check_finished`` raises it.
    """
    chosen = with_rows(study, rows)
    kept_rows(study, out, quick=quick)
    check_reality(chosen, real, quick=quick)
    start_s = time.perf_counter()
    done: dict[str, dict[str, Any]] = {}
    result = _write_table(study, out, real, done, quick, 0.0)
    for row in chosen.rows:
        done[row.name] = _run_row(study, row, out, real, quick, workers)
        result = _write_table(study, out, real, done, quick, time.perf_counter() - start_s)
    return result


def check_finished(result: Mapping[str, Any]) -> None:
    """See that every row of this run was trained and tested.

    Raises
    ------
    LearningError
        Lists the rows that were not, and why.
    """
    if result["problems"]:
        first = (
            "not all rows could be trained and tested; mend these and run the same command again, "
            "what is finished stays:"
        )
        raise LearningError.from_problems([first, *result["problems"]])


def _write_table(
    study: Study,
    out: Path,
    real: Reality,
    done: Mapping[str, Mapping[str, Any]],
    quick: bool,
    took_s: float,
) -> dict[str, Any]:
    """Write the rows that are done among those of earlier runs, in the study's order."""
    # Read anew each time: another process may have added rows meanwhile.
    found = kept_rows(study, out, quick=quick) | dict(done)
    told = [row for row in study.rows if row.name in found]
    result = {
        "study": study.name,
        "description": study.description,
        "quick": quick,
        "reduced": reductions(study, told) if quick else [],
        "notes": list(study.notes),
        "real": None if real.test is None else str(real.test),
        "real_is_simulated": real.test is not None and _is_simulated(real.test),
        "rows": [found[row.name] for row in told],
        "problems": [
            f"{row['name']}: {row[key]}"
            for row in done.values()
            for key in ("problem", "real_problem")
            if row[key]
        ],
        "took_s": took_s,
    }
    write_text(out / RECORD, json.dumps(result, indent=1))
    if told:
        write_study(result, out)
    return result


def _is_simulated(folder: Path) -> bool:
    return read_real_grasps(folder).recipe_sha256 is not None


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
    print_status(f"{row.name}: collects into {data}")
    collected = collect(data_recipe, data, workers=workers)
    result: dict[str, Any] = {
        "name": row.name,
        "published": row.published.model_dump(),
        "objects": [entry.name for entry in data_recipe.objects],
        "kind": train_recipe.model.kind,
        "contact_law": data_recipe.contact.law,
        "input_px": list(train_recipe.input.size_px),
        "epochs": train_recipe.training.epochs,
        "average_epochs": train_recipe.training.average_epochs,
        "weights": [],
        "training_grasps": {},
        "not_executed": collected.summary()["not_executed"],
        "contact_file": data_recipe.contact.file,
        "friction": {name: fit["mu"] for name, fit in friction.items()},
        "declaration_sha256": declaration_sha256(study, row, quick=quick),
        "problem": "",
        "real_problem": "",
    }
    try:
        result |= _trained(train_recipe, data, run, workers)
        result["sim"] = evaluate(run, data=data)
    except LearningError as error:
        # Such as grasps that all succeed: the other rows are worth having all the same.
        print_status(f"{row.name}: {error}")
        return result | {"problem": str(error)}
    return result if real.test is None else result | _tested_on_real(row, run, real.test)


def _trained(recipe: TrainRecipe, data: Path, run: Path, workers: int) -> dict[str, Any]:
    """Train a row's networks, and what the table says of them."""
    models = train(recipe, data, run, workers=workers)["models"]
    return {
        "weights": sorted({model["weights"] for model in models.values()}),
        "training_grasps": {
            name: model["grasps_fit"] + model["grasps_validation"] for name, model in models.items()
        },
    }


def _tested_on_real(row: Row, run: Path, real: Path) -> dict[str, Any]:
    """The row's scores on real grasps, or why there are none."""
    try:
        return {"real": evaluate(run, real=real)}
    except TacgenError as error:
        print_status(f"{row.name}: {error}")
        return {"real_problem": str(error)}


def _fitted_friction(recipe: Recipe, real: Path, out: Path, workers: int) -> Mapping[str, Any]:
    """μ of each object of the recipe, as ``tacgen friction`` finds it."""
    folder = out / "friction" / recipe.sha256()[:12]
    grasps = calibration_grasps(recipe, real)
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
