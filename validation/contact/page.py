"""The page of the study: shares with their intervals, figures, and every wrong diagnosis."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tacgen.core.files import atomic_path, write_text
from tacgen.report.figures import draw_confusion, new_figure
from validation.contact.cases import NORMAL_FORMS, SHEAR_FORMS
from validation.contact.run import NONE, Outcome, is_right


def write_page(outcomes: list[Outcome], page: Path, note: str = "") -> None:
    """Write the page and its figures; ``note`` goes under the table."""
    figures = page.parent / "figures"
    single = [o for o in outcomes if o.kind == "single" and o.truth]
    strong = [o for o in single if o.strength >= 1.5]
    clean = [o for o in outcomes if o.kind == "clean"]
    beside = [o for o in outcomes if o.kind == "single" and not o.truth]
    pairs = [o for o in outcomes if o.kind == "pair"]
    outside = [o for o in outcomes if o.kind == "outside"]
    covered = [o.covered for o in clean if o.covered is not None]
    after = [o.inflation for o in (*strong, *clean, *pairs)]
    named = [o for o in outside if o.found]
    _save(_power_figure(single), figures / "trust_power.png")
    _save(_confusion_figure(strong), figures / "trust_confusion.png")
    rows = [
        ("one effect, at least 1.5 × the noise: found, and nothing else", _share(strong), "97 %"),
        ("two effects, 1.5 × the noise each: found, and nothing else", _share(pairs), "88 %"),
        ("no effect: `sufficient`", _share(clean), "97 %"),
        (
            "a channel without effect, beside one with an effect: `sufficient`",
            _share(beside),
            "97 %",
        ),
        ("unlisted covariate: no effect found, the right covariate", _share(outside), "95 %"),
        ("unlisted covariate: an effect found falsely", f"{len(named)} of {len(outside)}", ""),
        (
            "remaining structure and noise, over the noise: at most 1.10",
            _share_of(after, 1.10),
            "95 %",
        ),
        ("95 % interval of k_n holds the true one", _fraction(covered), "95 %"),
    ]
    table = "\n".join(f"| {name} | {figure} | {aim} |" for name, figure, aim in rows)
    wrong = [o for o in (*strong, *clean, *beside, *outside, *pairs) if not is_right(o)]
    listed = "\n".join(
        f"| {o.kind} | {o.channel} | {' + '.join(o.truth) or NONE} "
        f"({', '.join(map(str, o.forms))}) | {' + '.join(o.found) or NONE}"
        f"{' | unexplained: ' + ', '.join(o.unexplained) if o.unexplained else ' |'} | {o.seed} |"
        for o in wrong
    )
    write_text(page, _PAGE.format(table=table, wrong=listed, count=len(outcomes), note=note))


_PAGE = """# Error rates of the contact diagnosis

Written by `make trust` (`python -m validation.contact`). Simulated press logs were diagnosed as by
`tacgen diagnose contact`. Their formulas (`validation/contact/forms.py`) differ from those that
are fitted. Loads, numbers of trials (30 to 80), noise and schedules are drawn at random. The
strength of an effect is the RMS residual of the best linear law, in units of the noise of one
sample. Thresholds were set on other logs, but also after wrong results of earlier runs of this
study were inspected. {count} channels were diagnosed.

| | measured (95 % interval) | aim |
|---|---|---|
{table}

{note}

![Found against strength](figures/trust_power.png)

Share of logs in which the simulated effect was found and nothing else, by strength.

![Confusion matrix](figures/trust_confusion.png)

Simulated effects (rows, at 1.5 times the noise and more) against effects found (columns), in per
cent of the row.

## All wrong results

| class | channel | simulated (form) | found | | seed |
|---|---|---|---|---|---|
{wrong}

## Limits of this study

Every press is loaded and unloaded, and the noise is white. [Other logs](diagnosis_logs.md) have
other rigs, correlated noise, and 12 to 80 trials.
"""


def _share(outcomes: list[Outcome]) -> str:
    return _fraction([is_right(o) for o in outcomes])


def _share_of(values: Iterable[float], limit: float) -> str:
    return _fraction([value <= limit for value in values])


def _fraction(flags: Iterable[bool | None]) -> str:
    values = [bool(flag) for flag in flags]
    if not values:
        return "not measured"
    low, high = (100 * bound for bound in _interval(sum(values), len(values)))
    share = 100 * sum(values) / len(values)
    return f"{sum(values)} of {len(values)} = {share:.1f} % ({low:.0f} to {high:.0f})"


def _interval(right: int, count: int) -> tuple[float, float]:
    """95 % interval of a share.

    Source
    ------
    Wilson 1927.
    """
    z2 = 1.96**2
    middle = (right + z2 / 2) / (count + z2)
    half = 1.96 * np.sqrt(right * (count - right) / count + z2 / 4) / (count + z2)
    return float(middle - half), float(min(middle + half, 1.0))


def _power_figure(single: list[Outcome]) -> Figure:
    figure, grid = new_figure(9, 3.4, 1, 2, sharey=True)
    for axis, channel in zip(grid[0], ("normal", "shear"), strict=True):
        by_name: dict[str, dict[float, list[bool]]] = defaultdict(lambda: defaultdict(list))
        for o in single:
            if o.channel == channel:
                by_name[o.truth[0]][o.strength].append(is_right(o))
        for name, by_strength in sorted(by_name.items()):
            points = sorted(by_strength.items())
            axis.plot([s for s, _ in points], [np.mean(f) for _, f in points], "o-", label=name)
        axis.set_title(channel)
        axis.set_xlabel("strength / noise")
        axis.set(xlim=(0.0, 3.2), ylim=(-0.03, 1.08))
        axis.legend(fontsize=6, loc="lower right", ncols=2)
    figure.axes[0].set_ylabel("exactly the simulated effect")
    return figure


def _confusion_figure(strong: list[Outcome]) -> Figure:
    figure, grid = new_figure(11, 6, 1, 2, width_ratios=[2, 1])
    for axis, channel, forms in zip(
        grid[0], ("normal", "shear"), (NORMAL_FORMS, SHEAR_FORMS), strict=True
    ):
        names = sorted(forms)
        columns = [*names, "unexplained", NONE]
        share = np.zeros((len(names), len(columns)))
        counts = Counter(o.truth[0] for o in strong if o.channel == channel)
        for o in strong:
            if o.channel == channel:
                found = [*o.found, *(["unexplained"] if o.unexplained else [])] or [NONE]
                for name in found:
                    share[names.index(o.truth[0]), columns.index(name)] += 100 / counts[o.truth[0]]
        draw_confusion(axis, share, names, columns)
        axis.set_title(channel)
    return figure


def _save(figure: Figure, path: Path) -> None:
    with atomic_path(path) as partial:
        figure.savefig(partial, format="png", dpi=110)
