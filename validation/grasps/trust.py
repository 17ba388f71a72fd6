"""How far ``tacgen diagnose grasps`` can be trusted: worlds altered on purpose, over and over.

Real grasps are simulated in worlds with one wrong figure, and the diagnosis, which knows only the
declared world and the labels, has to name it. Then fresh grasps, which it never saw, are simulated
in the altered world and in the one that was found. Run as
``python -m validation.grasps.trust --out DIR``.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.perturbed import Alteration, place_of
from tacgen.collection.recipe import Recipe
from tacgen.core.files import write_text
from tacgen.core.records import GraspConfig
from tacgen.diagnose.grasps.command import choose_confirmed, refine
from tacgen.diagnose.grasps.hypothesis import FAILED, NO_READING, SUCCESS
from tacgen.diagnose.grasps.model_comparison import Labels, choose, confusable
from tacgen.diagnose.grasps.perturbed_worlds import (
    DECLARED,
    GraspWorlds,
    combined_world,
    is_sure,
    slack_of,
)
from tacgen.diagnose.grasps.result import diagnose_labels
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
WORLDS: dict[str, Alteration] = {
    "none": DECLARED,
    "center_of_mass +y": Alteration(center_of_mass_y_mm=20.0),
    "center_of_mass -y": Alteration(center_of_mass_y_mm=-20.0),
    "grip_force": Alteration(force_scale=0.8),
    "mass": Alteration(mass_factor=1.4),
}
FLIPS = (0.0, 0.05)
N_FRESH, N_DRAWS = 100, 4000
LEAST_CHANGED = 2
"""A world that changes fewer labels cannot be told from the declared one by anybody."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One diagnosis: what was wrong, and what was said.

    ``rate_after`` is the diagnosis's own figure, ``rate_of_truth`` the share of flipped labels,
    and ``fresh_wrong`` the share of fresh grasps that end otherwise in the world that was found
    than in the true one.
    """

    objects: str
    world: str
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
        return "" if self.world == "none" else self.world.split()[0]

    @property
    def right(self) -> bool:
        """Whether the right name came first, or nothing was named where nothing is wrong."""
        return self.named[:1] == ((self.expected,) if self.expected else ())

    @property
    def listed(self) -> bool:
        """Whether the right name is the first or said to be as good as the first."""
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
    """Every world on one set of configurations; simulations in ``out`` are kept.

    ``quick`` stops at the first name and does not simulate about its value.
    """
    recipe = Recipe.model_validate({"name": "trust", "objects": list(objects)})
    configs = planned_grasps(objects, count, seed)
    folder = out / f"{'-'.join(objects)}_{count}_{seed}"
    worlds = GraspWorlds(recipe, configs, folder, workers)
    fresh_configs = planned_grasps(objects, N_FRESH, seed + FRESH_SEED)
    fresh = GraspWorlds(recipe, fresh_configs, folder / "fresh", workers)
    contest = worlds.contest()
    for name, alteration in WORLDS.items():
        worlds.simulate(name, [(config, alteration) for config in configs])
        truth = np.array([outcome.label == 1 for outcome in worlds.outcomes(alteration)])
        declared = np.array([outcome.label == 1 for outcome in worlds.outcomes(DECLARED)])
        for number, flips in enumerate(FLIPS):
            rng = np.random.default_rng([seed, number])
            success = truth.copy()
            success[rng.choice(count, round(flips * count), replace=False)] ^= True
            known = np.where(success, SUCCESS, FAILED)
            labels = Labels(known, np.zeros(count, bool), NO_READING)
            if quick:
                current, steps = contest, choose(contest, labels, rng)[:1]
            else:
                current = refine(worlds, contest, labels)
                steps, _ = choose_confirmed(worlds, current, labels, rng)
            found = diagnose_labels(current, labels, steps, declared.astype(int), {}, (), rng)
            said = {one: combined_world(found.found, one) for one in objects}
            wrong = fresh_labels(fresh, said) != fresh_labels(
                fresh, dict.fromkeys(objects, alteration)
            )
            yield Trial(
                "+".join(objects),
                name,
                flips,
                count,
                int((truth != declared).sum()),
                tuple(standing.name for standing in found.found),
                tuple(round(standing.value, 4) for standing in found.found),
                confusable(found.steps[0].standings),
                found.rate_before,
                found.rate_after,
                float((success != truth).mean()),
                float(wrong.mean()),
            )


def fresh_labels(worlds: GraspWorlds, altered: Mapping[str, Alteration]) -> NDArray[np.bool_]:
    """Whether each grasp succeeds (N,) in the world of its object.

    A mass is simulated as the force that it amounts to, and a grasp that another force leaves
    beyond doubt is not simulated at it.
    """
    worlds.simulate("declared", [(config, DECLARED) for config in worlds.configs])
    slack, _ = slack_of(worlds.outcomes(DECLARED))
    keys = []
    for config, own in zip(worlds.configs, slack, strict=True):
        world = as_force(altered[config.object])
        by_force = world == Alteration(force_scale=world.force_scale)
        known = by_force and is_sure(own, world.force_scale)
        keys.append((config, DECLARED if known else world))
    worlds.simulate("fresh", keys)
    return np.array([worlds.known[place_of(config), world].label == 1 for config, world in keys])


def as_force(world: Alteration) -> Alteration:
    """The world in which a force does what a mass does in ``world``."""
    scale = round(world.force_scale / world.mass_factor, 3)
    return replace(world, mass_factor=1.0, force_scale=scale)


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
    """The trials as a table in Markdown, a row for each world and share of flipped labels."""
    lines = [
        "| wrong | flipped | trials | too few labels changed | right first "
        "| right first or said to be as good | mislabels before → after (truth) | fresh (truth) |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for flips in FLIPS:
        for world in WORLDS:
            own = [t for t in trials if t.world == world and t.flips == flips]
            seen = [t for t in own if not t.expected or t.n_changed >= LEAST_CHANGED]
            if not seen:
                continue
            before, after, truth, fresh = (
                100 * float(np.mean([getattr(t, f"rate_{what}") for t in seen]))
                for what in ("before", "after", "of_truth", "fresh")
            )
            lines.append(
                f"| {world} | {100 * flips:.0f} % | {len(own)} | {len(own) - len(seen)} "
                f"| {sum(t.right for t in seen)} of {len(seen)} "
                f"| {sum(t.listed for t in seen)} of {len(seen)} "
                f"| {before:.1f} → {after:.1f} % ({truth:.1f} %) "
                f"| {fresh:.1f} % ({100 * flips:.1f} %) |"
            )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run every set and write ``trials.json`` and ``trust.md``."""
    parser = argparse.ArgumentParser(description="Diagnoses of worlds altered on purpose.")
    parser.add_argument("--out", type=Path, default=Path("out/grasp_trust"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="Stop at the first name.")
    parser.add_argument("--sets", type=int, default=len(SETS), help="Only the first so many.")
    arguments = parser.parse_args()
    trials: list[Trial] = []
    for objects, count, seed in SETS[: arguments.sets]:
        for trial in run_set(
            objects, count, seed, arguments.out, arguments.workers, quick=arguments.quick
        ):
            trials.append(trial)
            said = ", ".join(trial.named) or "sufficient"
            sys.stderr.write(f"{trial.objects} {trial.world} {trial.flips:g}: {said}\n")
        content = json.dumps([asdict(one) for one in trials], indent=1)
        write_text(arguments.out / "trials.json", content + "\n")
        write_text(arguments.out / "trust.md", summary_of(trials))


if __name__ == "__main__":
    main()
