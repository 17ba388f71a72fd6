"""Collecting, training and testing the rows of a study, and the table of the results.

The folder of a study holds the datasets, the runs and ``table.json``, which keeps finished rows.
"""

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacgen.collection.friction import friction_json, mu_range, sweep_friction
from tacgen.collection.recipe import Recipe
from tacgen.collection.recipe_inputs import recipe_inputs
from tacgen.collection.run import collect
from tacgen.core.errors import LearningError, TacgenError
from tacgen.core.files import refuse_other_page, sha256_of_content, write_text
from tacgen.core.progress import print_status
from tacgen.dataset.input_hashes import changed_roles
from tacgen.dataset.real_grasps import read_real_grasps
from tacgen.learning.evaluate import evaluate
from tacgen.learning.intervals import over_seeds
from tacgen.learning.run_folder import read_json
from tacgen.learning.train import train
from tacgen.study.real_data import RealData, calibration_grasps, check_real_data
from tacgen.study.study_recipe import Row, Study, reductions, run_folder_name, with_rows
from tacgen.study.table import write_study

MU_VALUES = "0:1:0.05"
"""Friction coefficients tried for a row that calibrates friction; as ``tacgen friction`` does."""
TABLE = "table.json"
_FIX_TABLE = "remove it; finished datasets and runs stay and are not repeated"


def run_study(
    study: Study,
    out: Path,
    real: RealData,
    *,
    rows: Sequence[str] = (),
    quick: bool = False,
    workers: int = 1,
) -> dict[str, Any]:
    """Run the rows of a study; what is finished in ``out`` is not repeated.

    The table is written anew after each row; rows that earlier runs finished stay in it. ``rows``
    names those to run, all of them if empty. The result holds ``rows`` with the scores on simulated
    and, where given, real grasps, and ``problems`` of this run; it is also written as
    ``table.json``, ``table.md`` and ``index.html``.

    Raises ``TacgenError`` if what is given cannot be used, the folder holds another study or
    version, or rows of objects, a sensor or an engine that have changed since, or a row cannot be
    collected. A row that cannot be trained or tested keeps its
    ``problem`` in the table; ``check_finished`` raises it.
    """
    chosen = with_rows(study, rows)
    run = _StudyRun(study, out, real, quick, workers)
    refuse_other_page(out / "index.html", "study")
    run.refuse_changed_inputs()
    check_real_data(chosen, real, quick=quick)
    start_s = time.perf_counter()
    done: dict[str, dict[str, Any]] = {}
    result = run.write_table(done, 0.0)
    for row in chosen.rows:
        done[row.name] = run.run_row(row)
        result = run.write_table(done, time.perf_counter() - start_s)
    return result


def check_finished(result: Mapping[str, Any]) -> None:
    """Check that every row of this run was trained and tested.

    Raises ``LearningError``, which lists the rows that were not, and why.
    """
    if result["problems"]:
        first = (
            "not all rows could be trained and tested; fix these and run the same command again, "
            "what is finished stays:"
        )
        raise LearningError.from_problems([first, *result["problems"]])


@dataclass(frozen=True, slots=True)
class _StudyRun:
    study: Study
    out: Path
    real: RealData
    quick: bool
    workers: int

    def finished_rows(self) -> dict[str, dict[str, Any]]:
        """The rows of the table in the folder whose settings are still the study's, by name.

        Raises ``LearningError`` if the table is of another study, or of the other version of this
        one.
        """
        path = self.out / TABLE
        if not path.is_file():
            return {}
        table = read_json(path, _FIX_TABLE)
        rows = table.get("rows")
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            msg = f"{path}: is not a table as tacgen writes it; {_FIX_TABLE}"
            raise LearningError(msg)
        found = _title(table.get("study"), table.get("quick") is True)
        wanted = _title(self.study.name, self.quick)
        if found != wanted:
            msg = f"{self.out}: holds {found}, this is {wanted}; give another --out, or remove it"
            raise LearningError(msg)
        current = {self._settings_sha256(row): row.name for row in self.study.rows}
        kept = {str(row.get("settings_sha256")): row for row in rows}
        return {current[key]: row for key, row in kept.items() if key in current}

    def refuse_changed_inputs(self) -> None:
        """Raise a ``LearningError`` if a finished row was made with other inputs than now."""
        rows, problems = self.finished_rows(), []
        for row in self.study.rows:
            if made := rows.get(row.name, {}).get("inputs"):
                now = recipe_inputs(self.study.data_recipe(row, quick=self.quick)).sha256
                if roles := changed_roles(made, now):
                    problems.append(f"{row.name}: made with another {', '.join(roles)}")
        if problems:
            first = f"{self.out}: holds rows of another world; give another --out, or restore it:"
            raise LearningError.from_problems([first, *problems])

    def write_table(self, done: Mapping[str, Mapping[str, Any]], took_s: float) -> dict[str, Any]:
        """Write the rows that are done among those of earlier runs, in the study's order."""
        # Read anew each time: another process may have added rows meanwhile.
        found = self.finished_rows() | dict(done)
        rows = [row for row in self.study.rows if row.name in found]
        test = self.real.test
        simulated = test is not None and read_real_grasps(test, needs=()).is_simulated
        result = {
            "study": self.study.name,
            "description": self.study.description,
            "quick": self.quick,
            "reduced": reductions(self.study, rows) if self.quick else [],
            "notes": list(self.study.notes),
            "real": None if test is None else str(test),
            "real_is_simulated": simulated,
            "rows": [found[row.name] for row in rows],
            "problems": [
                f"{row['name']}: {text}"
                for row in done.values()
                for text in filter(None, (row["problem"], row["real_problem"]))
            ],
            "took_s": took_s,
        }
        write_text(self.out / TABLE, json.dumps(result, indent=1))
        if rows:
            write_study(result, self.out)
        return result

    def run_row(self, row: Row) -> dict[str, Any]:
        """Collect, train and test one row; its entry in the table."""
        recipe = self.study.data_recipe(row, quick=self.quick)
        training = self.study.train_recipe(row, quick=self.quick)
        friction: Mapping[str, Any] = {}
        inputs = recipe_inputs(recipe).sha256  # before anything is calibrated
        if row.calibrate_contact and self.real.contact is not None:
            contact = recipe.contact.model_copy(update={"file": str(self.real.contact)})
            recipe = recipe.model_copy(update={"contact": contact})
        if row.calibrate_friction and self.real.calibration is not None:
            friction = self._fitted_friction(recipe, self.real.calibration)
            recipe = _with_friction(recipe, friction)
        data = self.out / "data" / recipe.sha256()[:12]
        trained_as = self._first_trained_as(row).name
        place = self.out / "runs" / run_folder_name(trained_as)
        trainings = self.study.seeded(training, quick=self.quick)
        runs = [(one, place / f"seed_{one.seed}") for one in trainings]
        print_status(f"{row.name}: collecting into {data}")
        collected = collect(recipe, data, workers=self.workers)
        tested_on = data
        if row.test is not None:
            test = self.study.test_recipe(row, quick=self.quick)
            tested_on = self.out / "data" / test.sha256()[:12]
            print_status(f"{row.name}: collecting the grasps to test on into {tested_on}")
            collect(test, tested_on, workers=self.workers)
        result: dict[str, Any] = {
            "name": row.name,
            "published": row.published.model_dump(),
            "objects": [entry.object_name for entry in recipe.objects],
            "kind": training.model.kind,
            "networks_of": trained_as,
            "seeds": len(trainings),
            "contact_law": recipe.contact.law,
            "input_px": list(training.input.size_px),
            "epochs": training.training.epochs,
            "average_epochs": training.training.average_epochs,
            "weights": [],
            "training_grasps": {},
            "not_executed": collected.summary()["not_executed"],
            "contact_file": recipe.contact.file,
            "friction": {name: fit["mu"] for name, fit in friction.items()},
            "settings_sha256": self._settings_sha256(row),
            "inputs": dict(inputs),
            "problem": "",
            "real_problem": "",
        }
        try:
            for seeded, run in runs:
                models = train(seeded, data, run, workers=self.workers)["models"]
                result["weights"] = sorted({model["weights"] for model in models.values()})
                result["training_grasps"] = {
                    name: model["grasps_fit"] + model["grasps_validation"]
                    for name, model in models.items()
                }
            result["sim"] = over_seeds([evaluate(run, data=tested_on) for _, run in runs])
        except LearningError as error:
            # Such as grasps that all succeed: the other rows are still of use.
            print_status(f"{row.name}: {error}")
            return result | {"problem": str(error)}
        if self.real.test is not None:
            try:
                on_real = [evaluate(run, real=self.real.test) for _, run in runs]
                result["real"] = over_seeds(on_real)
            except TacgenError as error:
                print_status(f"{row.name}: {error}")
                result["real_problem"] = str(error)
        return result

    def _fitted_friction(self, recipe: Recipe, real: Path) -> Mapping[str, Any]:
        """μ of each object of the recipe, as ``tacgen friction`` finds it."""
        folder = self.out / "friction" / recipe.sha256()[:12]
        grasps = calibration_grasps(recipe, real)
        fits, _ = sweep_friction(recipe, grasps, mu_range(MU_VALUES), folder, workers=self.workers)
        return friction_json(fits)

    def _first_trained_as(self, row: Row) -> Row:
        """The first row of the study with these networks: rows tested on others share them."""
        wanted = self._trained_on(row)
        return next(one for one in self.study.rows if self._trained_on(one) == wanted)

    def _trained_on(self, row: Row) -> tuple[str, str, bool, bool]:
        """What the networks of a row depend on but their seeds."""
        data = self.study.data_recipe(row, quick=self.quick).sha256()
        train = self.study.train_recipe(row, quick=self.quick).sha256()
        return data, train, row.calibrate_friction, row.calibrate_contact

    def _settings_sha256(self, row: Row) -> str:
        """A hash of all settings of a row, before anything is calibrated."""
        seeds = self.study.n_seeds(quick=self.quick)
        test = [self.study.test_recipe(row, quick=self.quick).sha256()] if row.test else []
        return sha256_of_content([row.name, *self._trained_on(row), seeds, *test])


def _title(name: object, quick: bool) -> str:
    return f"the study {name!r}, {'reduced (--quick)' if quick else 'full'}"


def _with_friction(recipe: Recipe, friction: Mapping[str, Any]) -> Recipe:
    fitted = {name: {"friction": fit["mu"]} for name, fit in friction.items()}
    objects = [one.model_copy(update=fitted.get(one.object_name, {})) for one in recipe.objects]
    return recipe.model_copy(update={"objects": tuple(objects)})
