"""``index.html``: a page that shows the grasps of a dataset.

It needs no network and stays below ``MAX_PAGE_BYTES``: a large dataset is represented by grasps
taken evenly, and the page says so.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import RecipeError
from tacgen.core.files import write_text
from tacgen.core.images import evenly, jpeg_uri, no_wider, side_by_side
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.reader import Dataset
from tacgen.dataset.summary import summarize
from tacgen.report.page import templates

MAX_PAGE_BYTES = 15_000_000  # what a browser opens at once
MAX_CARDS, MAX_SHARDS, MAX_STRIP = 200, 200, 8
IMAGE_WIDTH_PX, STRIP_WIDTH_PX = 280, 110
CARD_TEXT_BYTES = 2000  # of a card's markup, beside its images
OUTCOMES = {
    "success": "success",
    "translational_slip": "translational slip",
    "rotational_slip": "rotational slip",
    "failure": "failure",
    "not_executed": "not executed",
}

Card = dict[str, Any]
"""What the page shows of one grasp, by the names that its template uses; images are data URIs."""


class CardMaker:
    """The cards of a dataset's gallery, made one at a time, by any process that opens it.

    ``points`` holds what the plots need of each grasp, ``rows`` the places in it of the grasps that
    get a card. Raises ``DatasetError`` if there is no finished shard, or one is damaged.
    """

    def __init__(self, root: Path | str) -> None:
        self.dataset = Dataset(root, partial=True)
        shards = evenly(len(self.dataset.lines), MAX_SHARDS)
        self._columns = self.dataset.columns(shards, contact=True)
        self._shear_n = np.linalg.norm(self._columns["force_shear_n"], axis=2)
        self.points = [self._point(row) for row in range(len(self._columns["index"]))]
        self.rows = evenly(len(self.points), MAX_CARDS)

    def _point(self, row: int) -> dict[str, Any]:
        keys = ("label", "failure_mode", "grasp_frame", "force_n", "index", "object", "split")
        label, mode, frame, force_n, *same = (self._columns[key][row].item() for key in keys)
        return dict(zip(keys[4:], same, strict=True)) | {
            "force": round(force_n, 3),
            "outcome": "not_executed" if label < 0 else "success" if label else mode or "failure",
            "normal": round(float(self._columns["force_normal_n"][row, frame]), 3),
            "shear": round(float(self._shear_n[row].max()), 3),
        }

    def card(self, row: int) -> Card:
        """The card of one grasp: this is where images are decoded and made small."""
        data, values = self.dataset, {name: column[row] for name, column in self._columns.items()}
        index, moment = int(values["index"]), int(values["grasp_frame"])
        executed = self.points[row]["outcome"] != "not_executed"
        shown = evenly(data.n_frames, MAX_STRIP) if data.n_frames > 1 else []
        pads = data.pads if executed else ()
        picture = data.picture(index)
        strips = [[data.rgb(index, pad, k) for k in shown] for pad in pads] if shown else []
        forces_n = {"normal": values["force_normal_n"], "shear": self._shear_n[row]}
        top_n = max(float(force_n.max()) for force_n in forces_n.values())
        return self.points[row] | {
            "executed": executed,
            "values": values,
            "moment": moment,
            "picture": "" if picture is None or not picture.any() else _jpeg(picture),
            "images": [_jpeg(data.rgb(index, pad, moment)) for pad in pads],
            "strips": [jpeg_uri(side_by_side(strip, STRIP_WIDTH_PX)) for strip in strips],
            "curves": _curves(forces_n, data.time_s, top_n) if executed and shown else {},
            "curve_top_n": top_n,
        }


def write_gallery(
    root: Path | str, make_cards: Callable[[Sequence[int]], list[Card]] | None = None
) -> Path:
    """Write ``index.html`` of the dataset in ``root``, finished or not.

    ``make_cards`` makes the cards of the given rows, in their order, if several processes are to
    share the work. Raises ``DatasetError`` if there is no finished shard, or one is damaged.
    """
    folder = DatasetFolder(root)
    maker = CardMaker(folder.root)
    points, dataset = maker.points, maker.dataset
    cards = make_cards(maker.rows) if make_cards else [maker.card(row) for row in maker.rows]
    try:
        description = str(folder.recipe().get("description", ""))
    except RecipeError:  # `verify` reports it; the page has no description then
        description = ""
    page = templates("tacgen.dataset").get_template("gallery.html")
    text = page.render(
        summary=summarize(folder.root),
        description=description,
        cards=_fit(cards),
        points=points,
        outcomes=OUTCOMES,
        present=[name for name in OUTCOMES if any(p["outcome"] == name for p in points)],
        objects=sorted({p["object"] for p in points}),
        forces=sorted({p["force"] for p in points}),
        reference=_jpeg(dataset.reference()),
        time_s=[float(t) for t in dataset.time_s],
    )
    write_text(folder.gallery_path, text)
    return folder.gallery_path


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


def _fit(cards: Sequence[Card]) -> Sequence[Card]:
    """As many cards, taken evenly, as the page has room for."""
    room = MAX_PAGE_BYTES * 0.9
    images = sum(len(one) for c in cards for one in (c["picture"], *c["images"], *c["strips"]))
    total = images + len(cards) * CARD_TEXT_BYTES
    if total <= room:
        return cards
    return [cards[k] for k in evenly(len(cards), max(1, int(len(cards) * room / total)))]
