"""``index.html``: a page that shows the grasps of a dataset.

It needs no network and stays below ``MAX_PAGE_BYTES``: a large dataset is represented by grasps
taken evenly, and the page says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import RecipeError
from tacgen.core.files import write_text
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.reader import Dataset
from tacgen.dataset.summary import Summary, summarize
from tacgen.report.images import evenly, jpeg_uri, no_wider, side_by_side
from tacgen.report.page import templates

MAX_PAGE_BYTES = 15_000_000
"""What a browser opens at once."""
MAX_CARDS, MAX_SHARDS, MAX_STRIP = 200, 200, 8
IMAGE_WIDTH_PX, STRIP_WIDTH_PX = 280, 110
CARD_TEXT_BYTES = 2000
"""Of a card's markup, beside its images."""
OUTCOMES = {
    "success": "success",
    "translational_slip": "translational slip",
    "rotational_slip": "rotational slip",
    "failure": "failure",
    "not_executed": "not executed",
}


@dataclass(frozen=True, slots=True)
class Card:
    """One grasp as the page shows it; images are JPEG data URIs."""

    index: int
    object: str
    outcome: str
    force_n: float
    split: str
    place: str
    facts: tuple[tuple[str, str], ...]
    picture: str
    images: tuple[str, ...]
    strips: tuple[str, ...]
    curves: tuple[Mapping[str, str], ...]
    curve_top_n: float
    reason: str

    @property
    def n_bytes(self) -> int:
        """Roughly what it adds to the page."""
        return len(self.picture) + sum(map(len, (*self.images, *self.strips))) + CARD_TEXT_BYTES


class CardMaker:
    """The cards of a dataset's gallery, made one at a time, by any process that opens it.

    Attributes
    ----------
    points : list of dict
        What the plots need of each grasp.
    rows : list of int
        The places in ``points`` of the grasps that get a card.

    Raises ``DatasetError`` if there is no finished shard, or one is damaged.
    """

    def __init__(self, root: Path | str) -> None:
        self.dataset = Dataset(root, partial=True)
        shards = evenly(len(self.dataset.lines), MAX_SHARDS)
        self._columns = self.dataset.columns(shards, contact=True)
        self.points = _points(self._columns)
        self.rows = evenly(len(self.points), MAX_CARDS)

    def card(self, row: int) -> Card:
        """The card of one grasp: this is where images are decoded and made small."""
        return _card(self.dataset, self._columns, row, self.points[row]["outcome"])


def write_gallery(
    root: Path | str, make_cards: Callable[[Sequence[int]], list[Card]] | None = None
) -> Path:
    """Write ``index.html`` of the dataset in ``root``, finished or not.

    ``make_cards`` makes the cards of the given rows, in their order, if several processes are to
    share the work.

    Raises ``DatasetError`` if there is no finished shard, or one is damaged.
    """
    folder = DatasetFolder(root)
    maker = CardMaker(folder.root)
    cards = make_cards(maker.rows) if make_cards else [maker.card(row) for row in maker.rows]
    write_text(folder.gallery_path, render_gallery(maker, cards, summarize(folder.root), folder))
    return folder.gallery_path


def render_gallery(
    maker: CardMaker, cards: Sequence[Card], summary: Summary, folder: DatasetFolder
) -> str:
    """The page as text, with as many of the cards as there is room for."""
    dataset, points = maker.dataset, maker.points
    cards = _fit(cards)
    page = templates("tacgen.dataset").get_template("gallery.html")
    return page.render(
        summary=summary,
        description=_description(folder),
        cards=cards,
        n_points=len(points),
        points=points,
        outcomes=OUTCOMES,
        outcome_names=list(OUTCOMES.items()),
        present=[name for name in OUTCOMES if any(p["outcome"] == name for p in points)],
        objects=sorted({p["object"] for p in points}),
        forces=sorted({p["force"] for p in points}),
        reference=_jpeg(dataset.reference()),
        time_s=[float(t) for t in dataset.time_s],
    )


def _points(columns: Mapping[str, NDArray]) -> list[dict[str, Any]]:
    """What the plots need of each grasp."""
    rows = range(len(columns["index"]))
    frames = columns["grasp_frame"]
    normal_n = columns["force_normal_n"][np.arange(len(frames)), frames]
    shear_n = np.linalg.norm(columns["force_shear_n"], axis=2).max(axis=1)
    return [
        {
            "index": int(columns["index"][row]),
            "object": str(columns["object"][row]),
            "force": round(float(columns["force_n"][row]), 3),
            "outcome": _outcome(columns, row),
            "split": str(columns["split"][row]),
            "normal": round(float(normal_n[row]), 3),
            "shear": round(float(shear_n[row]), 3),
        }
        for row in rows
    ]


def _outcome(columns: Mapping[str, NDArray], row: int) -> str:
    label = int(columns["label"][row])
    if label < 0:
        return "not_executed"
    return "success" if label else str(columns["failure_mode"][row]) or "failure"


def _card(dataset: Dataset, columns: Mapping[str, NDArray], row: int, outcome: str) -> Card:
    index = int(columns["index"][row])
    executed = outcome != "not_executed"
    moment = int(columns["grasp_frame"][row])
    shown = evenly(dataset.n_frames, MAX_STRIP) if dataset.n_frames > 1 else []
    pads = dataset.pads if executed else ()
    picture = dataset.picture(index)
    place = ", ".join(f"{columns[axis][row]:g}" for axis in ("x_mm", "y_mm", "z_mm"))
    return Card(
        index=index,
        object=str(columns["object"][row]),
        outcome=outcome,
        force_n=float(columns["force_n"][row]),
        split=str(columns["split"][row]),
        place=place,
        facts=tuple(_facts(columns, row, moment)) if executed else (),
        picture="" if picture is None or not picture.any() else _jpeg(picture),
        images=tuple(_jpeg(dataset.rgb(index, pad, moment)) for pad in pads),
        strips=tuple(_strip(dataset, index, pad, shown) for pad in pads if shown),
        curves=_curves(columns, row, dataset.time_s) if executed and shown else (),
        curve_top_n=_top_n(columns, row),
        reason=str(columns["reason"][row]) or str(columns["status"][row]).replace("_", " "),
    )


def _facts(columns: Mapping[str, NDArray], row: int, moment: int) -> list[tuple[str, str]]:
    shear_n = float(np.linalg.norm(columns["force_shear_n"][row], axis=1).max())
    facts = [
        ("normal force", f"{columns['force_normal_n'][row, moment]:.1f} N"),
        ("shear force", f"{shear_n:.1f} N"),
        ("indentation", f"{columns['indentation_mm'][row, moment]:.2f} mm"),
        ("rise", f"{round(float(columns['rise_mm'][row])):d} mm"),
        ("turn", f"{columns['turn_rad'][row]:.3f} rad"),
    ]
    if np.isfinite(columns["margin_translational"][row]):
        facts.append(("slip margin", f"{columns['margin_translational'][row]:.2f} weights"))
    return facts


def _curves(
    columns: Mapping[str, NDArray], row: int, time_s: NDArray[np.float64]
) -> tuple[Mapping[str, str], ...]:
    """SVG points of the normal and shear force over time, in a box of 100 × 30."""
    shear_n = np.linalg.norm(columns["force_shear_n"][row], axis=1)
    forces = {"normal": columns["force_normal_n"][row], "shear": shear_n}
    top_n = max(1e-9, _top_n(columns, row))
    span_s = max(1e-9, float(time_s[-1] - time_s[0]))
    return tuple(
        {
            "name": name,
            "points": " ".join(
                f"{100 * (t - time_s[0]) / span_s:.1f},{29 - 28 * max(0.0, f) / top_n:.1f}"
                for t, f in zip(time_s, values, strict=True)
            ),
        }
        for name, values in forces.items()
    )


def _top_n(columns: Mapping[str, NDArray], row: int) -> float:
    """The largest force of a grasp, normal or shear."""
    shear_n = np.linalg.norm(columns["force_shear_n"][row], axis=1)
    return float(max(columns["force_normal_n"][row].max(), shear_n.max()))


def _strip(dataset: Dataset, index: int, pad: str, frames: Sequence[int]) -> str:
    """Frames side by side, in time order, as one image."""
    return jpeg_uri(
        side_by_side([dataset.rgb(index, pad, frame) for frame in frames], STRIP_WIDTH_PX)
    )


def _jpeg(rgb: NDArray[np.uint8]) -> str:
    return jpeg_uri(no_wider(rgb, IMAGE_WIDTH_PX))


def _fit(cards: Sequence[Card]) -> Sequence[Card]:
    """As many cards, taken evenly, as the page has room for."""
    room = MAX_PAGE_BYTES * 0.9
    total = sum(card.n_bytes for card in cards)
    if total <= room:
        return cards
    return [cards[k] for k in evenly(len(cards), max(1, int(len(cards) * room / total)))]


def _description(folder: DatasetFolder) -> str:
    try:
        return str(folder.recipe().get("description", ""))
    except RecipeError:  # `verify` reports it; the page has no description then
        return ""
