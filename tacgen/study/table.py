"""The table of a study, as Markdown and as a page."""

from collections.abc import Iterable, Mapping
from itertools import chain, compress
from pathlib import Path
from typing import Any

from tacgen.core.files import write_text
from tacgen.learning.reports import started_from
from tacgen.learning.scores import THE_RULE
from tacgen.report.formatting import MISSING
from tacgen.report.page import table_section, text_section, write_page

BASELINE_HEADS = (
    "variant",
    "accuracy / AUROC / ECE",
    "of trees that see what was commanded alone",
    "gain, 95 % interval",
    "share of what is left",
)
"""Heads of the table of what networks add to what was commanded; ECE: expected calibration
error; what is left: the grasps that the trees predict wrong."""
OTHER_SIMULATION = "other simulation"
"""Name of the column "sim-to-real" where another simulation made the grasps, not a robot."""


def write_study(result: Mapping[str, Any], out: Path) -> None:
    """Write ``table.md`` and ``index.html``."""
    header, rows = _filled(_header(result), [_row(row) for row in result["rows"]])
    object_header, object_rows = _by_object(result)
    beside = [_beside_baseline(row) for row in result["rows"]]
    beside = [cells for cells in beside if cells]
    remarks = study_remarks(result)
    parts = [
        f"# {result['study']}",
        result["description"],
        markdown_table(header, rows),
        *(["## Beside what was commanded", markdown_table(BASELINE_HEADS, beside)] * bool(beside)),
        "## By object",
        markdown_table(object_header, object_rows),
        "\n".join(f"* {text}" for text in remarks),
    ]
    write_text(out / "table.md", "\n\n".join(part for part in parts if part) + "\n")
    sections = (
        table_section("Accuracy", header, rows),
        *([table_section("Beside what was commanded", BASELINE_HEADS, beside)] * bool(beside)),
        table_section("By object", object_header, object_rows),
        text_section("How the figures were made", *remarks),
    )
    write_page(
        out / "index.html",
        result["study"],
        sections,
        summary=result["description"],
        made_by="study",
    )


def _beside_baseline(row: Mapping[str, Any]) -> tuple[object, ...]:
    """The cells of a row about what the network gains over what was commanded; empty if unknown."""
    scores = row.get("sim") or {}
    baseline = scores.get("without_touch")
    if baseline is None:
        return ()
    left, (low, high) = 1 - baseline["accuracy"], baseline["gain_interval"]
    share = MISSING if left == 0 else f"{baseline['gain'] / left:.2f}"
    figures = [
        f"{one['accuracy']:.3f} / {_accuracy(one['auroc'])} / {one['ece']:.3f}"
        for one in (scores, baseline)
    ]
    return (row["name"], *figures, f"{baseline['gain']:+.3f} [{low:+.3f}, {high:+.3f}]", share)


def study_remarks(result: Mapping[str, Any]) -> list[str]:
    """What a reader must know before comparing the figures with others."""
    rows, remarks = result["rows"], []
    if result["quick"]:
        less = "; ".join(result["reduced"]) or "no other objects, frames, grasps, input or epochs"
        remarks.append(f"REDUCED VERSION (--quick): {less}.")
    weights = sorted({name for row in rows for name in row["weights"]})
    if weights:
        names = ", ".join(started_from(name) for name in weights)
        remarks.append(f"Pre-trained weights: {names} (the paper: ImageNet).")
    sizes = ", ".join(f"{w}×{h} px" for h, w in sorted({tuple(row["input_px"]) for row in rows}))
    of = {1: "of one seed; their intervals hold for other test grasps"}
    seeds = ", ".join(
        of.get(k, f"means over {k} seeds; their intervals hold for other test grasps and seeds")
        for k in sorted({row["seeds"] for row in rows})
    )
    epochs, averaged = (_listed(row[key] for row in rows) for key in ("epochs", "average_epochs"))
    counts = _listed(n for row in rows for n in row["training_grasps"].values())
    remarks += [
        f"Input {sizes}; epochs: {epochs}; training grasps a model (of which some choose the "
        f"epoch): {counts or 'none'}.",
        f"Weights averaged over about {averaged} epochs (the paper: 1).",
        f"Accuracies are {seeds}.",
        *_rules(rows),
        f"Running time {result['took_s'] / 60:.1f} minutes, without rows of earlier runs.",
        *_where_tested(result),
    ]
    for row in rows:
        if row["friction"]:
            fitted = ", ".join(f"{name} μ = {mu:g}" for name, mu in row["friction"].items())
            remarks.append(f"{row['name']}: friction fitted, {fitted}")
    for row in rows:
        if row["problem"]:
            what = "tested" if row["weights"] else "trained"
            remarks.append(f"{row['name']}: NOT {what}. {row['problem']}")
        if row["real_problem"]:
            remarks.append(
                f"{row['name']}: NOT tested for {_tested_on(result)}. {row['real_problem']}"
            )
        scored = [row[source] for source in ("sim", "real") if source in row]
        remarks += [f"{row['name']}: {note}" for one in scored for note in one.get("notes", ())]
        if (trained_as := row.get("networks_of", row["name"])) != row["name"]:
            remarks.append(f"{row['name']}: the networks of {trained_as}.")
    remarks += [f"{r['name']}: contact law from {f}." for r in rows if (f := r["contact_file"])]
    return [*remarks, *result["notes"]]


def _rules(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """What the frames that a sequence network saw tell without training."""
    return [
        f"{row['name']}: without training, the rule that a grasp {THE_RULE} scores "
        f"{_scores(rule)[0]} ({_scores(rule)[1]})."
        for row in rows
        if (rule := (row.get("sim") or {}).get("same_imprint_rule"))
    ]


def _listed(values: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(set(values))))


def markdown_table(header: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    """A table in Markdown; bars in cells are escaped."""
    lines = [header, tuple("---" for _ in header), *rows]
    return "\n".join(
        "| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def _where_tested(result: Mapping[str, Any]) -> list[str]:
    """A line for each folder of real grasps; it names its rows where there are several."""
    tested: dict[tuple[str, bool], list[str]] = {}
    for row in result["rows"]:
        if "real" in row:
            where = (row["real"]["data"], row["real"]["real_is_simulated"])
            tested.setdefault(where, []).append(row["name"])
    lines = []
    for (folder, simulated), names in tested.items():
        what = ", grasps of another simulation: NOT real" if simulated else ""
        of = f" of {', '.join(names)}" if len(tested) > 1 else ""
        lines.append(f"The column {_tested_on(result)}{of} is measured on {folder}{what}.")
    return lines


def _tested_on(result: Mapping[str, Any]) -> str:
    """What the column of real grasps is called; rows of earlier runs may have other grasps."""
    kinds = {row["real"]["real_is_simulated"] for row in result["rows"] if "real" in row}
    names = [_kind_of(simulated) for simulated in sorted(kinds or {result["real_is_simulated"]})]
    return " or ".join(names)


def _kind_of(simulated: bool) -> str:
    return OTHER_SIMULATION if simulated else "sim-to-real"


def _header(result: Mapping[str, Any]) -> tuple[str, ...]:
    interval = "95 % interval"
    tested = ("sim-to-sim", interval, "n", _tested_on(result), interval, "n")
    return ("variant", "network", "sees until", *tested, "paper, sim", "paper, real")


def _filled(
    header: tuple[str, ...], rows: list[tuple[object, ...]]
) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
    """The columns in which some row says something."""
    filled = [any(row[k] != MISSING for row in rows) for k in range(len(header))]
    return tuple(compress(header, filled)), [tuple(compress(row, filled)) for row in rows]


def _row(row: Mapping[str, Any]) -> tuple[object, ...]:
    scores = (*_scores(row.get("sim")), *_scores(row.get("real")))
    published = (_accuracy(row["published"][source]) for source in ("sim", "real"))
    until = (row.get("sim") or {}).get("until", MISSING)
    return (row["name"], row["kind"], until, *scores, *published)


def _scores(scores: Mapping[str, Any] | None) -> tuple[str, str, str]:
    if scores is None:
        return MISSING, MISSING, MISSING
    lo, hi = scores["accuracy_interval"]
    return f"{scores['accuracy']:.3f}", f"{lo:.3f} to {hi:.3f}", str(scores["n"])


def _accuracy(value: float | None) -> str:
    return MISSING if value is None else f"{value:.3f}"


def _by_object(result: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
    scored = [row.get(source) or {} for row in result["rows"] for source in ("sim", "real")]
    of = [
        *(row["objects"] for row in result["rows"]),
        *(one.get("by_object", ()) for one in scored),
    ]
    names = sorted(set(chain(*of)))
    sources = ["sim"]
    if result["real"] is not None or any("real" in row for row in result["rows"]):
        sources.append("real")
    rows = []
    for row in result["rows"]:
        for source in sources:
            scores = row.get(source)
            parts = scores["by_object"] if scores else {}
            cells = [_accuracy(parts[n]["accuracy"]) if n in parts else MISSING for n in names]
            rows.append((row["name"], _column_of(result, source, scores), *cells))
    return ("variant", "tested on", *names), rows


def _column_of(result: Mapping[str, Any], source: str, scores: Mapping[str, Any] | None) -> str:
    if source == "sim":
        return "sim"
    return _kind_of(scores["real_is_simulated"]) if scores else _tested_on(result)
