"""What touch adds to regrasping: the network's policy and its controls on the same episodes."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.grid import rng_of
from tacgen.collection.recipe import Recipe
from tacgen.core.errors import LearningError
from tacgen.core.files import write_text
from tacgen.envs.regrasp import (
    Costs,
    Simulated,
    Step,
    about,
    failures,
    first_grasp,
    simulate,
)
from validation.regrasp.policies import (
    POLICIES,
    PolicyName,
    Rate,
    play,
    resampled_episodes,
    share_of_gain,
)

STUDY, PAGE = "study.json", "index.html"


@dataclass(frozen=True, slots=True)
class Episode:
    """One episode by one policy: its object, the world's seed, and the grasps; the last is lifted.

    ``outcome`` as of ``Tried``.
    """

    object: str
    seed: int
    steps: tuple[Step, ...]
    outcome: str

    @property
    def held(self) -> bool:
        """Whether the lift succeeded."""
        return self.outcome == "held"


@dataclass(frozen=True, slots=True)
class Played:
    """All that was played: ``episodes`` by policy and number of regrasps allowed."""

    simulated: Simulated
    episodes: Mapping[tuple[PolicyName, int], tuple[Episode, ...]]


def study(
    run: Path,
    recipe: Recipe,
    out: Path,
    *,
    costs: Costs,
    regrasps: int = 3,
    episodes: int = 40,
    worlds: int = 32,
    seed: int | None = None,
    workers: int = 1,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[dict[str, Any], Played]:
    """Play ``episodes`` of each object by every policy, and write ``out/study.json``.

    As ``tacgen.envs.regrasp.regrasp``, whose finished worlds it uses; but ``policies`` has, by
    name, a list over the regrasps allowed of ``success``, ``share_of_gain`` (of the oracle's over
    the first grasps) and ``share_beyond_blind`` (of the oracle's over the blind policy), each
    ``{"value", "interval"}`` (95 %, bootstrap over episodes), ``mean_regrasps``, ``drops`` and
    ``not_executed``; ``by_object`` the success of each policy; ``network`` its accuracy on the
    looks of the episodes (grasps that were executed), with the share of them that holds.
    """
    seed = recipe.seed if seed is None else seed
    simulated = simulate(run, recipe, out, episodes, worlds, seed, workers, show)
    played = Played(simulated, _play_all(simulated, costs, regrasps))
    result = {
        **about(simulated, run, seed, costs),
        "regrasps": regrasps,
        "episodes": episodes,
        "worlds": worlds,
        **_scores(played, regrasps, seed),
        "network": _network_scores(simulated),
    }
    write_text(out / STUDY, json.dumps(result, indent=1))
    return result, played


def _play_all(
    simulated: Simulated, costs: Costs, regrasps: int
) -> dict[tuple[PolicyName, int], tuple[Episode, ...]]:
    found: dict[tuple[PolicyName, int], list[Episode]] = {}
    for k, entry in enumerate(simulated.recipe.objects):
        belief = simulated.belief(k)
        for world in simulated.worlds_of(k, is_episode=True):
            look, holds = simulated.look(world), simulated.holds(world)
            first = first_grasp(world, len(look))
            for policy in POLICIES:
                for allowed in range(regrasps + 1):
                    rng = rng_of(world.seed, 3)
                    steps = play(policy, first, look, holds, belief, costs, allowed, rng)
                    outcome = simulated.tried[world][steps[-1].grasp].outcome
                    episode = Episode(entry.object_name, world.seed, tuple(steps), outcome)
                    found.setdefault((policy, allowed), []).append(episode)
    return {key: tuple(listed) for key, listed in found.items()}


def _scores(played: Played, regrasps: int, seed: int) -> dict[str, Any]:
    episodes = played.episodes
    objects = np.array([one.object for one in episodes["touch", 0]])
    drawn = resampled_episodes(objects, rng_of(seed, 4))
    held = {key: np.array([one.held for one in listed]) for key, listed in episodes.items()}
    start = held["touch", 0]

    def rates(of: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return of.mean(keepdims=True), of[drawn].mean(axis=1)

    def share(key: tuple[PolicyName, int], base: NDArray[np.bool_]) -> dict[str, Any]:
        best = held["oracle", key[1]]
        parts = zip(rates(held[key]), rates(base), rates(best), strict=True)
        value, resampled = (share_of_gain(*three) for three in parts)
        return Rate.of(float(value[0]), resampled).as_json()

    policies: dict[str, list[dict[str, Any]]] = {}
    for key, listed in episodes.items():
        value, resampled = rates(held[key])
        policies.setdefault(key[0], []).append(
            {
                "success": Rate.of(float(value[0]), resampled).as_json(),
                "share_of_gain": share(key, start),
                "share_beyond_blind": share(key, held["blind", key[1]]),
                "mean_regrasps": float(np.mean([len(one.steps) - 1 for one in listed])),
                **failures([one.outcome for one in listed]),
            }
        )
    by_object = {
        name: {"first": float(start[objects == name].mean())}
        | {policy: float(held[policy, regrasps][objects == name].mean()) for policy in POLICIES}
        for name in dict.fromkeys(objects.tolist())
    }
    return {"policies": policies, "by_object": by_object}


def _network_scores(simulated: Simulated) -> dict[str, float]:
    tried = simulated.tried.items()
    rows = [one for world, row in tried if world.is_episode for one in row if one.was_seen]
    if not rows:
        msg = "no grasp of the episodes could be executed; `tacgen collect` says why"
        raise LearningError(msg)
    holds = np.array([one.outcome == "held" for one in rows])
    sure = np.array([one.probability >= 0.5 for one in rows])
    return {"accuracy": float((sure == holds).mean()), "holds": float(holds.mean())}
