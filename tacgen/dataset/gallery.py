"""``index.html``: a page that shows the grasps of a dataset.

It needs no network and stays below ``MAX_PAGE_BYTES``: a large dataset is represented by grasps
taken evenly, and the page says so.
"""

import contextlib
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import RecipeError
from tacgen.core.images import evenly, jpeg_uri, no_wider, side_by_side
from tacgen.core.records import PADS
from tacgen.dataset import overlays
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import DatasetSpec, GraspSample, frame_times_s, rgb_at_load
from tacgen.dataset.schema import EDGES, FLAG_WORDS
from tacgen.dataset.summary import replace_page, summarize
from tacgen.optics.visible import VISIBLE
from tacgen.report.page import templates

MAX_PAGE_BYTES = 15_000_000  # what a browser opens at once
SHOWN = "shows a contact"
MAX_CARDS, MAX_SHARDS, MAX_STRIP = 200, 200, 8
IMAGE_WIDTH_PX, STRIP_WIDTH_PX = 280, 110
CARD_TEXT_BYTES = 2000  # of a card's markup, beside its images
LINE_BYTES = 32  # at most, of the motion of a marker
OUTCOMES = {
    "success": "success",
    "translational_slip": "translational slip",
    "rotational_slip": "rotational slip",
    "failure": "failure",
    "not_executed": "not executed",
}


@dataclass(frozen=True, slots=True)
class Thumbnails:
    """What the page shows of a grasp's images, as data URIs: the scene, and of each pad the image
    of the moment of grasp and a strip of images over time; of each camera that moment.
    """

    picture: str
    images: list[str]
    strips: list[str]
    views: list[str] = field(default_factory=list)


def thumbnails(sample: GraspSample, noise_at_load_grey: float = 0.0) -> Thumbnails:
    """Make the images of one grasp small; ``noise_at_load_grey`` is what a reader would add."""

    def seen(pad: str, frame: int) -> NDArray[np.uint8]:
        rgb = sample.pads[pad].rgb[frame]
        return rgb_at_load(rgb, noise_at_load_grey, sample.seed, pad, frame)

    pads = [pad for pad in PADS if pad in sample.pads]
    n_frames = len(sample.pads[pads[0]].rgb) if pads else 0
    views = [
        one.rgb if one.rgb.ndim == 3 else one.rgb[sample.grasp_frame]
        for one in sample.cameras.values()
    ]
    return _thumbnails(sample.picture, pads, n_frames, sample.grasp_frame, seen, views)


def _thumbnails(
    picture: NDArray[np.uint8] | None,
    pads: Sequence[str],
    n_frames: int,
    moment: int,
    seen: Callable[[str, int], NDArray[np.uint8]],
    views: Sequence[NDArray[np.uint8]],
) -> Thumbnails:
    """Pictures of the scene, of what each pad has ``seen`` in the frames shown, and of cameras."""
    shown = evenly(n_frames, MAX_STRIP) if n_frames > 1 else []
    strips = [[seen(pad, k) for k in shown] for pad in pads] if shown else []
    return Thumbnails(
        "" if picture is None or not picture.any() else _jpeg(picture),
        [_jpeg(seen(pad, moment)) for pad in pads],
        [jpeg_uri(side_by_side(strip, STRIP_WIDTH_PX)) for strip in strips],
        [_jpeg(view) for view in views],
    )


def shown_grasps(spec: DatasetSpec) -> frozenset[int]:
    """The indices of the grasps that get a card once the dataset is whole."""
    shards = map(spec.shard_range, evenly(spec.n_shards, MAX_SHARDS))
    indices = [index for shard in shards for index in shard]
    return frozenset(indices[k] for k in evenly(len(indices), MAX_CARDS))


def write_gallery(root: Path | str, made: Mapping[int, Thumbnails] | None = None) -> Path:
    """Write ``index.html`` of the dataset in ``root``, finished or not.

    ``made`` are thumbnails of grasps by their index; others are made of what the shards hold. No
    shard is hashed: the page shows what is there, and ``verify`` checks it. Raises
    ``DatasetError`` if there is no finished shard, or one cannot be read.
    """
    folder = DatasetFolder(root)
    dataset = Dataset(folder.root, partial=True, check_hashes=False)
    shards = evenly(len(dataset.lines), MAX_SHARDS)
    columns = dataset.columns(shards, contact=True)
    pads = [dataset.columns(shards, contact=True, pad=pad) for pad in dataset.pads]
    looks = [[_look(pad, row) for pad in pads] for row in range(len(columns["index"]))]
    points = [_point(columns, row, looks[row]) for row in range(len(looks))]
    time_s = dataset.time_s
    cards = _in_turn(
        [
            _card(dataset, columns, row, points[row], time_s, made or {}) | {"looks": looks[row]}
            for row in evenly(len(points), MAX_CARDS)
        ]
    )
    recipe: dict[str, Any] = {}
    with contextlib.suppress(RecipeError):  # `verify` reports it; the page says less then
        recipe = folder.recipe()
    physics = recipe.get("physics")
    has_markers = "markers_mm" in dataset.touch_names
    n_lines = len(dataset.pads) * len(dataset.marker_rest_mm()) if has_markers else 0
    cards = _fit(cards, CARD_TEXT_BYTES + LINE_BYTES * n_lines)
    gain = _draw_motion(dataset, cards) if has_markers else 0.0
    height, width = dataset.shape_px
    page = templates("tacgen.dataset").get_template("gallery.html")
    text = page.render(
        summary=summarize(folder.root),
        description=str(recipe.get("description", "")),
        lift_mm=physics.get("lift_mm") if isinstance(physics, dict) else None,
        cards=cards,
        gain=gain,
        size_px=(width, height),
        points=points,
        outcomes=OUTCOMES,
        present=[name for name in OUTCOMES if any(p["outcome"] == name for p in points)],
        objects=sorted({p["object"] for p in points}),
        pictures=[w for w in (SHOWN, *FLAG_WORDS.values()) if any(w in p["shows"] for p in points)],
        forces=sorted({p["force"] for p in points}),
        reference=_jpeg(dataset.reference()),
        time_s=time_s.tolist(),
    )
    dataset.close()
    replace_page(folder.gallery_path, text)
    return folder.gallery_path


def _draw_motion(dataset: Dataset, cards: Sequence[dict[str, Any]]) -> float:
    """Give each card's images the motion of their markers, as paths; the factor it is drawn by.

    That is 0 where none has moved.
    """
    rest_mm = dataset.marker_rest_mm()
    scale = dataset.mm_per_px, dataset.shape_px
    rest_px = overlays.to_pixels(rest_mm, *scale)
    moved_mm = [
        [dataset.touch(card["index"], "markers_mm", pad, card["moment"]) for pad in dataset.pads]
        for card in cards
    ]
    largest_mm = max((float(np.linalg.norm(one, axis=-1).max()) for one in moved_mm), default=0.0)
    if largest_mm == 0:
        return 0.0
    gain = overlays.gain_of(largest_mm, overlays.spacing_mm(rest_mm))
    for card, pads in zip(cards, moved_mm, strict=True):
        steps = (gain * one / dataset.mm_per_px for one in pads)
        card["motion"] = [overlays.arrows_path(rest_px, step) for step in steps]
    return gain


@dataclass(frozen=True, slots=True)
class Look:
    """What the picture of a pad shows at the moment of grasp, in ``words``.

    The contact is cut off at ``edges``; ``share`` of the pixels differ visibly from rest.
    """

    words: tuple[str, ...] = ()
    edges: tuple[str, ...] = ()
    share: float = 0.0


def _look(columns: Mapping[str, NDArray[Any]], row: int) -> Look:
    if columns["status"][row] != "executed":
        return Look()
    at = row, int(columns["grasp_frame"][row])
    share, beyond = float(columns["visible_share"][at]), columns["outside_share"][at]
    words = [words for name, words in FLAG_WORDS.items() if columns[name][at]]
    # An edge with its part or more of what is cut off: there is one.
    is_cut = (beyond > 0) & (beyond >= beyond.sum() / len(EDGES))
    edges = [edge for edge, cut in zip(EDGES, is_cut, strict=True) if cut]
    return Look(
        (*([SHOWN] if share >= VISIBLE.contact_share else []), *words),
        tuple(edges) if columns["outside_window"][at] else (),
        share,
    )


def _in_turn(cards: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The cards that show a contact first, then those that show less; in each of the two, objects
    and outcomes take turns.
    """
    objects, outcomes = (list(dict.fromkeys(c[k] for c in cards)) for k in ("object", "outcome"))
    turns: Counter[tuple[int, int, int]] = Counter()
    ranks = []
    for card in cards:
        share = max((look.share for look in card["looks"]), default=0.0)
        shows_less = (share < VISIBLE.contact_share) + (share == 0)
        k, j = objects.index(card["object"]), outcomes.index(card["outcome"])
        ranks.append((shows_less, turns[shows_less, k, j], (j - k) % len(outcomes), k))
        turns[shows_less, k, j] += 1
    return [cards[k] for k in sorted(range(len(cards)), key=ranks.__getitem__)]


def _margins(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Each slip margin with what its sign means."""
    found = []
    ways = (("sliding", "slides", "translational", ""), ("turning", "turns", "rotational", " mm"))
    for way, what, name, unit in ways:
        margin = round(float(values[f"margin_{name}"]), 2) + 0.0  # no "-0.00"
        if math.isnan(margin):
            continue
        sign = "holds" if margin >= 0 else what
        if margin < 0 and values["label"] == 1:
            sign += ", but too little to fail"
        found.append((f"margin, {way}", f"{margin:+.2f}{unit} × weight: {sign}"))
    return found


def _point(columns: Mapping[str, NDArray[Any]], row: int, looks: Sequence[Look]) -> dict[str, Any]:
    """What the plots and filters need of one grasp."""
    keys = ("label", "failure_mode", "grasp_frame", "force_n", "index", "object", "split")
    label, mode, frame, force_n, *same = (columns[key][row].item() for key in keys)
    return dict(zip(keys[4:], same, strict=True)) | {
        "shows": sorted({words for look in looks for words in look.words}),
        "force": round(force_n, 3),
        "outcome": "not_executed" if label < 0 else "success" if label else mode or "failure",
        "normal": round(float(columns["force_normal_n"][row, frame]), 3),
        "shear": round(float(np.linalg.norm(columns["force_shear_n"][row], axis=1).max()), 3),
    }


def _card(
    dataset: Dataset,
    columns: Mapping[str, NDArray[Any]],
    row: int,
    point: Mapping[str, Any],
    time_s: NDArray[np.float64],
    made: Mapping[int, Thumbnails],
) -> dict[str, Any]:
    """What the page shows of one grasp, by the names that its template uses."""
    values = {name: column[row] for name, column in columns.items()}
    executed = point["outcome"] != "not_executed"
    shear_n = np.linalg.norm(values["force_shear_n"], axis=1)
    forces_n = {"normal": values["force_normal_n"], "shear": shear_n}
    top_n = max(float(force_n.max()) for force_n in forces_n.values())
    index, moment = point["index"], int(values["grasp_frame"])
    last_s = float(values["lift_start_time_s"]) if dataset.until == "lift" else math.nan
    time_s = frame_times_s(time_s, moment, float(values["grasp_time_s"]), last_s)
    small = made.get(index)
    if small is None:
        pads, seen = dataset.pads if executed else (), partial(dataset.rgb, index)
        names = [f"camera/{name}/rgb" for name in dataset.cameras] if executed else []
        views = [dataset.view(index, name, moment) for name in names]
        small = _thumbnails(dataset.picture(index), pads, dataset.n_frames, moment, seen, views)
    return {
        **point,
        "executed": executed,
        "values": values,
        "margins": _margins(values),
        "moment": moment,
        "picture": small.picture,
        "images": small.images,
        "strips": small.strips,
        "views": small.views,
        "curves": _curves(forces_n, time_s, top_n) if executed and len(time_s) > 1 else {},
        "curve_top_n": top_n,
    }


def _curves(
    forces_n: Mapping[str, NDArray[np.float64]], time_s: NDArray[np.float64], top_n: float
) -> dict[str, str]:
    """SVG points of each force over time, in a box of 100 × 30."""
    x = 100 * (time_s - time_s[0]) / max(1e-9, float(time_s[-1] - time_s[0]))
    curves = {}
    for name, force_n in forces_n.items():
        y = 29 - 28 * np.maximum(0.0, force_n) / max(1e-9, top_n)
        curves[name] = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return curves


def _jpeg(rgb: NDArray[np.uint8]) -> str:
    return jpeg_uri(no_wider(rgb, IMAGE_WIDTH_PX))


def _images_of(card: Mapping[str, Any]) -> list[str]:
    return [card["picture"], *card["images"], *card["strips"], *card["views"]]


def _fit(cards: list[dict[str, Any]], card_text_bytes: int) -> list[dict[str, Any]]:
    """As many cards, taken evenly, as the page has room for."""
    room = MAX_PAGE_BYTES * 0.9
    images = sum(len(one) for c in cards for one in _images_of(c))
    total = images + len(cards) * card_text_bytes
    if total <= room:
        return cards
    return [cards[k] for k in evenly(len(cards), max(1, int(len(cards) * room / total)))]
