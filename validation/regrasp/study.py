"""What touch adds to regrasping: the network's policy and its controls on the same episodes."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.collection.recipe import Recipe
from tacgen.core.errors import LearningError
from tacgen.core.files import write_text
from tacgen.core.records import rng_of
from tacgen.envs.regrasp import (
    DROPS,
    ObjectGrasps,
    Play,
    Question,
    Step,
    about,
    failures,
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

    ``outcome`` is as of ``Tried``.
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

    asked: Question
    simulated: Mapping[str, ObjectGrasps]
    episodes: Mapping[tuple[PolicyName, int], tuple[Episode, ...]]


def study(
    run: Path, recipe: Recipe, out: Path, play: Play, *, workers: int = 1
) -> tuple[dict[str, Any], Played]:
    """Play episodes of each object by every policy, and write ``out/study.json``.

    As ``tacgen.envs.regrasp.regrasp``, whose finished worlds it uses; but ``policies`` has, by
    name, a list over the regrasps allowed of ``success``, ``share_of_gain`` (of the oracle's over
    the first grasps) and ``share_beyond_blind`` (of the oracle's over the blind policy), each
    ``{"value", "interval"}`` (95 %, bootstrap over episodes), ``mean_regrasps``, ``drops`` and
    ``not_executed``; ``by_object`` the success of each policy; ``network`` its accuracy on the
    looks of the episodes (grasps that were executed), with the share of them that holds.
    """
    asked = Question.checked(run, recipe)
    simulated = simulate(asked, out, play, workers=workers)
    played = Played(asked, simulated, _play_all(simulated, play))
    stated = about(asked, play, simulated)
    result = {
        **stated,
        **_scores(played, play.regrasps, stated["seed"]),
        "network": _network_scores(simulated),
    }
    write_text(out / STUDY, json.dumps(result, indent=1))
    return result, played


def _play_all(
    simulated: Mapping[str, ObjectGrasps], how: Play
) -> dict[tuple[PolicyName, int], tuple[Episode, ...]]:
    found: dict[tuple[PolicyName, int], list[Episode]] = {}
    for name, own in simulated.items():
        belief, tried = own.belief, own.episodes
        for world, seed in enumerate(tried.seeds):
            look, holds, first = tried.look[world], tried.holds[world], tried.first_grasp(world)
            for policy in POLICIES:
                for allowed in range(how.regrasps + 1):
                    rng = rng_of(seed, 3)
                    steps = play(policy, first, look, holds, belief, how.costs, allowed, rng)
                    outcome = str(tried.outcome[world, steps[-1].grasp])
                    episode = Episode(name, seed, tuple(steps), outcome)
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


def _network_scores(simulated: Mapping[str, ObjectGrasps]) -> dict[str, float]:
    look = np.concatenate([own.episodes.look.ravel() for own in simulated.values()])
    outcome = np.concatenate([own.episodes.outcome.ravel() for own in simulated.values()])
    seen = np.isin(outcome, ("held", *DROPS))  # grasps that were executed
    if not seen.any():
        msg = "no grasp of the episodes could be executed; `tacgen collect` says why"
        raise LearningError(msg)
    holds, sure = outcome[seen] == "held", look[seen] >= 0.5
    return {"accuracy": float((sure == holds).mean()), "holds": float(holds.mean())}
