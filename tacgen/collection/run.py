"""Collecting a dataset: the plan's shards, worked through by watched processes."""

import contextlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from tacgen.collection.grid import PlannedGrasp, grown_plan
from tacgen.collection.pipeline import GraspPipeline, dataset_spec, planned_times_s, tactile_pad
from tacgen.collection.recipe import Recipe, load_recipe
from tacgen.core.errors import SensorError, require_extra
from tacgen.core.files import disk_errors
from tacgen.core.processes import Event, Report, run_tasks
from tacgen.core.progress import print_status, progress_counter
from tacgen.core.records import LABEL_NOT_EXECUTED
from tacgen.dataset import DatasetFolder, DatasetSpec, GraspSample
from tacgen.dataset.gallery import Thumbnails, shown_grasps, thumbnails, write_gallery
from tacgen.dataset.summary import write_card
from tacgen.physics import GraspSimulator


@dataclass(slots=True)
class Collected:
    """What a run of ``collect`` did: shards it made, found done, and that another job has claimed.

    ``labels`` are those of the grasps that were simulated, ``crashed`` the reasons of the others,
    both by the grasp's index; ``n_succeeded`` counts the successes among them. ``thumbnails`` are
    for the gallery, of the grasps that it shows.
    """

    found: tuple[int, ...]
    made: list[int] = field(default_factory=list)
    claimed_elsewhere: list[int] = field(default_factory=list)
    labels: dict[int, int] = field(default_factory=dict)
    crashed: dict[int, str] = field(default_factory=dict)
    n_succeeded: int = 0
    thumbnails: dict[int, Thumbnails] = field(default_factory=dict)

    def add(self, event: Event) -> None:
        """Count what happened."""
        if event.kind in ("item", "crashed"):  # again, if its shard was begun before
            self.n_succeeded -= self.labels.pop(event.item, 0) == 1
            self.crashed.pop(event.item, None)
            self.thumbnails.pop(event.item, None)
        if event.kind == "item":
            label, small = event.value
            self.labels[event.item] = label
            self.n_succeeded += label == 1
            if small:
                self.thumbnails[event.item] = small
        elif event.kind == "crashed":
            self.crashed[event.item] = event.value
        elif event.kind == "done":
            (self.made if event.value else self.claimed_elsewhere).append(event.task)

    def summary(self) -> dict[str, int]:
        """Counts to show."""
        labels = Counter(self.labels.values())
        elsewhere = {"shards_claimed_by_another_job": len(self.claimed_elsewhere)}
        return {
            "shards_made": len(self.made),
            "shards_found": len(self.found),
            **(elsewhere if self.claimed_elsewhere else {}),
            "grasps_made": len(self.labels) + len(self.crashed),
            "crashed": len(self.crashed),
            "grasps_held": len(self.labels) + len(self.crashed),
            "successes": labels[1],
            "failures": labels[0],
            "not_executed": labels[-1],
        }


def collect(
    recipe: Recipe | str | Path,
    out: Path | str,
    *,
    workers: int = 1,
    shards: Sequence[int] | None = None,
    redo: Sequence[int] = (),
    grow: bool = False,
    item_limit_s: float = 120.0,
    progress: bool = True,
) -> Collected:
    """Make every shard of ``recipe`` that ``out`` does not hold yet.

    Parameters
    ----------
    recipe : Recipe, or the name or path of one
    out : path of the dataset's folder
    shards : sequence of int, optional
        The share of this call; all by default.
    redo : sequence of int
        Shards to make anew although they are there (a repair).
    grow : bool
        Keep the shards of a dataset of which ``recipe`` has all grasps, and add the others.
    item_limit_s : float
        A grasp that takes longer, without its waiting for a core, is recorded as ``crashed``.

    Raises
    ------
    DatasetError
        If the folder cannot be written to or holds another dataset.
    TacgenError
        If three grasps in a row crash.

    Examples
    --------
    >>> _ = tacgen.collect("two_grasps.yaml", "data", progress=False)
    >>> len(tacgen.Dataset("data"))
    2
    """
    recipe, out = recipe if isinstance(recipe, Recipe) else load_recipe(recipe), Path(out)
    if not DatasetFolder(out).plan_path.is_file():
        # Before anything is written: is the engine there?
        GraspSimulator(recipe.robot.spec(), recipe.physics.engine)
    planned, spec = prepare(recipe, out, grow=grow)
    folder = DatasetFolder(out)
    if progress:
        print_status(f"sensor {spec.sensor.name}: colours from {spec.colors_from}")
    share = range(spec.n_shards) if shards is None else shards
    result = Collected(tuple(s for s in share if s not in redo and folder.is_done(s)))
    wanted = [shard for shard in share if shard not in result.found]
    n_items = sum(len(spec.shard_range(shard)) for shard in wanted)
    job = partial(_shard_job, recipe, planned, folder.root, spec, frozenset(redo))
    with progress_counter("grasp", enabled=progress and n_items > 0) as show:
        for event in run_tasks(wanted, job, workers=workers, item_limit_s=item_limit_s):
            result.add(event)
            n_made = len(result.labels) + len(result.crashed)
            show(n_made, max(n_items, n_made), f"{result.n_succeeded} succeeded")
            if progress and event.kind in ("crashed", "retried"):
                is_grasp = event.kind == "crashed"
                what = f"grasp {event.item}" if is_grasp else f"shard {event.task}"
                print_status(f"{what} {event.kind}: {event.value}")
    result.made.sort()
    result.claimed_elsewhere = sorted({*result.claimed_elsewhere} - {*result.made})
    is_whole = bool(result.made or result.found) and len(folder.merge()) == spec.n_shards
    if is_whole and (result.made or not folder.gallery_path.is_file()):
        with disk_errors(folder.root):
            write_card(folder.root)
            write_gallery(folder.root, result.thumbnails)
    return result


def prepare(
    recipe: Recipe, out: Path, *, grow: bool = False
) -> tuple[tuple[PlannedGrasp, ...], DatasetSpec]:
    """Make ``out`` ready for the dataset of ``recipe``: its grasps, and what they have in common.

    Raises ``DatasetError`` if the folder cannot be written to or holds another dataset,
    ``SensorError`` if the device that is to draw the images is not here.
    """
    folder, device = DatasetFolder(out), recipe.optics.device
    drawn_by = ""
    if device != "none":
        require_extra("batch", f"optics.device = {device!r} needs", SensorError)
        from tacgen.batch.pad_images import name_of

        drawn_by = name_of(device, tactile_pad(recipe))
    plan = grown_plan(recipe, folder.grids())
    spec = dataset_spec(
        recipe, len(plan.grasps), grids=plan.grids, parts=plan.parts, folder=folder.root
    )
    if drawn_by:
        spec = replace(spec, inputs=spec.inputs.drawn_by(drawn_by))
    folder.prepare(spec, grow=grow)
    return plan.grasps, spec


def describe(recipe: Recipe, out: Path) -> dict[str, Any]:
    """What a recipe asks for, and how much of it is there."""
    folder = DatasetFolder(out)
    plan = grown_plan(recipe, folder.grids())
    n_shards = sum(-(-part // recipe.dataset.shard_size) for part in plan.parts)
    return {
        "recipe": recipe.name,
        "out": str(out),
        "objects": [entry.object_name for entry in recipe.objects],
        "grasps": len(plan.grasps),
        "frames_a_grasp": len(planned_times_s(recipe)),
        "shards": n_shards,
        "shards_done": sum(folder.is_done(shard) for shard in range(n_shards)),
    }


@contextlib.contextmanager
def _shard_job(
    recipe: Recipe,
    planned: tuple[PlannedGrasp, ...],
    root: Path,
    spec: DatasetSpec,
    redo: frozenset[int],
) -> Iterator[Callable[[int, Mapping[int, str], Report], bool]]:
    """The work of one process: a simulator kept open, and a shard for each call.

    The job returns False where another process has the shard.
    """
    folder, shown, noise_grey = DatasetFolder(root), shown_grasps(spec), spec.noise_at_load_grey
    with GraspPipeline(recipe, recipe.optics.device) as pipeline:

        def job(shard: int, crashed: Mapping[int, str], report: Report) -> bool:
            def samples() -> Iterator[GraspSample]:
                for index in spec.shard_range(shard):
                    if index in crashed:
                        one = planned[index]
                        yield GraspSample(
                            config=one.config,
                            seed=one.seed,
                            split=one.split,
                            status="crashed",
                            label=LABEL_NOT_EXECUTED,
                            reason=crashed[index],
                        )
                        continue
                    report("start", index, None)
                    sample = pipeline.sample(planned[index])
                    yield sample
                    small = thumbnails(sample, noise_grey) if index in shown else None
                    report("item", index, (sample.label, small))

            with folder.claim(shard, redo=shard in redo) as mine:
                if mine:
                    folder.write_shard(shard, samples(), spec)
                return mine

        yield job
