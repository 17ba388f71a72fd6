"""The friction sweep: simulate the real grasps at every μ and keep the μ that matches best."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.errors import RecipeError
from tacgen.files import write_text
from tacgen.friction_fit import FrictionFit, fit_friction
from tacgen.grasp_pipeline import recipe_object
from tacgen.physics import FrameRequest, GraspSimulator, run_grasp
from tacgen.randomize import with_friction
from tacgen.recipe import ObjectEntry, Recipe
from tacgen.records import GraspTrace
from tacgen.resources import find_object_folder
from tacgen.workers import Report, run_tasks

GRASP_LIMIT_S = 120.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """How one simulated grasp ended, and how far it was from ending otherwise."""

    label: int
    failure_mode: str
    translational_margin: float
    rotational_margin: float

    @classmethod
    def of(cls, trace: GraspTrace) -> Outcome:
        """The outcome of a trace; margins are NaN where the grasp was not executed."""
        margin = trace.margin
        return cls(
            trace.label,
            trace.failure_mode,
            margin.translational if margin else float("nan"),
            margin.rotational if margin else float("nan"),
        )


Key = tuple[str, float]
"""(grasp_id, μ)."""


def sweep_friction(
    recipe: Recipe,
    real: RealGrasps,
    mu_values: Sequence[float],
    out: Path,
    *,
    workers: int,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[dict[str, FrictionFit], dict[Key, Outcome]]:
    """Fit every object's friction to its real grasps; finished simulations in ``out`` are kept.

    Returns
    -------
    The fit of every object by name, and every simulated outcome.
    """
    outcomes = simulate_outcomes(recipe, real.grasps, mu_values, out, workers=workers, show=show)
    fits: dict[str, FrictionFit] = {}
    for number, (name, grasps) in enumerate(real.by_object().items()):
        labels = label_matrix(outcomes, grasps, mu_values)
        truth = np.array([grasp.label for grasp in grasps])
        rng = np.random.default_rng(np.random.SeedSequence(recipe.seed, spawn_key=(number,)))
        fits[name] = fit_friction(np.asarray(mu_values), labels, truth, rng)
    write_text(out / "friction.json", json.dumps(friction_json(fits), indent=2) + "\n")
    return fits, outcomes


def mu_range(text: str) -> tuple[float, ...]:
    """The values of μ that ``start:stop:step`` means, the end included.

    Raises
    ------
    RecipeError
        If the text is not of that form, or a value lies outside [0, 2].
    """
    try:
        start, stop, step = (float(part) for part in text.split(":"))
    except ValueError:
        start, stop, step = 0.0, -1.0, 1.0
    if not (0 <= start <= stop <= 2 and step > 0 and (stop - start) / step <= 1000):
        msg = f"--mu {text}: give start:stop:step within 0 to 2, such as 0:1:0.05"
        raise RecipeError(msg)
    count = int(np.floor((stop - start) / step + 1e-9)) + 1
    return tuple(round(start + k * step, 9) for k in range(count))


def write_object_copies(fits: Mapping[str, FrictionFit], folder: Path) -> None:
    """Copy each object's folder into ``folder`` with its friction replaced by the fitted one."""
    for name, fit in fits.items():
        target = folder / name
        shutil.copytree(find_object_folder(name), target, dirs_exist_ok=True)
        path = target / "object.yaml"
        low, high = fit.interval
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        content["friction"] = {
            "value": round(fit.mu, 6),
            "source": f"tacgen friction, {fit.n_grasps} real grasps, 95 % {low:.3g} to {high:.3g}",
        }
        write_text(path, yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def label_matrix(
    outcomes: Mapping[Key, Outcome], grasps: Sequence[RealGrasp], mu_values: Sequence[float]
) -> NDArray[np.int64]:
    """Simulated labels (M, N) of the grasps at every μ."""
    return np.array(
        [[outcomes[(grasp.grasp_id, mu)].label for grasp in grasps] for mu in mu_values]
    )


def friction_json(fits: Mapping[str, FrictionFit]) -> dict[str, object]:
    """The content of ``friction.json``."""
    return {
        name: {
            "mu": round(fit.mu, 6),
            "interval": [round(end, 6) for end in fit.interval],
            "mislabels": [
                [round(float(mu), 6), int(n)]
                for mu, n in zip(fit.mu_values, fit.mislabels, strict=True)
            ],
            "n_grasps": fit.n_grasps,
            "bounded": fit.bounded,
        }
        for name, fit in fits.items()
    }


def simulate_outcomes(
    recipe: Recipe,
    grasps: Sequence[RealGrasp],
    mu_values: Sequence[float],
    out: Path,
    *,
    workers: int,
    show: Callable[[int, int], None],
) -> dict[Key, Outcome]:
    """The outcome of every grasp at every μ, by (grasp_id, μ).

    A line of ``out/outcomes.jsonl`` is written as soon as a grasp has been simulated at every μ;
    a sweep that was interrupted goes on from there. The lines carry the hash of the recipe and
    are not used for another.
    """
    store = _Store(out / "outcomes.jsonl", recipe.sha256())
    outcomes = store.read()
    pending = [
        k
        for k, grasp in enumerate(grasps)
        if any((grasp.grasp_id, mu) not in outcomes for mu in mu_values)
    ]
    make_job = partial(_grasp_job, recipe, tuple(grasps), tuple(mu_values))
    done = len(grasps) - len(pending)
    show(done, len(grasps))
    for event in run_tasks(pending, make_job, workers=workers, item_limit_s=GRASP_LIMIT_S):
        if event.kind != "done":
            continue
        grasp = grasps[event.task]
        found = {(grasp.grasp_id, mu): one for mu, one in zip(mu_values, event.value, strict=True)}
        store.append(found)
        outcomes |= found
        done += 1
        show(done, len(grasps))
    return outcomes


@contextlib.contextmanager
def _grasp_job(
    recipe: Recipe, grasps: tuple[RealGrasp, ...], mu_values: tuple[float, ...]
) -> Iterator[Callable[[int, Mapping[int, str], Report], list[Outcome]]]:
    """One process: a task is one real grasp, its items are the values of μ."""
    entries = {entry.name: entry for entry in recipe.objects}
    settings = recipe.physics_settings
    built = lru_cache(maxsize=1)(recipe_object)
    with GraspSimulator(recipe.robot.name) as simulator:

        def job(task: int, crashed: Mapping[int, str], report: Report) -> list[Outcome]:
            grasp = grasps[task]
            name = grasp.config.object
            base = built(entries.get(name, ObjectEntry(name=name)))
            found = []
            for k, mu in enumerate(mu_values):
                item = task * len(mu_values) + k
                if item in crashed:
                    found.append(Outcome(-1, "", float("nan"), float("nan")))
                    continue
                report("start", item, None)
                trace = run_grasp(
                    simulator,
                    with_friction(base, mu),
                    replace(grasp.config, index=task),
                    settings,
                    frames=FrameRequest(),
                )
                found.append(Outcome.of(trace))
            return found

        yield job


class _Store:
    """Finished simulations on disk, a line each."""

    def __init__(self, path: Path, recipe_sha256: str) -> None:
        self._path = path
        self._recipe = recipe_sha256

    def read(self) -> dict[Key, Outcome]:
        """What is there of this recipe; a line cut short by a crash is passed over."""
        found: dict[Key, Outcome] = {}
        if not self._path.is_file():
            return found
        for line in self._path.read_text(encoding="utf-8").splitlines():
            try:
                data = json.loads(line)
                if data["recipe"] == self._recipe:
                    found[(data["grasp_id"], data["mu"])] = Outcome(*data["outcome"])
            except (ValueError, KeyError, TypeError):
                continue
        return found

    def append(self, outcomes: Mapping[Key, Outcome]) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            for (grasp_id, mu), one in outcomes.items():
                values = [
                    one.label,
                    one.failure_mode,
                    one.translational_margin,
                    one.rotational_margin,
                ]
                line = {
                    "recipe": self._recipe,
                    "grasp_id": grasp_id,
                    "mu": mu,
                    "outcome": values,
                }
                file.write(json.dumps(line) + "\n")
