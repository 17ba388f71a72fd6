"""``tacgen regrasp``: grasp, look, then lift or move, with a trained network; against controls.

All that can happen in an episode is simulated first: every grasp of the recipe in the world of each
episode, and in worlds that the policy draws itself, to imagine with. What a policy does is then
read from these tables, so that all policies meet the same worlds, looks and outcomes.
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

from tacgen.collection.grid import PlannedGrasp, plan_recipe, rng_of
from tacgen.collection.inputs import recipe_inputs
from tacgen.collection.pipeline import GraspPipeline, frame_times_s
from tacgen.collection.recipe import Recipe
from tacgen.core.errors import LearningError
from tacgen.core.files import (
    refuse_foreign,
    refuse_other_page,
    sha256_of,
    sha256_of_content,
    write_text,
)
from tacgen.core.lock import holder_of, locked
from tacgen.core.progress import LOG, print_status
from tacgen.core.records import LABEL_SUCCESS, GraspTrace
from tacgen.core.workers import Report, run_tasks
from tacgen.dataset.reader import ROUNDING_S, TIME_DIGITS
from tacgen.dataset.samples import PadSample
from tacgen.dataset.samples import frame_times_s as frame_times_of
from tacgen.envs.regrasp_policies import (
    POLICIES,
    Belief,
    Costs,
    PolicyName,
    Rate,
    Step,
    play,
    resampled_episodes,
    share_of_gain,
)
from tacgen.learning.inputs import ARRAYS, InputSpec
from tacgen.learning.predictor import Predictor
from tacgen.learning.run_folder import RunFolder
from tacgen.learning.training_recipe import TrainRecipe
from tacgen.physics.rest import topples_deg

SCHEMA = 1
WORLDS, RESULT, PAGE = "worlds.jsonl", "regrasp.json", "index.html"
GRASP_LIMIT_S = 120.0  # of one grasp with its images, which takes 0.2 to 1 s
MOST_TEST_LIFT_MM = 10.0
"""Height of a look, from which a drop harms nothing and the object can still be set down."""
DROPS = ("translational_slip", "rotational_slip")  # how a lift fails
MOST_TOPPLED = 50  # draws for each one in which the object stands; then the recipe is at fault


@dataclass(frozen=True, slots=True)
class Drawn:
    """One world of an object: what its ``seed`` varies, and whether it is an episode's."""

    entry: int
    seed: int
    is_episode: bool


@dataclass(frozen=True, slots=True)
class Tried:
    """One grasp in one world: what the network said, and how its lift ended.

    ``outcome`` is ``held``, a failure mode, or the status of a grasp that was not executed;
    ``probability`` is then 0, for the gripper knows.
    """

    probability: float
    outcome: str
    look_rise_mm: float = 0.0

    @property
    def was_seen(self) -> bool:
        """Whether there was a look: the grasp was executed."""
        return self.outcome in ("held", *DROPS)


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
    """All that was played: ``episodes`` by policy and number of regrasps allowed.

    ``spec`` and ``pad`` say what the network sees of a grasp, and on which pad.
    """

    recipe: Recipe
    spec: InputSpec
    pad: str
    grasps: Mapping[str, tuple[PlannedGrasp, ...]]
    episodes: Mapping[tuple[PolicyName, int], tuple[Episode, ...]]


def regrasp(
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
    """Play ``episodes`` of each object by every policy, and write ``out/regrasp.json``.

    ``worlds`` is how many the policy imagines of each object, ``seed`` draws both kinds (default:
    the recipe's). Finished worlds are kept in ``out/worlds.jsonl``: an interrupted run goes on from
    there, and other costs cost nothing.

    ``regrasp.json``: ``schema``, ``run``, ``recipe``, ``seed``, ``costs``, ``regrasps``,
    ``episodes`` and ``worlds`` (of each object), ``looks`` (``grasp``, ``lift`` or ``test lift``),
    ``test_lift_mm``; ``policies``: by name a list over the regrasps allowed, 0 first, of
    ``success``, ``share_of_gain`` (of the oracle's over the first grasps) and
    ``share_beyond_blind`` (of the oracle's over the blind policy), each ``{"value", "interval"}``
    (95 %, bootstrap over episodes), ``mean_regrasps``, ``drops`` (episodes that ended in a failed
    lift, by failure mode) and ``not_executed``; ``by_object``: by name the ``success`` of each
    policy after all regrasps, and of the first grasps; ``network``: its accuracy on the looks of
    the episodes (grasps that were executed), with the share of them that holds.

    Raises ``LearningError`` if the run lacks an object or saw other images than the recipe gives,
    an object has a single grasp or does not stand, or the looks show the outcome.
    """
    seed = recipe.seed if seed is None else seed
    grasps = _grasps_of(recipe)
    pad = _checked_pad(run, recipe)
    unknown = ("friction_relative", "mass_relative", "center_of_mass_mm")
    if not any(getattr(recipe.randomize, name) for name in unknown):
        print_status(
            f"warning: {recipe.name}: randomize draws no friction, mass or centre of mass, so that "
            f"nothing of an object is unknown and touch finds nothing out; set {', '.join(unknown)}"
        )
    pipeline = GraspPipeline(recipe)
    drawn = [
        Drawn(own[0].entry, one, is_episode)
        for own in grasps.values()
        for is_episode, n in ((False, worlds), (True, episodes))
        for one in standing_seeds(pipeline, own[0], seed, n, is_episode=is_episode)
    ]
    tried = _tried_in(drawn, run, pad, recipe, grasps, out, workers, show)
    spec = Predictor(run, recipe.objects[0].object_name, device="cpu").spec
    episodes_of = _play_all(recipe, drawn, tried, costs, regrasps)
    played, until = Played(recipe, spec, pad, grasps, episodes_of), spec.shows_until
    result = {
        "schema": SCHEMA,
        "run": str(run),
        "recipe": recipe.name,
        "seed": seed,
        "costs": asdict(costs),
        "regrasps": regrasps,
        "episodes": episodes,
        "worlds": worlds,
        "looks": "test lift" if until == "outcome" else until,
        "test_lift_mm": max(one.look_rise_mm for row in tried.values() for one in row),
        **_scores(played, regrasps, seed),
        "network": _network_scores(drawn, tried),
    }
    write_text(out / RESULT, json.dumps(result, indent=1))
    return result, played


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


def _checked_pad(run: Path, recipe: Recipe) -> str:
    """The pad that the run was trained on.

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
            "train on a dataset with all of the recipe's objects, or take these out of the recipe"
        )
    before, inputs = plan["dataset"].get("taken_with", {}), recipe_inputs(recipe).sha256
    pads, frames = recipe.physics_settings.sensing_pads, recipe.frames
    pad = before["pad"] if before.get("pad") in pads else pads[0]
    now: dict[str, Any] = {
        "sensor_sha256": inputs["sensor"],
        "table": inputs.get("table"),
        "pad": pad,
        "markers": recipe.optics.markers,
        "shadows": recipe.optics.shadows,
    }
    if trained.model.kind == "sequence":
        now["time_s"] = np.round(frame_times_s(recipe), TIME_DIGITS).tolist()
        now["until"] = "lift" if frames.until == "lift" else "outcome"
    other = [
        name.removesuffix("_sha256")
        for name, value in now.items()
        if None not in (before.get(name), value) and before[name] != value
    ]
    if other:
        problems.append(
            f"{run}: was trained on images of another {', '.join(other)} than those of the recipe "
            f"{recipe.name}; collect its dataset with the recipe's sensor, optics and frames"
        )
    if "vision" in trained.input.channels:
        problems.append(
            f"{run}: its network sees a camera, and looks before a lift are of touch alone; train "
            "one without the channel vision"
        )
    kept = {"markers": recipe.dataset.markers, "force_field": recipe.dataset.force_field}
    lacking = [name for name in kept if name in trained.input.channels and not kept[name]]
    if lacking:
        problems.append(
            f"{run}: its network also sees {', '.join(lacking)}; set dataset.{lacking[0]} in the "
            "recipe as its dataset had it"
        )
    LearningError.raise_if(problems)
    return pad


def standing_seeds(
    pipeline: GraspPipeline, planned: PlannedGrasp, seed: int, n: int, *, is_episode: bool
) -> list[int]:
    """The first ``n`` seeds that draw a world in which the object of a grasp stands.

    Those of episodes and of imagined worlds have nothing in common. Raises ``LearningError`` if
    the object topples in almost all.
    """
    name, stream = planned.config.object, "episode" if is_episode else "imagined"
    every = (int(sha256_of_content([seed, stream, name, k])[:15], 16) for k in count())
    standing = (
        one
        for one in islice(every, n * MOST_TOPPLED)
        if not topples_deg(pipeline.at_rest(replace(planned, seed=one)).grasped)
    )
    found = list(islice(standing, n))
    if len(found) < n:
        msg = (
            f"{name}: stands in {len(found)} of {n * MOST_TOPPLED} draws of its centre of mass; "
            "lower randomize.center_of_mass_mm, or take it out of the recipe"
        )
        raise LearningError(msg)
    return found


def _tried_in(
    drawn: Sequence[Drawn],
    run: Path,
    pad: str,
    recipe: Recipe,
    grasps: Mapping[str, Sequence[PlannedGrasp]],
    out: Path,
    workers: int,
    show: Callable[[int, int], None],
) -> dict[Drawn, list[Tried]]:
    """Every grasp in every drawn world, from the file of finished ones or simulated."""
    refuse_foreign(out, WORLDS, [RESULT, PAGE])
    refuse_other_page(out / PAGE, "regrasp")
    out.mkdir(parents=True, exist_ok=True)
    lock = out / ".lock"
    with locked(lock) as held:
        if held is False:
            holder = holder_of(lock) or "another process"
            msg = f"{out}: {holder} is working there; wait for it, or end it"
            raise LearningError(msg)
        store = _Store(out / WORLDS, run, recipe, grasps)
        kept = store.read()
        found = {one: kept[key] for one in drawn if (key := store.key(one)) in kept}
        pending = [k for k, one in enumerate(drawn) if one not in found]
        show(len(found), len(drawn))
        job = partial(_world_job, run, pad, recipe, grasps, tuple(drawn))
        for event in run_tasks(pending, job, workers=workers, item_limit_s=GRASP_LIMIT_S):
            if event.kind == "done":
                store.append(drawn[event.task], event.value)
                found[drawn[event.task]] = event.value
                show(len(found), len(drawn))
    return found


@contextlib.contextmanager
def _world_job(
    run: Path,
    pad: str,
    recipe: Recipe,
    grasps: Mapping[str, Sequence[PlannedGrasp]],
    drawn: Sequence[Drawn],
) -> Iterator[Callable[[int, Mapping[int, str], Report], list[Tried]]]:
    """One process: a task is one world, its items are the grasps."""
    # What the predictor notes of images it would say of each world: ``_checked_pad`` compares them.
    LOG.setLevel(logging.WARNING)
    names = [entry.object_name for entry in recipe.objects]
    most = max(map(len, grasps.values()))
    predictor_of = lru_cache(maxsize=None)(partial(Predictor, run, device="cpu"))
    with GraspPipeline(recipe) as pipeline:

        def job(task: int, crashed: Mapping[int, str], report: Report) -> list[Tried]:
            world = drawn[task]
            predictor = predictor_of(names[world.entry])
            found = []
            for k, planned in enumerate(grasps[names[world.entry]]):
                item = task * most + k
                if item in crashed:
                    found.append(Tried(0.0, "crashed"))
                    continue
                report("start", item, None)
                look = look_at(pipeline, planned, world.seed, k, predictor.spec, pad)
                found.append(_try(look, recipe, predictor))
            return found

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
    frames = list(range(len(frame_times_s(recipe))))
    if spec.shows_until == "grasp":
        frames = [trace.grasp_frame]
    elif spec.shows_until == "lift" and trace.status == "executed":
        start_s = trace.lift_start_time_s
        frames = [k for k, s in enumerate(_times_s(trace, recipe)) if s <= start_s + ROUNDING_S]
    return Look(trace, pads[pad], frames)


def _try(look: Look, recipe: Recipe, predictor: Predictor) -> Tried:
    trace = look.trace
    if trace.status != "executed":
        return Tried(0.0, trace.status)
    names = [ARRAYS[channel.name] for channel in predictor.spec.touch]
    touch = {name: [np.asarray(getattr(look.pad, name))[look.frames]] for name in names}
    images = look.images[0] if predictor.spec.kind == "single" else look.images
    probability = float(predictor.predict([images], touch)[0])
    outcome = "held" if trace.label == LABEL_SUCCESS else trace.failure_mode
    return Tried(probability, outcome, look_rise_mm(trace, recipe, look.frames[-1]))


def _times_s(trace: GraspTrace, recipe: Recipe) -> NDArray[np.float64]:
    last_s = trace.lift_start_time_s if recipe.frames.until == "lift" else float("nan")
    planned_s = np.array(frame_times_s(recipe))
    return frame_times_of(planned_s, trace.grasp_frame, trace.grasp_time_s, last_s)


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


class _Store:
    """Finished worlds on disk, a line each, with a hash of all that they depend on."""

    def __init__(
        self,
        path: Path,
        run: Path,
        recipe: Recipe,
        grasps: Mapping[str, Sequence[PlannedGrasp]],
    ) -> None:
        self._path, self._names = path, [entry.object_name for entry in recipe.objects]
        models, folder = RunFolder(run).plan()["models"], RunFolder(run)
        self._made_with = {}
        for name in self._names:
            model = next(key for key, one in models.items() if name in one["objects"])
            places = [asdict(planned.config) | {"index": 0} for planned in grasps[name]]
            digest = sha256_of(folder.model(model).model_path)
            inputs = recipe_inputs(recipe, [name]).sha256
            self._made_with[name] = sha256_of_content([inputs, places, digest])

    def key(self, world: Drawn) -> tuple[str, int]:
        """What a line is found by."""
        return self._names[world.entry], world.seed

    def read(self) -> dict[tuple[str, int], list[Tried]]:
        """What was finished with these inputs; damaged lines, and those of others, are not used."""
        found: dict[tuple[str, int], list[Tried]] = {}
        if self._path.is_file():
            for line in self._path.read_text(encoding="utf-8", errors="replace").splitlines():
                with contextlib.suppress(ValueError, KeyError, TypeError):
                    data = json.loads(line)
                    if data["made_with"] == self._made_with.get(data["object"]):
                        row = [Tried(**one) for one in data["grasps"]]
                        found[data["object"], data["seed"]] = row
        return found

    def append(self, world: Drawn, row: Sequence[Tried]) -> None:
        """Add a finished world."""
        name, seed = self.key(world)
        line = {"made_with": self._made_with[name], "object": name, "seed": seed}
        line["grasps"] = [asdict(one) for one in row]
        with self._path.open("a+b") as file:
            file.seek(max(0, file.tell() - 1))
            if file.read(1) not in (b"", b"\n"):
                file.write(b"\n")  # after a line that was cut short
            file.write(f"{json.dumps(line)}\n".encode())


def _play_all(
    recipe: Recipe,
    drawn: Sequence[Drawn],
    tried: Mapping[Drawn, Sequence[Tried]],
    costs: Costs,
    regrasps: int,
) -> dict[tuple[PolicyName, int], tuple[Episode, ...]]:
    found: dict[tuple[PolicyName, int], list[Episode]] = {}
    for k, entry in enumerate(recipe.objects):
        own = [one for one in drawn if one.entry == k]
        look = {one: np.array([grasp.probability for grasp in tried[one]]) for one in own}
        holds = {one: np.array([grasp.outcome == "held" for grasp in tried[one]]) for one in own}
        imagined = [one for one in own if not one.is_episode]
        belief = Belief(
            np.stack([holds[one] for one in imagined]), np.stack([look[one] for one in imagined])
        )
        for world in (one for one in own if one.is_episode):
            first = int(rng_of(world.seed, 2).integers(len(look[world])))
            for policy in POLICIES:
                for allowed in range(regrasps + 1):
                    rng = rng_of(world.seed, 3)
                    steps = play(
                        policy, first, look[world], holds[world], belief, costs, allowed, rng
                    )
                    outcome = tried[world][steps[-1].grasp].outcome
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
        failed = [one.outcome for one in listed if not one.held]
        policies.setdefault(key[0], []).append(
            {
                "success": Rate.of(float(value[0]), resampled).as_json(),
                "share_of_gain": share(key, start),
                "share_beyond_blind": share(key, held["blind", key[1]]),
                "mean_regrasps": float(np.mean([len(one.steps) - 1 for one in listed])),
                "drops": {mode: failed.count(mode) for mode in DROPS},
                "not_executed": sum(outcome not in DROPS for outcome in failed),
            }
        )
    by_object = {
        name: {"first": float(start[objects == name].mean())}
        | {policy: float(held[policy, regrasps][objects == name].mean()) for policy in POLICIES}
        for name in dict.fromkeys(objects.tolist())
    }
    return {"policies": policies, "by_object": by_object}


def _network_scores(
    drawn: Sequence[Drawn], tried: Mapping[Drawn, Sequence[Tried]]
) -> dict[str, float]:
    rows = [one for world in drawn if world.is_episode for one in tried[world] if one.was_seen]
    if not rows:
        msg = "no grasp of the episodes could be executed; `tacgen collect` says why"
        raise LearningError(msg)
    holds = np.array([one.outcome == "held" for one in rows])
    sure = np.array([one.probability >= 0.5 for one in rows])
    return {"accuracy": float((sure == holds).mean()), "holds": float(holds.mean())}
