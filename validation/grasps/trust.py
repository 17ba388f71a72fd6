"""How far ``tacgen diagnose grasps`` can be trusted: simulations perturbed on purpose.

Real grasps are simulated with none, one or two wrong figures, and the diagnosis, which knows only
the declared simulation and the labels, has to name them, or to say which of them it cannot
separate.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.collection.perturbed import Perturbation
from tacgen.collection.recipe import Recipe
from tacgen.core.records import GraspConfig
from tacgen.core.types import BoolArray
from tacgen.diagnose.grasps.command import refine
from tacgen.diagnose.grasps.model_comparison import (
    FAILED,
    NO_READING,
    SUCCESS,
    Cause,
    Explanation,
    Labels,
    Posterior,
    posterior,
)
from tacgen.diagnose.grasps.perturbed_simulations import PerturbedSimulations
from tacgen.diagnose.grasps.result import diagnose_labels
from tacgen.diagnose.rules import GRASPS
from tacgen.objects import load_object

SETS: tuple[tuple[tuple[str, ...], int], ...] = (
    (("sugar_box",), 111),
    (("tomato_soup_can",), 112),
    (("rubiks_cube",), 113),
    (("sugar_box", "mustard_bottle"), 114),
    (("mustard_bottle",), 115),
    (("flat_screwdriver",), 116),
)
"""Objects and seed of each set of configurations; what is an object's is wrong in the first."""
N_GRASPS = 60
WRONG: dict[str, tuple[str, float]] = {
    "grip_force": ("force_scale", 0.8),
    "mass": ("mass_factor", 1.4),
    "friction": ("friction_factor", 0.7),
    "center_of_mass": ("center_of_mass_y_mm", 18.0),
    "spinning_friction": ("spinning_friction_factor", 1.6),
}
"""What may be wrong and how far; half of them the other way round, drawn with a set's seed."""
CASES: tuple[tuple[str, ...], ...] = tuple(
    names for size in range(3) for names in combinations(WRONG, size)
)
FLIPS = (0.0, 0.05)
LEAST_CHANGED = 2
"""Nothing can name a cause that changes fewer labels, or separate it from the others."""
PHYSICS = {"lift_mm": 40.0, "success_rise_mm": 30.0, "time_step_s": 1 / 240, "hold_s": 0.1}
"""A shorter lift in longer steps: 0.4 of the time."""
DEVIATIONS = 3.0
"""A product that was reported for several causes must be the true one to so many."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One diagnosis: the causes, what was named, and with what each was reported as confounded.

    ``result`` is ``right``, ``confounded`` (all causes are named or reported as confounded with
    what is named, nothing else is named, and the product of the confounded ones is the true one;
    or nothing is named, and the true product of all of them is stated as all that is known),
    ``alternative`` (neither, but exactly the causes, at their values, are among what is reported as
    also possible), ``undecided`` (nothing is named, because too few labels differ, and the
    diagnosis reports so), ``missed`` (a cause is not mentioned) or ``false`` (something named has
    no part in the truth). ``telling`` tells whether every cause changes labels enough, ``at_value``
    whether each one named has its true value, and ``probability`` is that given to what is named.
    """

    objects: str
    causes: tuple[str, ...]
    flips: float
    telling: bool
    named: tuple[str, ...]
    values: tuple[float, ...]
    confounded: tuple[tuple[str, ...], ...]
    result: str
    rate_before: float
    rate_after: float
    at_value: bool
    probability: float


def planned_grasps(objects: Sequence[str], count: int, seed: int) -> tuple[GraspConfig, ...]:
    """Configurations spread over the objects' own ranges, forces evenly by ratio."""
    rng = np.random.default_rng([seed, count])
    configs = []
    for k in range(count):
        name = objects[k % len(objects)]
        ranges = load_object(name).grasp_ranges
        force, y, z = (ranges[axis] for axis in ("force_n", "y_mm", "z_mm"))
        force_n = np.exp(rng.uniform(np.log(min(force)), np.log(max(force))))
        y_mm, z_mm = rng.uniform(min(y), max(y)), rng.uniform(min(z), max(z))
        configs.append(GraspConfig(k, name, round(force_n, 3), 0.0, round(y_mm, 2), round(z_mm, 2)))
    return tuple(configs)


def wrong_values(seed: int) -> dict[str, float]:
    """The value of each of ``WRONG`` in the set of that seed."""
    up = np.random.default_rng([seed, len(WRONG)]).uniform(size=len(WRONG)) < 0.5
    values = {}
    for (name, (key, value)), reversed_ in zip(WRONG.items(), up, strict=True):
        other = -value if key.endswith("mm") else round(1 / value, 4)
        values[name] = other if reversed_ else value
    return values


def perturbation(
    names: Collection[str], values: dict[str, float], *, is_first: bool
) -> Perturbation:
    """What these causes do to grasps of the set's first object, or of another."""
    figures: dict[str, Any] = {
        WRONG[name][0]: values[name] for name in names if is_first or name == "grip_force"
    }
    return Perturbation(**figures)


def simulations_of(objects: Sequence[str], seed: int, out: Path) -> PerturbedSimulations:
    """The simulations of a set, kept in ``out``."""
    recipe = Recipe.model_validate(
        {"name": "trust", "objects": list(objects), "physics": PHYSICS, "seed": seed}
    )
    folder = out / f"{'-'.join(objects)}_{seed}"
    return PerturbedSimulations(recipe, planned_grasps(objects, N_GRASPS, seed), folder, 1)


def true_labels(
    simulations: PerturbedSimulations, objects: Sequence[str], seed: int
) -> dict[tuple[str, ...], BoolArray]:
    """Whether each grasp succeeds (N,), by causes."""
    values = wrong_values(seed)
    keys = {
        names: [
            (config, perturbation(names, values, is_first=config.object == objects[0]))
            for config in simulations.configs
        ]
        for names in CASES
    }
    simulations.simulate([key for own in keys.values() for key in own])
    return {
        names: np.array([simulations.known[c.point, change].label == 1 for c, change in own])
        for names, own in keys.items()
    }


def run_set(objects: Sequence[str], seed: int, flips: float, out: Path) -> Iterator[Trial]:
    """Every case on one set of configurations; simulations in ``out`` are kept."""
    simulations = simulations_of(objects, seed, out)
    declared = simulations.comparison()
    truths, values = true_labels(simulations, objects, seed), wrong_values(seed)
    for names, truth in truths.items():
        others = [truths[tuple(one for one in names if one != name)] for name in names]
        wrong = {name: values[name] for name in names}
        changed = [int((truth != one).sum()) for one in [*others, *([truths[()]] if names else [])]]
        rng = np.random.default_rng([seed, round(100 * flips)])
        success = truth.copy()
        success[rng.choice(N_GRASPS, round(flips * N_GRASPS), replace=False)] ^= True
        known = np.where(success, SUCCESS, FAILED)
        labels = Labels(known, np.zeros(N_GRASPS, bool), NO_READING)
        # From the first nodes again; what was simulated stays known.
        simulations.further.clear()
        simulations.joint.clear()
        comparison = refine(simulations, declared, labels)
        found = posterior(comparison, labels, rng)
        diagnosis = diagnose_labels(comparison, labels, found, truths[()].astype(int), {}, rng)
        yield Trial(
            "+".join(objects),
            names,
            flips,
            min(changed, default=LEAST_CHANGED) >= LEAST_CHANGED,
            tuple(cause.name for cause in found.found),
            tuple(round(cause.value, 4) for cause in found.found),
            tuple(found.confusable_with(own) for own in found.found or diagnosis.products),
            judged_undecided(found, wrong, objects)
            if names and diagnosis.undecided
            else judged(found, wrong, objects),
            diagnosis.rate_before,
            diagnosis.rate_after,
            all(_has_true_value(cause, wrong) for cause in found.found),
            found.found_probability,
        )


def judged(found: Posterior, truth: dict[str, float], objects: Sequence[str]) -> str:
    """The result of a trial, see ``Trial``; ``truth`` are the values of the causes by name."""
    result = _judged_by_names(found, truth, objects)
    if not truth or result not in ("missed", "false"):
        return result
    likely = [one for one in found.same if found.share(one) >= GRASPS.sentence_least_share]
    possible = (*likely, *found.alternatives)
    is_reported = any(_is_truth(one, truth, objects) for one in possible)
    return "alternative" if is_reported else result


def _is_truth(one: Explanation, truth: dict[str, float], objects: Sequence[str]) -> bool:
    """Whether an explanation has exactly the true causes, at their values."""
    keys = [cause.candidate.parameter.key for cause in one.causes]
    if sorted(keys) != sorted(WRONG[name][0] for name in truth):
        return False
    if not all(_is_true(cause, truth, objects) for cause in one.causes):
        return False
    apart = np.array([_true_coordinate(cause, truth) - cause.coordinate for cause in one.causes])
    covariance = one.covariance + GRASPS.least_variance * np.eye(len(apart))
    return bool(apart @ np.linalg.solve(covariance, apart) <= DEVIATIONS**2)


def _is_true(cause: Cause, truth: dict[str, float], objects: Sequence[str]) -> bool:
    """Whether this is wrong indeed, whatever its value."""
    own = cause.candidate
    is_axis = own.name != "center_of_mass" or own.parameter.key == WRONG[own.name][0]
    of_set = own.hypothesis.of_gripper or own.objects == tuple(objects[:1])
    return own.name in truth and is_axis and of_set


def _has_true_value(cause: Cause, truth: dict[str, float]) -> bool:
    """Whether the true value is within ``DEVIATIONS`` of the reported one, or of its second."""
    value = cause.candidate.parameter.value(_true_coordinate(cause, truth))
    reported = [cause.value, *([] if cause.second_mode is None else [cause.second_mode])]
    return any(abs(value - one) <= DEVIATIONS * cause.stderr for one in reported)


def _true_coordinate(cause: Cause, truth: dict[str, float]) -> float:
    """Where the figure that a cause is about really is: as declared, unless it is wrong."""
    if cause.name not in truth:
        return cause.candidate.parameter.center
    value = truth[cause.name]
    return value if WRONG[cause.name][0].endswith("mm") else float(np.log(value))


def _judged_by_names(found: Posterior, truth: dict[str, float], objects: Sequence[str]) -> str:
    """The result by what is named, and by what shares what is known with it."""

    def is_true(cause: Cause) -> bool:
        return _is_true(cause, truth, objects)

    groups = [(cause, *(one.other for one in found.shared(cause))) for cause in found.found]
    mentioned = {one.name for group in groups for one in group if is_true(one)}
    if any(not any(map(is_true, group)) for group in groups):
        return "false"
    if mentioned != set(truth):
        return "missed"
    if all(is_true(group[0]) for group in groups) and len(groups) == len(truth):
        return "right"
    known = all(_is_true_product(found, cause, truth, objects) for cause in found.found)
    return "confounded" if known else "false"


def judged_undecided(found: Posterior, truth: dict[str, float], objects: Sequence[str]) -> str:
    """The result where nothing is named: several causes may be reported to compensate."""
    for cause in found.products:
        group = [cause, *(one.other for one in found.shared(cause) if one.is_product)]
        mentioned = {one.name for one in group if _is_true(one, truth, objects)}
        is_whole = len(truth) > 1 and mentioned == set(truth)
        if is_whole and _is_true_product(found, cause, truth, objects):
            return "confounded"
    return "undecided"


def _is_true_product(
    found: Posterior, cause: Cause, truth: dict[str, float], objects: Sequence[str]
) -> bool:
    """Whether what the labels determine of ``cause`` and what it shares this with is true."""
    total, parts = 0.0, [(cause, 1.0)]
    for one in found.shared(cause):
        if _is_true(one.other, truth, objects):
            parts.append((one.other, one.exponent))
    for part, exponent in {one.name: (one, power) for one, power in parts}.values():
        total += exponent * _true_coordinate(part, truth)
    return abs(total - cause.coordinate) <= DEVIATIONS * cause.deviation


def summary_of(trials: Sequence[Trial]) -> str:
    """The trials in Markdown, a row for each number of causes and share of flipped labels."""
    lines = [
        "| causes | flipped | trials | too few labels changed | right (at the true value) "
        "| confounded | alternative | undecided | missed | false | names mentioned "
        "| probability given | mislabels before → after |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for size in sorted({len(one.causes) for one in trials}):
        for flips in FLIPS:
            own = [one for one in trials if len(one.causes) == size and one.flips == flips]
            seen = [one for one in own if one.telling]
            if not seen:
                continue
            right = [one for one in seen if one.result == "right"]
            counts = [
                sum(one.result == kind for one in seen)
                for kind in ("confounded", "alternative", "undecided", "missed", "false")
            ]
            named = [one.probability for one in seen if one.named]
            given = f"{100 * np.mean(named):.0f} %" if named else "–"
            names = np.mean([len({*one.named, *sum(one.confounded, ())}) for one in seen])
            before, after = (
                100 * float(np.mean([getattr(one, f"rate_{what}") for one in seen]))
                for what in ("before", "after")
            )
            lines.append(
                f"| {size} | {100 * flips:.0f} % | {len(own)} | {len(own) - len(seen)} "
                f"| {len(right)} ({sum(one.at_value for one in right)}) "
                f"| {' | '.join(map(str, counts))} | {names:.1f} | {given} "
                f"| {before:.1f} → {after:.1f} % |"
            )
    return "\n".join(lines) + "\n"
