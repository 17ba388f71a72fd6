"""``tacgen diagnose grasps``: real labels against simulated worlds, and what the declared lacks."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from tacgen.collection.perturbed import Outcome, check_forces, words_about_unexecuted
from tacgen.collection.pipeline import recipe_object
from tacgen.collection.recipe import Recipe
from tacgen.core.files import write_text
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.diagnose.grasps.extended_recipe import extended_recipe, write_extended_recipe
from tacgen.diagnose.grasps.hypothesis import FAILED, NO_READING, SLID, SUCCESS, TURNED
from tacgen.diagnose.grasps.images import force_from_images
from tacgen.diagnose.grasps.model_comparison import (
    Choice,
    Contest,
    Labels,
    Standing,
    choose,
    confirmed,
)
from tacgen.diagnose.grasps.next_grasps import Proposal, propose_grasps, rivals_of
from tacgen.diagnose.grasps.perturbed_worlds import (
    DECLARED,
    GraspWorlds,
    combined_world,
    declared_object,
)
from tacgen.diagnose.grasps.result import FEW, GraspDiagnosis, diagnose_labels
from tacgen.diagnose.grasps.result_json import diagnosis_record

Show = Callable[[int, int], None]
LEADING = 5.0
"""Names whose log-evidence is within this of the best are simulated about their own values."""
MOST_REFINED, N_ROUNDS = 3, 3
_KNOWN_MODE = {"rotational_slip": TURNED, "translational_slip": SLID}


@dataclass(frozen=True)
class GraspFindings:
    """A diagnosis with what is needed to act on it: labels (N,) simulated after it, next grasps."""

    diagnosis: GraspDiagnosis
    simulated_after: NDArray[np.int64]
    proposals: tuple[Proposal, ...]
    recipe: Recipe


def diagnose_grasps(
    recipe: Recipe,
    real: RealGrasps,
    out: Path,
    *,
    workers: int,
    show: Callable[[str], Show] = lambda what: lambda done, total: None,
) -> GraspFindings:
    """Trace the mislabels of simulated grasps to what the declared world lacks.

    Finished simulations in ``out`` are kept and used again.

    Raises
    ------
    DatasetError
        If a real grasp asks for a force that the recipe's gripper cannot give.
    """
    check_forces(recipe, real)
    configs = tuple(grasp.config for grasp in real.grasps)
    worlds = GraspWorlds(recipe, configs, out, workers, show)
    contest = worlds.contest()
    reading, about = force_from_images(recipe, real, out / "imprints.json", show("images"))
    labels = labels_of(real.grasps)
    labels = Labels(labels.known, labels.modes, reading)
    contest = refine(worlds, contest, labels)
    rng = np.random.default_rng(np.random.SeedSequence(recipe.seed, spawn_key=(0x67,)))
    steps, simulated = choose_confirmed(worlds, contest, labels, rng)
    diagnosis = diagnose_labels(
        contest,
        labels,
        steps,
        simulated[0],
        _covariates(real.grasps),
        _notes(recipe, real, worlds.outcomes(DECLARED)),
        rng,
        reading=about,
    )
    objects = list(real.by_object())
    after = simulated[len(diagnosis.found)]
    rivals = rivals_of(diagnosis.steps[0].standings, bool(diagnosis.found))
    findings = GraspFindings(
        diagnosis,
        after,
        propose_grasps(worlds, rivals),
        extended_recipe(recipe, diagnosis.found, objects),
    )
    _write(findings, recipe, objects, out)
    return findings


def refine(worlds: GraspWorlds, contest: Contest, labels: Labels) -> Contest:
    """Simulate the leading candidates about their own values, which moves them, a few times."""
    for _ in range(N_ROUNDS):
        leading = _leading(contest.standings(labels))
        if not leading:
            break
        contest = worlds.refined(leading)
    return contest


def choose_confirmed(
    worlds: GraspWorlds, contest: Contest, labels: Labels, rng: np.random.Generator
) -> tuple[list[Choice], list[NDArray[np.int64]]]:
    """The choice, and labels (N,) simulated with none, one, two … of what it took."""
    steps = choose(contest, labels, rng)
    taken = [step.standings[0] for step in steps if step.taken]
    names = {config.object for config in worlds.configs}
    simulated = [
        worlds.labels({name: combined_world(taken[:count], name) for name in names})
        for count in range(len(taken) + 1)
    ]
    real = labels.success.astype(np.int64)
    mislabels = [int((one != real).sum()) for one in simulated]
    return confirmed(steps, mislabels), simulated


def labels_of(grasps: Sequence[RealGrasp]) -> Labels:
    """What is known of real grasps; where any failure names its mode, the others' are unknown."""
    known = [
        SUCCESS if grasp.label == 1 else _KNOWN_MODE.get(grasp.failure_mode, FAILED)
        for grasp in grasps
    ]
    modes = any(grasp.failure_mode for grasp in grasps)
    return Labels(np.array(known), np.full(len(known), modes), NO_READING)


def record_of(findings: GraspFindings, recipe: Recipe, objects: Sequence[str]) -> dict:
    """The content of ``diagnosis.json``."""
    record = diagnosis_record(
        findings.diagnosis, {name: _declared_values(recipe, name) for name in objects}
    )
    channel = record["channels"]["grasp"]
    wrong = findings.simulated_after != findings.diagnosis.real
    channel["simulated_again"] = {
        "mislabels": int(wrong.sum()),
        "rate": float(wrong.mean()),
        "how": "all grasps simulated in the world that was found",
    }
    channel["next_grasps"] = [
        {
            "object": one.config.object,
            "force_n": one.config.force_n,
            "x_mm": one.config.x_mm,
            "y_mm": one.config.y_mm,
            "z_mm": one.config.z_mm,
            "yaw_rad": one.config.yaw_rad,
            "success": {name: round(p, 3) for name, p in one.success.items()},
        }
        for one in findings.proposals
    ]
    return record


def _leading(standings: Sequence[Standing]) -> list[Standing]:
    best = standings[0].gain
    if best <= 0:
        return []
    return [s for s in standings if s.gain > max(0.0, best - LEADING)][:MOST_REFINED]


def _write(findings: GraspFindings, recipe: Recipe, objects: Sequence[str], out: Path) -> None:
    text = json.dumps(record_of(findings, recipe, objects), indent=2, ensure_ascii=False)
    write_text(out / "diagnosis.json", text + "\n")
    write_extended_recipe(findings.recipe, out / "recipe.yaml")
    names = ["object", "force_n", "x_mm", "y_mm", "z_mm", "yaw_rad"]
    rows = [
        {"grasp_id": f"next{k}"} | {name: getattr(one.config, name) for name in names}
        for k, one in enumerate(findings.proposals)
    ]
    table = pd.DataFrame(rows, columns=["grasp_id", *names])
    write_text(out / "next_grasps.csv", table.to_csv(index=False))


def _declared_values(recipe: Recipe, name: str) -> dict[str, float]:
    grasped = recipe_object(declared_object(recipe, name))
    return {
        "mass_factor": grasped.mass_kg,
        "friction_factor": grasped.friction,
        "spinning_friction_factor": grasped.spinning_friction_mm,
    }


def _covariates(grasps: Sequence[RealGrasp]) -> dict[str, NDArray[np.float64]]:
    names = ("force_n", "x_mm", "y_mm", "z_mm", "yaw_rad")
    found = {name: np.array([getattr(g.config, name) for g in grasps], float) for name in names}
    return found | {"order": np.arange(len(grasps), dtype=float)}


def _notes(recipe: Recipe, real: RealGrasps, declared: Sequence[Outcome]) -> list[str]:
    """What the reader should know about the data."""
    notes = list(real.warnings)
    if len(real.grasps) < FEW:
        notes.append(
            f"{len(real.grasps)} grasps only: a large error of the world can be seen, a small one "
            "cannot; 20 to 40 grasps about the thresholds tell"
        )
    known = {entry.name for entry in recipe.objects}
    notes += [
        f"the recipe does not name {name}; it is taken as its object.yaml declares it"
        for name in real.by_object()
        if name not in known
    ]
    notes += words_about_unexecuted(real.grasps, declared, "count as mislabels there")
    if any(recipe.randomize.model_dump().values()):
        notes.append("the recipe's domain randomisation is left out of a diagnosis")
    return notes
