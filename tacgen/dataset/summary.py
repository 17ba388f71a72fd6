"""What a dataset holds, from its manifest: counts, balance, sizes, origin; and its card."""

import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.core.errors import DatasetError
from tacgen.core.files import write_text
from tacgen.core.progress import print_status
from tacgen.dataset.check import OUTCOME, flags_at_moment
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.manifest import ShardLine, total
from tacgen.dataset.reader import Dataset
from tacgen.dataset.schema import FLAG_WORDS, SEGMENTS, VALIDITY
from tacgen.dataset.shard import broken_as_error, open_shard, read_image
from tacgen.optics.visible import VISIBLE
from tacgen.report.page import templates


def summarize(root: Path | str) -> dict[str, Any]:
    """The figures of ``tacgen inspect``, finished or not.

    It opens the first shard, and those with grasps that were not executed.

    ``success_rate`` is over executed grasps, None where none was; ``ratio`` is the size of the
    arrays over that of the files; ``not_executed`` counts grasps by the reason why they could not
    be executed, reasons that differ only in numbers as the first of them. ``validity`` counts the
    frames of executed grasps and those whose images do not show the whole force, ``nothing_to_see``
    lists, by object, the grasps with such a picture at their moment. ``inputs`` are the
    hashes of all that the shards depend on, ``parts`` the grasps at first and those that each
    growth added, ``listed`` whether they stand in a list (``grid.file``). ``arrays`` are the
    images and what is kept of the touch: of which shape (without the grasps; those of a camera as
    ``camera/<name>/…``), and the bytes a grasp takes of all pads, before compression
    (``raw_bytes``) and in the first shard. ``blind_cameras`` show the object in no image of that.

    Raises ``DatasetError`` if there is no finished shard, or the manifest cannot be read.
    """
    folder = DatasetFolder(root)
    lines = list(folder.manifest().values())
    if not lines:
        msg = f"{folder.root} has no finished shard; `tacgen collect --out` makes a dataset"
        raise DatasetError(msg)
    plan = folder.plan() if folder.plan_path.is_file() else {}
    n_bytes, raw = sum(line.bytes for line in lines), sum(line.raw_bytes for line in lines)
    n_grasps = sum(line.n_grasps for line in lines)
    objects: dict[str, Counter[str]] = {}
    for line in lines:
        for name, tally in line.objects.items():
            objects.setdefault(name, Counter(dict.fromkeys(OUTCOME.values(), 0))).update(tally)
    totals = {name: total(lines, name) for name in ("counts", "status", "failure_modes", "splits")}
    same = (
        "recipe_sha256",
        "sensor",
        "pads",
        "frames",
        "calibration",
        "versions",
        "engine",
        "device",
    )
    inputs = {role: digest for line in lines for role, digest in line.inputs.items()}
    parts = Counter({line.part: 0 for line in lines})
    for line in lines:
        parts[line.part] += line.n_grasps
    return {
        "root": str(folder.root),
        "recipe": plan.get("recipe", lines[0].recipe),
        **{name: getattr(lines[0], name) for name in same},
        "colors_from": plan.get("colors_from", "not recorded"),
        "inputs": dict(sorted(inputs.items())),
        "parts": [parts[k] for k in sorted(parts)],
        "listed": any("points" in one for grid in plan.get("grids", ()) for one in grid),
        "shards": len(lines),
        "shards_planned": plan.get("n_shards", len(lines)),
        "grasps": n_grasps,
        "grasps_planned": plan.get("n_grasps", n_grasps),
        **totals,
        "objects": {name: dict(tally) for name, tally in sorted(objects.items())},
        "success_rate": success_rate(totals["counts"]),
        "bytes": n_bytes,
        "raw_bytes": raw,
        "ratio": raw / max(n_bytes, 1),
        "not_executed": _reasons(folder, lines),
        "validity": _validity(lines),
        "nothing_to_see": _nothing_to_see(folder, lines),
        "arrays": _arrays(folder, lines[0]),
        "blind_cameras": _blind_cameras(folder, lines[0]),
    }


def _blind_cameras(folder: DatasetFolder, line: ShardLine) -> list[str]:
    path, seen = folder.shard_path(line.shard), SEGMENTS.index("object")
    if not line.status.get("executed"):
        return []
    with closing(open_shard(path)) as shard, broken_as_error(path):
        return [
            one.owner
            for one in shard.layout.placed()
            if one.field.of == "camera" and one.field.name == "segmentation"
            for images in [shard.arrays[one.path]]
            if not any(
                (read_image(images, at) == seen).any() for at in np.ndindex(images.shape[:-2])
            )
        ]


def _arrays(folder: DatasetFolder, line: ShardLine) -> dict[str, dict[str, Any]]:
    path = folder.shard_path(line.shard)
    n_stored = max(line.status.get("executed", 0), 1)
    found: dict[str, dict[str, Any]] = {}
    with closing(open_shard(path)) as shard, broken_as_error(path):
        for one in shard.layout.placed():
            field = one.field
            if field.of in ("pad", "camera") and field.image:
                stored = shard.arrays[one.path]
                shape = stored.shape[1:]
                of_name = found.setdefault(
                    field.known_as(one.owner), {"shape": list(shape), "raw_bytes": 0, "bytes": 0}
                )
                of_name["raw_bytes"] += stored.dtype.itemsize * math.prod(shape)
                of_name["bytes"] += round(stored.id.get_storage_size() / n_stored)
    return found


def sampling_text(summary: Mapping[str, Any]) -> str:
    """How the grasps came out of the grid, where not all at once and at random; else empty."""
    parts = summary["parts"]
    text = ""
    if len(parts) > 1:
        text = f"{parts[0]} grasps at first, then {', then '.join(map(str, parts[1:]))} more"
    if summary["listed"]:
        listed = "grasps of a list (grid.file), so rates of success are the list's, not a grid's"
        text = f"{text}; {listed}" if text else listed
    return text


def none_executed(summary: Mapping[str, Any]) -> bool:
    """Whether all planned grasps are there and none of them could be executed."""
    is_whole = summary["grasps"] == summary["grasps_planned"]
    return is_whole and summary["success_rate"] is None


def not_executed_lines(summary: Mapping[str, Any]) -> list[str]:
    """How many grasps were not executed, and each reason with its count."""
    reasons: Mapping[str, int] = summary["not_executed"]
    if not reasons:
        return []
    lines = [f"{sum(reasons.values())} of {summary['grasps']} grasps could not be executed:"]
    return lines + [f"  {count} × {reason}" for reason, count in reasons.items()]


CHANGE = (
    "grip with more force (grid.force_n); put the pads where an edge or a curve of the object lies "
    "within the picture (grid.x_mm, y_mm, z_mm; `tacgen objects show NAME`); or take a sensor with "
    "a softer or more domed gel (`tacgen sensors list`)"
)
"""How grasps come to show something: force, place, sensor."""
MAX_LISTED = 12  # grasps of an object in a message


def validity_lines(summary: Mapping[str, Any]) -> list[str]:
    """What pictures lack, and what to change: a force or an object that they do not show."""
    lines = [
        f"camera {name} shows the object nowhere in the first shard; correct its pose or look_at"
        for name in summary["blind_cameras"]
    ]
    found = summary["validity"]["grasps"]
    for name, what in (("saturated", "press the gel through"), ("no_contact", "miss a pad")):
        if found[name]:
            lines.append(f"{FLAG_WORDS[name]}: {found[name]} of {found['of']} grasps {what}")
    if empty := summary["nothing_to_see"]:
        lines.append(
            f"nothing to see: in {found['nothing_to_see']} of {found['of']} grasps no pixel of a "
            f"picture differs from the gel at rest by over {VISIBLE.change_grey:g} grey levels; "
            + CHANGE
        )
        for name, indices in empty.items():
            more = f" and {len(indices) - MAX_LISTED} more" if len(indices) > MAX_LISTED else ""
            lines[-1] += f"\n  {name}: grasp {', '.join(map(str, indices[:MAX_LISTED]))}{more}"
    return lines


def cut_off_line(summary: Mapping[str, Any]) -> list[str]:
    """In how many grasps the contact goes on beyond the picture, which is usual."""
    found = summary["validity"]["grasps"]
    if not found["outside_window"]:
        return []
    return [
        f"cut off: the contact goes on beyond the picture in {found['outside_window']} of "
        f"{found['of']} grasps, as it does where an object is larger than the picture"
    ]


def _nothing_to_see(folder: DatasetFolder, lines: Iterable[ShardLine]) -> dict[str, list[int]]:
    found: dict[str, list[int]] = {}
    for line in lines:
        if not line.validity.get("grasps", {}).get("nothing_to_see"):
            continue
        path = folder.shard_path(line.shard)
        with closing(open_shard(path)) as shard, broken_as_error(path):
            columns = shard.small_arrays()
            at_moment = flags_at_moment(columns, shard.layout, "nothing_to_see")
            names, indices = (columns[f"/grasp/{name}"] for name in ("object", "index"))
        for row in np.flatnonzero(at_moment):
            found.setdefault(names[row].decode(errors="replace"), []).append(int(indices[row]))
    return found


def _validity(lines: Sequence[ShardLine]) -> dict[str, dict[str, int]]:
    """Flagged frames and grasps at their moment, and of how many (``of``)."""
    executed = sum(line.status.get("executed", 0) for line in lines)
    n_frames = len(lines[0].pads) * lines[0].frames
    found = {"frames": {"of": executed * n_frames}, "grasps": {"of": executed}}
    for kind, counts in found.items():
        for name in VALIDITY:
            counts[name] = sum(line.validity.get(kind, {}).get(name, 0) for line in lines)
    return found


def success_rate(counts: Mapping[str, int]) -> float | None:
    """Successes over executed grasps; None where none was executed."""
    executed = counts.get("success", 0) + counts.get("failure", 0)
    return counts.get("success", 0) / executed if executed else None


def arrays_text(summary: Mapping[str, Any]) -> str:
    """What a grasp's images, and what is kept of its touch, take on disk."""
    found = []
    for name, cost in summary["arrays"].items():
        shape = cost["shape"]
        of = {
            "rgb": "",
            "depth_mm": "of every frame " if len(shape) == 3 else "of the moment of grasp ",
            "markers_mm": f"of {shape[-2]} markers ",
            "force_field_n": f"of {' × '.join(map(str, shape[1:3]))} cells ",
        }.get(name, "")
        raw = f" ({cost['raw_bytes'] / 1e3:.1f} raw)"
        found.append(f"{name} {of}{cost['bytes'] / 1e3:.1f} kB{raw}")
    return ", ".join(found)


def summary_text(summary: Mapping[str, Any]) -> str:
    """A page of plain text for a terminal."""
    table = [("object", *(name.replace("_", " ") for name in OUTCOME.values()), "success rate")]
    for name, tally in summary["objects"].items():
        rate = success_rate(tally)
        share = "–" if rate is None else f"{rate:.0%}"
        table.append((name, *(str(tally[outcome]) for outcome in OUTCOME.values()), share))
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    page = templates("tacgen.dataset", escaped=False).get_template("summary.txt")
    frames = summary["validity"]["frames"]
    flags = ", ".join(f"{frames[name]} {words}" for name, words in FLAG_WORDS.items())
    kept = arrays_text(summary)
    sampling = sampling_text(summary)
    text = page.render(
        summary=summary, table=table, widths=widths, kept=kept, sampling=sampling, flags=flags
    ).rstrip("\n")
    notes = (not_executed_lines(summary), validity_lines(summary), cut_off_line(summary))
    return "\n".join([text, *itertools.chain(*notes)])


def write_card(root: Path | str) -> Path:
    """Write ``README.md`` of the dataset in ``root``, finished or not.

    Raises ``DatasetError`` if there is no finished shard, or the first is damaged.
    """
    folder = DatasetFolder(root)
    summary = summarize(folder.root)
    dataset = Dataset(folder.root, partial=True)
    height, width = dataset.shape_px
    card = templates("tacgen.dataset", escaped=False).get_template("card.md")
    arrays, first = list(dataset.layout.placed()), int(dataset.indices[0])
    text = card.render(
        summary=summary,
        arrays=arrays,
        height=height,
        width=width,
        first=first,
        until=dataset.until,
        kept=arrays_text(summary),
        sampling=sampling_text(summary),
        words=FLAG_WORDS,
    )
    dataset.close()
    replace_page(folder.card_path, text)
    return folder.card_path


def replace_page(path: Path, text: str) -> None:
    """Write a page of a dataset; one that somebody else wrote is left as it is."""
    if path.is_file() and "ade by tacgen" not in path.read_text(errors="replace"):
        print_status(f"{path}: is not by tacgen, so it is left as it is")
    else:
        write_text(path, text)


def _reasons(folder: DatasetFolder, lines: Iterable[ShardLine]) -> dict[str, int]:
    counts: Counter[str] = Counter()
    first: dict[str, str] = {}
    for line in lines:
        if not line.counts.get("not_executed"):
            continue
        path = folder.shard_path(line.shard)
        with closing(open_shard(path)) as shard, broken_as_error(path):
            rows = zip(*(shard.read(f"/grasp/{name}") for name in ("label", "reason")), strict=True)
            texts = [reason.decode(errors="replace") for label, reason in rows if label < 0]
        for text in texts:
            kind = re.sub(r"-?\d+(\.\d+)?", "#", text)
            counts[kind] += 1
            first.setdefault(kind, text or "no reason recorded")
    return {first[kind]: count for kind, count in counts.most_common()}
