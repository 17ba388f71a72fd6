"""The table of a study, as Markdown and as a page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tacgen.files import write_text
from tacgen.learning.reports import started_from
from tacgen.report import Section, table_section, text_section, write_page

STAND_IN = "other simulation"
"""What the column "sim-to-real" is called where another simulation stands in for reality."""


def write_study(result: Mapping[str, Any], out: Path) -> None:
    """Write ``table.md`` and ``table.html``."""
    rows = [_row(row) for row in result["rows"]]
    header = _header(result)
    object_header, object_rows = _by_object(result)
    remarks = study_remarks(result)
    parts = [
        f"# {result['study']}",
        result["description"],
        markdown_table(header, rows),
        "## By object",
        markdown_table(object_header, object_rows),
        "\n".join(f"* {text}" for text in remarks),
    ]
    write_text(out / "table.md", "\n\n".join(part for part in parts if part) + "\n")
    sections: list[Section] = [
        table_section("Accuracy", header, rows),
        table_section("By object", object_header, object_rows),
        text_section("What this is", *remarks),
    ]
    write_page(out / "table.html", result["study"], sections, summary=result["description"])


def study_remarks(result: Mapping[str, Any]) -> list[str]:
    """What a reader must know before comparing the figures with others."""
    rows = result["rows"]
    weights = sorted({name for row in rows for name in row["weights"]})
    sizes = sorted({tuple(row["input_px"]) for row in rows})
    epochs = sorted({row["epochs"] for row in rows})
    counts = sorted({n for row in rows for n in row["training_grasps"].values()})
    remarks = [
        f"First weights of the backbone: {', '.join(started_from(name) for name in weights)} "
        "(the paper: ImageNet).",
        f"Input {', '.join(f'{w}×{h} px' for h, w in sizes)}; "
        f"epochs: {', '.join(map(str, epochs))}; training grasps a model (of which some choose "
        f"the epoch): {', '.join(map(str, counts))}.",
        f"Took {result['took_s'] / 60:.1f} minutes, without what was there already.",
    ]
    if result["quick"]:
        remarks.insert(0, "REDUCED VERSION (--quick): fewer objects, smaller input.")
    if result["real"] is not None:
        what = ", simulated grasps of another world: NOT real" if result["stand_in"] else ""
        remarks.append(f"The column {_tested_on(result)} is measured on {result['real']}{what}.")
    remarks += [
        f"{row['name']}: friction fitted, "
        + ", ".join(f"{name} μ = {mu:g}" for name, mu in row["friction"].items())
        for row in rows
        if row["friction"]
    ]
    remarks += [f"{row['name']}: NOT trained. {row['problem']}" for row in rows if row["problem"]]
    remarks += [
        f"{row['name']}: contact law from {row['contact_file']}."
        for row in rows
        if row["contact_file"]
    ]
    return [*remarks, *result["notes"]]


def markdown_table(header: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    """A table in Markdown; bars in cells are escaped."""
    lines = [header, tuple("---" for _ in header), *rows]
    return "\n".join(
        "| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def _tested_on(result: Mapping[str, Any]) -> str:
    return STAND_IN if result["stand_in"] else "sim-to-real"


def _header(result: Mapping[str, Any]) -> tuple[str, ...]:
    interval = "95 % interval"
    tested = ("sim-to-sim", interval, "n", _tested_on(result), interval, "n")
    return ("variant", "network", *tested, "paper, sim", "paper, real")


def _row(row: Mapping[str, Any]) -> tuple[object, ...]:
    published = row["published"]
    return (
        row["name"],
        row["kind"],
        *_scores(row.get("sim")),
        *_scores(row.get("real")),
        _figure(published["sim"]),
        _figure(published["real"]),
    )


def _scores(scores: Mapping[str, Any] | None) -> tuple[str, str, str]:
    if scores is None:
        return "–", "–", "–"
    lo, hi = scores["accuracy_interval"]
    return f"{scores['accuracy']:.3f}", f"{lo:.3f} to {hi:.3f}", str(scores["n"])


def _figure(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"


def _by_object(result: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
    names = sorted({name for row in result["rows"] for name in row["objects"]})
    sources = {"sim": "sim"}
    if result["real"] is not None:
        sources["real"] = _tested_on(result)
    rows = []
    for row in result["rows"]:
        for source, told in sources.items():
            parts = row.get(source, {}).get("by_object", {})
            cells = [_figure(parts[n]["accuracy"]) if n in parts else "–" for n in names]
            rows.append((row["name"], told, *cells))
    return ("variant", "tested on", *names), rows
