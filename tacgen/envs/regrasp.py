"""``tacgen regrasp``: grasp, look, then lift or move, with a trained network.

All that can happen in an episode is simulated first: every grasp of the recipe in the world of each
episode, and in worlds that the policy draws itself, to imagine with. What a policy does is then
read from these tables. An episode is one object with a drawn centre of mass and friction; it ends
in a lift, after the last regrasp that is allowed whatever the look says. Before each grasp the
object rests as at first.
"""

import contextlib
import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logit, softmax

from tacgen.collection.grid import PlannedGrasp, plan_recipe
from tacgen.collection.kept import kept_results
from tacgen.collection.pipeline import GraspPipeline, planned_times_s
from tacgen.collection.recipe import Recipe
from tacgen.collection.recipe_inputs import recipe_inputs
from tacgen.core.errors import LearningError
from tacgen.core.files import alone, refuse_foreign, sha256_of, sha256_of_content, write_text
from tacgen.core.processes import Report
from tacgen.core.progress import LOG, print_status, progress_counter
from tacgen.core.records import LABEL_SUCCESS, GraspTrace, rng_of
from tacgen.dataset.reader import ROUNDING_S, TIME_DIGITS
from tacgen.dataset.samples import PadSample, frame_times_s
from tacgen.learning.network_input import ARRAYS, WITHOUT_TOUCH, InputSpec, taken_otherwise
from tacgen.learning.predictor import Predictor
from tacgen.learning.run_folder import RunFolder
from tacgen.learning.scores import wilson_interval
from tacgen.learning.training_recipe import TrainRecipe

SCHEMA = 2
WORLDS, RESULT = "worlds.jsonl", "regrasp.json"
MOST_TEST_LIFT_MM = 10.0
"""Height of a look, from which a drop harms nothing and the object can still be set down."""
DROPS = ("translational_slip", "rotational_slip")  # how a lift fails
MOST_TOPPLED = 50  # draws for each one in which the object stands; then the recipe is at fault
LOOK_SPREAD = 1.0
"""Standard deviation of a network's log odds between a grasp and its simulation in a world like it.

Chosen on the imagined worlds of ``recipes/regrasp.yaml``, each played as an episode of the others:
from 0.5 to 3 the share of the oracle's gain after three regrasps is 0.84 to 0.87, with 5 it is
0.79.
"""
MIN_PROBABILITY = 0.01
"""Looks are cut to this: a network that errs in one of a hundred may not rule a world out."""


@dataclass(frozen=True, slots=True)
class Costs:
    """Of a drop and of a regrasp, in the same unit; only their ratio counts.

    Raises ``LearningError`` if a drop costs nothing, or a regrasp less.
    """

    drop: float = 1.0
    regrasp: float = 0.1

    def __post_init__(self) -> None:
        if not (0 < self.drop < np.inf and 0 <= self.regrasp < np.inf):
            msg = (
                f"a drop of cost {self.drop:g} and a regrasp of {self.regrasp:g}: give --drop-cost "
                "above 0 and --regrasp-cost of 0 or more"
            )
            raise LearningError(msg)

    def threshold(self, holds: float, left: int) -> float:
        """Probability of success from which lifting costs less than regrasping.

        ``holds`` is the probability that the best other grasp holds, ``left`` how many regrasps
        are left. A lift costs (1 − p) drop on average. A regrasp costs its price and, where the
        other grasp fails too, W of one regrasp less: W₀ = drop and
        Wₙ = min(drop, regrasp + (1 − holds) Wₙ₋₁), as if each look were certain. With none
        left there is no choice, and the threshold is 0.
        """
        if left == 0:
            return 0.0
        failed = self.drop
        for _ in range(left - 1):
            failed = min(self.drop, self.regrasp + (1 - holds) * failed)
        return 1 - (self.regrasp + (1 - holds) * failed) / self.drop


@dataclass(frozen=True, slots=True)
class Belief:
    """What the recipe's own simulation says of A grasps in W worlds that it draws.

    ``holds`` (W, A) is whether the grasp holds, ``look`` (W, A) the probability that the network
    gives it.
    """

    holds: NDArray[np.bool_]
    look: NDArray[np.float64]

    def weights(self, seen: Sequence[tuple[int, float]]) -> NDArray[np.float64]:
        """How likely each world is (W,), after the network's probability of the grasps ``seen``.

        Each world's own log odds are off by ``LOOK_SPREAD`` from those that are seen in it.
        """
        log_weights = np.zeros(len(self.holds))
        for grasp, probability in seen:
            off = _log_odds(self.look[:, grasp]) - _log_odds(probability)
            log_weights -= (off / LOOK_SPREAD) ** 2 / 2
        return np.asarray(softmax(log_weights))

    def rating(self, seen: Sequence[tuple[int, float]] = ()) -> NDArray[np.float64]:
        """Probability that each grasp holds (A,); of those that were seen, that of the network."""
        rating = self.weights(seen) @ self.holds
        for grasp, probability in seen:
            rating[grasp] = probability
        return np.asarray(rating)

    def best_other(self, seen: Sequence[tuple[int, float]]) -> tuple[int, float]:
        """The best rated grasp but the last that was seen, and its rating."""
        rating = self.rating(seen)
        others = np.delete(np.arange(len(rating)), seen[-1][0])
        move = int(others[np.argmax(rating[others])])
        return move, float(rating[move])


@dataclass(frozen=True, slots=True)
class Step:
    """One grasp of an episode: the network's probability, and from which on it would be lifted.

    Policies that do not look have NaN for both.
    """

    grasp: int
    probability: float
    threshold: float


def by_touch(
    first: int,
    look: NDArray[np.float64],
    costs: Costs,
    regrasps: int,
    other_of: Callable[[Sequence[tuple[int, float]]], tuple[int, float]],
) -> list[Step]:
    """The grasps of an episode from its ``first`` on; the last one is lifted.

    ``look`` (A,) is what the network says of each grasp where it is tried; ``other_of`` names the
    grasp to move to after those that were seen, and how probable it is that it holds.
    """
    steps: list[Step] = []
    seen: list[tuple[int, float]] = []
    grasp = first
    for left in range(regrasps, -1, -1):
        probability = float(look[grasp])
        seen.append((grasp, probability))
        move, hope = other_of(seen)
        threshold = costs.threshold(hope, left)
        steps.append(Step(grasp, probability, threshold))
        if probability >= threshold:
            break
        grasp = move
    return steps


def _log_odds(probability: NDArray[np.float64] | float) -> NDArray[np.float64]:
    return np.asarray(logit(np.clip(probability, MIN_PROBABILITY, 1 - MIN_PROBABILITY)))


@dataclass(frozen=True, slots=True)
class Tried:
    """Every grasp (A) of an object in W worlds, which differ in what their ``seeds`` vary.

    ``look`` (W, A) is the probability that the network gives it; 0 where the grasp was not
    executed, for the gripper knows. ``outcome`` (W, A) says how its lift ended: ``held``, a failure
    mode, or the status of a grasp that was not executed; ``look_rise_mm`` (W, A) how far it had
    been lifted in the look.
    """

    seeds: tuple[int, ...]
    look: NDArray[np.float64]
    outcome: NDArray[np.str_]
    look_rise_mm: NDArray[np.float64]

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Which grasps hold (W, A)."""
        return np.asarray(self.outcome == "held")

    def first_grasp(self, world: int) -> int:
        """The grasp that an episode in a world starts with, the same for all policies."""
        return int(rng_of(self.seeds[world], 2).integers(self.look.shape[1]))


@dataclass(frozen=True, slots=True)
class ObjectGrasps:
    """The grasps of an object, tried in the worlds of ``episodes`` and in ``imagined`` ones."""

    grasps: tuple[PlannedGrasp, ...]
    episodes: Tried
    imagined: Tried

    @property
    def belief(self) -> Belief:
        """What the imagined worlds say."""
        return Belief(self.imagined.holds, self.imagined.look)


@dataclass(frozen=True, slots=True)
class Question:
    """What a network of ``run`` is asked about ``recipe``: of each grasp ``spec`` of a ``pad``."""

    run: Path
    recipe: Recipe
    pad: str
    spec: InputSpec

    @classmethod
    def checked(cls, run: Path, recipe: Recipe) -> "Question":
        """The question, if the run can answer it.

        Raises ``LearningError`` unless it has a model of each object, of images like the recipe's.
        """
        plan = RunFolder(run).plan()
        trained = TrainRecipe.model_validate(plan["recipe"])
        known = {name for model in plan["models"].values() for name in model["objects"]}
        missing = [one.object_name for one in recipe.objects if one.object_name not in known]
        problems = []
        if missing:
            problems.append(
                f"{run}: has no model of {', '.join(missing)}, only of {', '.join(sorted(known))}; "
                "train on a dataset with all of the recipe's objects, or take these out of it"
            )
        before, inputs = plan["dataset"].get("taken_with", {}), recipe_inputs(recipe).sha256
        pads = recipe.physics_settings.sensing_pads
        pad = before["pad"] if before.get("pad") in pads else pads[0]
        now = {
            "sensor_sha256": inputs["sensor"],
            "table": inputs.get("table"),
            "pad": pad,
            "markers": recipe.optics.markers,
            "shadows": recipe.optics.shadows,
            "time_s": np.round(planned_times_s(recipe), TIME_DIGITS).tolist(),
            "until": "lift" if recipe.frames.until == "lift" else "outcome",
        }
        if other := taken_otherwise(before, now, trained.model.kind):
            problems.append(
                f"{run}: was trained on images of another {', '.join(other)} than those of the "
                f"recipe {recipe.name}; collect its dataset with the recipe's sensor, optics and "
                "frames"
            )
        beside = {"vision", *WITHOUT_TOUCH}.intersection(trained.input.channels)
        if beside:
            problems.append(
                f"{run}: its network sees {', '.join(sorted(beside))}, and looks before a lift are "
                "of touch alone; train one without"
            )
        kept = {"markers": recipe.dataset.markers, "force_field": recipe.dataset.force_field}
        lacking = [name for name in kept if name in trained.input.channels and not kept[name]]
        if lacking:
            problems.append(
                f"{run}: its network also sees {', '.join(lacking)}; set dataset.{lacking[0]} in "
                "the recipe as its dataset had it"
            )
        LearningError.raise_if(problems)
        spec = Predictor(run, recipe.objects[0].object_name, device="cpu").spec
        return cls(run, recipe, pad, spec)


@dataclass(frozen=True, slots=True)
class Play:
    """How episodes are played: ``episodes`` and imagined ``worlds`` of each object, at most
    ``regrasps`` in each; ``seed`` draws both kinds of worlds (None: the recipe's).
    """

    costs: Costs = Costs()
    regrasps: int = 3
    episodes: int = 40
    worlds: int = 32
    seed: int | None = None


def regrasp(
    run: Path, recipe: Recipe, out: Path, play: Play, *, workers: int = 1
) -> dict[str, Any]:
    """Play episodes of each object by touch, and write ``out/regrasp.json``.

    Finished worlds are kept in ``out/worlds.jsonl``: an interrupted run goes on from there, and
    other costs cost nothing.

    ``regrasp.json``: ``schema``, ``run``, ``recipe``, ``seed``, ``costs``, ``regrasps``,
    ``episodes`` and ``worlds`` (of each object), ``looks`` (``grasp``, ``lift`` or ``test lift``),
    ``test_lift_mm``; ``by_touch``: a list over the regrasps allowed, 0 (the first grasps) first, of
    ``success`` with its ``interval`` (95 %, Wilson's), ``mean_regrasps``, ``drops`` (episodes that
    ended in a failed lift, by failure mode) and ``not_executed``; ``by_object``: by name the
    success of the ``first`` grasps and by ``touch`` after all regrasps.

    Raises ``LearningError`` as ``simulate`` does.
    """
    asked = Question.checked(run, recipe)
    simulated = simulate(asked, out, play, workers=workers)
    ended: dict[str, list[list[tuple[int, str]]]] = {
        name: [_played(own, play.costs, allowed) for allowed in range(play.regrasps + 1)]
        for name, own in simulated.items()
    }
    result = {
        **about(asked, play, simulated),
        "by_touch": [
            _scores([one for own in ended.values() for one in own[allowed]])
            for allowed in range(play.regrasps + 1)
        ],
        "by_object": {
            name: {"first": _success(own[0]), "touch": _success(own[-1])}
            for name, own in ended.items()
        },
    }
    write_text(out / RESULT, json.dumps(result, indent=1))
    return result


def regrasp_lines(result: Mapping[str, Any]) -> list[str]:
    """The result for a terminal: success after each number of regrasps, 0 first."""
    return [
        f"success after at most {k} regrasps: {100 * one['success']:.0f} % "
        f"({100 * one['interval'][0]:.0f} to {100 * one['interval'][1]:.0f})"
        + (", the first grasps" if k == 0 else "")
        for k, one in enumerate(result["by_touch"])
    ]


def _played(own: ObjectGrasps, costs: Costs, allowed: int) -> list[tuple[int, str]]:
    """Of each episode of an object how many regrasps there were, and how it ended."""
    other_of, tried, found = own.belief.best_other, own.episodes, []
    for world, (look, outcome) in enumerate(zip(tried.look, tried.outcome, strict=True)):
        steps = by_touch(tried.first_grasp(world), look, costs, allowed, other_of)
        found.append((len(steps) - 1, str(outcome[steps[-1].grasp])))
    return found


def _success(episodes: Sequence[tuple[int, str]]) -> float:
    return float(np.mean([outcome == "held" for _, outcome in episodes]))


def _scores(episodes: Sequence[tuple[int, str]]) -> dict[str, Any]:
    share = _success(episodes)
    return {
        "success": share,
        "interval": list(wilson_interval(share * len(episodes), len(episodes))),
        "mean_regrasps": float(np.mean([moves for moves, _ in episodes])),
        **failures([outcome for _, outcome in episodes]),
    }


def failures(outcomes: Sequence[str]) -> dict[str, Any]:
    """How many episodes ended in a failed lift, by failure mode, and in none."""
    drops = {mode: outcomes.count(mode) for mode in DROPS}
    lifted = outcomes.count("held") + sum(drops.values())
    return {"drops": drops, "not_executed": len(outcomes) - lifted}


def about(asked: Question, play: Play, simulated: Mapping[str, ObjectGrasps]) -> dict[str, Any]:
    """What is stated of every result."""
    until = asked.spec.shows_until
    rises_mm = [
        one.look_rise_mm for own in simulated.values() for one in (own.episodes, own.imagined)
    ]
    return {
        "schema": SCHEMA,
        "run": str(asked.run),
        "recipe": asked.recipe.name,
        **asdict(play),
        "seed": _seed(asked, play),
        "looks": "test lift" if until == "outcome" else until,
        "test_lift_mm": float(np.max(rises_mm)),
    }


def _seed(asked: Question, play: Play) -> int:
    return asked.recipe.seed if play.seed is None else play.seed


def simulate(
    asked: Question, out: Path, play: Play, *, workers: int = 1
) -> dict[str, ObjectGrasps]:
    """By object every grasp in the worlds of all episodes, and in those that the policy imagines.

    Raises ``LearningError`` if an object has a single grasp or does not stand, or the looks show
    the outcome.
    """
    recipe, run = asked.recipe, RunFolder(asked.run)
    grasps = _grasps_of(recipe)
    unknown = ("friction_relative", "mass_relative", "center_of_mass_mm")
    if not any(getattr(recipe.randomize, name) for name in unknown):
        print_status(
            f"warning: {recipe.name}: randomize draws no friction, mass or centre of mass, so that "
            f"nothing of an object is unknown and touch finds nothing out; set {', '.join(unknown)}"
        )
    models = run.plan()["models"].items()
    model_of = {one: name for name, model in models for one in model["objects"]}
    pipeline = GraspPipeline(recipe)
    kinds, tasks, items = list[tuple[str, str]](), list[World](), list[list[dict[str, Any]]]()
    for name, planned in grasps.items():
        places = [asdict(one.config) | {"index": 0} for one in planned]
        digest = sha256_of(run.model(model_of[name]).model_path)
        made_with = sha256_of_content([recipe_inputs(recipe, [name]).sha256, places, digest])
        for stream, n in (("episode", play.episodes), ("imagined", play.worlds)):
            for seed in standing_seeds(pipeline, planned[0], _seed(asked, play), stream, n):
                kinds.append((name, stream))
                tasks.append((planned, seed))
                items.append([{"made_with": made_with, "seed": seed}])
    refuse_foreign(out, WORLDS, [RESULT])
    out.mkdir(parents=True, exist_ok=True)
    job = partial(_world_job, asked, tasks)
    with (
        alone(out / ".lock", out, "working there", LearningError),
        progress_counter("world") as show,
    ):
        found = kept_results(out / WORLDS, items, job, _checked_row, workers=workers, show=show)

    def tried(*kind: str) -> Tried:
        own = [k for k, one in enumerate(kinds) if one == kind]
        look, outcome, rise_mm = np.moveaxis(np.array([found[k][0] for k in own], object), -1, 0)
        seeds = tuple(tasks[k][1] for k in own)
        return Tried(seeds, look.astype(float), outcome.astype(str), rise_mm.astype(float))

    return {
        name: ObjectGrasps(planned, tried(name, "episode"), tried(name, "imagined"))
        for name, planned in grasps.items()
    }


World = tuple[tuple[PlannedGrasp, ...], int]
"""The grasps of an object, and the seed of a world."""
Row = list[tuple[float, str, float]]
"""Of each grasp in a world its look, outcome and rise, as of ``Tried``."""


def _checked_row(kept: Any) -> Row:
    return [(float(look), str(outcome), float(rise_mm)) for look, outcome, rise_mm in kept]


def _grasps_of(recipe: Recipe) -> dict[str, tuple[PlannedGrasp, ...]]:
    """The grasps of each object.

    Raises ``LearningError`` if there is nothing to choose from.
    """
    planned = plan_recipe(recipe)
    found = {
        entry.object_name: tuple(one for one in planned if one.entry == k)
        for k, entry in enumerate(recipe.objects)
    }
    LearningError.raise_if(
        [
            f"{name}: the recipe has a single grasp of it, so there is no other to move to; give "
            "its grid more places"
            for name, listed in found.items()
            if len(listed) < 2
        ]
    )
    return found


def standing_seeds(
    pipeline: GraspPipeline, planned: PlannedGrasp, seed: int, stream: str, n: int
) -> list[int]:
    """The first ``n`` seeds that draw a world in which the object of a grasp stands.

    Those of two streams have nothing in common. Raises ``LearningError`` if the object topples in
    almost all.
    """
    name = planned.config.object
    every = (int(sha256_of_content([seed, stream, name, k])[:15], 16) for k in count())
    standing = (
        one
        for one in islice(every, n * MOST_TOPPLED)
        if pipeline.stands(replace(planned, seed=one))
    )
    found = list(islice(standing, n))
    if len(found) < n:
        msg = (
            f"{name}: stands in {len(found)} of {n * MOST_TOPPLED} draws of its centre of mass; "
            "lower randomize.center_of_mass_mm, or take it out of the recipe"
        )
        raise LearningError(msg)
    return found


@contextlib.contextmanager
def _world_job(
    asked: Question, worlds: Sequence[World], missing: Sequence[Sequence[int]]
) -> Iterator[Callable[[int, Mapping[int, str], Report], list[Row]]]:
    """One process: a task is one world, its items are the grasps."""
    # What the predictor notes of images it would say of each world: they have been compared.
    LOG.setLevel(logging.WARNING)
    most = max(len(planned) for planned, _ in worlds)
    predictor_of = lru_cache(maxsize=None)(partial(Predictor, asked.run, device="cpu"))
    with GraspPipeline(asked.recipe) as pipeline:

        def job(task: int, crashed: Mapping[int, str], report: Report) -> list[Row]:
            grasps, seed = worlds[task]
            predictor = predictor_of(grasps[0].config.object)
            row: Row = []
            for k, planned in enumerate(grasps):
                item = task * most + k
                if item in crashed:
                    row.append((0.0, "crashed", 0.0))
                    continue
                report("start", item, None)
                look = look_at(pipeline, planned, seed, k, predictor.spec, asked.pad)
                row.append(_said(look, asked.recipe, predictor))
            return [row]

        yield job


@dataclass(frozen=True, slots=True)
class Look:
    """What a network sees of a grasp before it is lifted, and how the lift then ends.

    ``frames`` are those of the sample of a ``pad`` that it sees.
    """

    trace: GraspTrace
    pad: PadSample
    frames: list[int]

    @property
    def images(self) -> NDArray[np.uint8]:
        """(T, H, W, 3) RGB."""
        return self.pad.rgb[self.frames]


def look_at(
    pipeline: GraspPipeline,
    planned: PlannedGrasp,
    seed: int,
    attempt: int,
    spec: InputSpec,
    pad: str,
) -> Look:
    """One grasp in the world of that seed; ``attempt`` draws its noise.

    A single image is that of the moment of grasp, a sequence ends with the lift's start or, of a
    network that was trained on the outcome, with the recipe's last frame.
    """
    recipe = pipeline.recipe
    grasp = pipeline.start(replace(planned, seed=seed), attempt).lift()
    pads, trace = pipeline.pad_samples(grasp, attempt), grasp.trace
    frames = list(range(len(planned_times_s(recipe))))
    if spec.shows_until == "grasp":
        frames = [trace.grasp_frame]
    elif spec.shows_until == "lift" and trace.status == "executed":
        start_s = trace.lift_start_time_s
        frames = [k for k, s in enumerate(_times_s(trace, recipe)) if s <= start_s + ROUNDING_S]
    return Look(trace, pads[pad], frames)


def _said(look: Look, recipe: Recipe, predictor: Predictor) -> tuple[float, str, float]:
    """What the network says of a grasp, how its lift ended, and how far it had risen."""
    trace = look.trace
    if trace.status != "executed":
        return 0.0, trace.status, 0.0
    names = [ARRAYS[channel.name] for channel in predictor.spec.touch]
    touch = {name: [np.asarray(getattr(look.pad, name))[look.frames]] for name in names}
    images = look.images[0] if predictor.spec.kind == "single" else look.images
    probability = float(predictor.predict([images], touch)[0])
    outcome = "held" if trace.label == LABEL_SUCCESS else trace.failure_mode
    return probability, outcome, look_rise_mm(trace, recipe, look.frames[-1])


def _times_s(trace: GraspTrace, recipe: Recipe) -> NDArray[np.float64]:
    last_s = trace.lift_start_time_s if recipe.frames.until == "lift" else float("nan")
    planned_s = np.array(planned_times_s(recipe))
    return frame_times_s(planned_s, trace.grasp_frame, trace.grasp_time_s, last_s)


def look_rise_mm(trace: GraspTrace, recipe: Recipe, frame: int) -> float:
    """How far the gripper has been lifted when the frame is taken.

    Raises ``LearningError`` if that is more than a test lift, and shows how the lift ends.
    """
    settings = recipe.physics_settings
    lifted_s = max(0.0, float(_times_s(trace, recipe)[frame]) - trace.lift_start_time_s)
    accelerated_s = min(lifted_s, settings.lift_speed_mm_s / settings.lift_acceleration_mm_s2)
    first_mm = settings.lift_acceleration_mm_s2 * accelerated_s**2 / 2
    steady_mm = settings.lift_speed_mm_s * (lifted_s - accelerated_s)
    rise_mm = min(settings.lift_mm, first_mm + steady_mm)
    if rise_mm > MOST_TEST_LIFT_MM:
        msg = (
            f"{recipe.name}: the network sees {rise_mm:.0f} mm of the lift, in which a grasp holds "
            f"or fails; a look is a test lift of at most {MOST_TEST_LIFT_MM:g} mm, before which "
            "the object can be set down: shorten frames.span_s in both recipes, or train with "
            "input.until: lift"
        )
        raise LearningError(msg)
    return rise_mm
