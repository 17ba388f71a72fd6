"""``README.md`` of a dataset: what it is, how it was made, how to read it, its limits."""

from pathlib import Path

from tacgen.core.files import write_text
from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.reader import Dataset
from tacgen.dataset.summary import summarize
from tacgen.report.page import templates


def write_card(root: Path | str) -> Path:
    """Write ``README.md`` of the dataset in ``root``, finished or not.

    Raises ``DatasetError`` if there is no finished shard, or the first is damaged.
    """
    folder = DatasetFolder(root)
    summary = summarize(folder.root)
    dataset = Dataset(folder.root, partial=True)
    height, width = dataset.shape_px
    card = templates("tacgen.dataset", escaped=False).get_template("card.md")
    arrays, first = list(dataset.layout.arrays()), int(dataset.indices[0])
    text = card.render(summary=summary, arrays=arrays, height=height, width=width, first=first)
    dataset.close()
    write_text(folder.card_path, text)
    return folder.card_path
