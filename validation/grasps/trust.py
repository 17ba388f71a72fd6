"""How far ``tacgen diagnose grasps`` can be trusted: simulations perturbed on purpose.

Real grasps are simulated with one wrong figure, and the diagnosis, which knows only the declared
simulation and the labels, has to name it. Then fresh grasps, which it never saw, are simulated with
the true perturbation and with the one that was found.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacgen.collection.perturbed import Perturbation, place_of
from tacgen.collection.recipe import Recipe
from tacgen.core.arrays import BoolArray
from tacgen.core.records import GraspConfig
from tacgen.diagnose.grasps.command import choose_confirmed, refine
from tacgen.diagnose.grasps.model_comparison import (
    FAILED,
    NO_READING,
    SUCCESS,
    Labels,
    choose,
    confusable,
)
from tacgen.diagnose.grasps.perturbed_simulations import (
    DECLARED,
    PerturbedSimulations,
    combined_perturbation,
)
from tacgen.diagnose.grasps.result import diagnose_labels
from tacgen.diagnose.grasps.slip_margin import is_sure, margins_of
from tacgen.objects import load_object

FRESH_SEED = 1000
SETS: tuple[tuple[tuple[str, ...], int, int], ...] = (
    (("wood_block",), 40, 1),
    (("potted_meat_can",), 40, 1),
    (("scissors",), 40, 1),
    (("tomato_soup_can",), 40, 1),
    (("cup",), 40, 1),
    (("wood_block", "potted_meat_can"), 40, 1),
    (("rubiks_cube",), 40, 1),
    (("sugar_box",), 24, 2),
)
"""Objects, number of grasps and seed of each set of configurations."""
PERTURBATIONS: dict[str, Perturbation] = {
    "none": DECLARED,
    "center_of_mass +y": Perturbation(center_of_mass_y_mm=20.0),
    "center_of_mass -y": Perturbation(center_of_mass_y_mm=-20.0),
    "grip_force": Perturbation(force_scale=0.8),
    "mass": Perturbation(mass_factor=1.4),
}
FLIPS = (0.0, 0.05)
N_FRESH, N_DRAWS = 100, 4000
LEAST_CHANGED = 2
"""Nothing can name a perturbation that changes fewer labels."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One diagnosis: what was wrong, and what was named.

    ``rate_after`` is the diagnosis's own figure, ``rate_of_truth`` the share of flipped labels,
    and ``fresh_wrong`` the share of fresh grasps whose labels differ between the true perturbation
    and the one that was found.
    """

    objects: str
    change: str
    flips: float
    n_grasps: int
    n_changed: int
    named: tuple[str, ...]
    values: tuple[float, ...]
    confusable: tuple[str, ...]
    rate_before: float
    rate_after: float
    rate_of_truth: float
    fresh_wrong: float

    @property
    def rate_fresh(self) -> float:
        """Expected mislabel rate of fresh grasps whose real labels are flipped as often."""
        return self.fresh_wrong + self.flips * (1 - 2 * self.fresh_wrong)

    @property
    def expected(self) -> str:
        """The name that is right; empty where nothing is wrong."""
        return "" if self.change == "none" else self.change.split()[0]

    @property
    def right(self) -> bool:
        """Whether the right name came first, or nothing was named where nothing is wrong."""
        return self.named[:1] == ((self.expected,) if self.expected else ())

    @property
    def listed(self) -> bool:
        """Whether the right name is the first or reported as equally good."""
        return self.right or self.expected in self.confusable


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


def run_set(
    objects: Sequence[str], count: int, seed: int, out: Path, workers: int, *, quick: bool
) -> Iterator[Trial]:
    """Every perturbation on one set of configurations; simulations in ``out`` are kept.

    ``quick`` stops at the first name and does not simulate about its value.
    """
    recipe = Recipe.model_validate({"name": "trust", "objects": list(objects)})
    configs = planned_grasps(objects, count, seed)
    folder = out / f"{'-'.join(objects)}_{count}_{seed}"
    simulations = PerturbedSimulations(recipe, configs, folder, workers)
    fresh_configs = planned_grasps(objects, N_FRESH, seed + FRESH_SEED)
    fresh = PerturbedSimulations(recipe, fresh_configs, folder / "fresh", workers)
    comparison = simulations.comparison()
    for name, change in PERTURBATIONS.items():
        simulations.simulate([(config, change) for config in configs])
        truth = np.array([outcome.label == 1 for outcome in simulations.outcomes(change)])
        declared = np.array([outcome.label == 1 for outcome in simulations.outcomes(DECLARED)])
        for number, flips in enumerate(FLIPS):
            rng = np.random.default_rng([seed, number])
            success = truth.copy()
            success[rng.choice(count, round(flips * count), replace=False)] ^= True
            known = np.where(success, SUCCESS, FAILED)
            labels = Labels(known, np.zeros(count, bool), NO_READING)
            if quick:
                current, steps = comparison, choose(comparison, labels, rng)[:1]
            else:
                current = refine(simulations, comparison, labels)
                steps, _ = choose_confirmed(simulations, current, labels, rng)
            found = diagnose_labels(current, labels, steps, declared.astype(int), {}, (), rng)
            found_changes = {one: combined_perturbation(found.found, one) for one in objects}
            wrong = fresh_labels(fresh, found_changes) != fresh_labels(
                fresh, dict.fromkeys(objects, change)
            )
            yield Trial(
                "+".join(objects),
                name,
                flips,
                count,
                int((truth != declared).sum()),
                tuple(score.name for score in found.found),
                tuple(round(score.value, 4) for score in found.found),
                confusable(found.steps[0].scores),
                found.rate_before,
                found.rate_after,
                float((success != truth).mean()),
                float(wrong.mean()),
            )


def fresh_labels(
    simulations: PerturbedSimulations, changes: Mapping[str, Perturbation]
) -> BoolArray:
    """Whether each grasp succeeds (N,) under the perturbation of its object.

    A mass is simulated as the force that it amounts to, and a grasp that another force leaves
    certain is not simulated at it.
    """
    simulations.simulate([(config, DECLARED) for config in simulations.configs])
    margin, _ = margins_of(simulations.outcomes(DECLARED))
    keys = []
    for config, own in zip(simulations.configs, margin, strict=True):
        change = as_force(changes[config.object])
        by_force = change == Perturbation(force_scale=change.force_scale)
        known = by_force and is_sure(own, change.force_scale)
        keys.append((config, DECLARED if known else change))
    simulations.simulate(keys)
    return np.array(
        [simulations.known[place_of(config), change].label == 1 for config, change in keys]
    )


def as_force(change: Perturbation) -> Perturbation:
    """The perturbation in which a force does what a mass does in ``change``."""
    scale = round(change.force_scale / change.mass_factor, 3)
    return replace(change, mass_factor=1.0, force_scale=scale)


def least_fresh_wrong(count: int, flips: float, rng: np.random.Generator) -> float:
    """What no diagnosis can beat: the mean of ``fresh_wrong`` where only the number is not known.

    ``count`` grasps whose thresholds lie at random along one number, every threshold known, the
    name and the share of flips too; the number is the posterior median. Without flips it is the
    middle of the gap between two thresholds, and the mean is 1/(2 (count + 1)).
    """
    wrong = []
    flip = max(flips, 1e-4)
    for _ in range(N_DRAWS):
        places, truth = np.sort(rng.uniform(size=count)), rng.uniform(0.1, 0.9)
        success = places < truth
        success[rng.choice(count, round(flips * count), replace=False)] ^= True
        edges = np.concatenate([[0.0], places, [1.0]])
        # In gap k the first k grasps hold and the rest fail.
        agree = np.cumsum(np.concatenate([[0], 2 * success - 1])) + (~success).sum()
        weight = np.diff(edges) * (flip / (1 - flip)) ** (agree.max() - agree)
        upto = np.concatenate([[0.0], np.cumsum(weight) / weight.sum()])
        wrong.append(abs(np.interp(0.5, upto, edges) - truth))
    return float(np.mean(wrong))


def summary_of(trials: Sequence[Trial]) -> str:
    """The trials in Markdown, a row for each perturbation and share of flipped labels."""
    lines = [
        "| wrong | flipped | trials | too few labels changed | right first "
        "| right first or reported as equally good "
        "| mislabels before → after (truth) | fresh (truth) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for flips in FLIPS:
        for change in PERTURBATIONS:
            own = [t for t in trials if t.change == change and t.flips == flips]
            seen = [t for t in own if not t.expected or t.n_changed >= LEAST_CHANGED]
            if not seen:
                continue
            before, after, truth, fresh = (
                100 * float(np.mean([getattr(t, f"rate_{what}") for t in seen]))
                for what in ("before", "after", "of_truth", "fresh")
            )
            lines.append(
                f"| {change} | {100 * flips:.0f} % | {len(own)} | {len(own) - len(seen)} "
                f"| {sum(t.right for t in seen)} of {len(seen)} "
                f"| {sum(t.listed for t in seen)} of {len(seen)} "
                f"| {before:.1f} → {after:.1f} % ({truth:.1f} %) "
                f"| {fresh:.1f} % ({100 * flips:.1f} %) |"
            )
    return "\n".join(lines) + "\n"
