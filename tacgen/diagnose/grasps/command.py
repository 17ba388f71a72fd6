"""``tacgen diagnose grasps``: traces mislabels of simulated grasps to wrong figures."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from tacgen.collection import perturbed
from tacgen.collection.recipe import Recipe
from tacgen.collection.recipe_inputs import recipe_inputs
from tacgen.core.files import refuse_foreign, refuse_other_page, sha256_of, write_text
from tacgen.core.records import AXES
from tacgen.core.types import FloatArray, IntArray
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps
from tacgen.diagnose.grasps.force_from_images import force_from_images
from tacgen.diagnose.grasps.model_comparison import (
    FAILED,
    NO_READING,
    SLID,
    SUCCESS,
    TURNED,
    Cause,
    Labels,
    ModelComparison,
    posterior,
)
from tacgen.diagnose.grasps.next_grasps import Proposal, competing_explanations, propose_grasps
from tacgen.diagnose.grasps.perturbed_simulations import (
    DECLARED,
    PerturbedSimulations,
    Show,
    combined_perturbation,
)
from tacgen.diagnose.grasps.result import GraspDiagnosis, diagnose_labels, diagnosis_record
from tacgen.diagnose.record import write_record
from tacgen.diagnose.rules import GRASPS

PLACE = ("object", *AXES)
_KNOWN_MODE = {"rotational_slip": TURNED, "translational_slip": SLID}


@dataclass(frozen=True)
class GraspFindings:
    """A diagnosis with what is needed to act on it: labels (N,) simulated after it, next grasps."""

    diagnosis: GraspDiagnosis
    simulated_after: IntArray
    proposals: tuple[Proposal, ...]
    recipe: Recipe


def diagnose_grasps(
    recipe: Recipe,
    real: RealGrasps,
    out: Path,
    *,
    workers: int,
    show: Show = lambda done, total: None,
) -> GraspFindings:
    """Trace the mislabels of simulated grasps to wrong figures of the declared simulation.

    Finished simulations in ``out`` are kept and used again.

    Raises ``DatasetError`` if a real grasp asks for a force that the recipe's gripper cannot give.
    """
    results = ("diagnosis.json", "recipe.yaml", "next_grasps.csv", "report.html")
    refuse_foreign(out, perturbed.OUTCOMES, results)
    refuse_other_page(out / "report.html", "diagnose grasps")
    perturbed.check_forces(recipe, real)
    configs = tuple(grasp.config for grasp in real.grasps)
    simulations = PerturbedSimulations(recipe, configs, out, workers, show)
    comparison = simulations.comparison()
    reading, about = force_from_images(recipe, real, show)
    labels = replace(labels_of(real.grasps), reading=reading)
    comparison = refine(simulations, comparison, labels)
    rng = np.random.default_rng(np.random.SeedSequence(recipe.seed, spawn_key=(0x67,)))
    found = posterior(comparison, labels, rng)
    names = list(real.by_object())
    before, after = (
        simulations.labels({name: combined_perturbation(causes, name) for name in names})
        for causes in ((), found.found)
    )
    diagnosis = diagnose_labels(
        comparison,
        labels,
        found,
        before,
        _covariates(real.grasps),
        rng,
    )
    notes = tuple(_notes(recipe, real, simulations.outcomes(DECLARED)))
    diagnosis = replace(diagnosis, notes=notes, reading=about)
    findings = GraspFindings(
        diagnosis,
        after,
        propose_grasps(simulations, competing_explanations(found)),
        extended_recipe(recipe, found.found, names),
    )
    inputs = {
        "grasps": sha256_of(real.folder / "grasps.csv"),
        **recipe_inputs(recipe, names).sha256,
    }
    _write(findings, record_of(findings, recipe, names) | {"inputs": inputs}, out)
    return findings


def extended_recipe(recipe: Recipe, found: Sequence[Cause], objects: Sequence[str]) -> Recipe:
    """The recipe with everything that was found, for ``tacgen collect``.

    Objects that were grasped but are not in the recipe are added to it, so that what was found
    about them is not lost.
    """
    if not found:
        return recipe
    names = dict.fromkeys([*(entry.object_name for entry in recipe.objects), *objects])
    entries = [
        perturbed.perturbed_entry(recipe.entry_of(name), combined_perturbation(found, name))
        for name in names
    ]
    before = recipe.physics_settings
    after = perturbed.perturbed_settings(before, combined_perturbation(found, ""))
    return recipe.model_copy(
        update={
            "name": f"{recipe.name}_extended",
            "objects": tuple(entries),
            "physics": replace(
                recipe.physics,
                **{
                    field.name: getattr(after, field.name)
                    for field in fields(after)
                    if getattr(after, field.name) != getattr(before, field.name)
                },
            ),
        }
    )


def refine(
    simulations: PerturbedSimulations, comparison: ModelComparison, labels: Labels
) -> ModelComparison:
    """Simulate the leading explanations about their own values, which moves them, a few times."""
    for _ in range(GRASPS.refining_rounds):
        explanations = comparison.explanations(labels)
        least = explanations[0].gain - GRASPS.leading_gain
        comparison = simulations.refined([one for one in explanations if one.gain > least])
    return comparison


def labels_of(grasps: Sequence[RealGrasp]) -> Labels:
    """What is known of real grasps; where any failure names its mode, the others' are unknown."""
    known = [
        SUCCESS if grasp.label == 1 else _KNOWN_MODE.get(grasp.failure_mode, FAILED)
        for grasp in grasps
    ]
    modes = any(grasp.failure_mode for grasp in grasps)
    return Labels(np.array(known), np.full(len(known), modes), NO_READING)


def record_of(findings: GraspFindings, recipe: Recipe, objects: Sequence[str]) -> dict[str, Any]:
    """The content of ``diagnosis.json``."""
    declared = {name: perturbed.recipe_object(recipe.entry_of(name)) for name in objects}
    record = diagnosis_record(findings.diagnosis, declared)
    channel = record["channels"]["grasp"]
    wrong = findings.simulated_after != findings.diagnosis.real
    channel["simulated_again"] = {
        "mislabels": int(wrong.sum()),
        "rate": float(wrong.mean()),
        "how": "all grasps simulated with what was found",
    }
    channel["next_grasps"] = [
        _place(one) | {"success": {name: round(p, 3) for name, p in one.success.items()}}
        for one in findings.proposals
    ]
    return record


def _place(proposal: Proposal) -> dict[str, Any]:
    return {name: getattr(proposal.config, name) for name in PLACE}


def _write(findings: GraspFindings, record: dict[str, Any], out: Path) -> None:
    write_record(record, out)
    resolved = findings.recipe.resolved(out)
    recipe = yaml.safe_dump(resolved, sort_keys=False, allow_unicode=True)
    write_text(out / "recipe.yaml", recipe)
    rows = [{"grasp_id": f"next{k}"} | _place(one) for k, one in enumerate(findings.proposals)]
    table = pd.DataFrame(rows, columns=["grasp_id", *PLACE])
    write_text(out / "next_grasps.csv", table.to_csv(index=False))


def _covariates(grasps: Sequence[RealGrasp]) -> dict[str, FloatArray]:
    found = {n: np.array([getattr(g.config, n) for g in grasps], float) for n in PLACE[1:]}
    return found | {"order": np.arange(len(grasps), dtype=float)}


def _notes(recipe: Recipe, real: RealGrasps, declared: Sequence[perturbed.Outcome]) -> list[str]:
    """What the reader should know about the data."""
    notes = list(real.warnings)
    if len(real.grasps) < GRASPS.few_grasps:
        notes.append(
            f"{len(real.grasps)} grasps only: they show a large error of the simulation, not a "
            "small one; 20 to 40 grasps near the thresholds do"
        )
    known = {entry.object_name for entry in recipe.objects}
    notes += [
        f"the recipe does not name {name}; it is accepted as its object.yaml declares it"
        for name in real.by_object()
        if name not in known
    ]
    notes += perturbed.unexecuted_note(real.grasps, declared, "count as mislabels")
    if any(recipe.randomize.model_dump().values()):
        notes.append("a diagnosis ignores the recipe's domain randomisation")
    return notes
