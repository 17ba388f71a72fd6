"""What a dataset holds, from its manifest alone: counts, balance, sizes, origin."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tacgen.core.errors import DatasetError
from tacgen.dataset.check import OUTCOME
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.manifest import ShardLine, total

_MB = 1e6


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures of ``tacgen inspect``.

    ``success_rate`` is over executed grasps, NaN-free: None where none was. ``ratio`` is the
    size of the arrays over the size of the files.
    """

    root: str
    recipe: str
    recipe_sha256: str
    sensor: str
    pads: tuple[str, ...]
    frames: int
    shards: int
    shards_planned: int
    grasps: int
    grasps_planned: int
    counts: dict[str, int]
    status: dict[str, int]
    failure_modes: dict[str, int]
    splits: dict[str, int]
    objects: dict[str, dict[str, int]]
    success_rate: float | None
    bytes: int
    raw_bytes: int
    ratio: float
    calibration: dict[str, str]
    versions: dict[str, str]

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return asdict(self)


def summarize(root: Path | str) -> Summary:
    """Sum up the dataset in ``root``, finished or not, without opening a shard.

    Raises ``DatasetError`` if there is no finished shard, or the manifest cannot be read.
    """
    folder = DatasetFolder(root)
    lines = list(folder.manifest().values())
    if not lines:
        msg = f"{folder.root} has no finished shard; `tacgen collect --out` makes a dataset"
        raise DatasetError(msg)
    plan = folder.plan() if folder.plan_path.is_file() else {}
    counts = total(lines, "counts")
    executed = counts.get("success", 0) + counts.get("failure", 0)
    n_bytes, raw = sum(line.bytes for line in lines), sum(line.raw_bytes for line in lines)
    n_grasps = sum(line.index_range[1] - line.index_range[0] for line in lines)
    return Summary(
        root=str(folder.root),
        recipe=lines[0].recipe,
        recipe_sha256=lines[0].recipe_sha256,
        sensor=lines[0].sensor,
        pads=lines[0].pads,
        frames=lines[0].frames,
        shards=len(lines),
        shards_planned=plan.get("n_shards", len(lines)),
        grasps=n_grasps,
        grasps_planned=plan.get("n_grasps", n_grasps),
        counts=counts,
        status=total(lines, "status"),
        failure_modes=total(lines, "failure_modes"),
        splits=total(lines, "splits"),
        objects=_by_object(lines),
        success_rate=counts.get("success", 0) / executed if executed else None,
        bytes=n_bytes,
        raw_bytes=raw,
        ratio=raw / max(n_bytes, 1),
        calibration=dict(lines[0].calibration),
        versions=dict(lines[0].versions),
    )


def summary_text(summary: Summary) -> str:
    """A page of plain text for a terminal."""
    rate = "–" if summary.success_rate is None else f"{summary.success_rate:.0%}"
    missing = summary.shards_planned - summary.shards
    shards = f"{summary.shards} of {summary.shards_planned} shards"
    rows = [
        ("recipe", f"{summary.recipe}  ({summary.recipe_sha256[:12]})"),
        ("sensor", f"{summary.sensor}, {' and '.join(summary.pads)} pad, {_frames(summary)}"),
        ("grasps", f"{summary.grasps} of {summary.grasps_planned}, in {shards}"),
        ("outcome", f"{_listed(summary.counts)}; {rate} of the executed succeed"),
        ("status", _listed(summary.status)),
        ("failures", _listed(summary.failure_modes) or "none"),
        ("split", _listed(summary.splits)),
        ("size", f"{summary.bytes / _MB:.1f} MB, {summary.ratio:.1f} × smaller than raw"),
        ("made by", f"tacgen {summary.versions.get('tacgen', '?')}"),
    ]
    text = "\n".join(f"{name:<9} {value}" for name, value in rows)
    columns = list(OUTCOME.values())
    table = [["object", *(name.replace("_", " ") for name in columns), "success rate"]]
    for name, tally in summary.objects.items():
        executed = tally.get("success", 0) + tally.get("failure", 0)
        share = f"{tally.get('success', 0) / executed:.0%}" if executed else "–"
        table.append([name, *(str(tally.get(column, 0)) for column in columns), share])
    hint = "\n\nnot complete: `tacgen collect` resumes it" if missing > 0 else ""
    return f"{text}\n\n{_aligned(table)}{hint}"


def _by_object(lines: Iterable[ShardLine]) -> dict[str, dict[str, int]]:
    objects: dict[str, dict[str, int]] = {}
    for line in lines:
        for name, tally in line.objects.items():
            mine = objects.setdefault(name, dict.fromkeys(OUTCOME.values(), 0))
            for outcome, count in tally.items():
                mine[outcome] = mine.get(outcome, 0) + count
    return dict(sorted(objects.items()))


def _frames(summary: Summary) -> str:
    return "one image a grasp" if summary.frames == 1 else f"{summary.frames} images a grasp"


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in counts.items())


def _aligned(rows: Sequence[Sequence[str]]) -> str:
    """Columns of equal width: the first to the left, the others to the right."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if place else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    )
