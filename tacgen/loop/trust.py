"""How far the tracer can be trusted: inject effects, by other formulas, and count.

    python -m tacgen.loop.trust [--repeats N] [--out docs/trust.md]

Every effect of the lists, none, effects outside the lists, and pairs are put into made-up logs
(`trust_cases`) at several strengths; the page says what was found. It takes about one and a half
seconds of one core a log and channel; results are kept beside the page, so that a run goes on
where it stopped.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tacgen.files import atomic_path, write_text
from tacgen.loop.attribution import Tracer
from tacgen.loop.channel import channel_data
from tacgen.loop.trust_cases import (
    NORMAL_FORMS,
    OUTSIDE_FORMS,
    SHEAR_FORMS,
    Columns,
    blank_log,
    make_case,
)

STRENGTHS = (0.5, 1.0, 1.5, 3.0)
NONE = "none"
SEED = 41


@dataclass(frozen=True)
class Outcome:
    """What was put into a log's channel and what was found in it.

    ``inflation`` is the held-out error of the traced law over the true noise; ``covered`` says
    whether the 95 % interval of a clean log's compliance holds the true one.
    """

    kind: str
    channel: str
    truth: tuple[str, ...]
    strength: float
    seed: int
    found: tuple[str, ...]
    unexplained: tuple[str, ...]
    inflation: float
    covered: bool | None = None
    forms: tuple[int, ...] = field(default=())


def cases(repeats: int) -> Iterator[tuple[str, float, list[tuple[str, str, int]], int]]:
    """(kind, strength, effects, seed) of every log of the study."""
    seed = SEED * 100_000
    singles = [("normal", n, k) for n, f in NORMAL_FORMS.items() for k in range(len(f))]
    singles += [("shear", n, k) for n, f in SHEAR_FORMS.items() for k in range(len(f))]
    outside = [("outside", n, k) for n, f in OUTSIDE_FORMS.items() for k in range(len(f))]
    rng = np.random.default_rng(SEED)
    for repeat in range(repeats):
        for _ in range(12):
            seed += 1
            yield "clean", 0.0, [], seed
        for effect in singles:
            for strength in STRENGTHS if repeat == 0 else STRENGTHS[2:3]:
                seed += 1
                yield "single", strength, [effect], seed
        for effect in outside:
            seed += 1
            yield "outside", 1.5, [effect], seed
        for _ in range(24):
            seed += 1
            pair = [singles[i] for i in rng.choice(len(singles), 2, replace=False)]
            if pair[0][0] == pair[1][0] and pair[0][1] != pair[1][1]:
                yield "pair", 1.5, pair, seed


def run_case(
    kind: str, strength: float, effects: list[tuple[str, str, int]], seed: int
) -> list[Outcome]:
    """Trace one log; both channels where it is clean, else the one with the effects."""
    rng = np.random.default_rng(seed)
    truth = blank_log(rng)
    k_n = float(truth.volume_mm3.max() / truth.force_n.max())
    columns, noise = make_case(effects, strength, rng, truth)
    channel = "shear" if effects and effects[0][0] == "shear" else "normal"
    outcomes = []
    for name in ("normal", "shear") if kind in ("clean", "single") else (channel,):
        names = tuple(sorted(e[1] for e in effects)) if name == channel else ()
        outcomes.append(
            _trace(columns, name, names, kind, strength, seed, noise[name], k_n, effects)
        )
    return outcomes


def _trace(
    columns: Columns,
    channel: str,
    names: tuple[str, ...],
    kind: str,
    strength: float,
    seed: int,
    noise: float,
    k_n: float,
    effects: list[tuple[str, str, int]],
) -> Outcome:
    from tacgen.loop.model import standard_errors, without_noise_bias

    data = channel_data(columns, "shear" if channel == "shear" else "normal")
    result = Tracer(data, np.random.default_rng(seed)).run()
    chosen = [c.candidate for c in result.chosen]
    covered = None
    if kind == "clean" and channel == "normal":
        fit = without_noise_bias(data, result.final.fit)
        error = standard_errors(data, fit).compliance
        covered = bool(abs(fit.model.compliance - k_n) < 1.96 * error)
    structure = max(result.final.loss, 0.0) / data.noise_loss
    return Outcome(
        kind,
        channel,
        names,
        strength,
        seed,
        tuple(sorted(c.name for c in chosen if c.is_effect)),
        tuple(sorted(c.name for c in chosen if not c.is_effect)),
        float(np.sqrt(1.0 + structure) * data.noise / noise),
        covered,
        tuple(e[2] for e in effects),
    )


def is_right(outcome: Outcome) -> bool:
    """Whether every effect, and nothing else, was named; outside the lists, the covariate."""
    if outcome.kind == "outside":
        return not outcome.found and outcome.truth == outcome.unexplained
    return outcome.found == outcome.truth and not outcome.unexplained


def run_study(repeats: int, store: Path) -> list[Outcome]:
    """Run what ``store`` does not hold yet; a line of JSON a log."""
    done: dict[int, list[Outcome]] = defaultdict(list)
    if store.is_file():
        for line in store.read_text(encoding="utf-8").splitlines():
            for item in json.loads(line):
                outcome = _outcome_of(item)
                done[outcome.seed].append(outcome)
    store.parent.mkdir(parents=True, exist_ok=True)
    planned = sorted(cases(repeats), key=lambda case: (case[0] == "single", case[1] != 1.5))
    with store.open("a", encoding="utf-8") as file:
        for number, (kind, strength, effects, seed) in enumerate(planned):
            if seed not in done:
                done[seed] = run_case(kind, strength, effects, seed)
                file.write(json.dumps([asdict(o) for o in done[seed]]) + "\n")
                file.flush()
            if sys.stderr.isatty() or number % 50 == 0:
                sys.stderr.write(f"\r{number + 1} of {len(planned)} logs")
    sys.stderr.write("\n")
    wanted = {seed for *_, seed in planned}
    return [o for seed in sorted(wanted & set(done)) for o in done[seed]]


def _outcome_of(item: dict[str, Any]) -> Outcome:
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in item.items()}
    return Outcome(**values)


def write_page(outcomes: list[Outcome], page: Path) -> None:
    """Write the page and its figures."""
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
        ("one effect, at least 1.5 × the noise: it and only it", _share(strong)),
        ("two effects at once, 1.5 × the noise each: both and only they", _share(pairs)),
        ("no effect: `sufficient`", _share(clean)),
        ("the channel beside one with an effect: `sufficient`", _share(beside)),
        ("outside the lists: no effect named, the right covariate", _share(outside)),
        ("outside the lists: an effect named all the same", f"{len(named)} of {len(outside)}"),
        ("structure and noise left, over the noise: at most 1.10", _share_of(after, 1.10)),
        ("95 % interval of k_n holds the true one", _fraction(covered)),
    ]
    table = "\n".join(f"| {words} | {figure} |" for words, figure in rows)
    wrong = [o for o in (*strong, *clean, *beside, *outside, *pairs) if not is_right(o)]
    listed = "\n".join(
        f"| {o.kind} | {o.channel} | {' + '.join(o.truth) or NONE} "
        f"({', '.join(map(str, o.forms))}) | {' + '.join(o.found) or NONE}"
        f"{' | unexplained: ' + ', '.join(o.unexplained) if o.unexplained else ' |'} | {o.seed} |"
        for o in wrong
    )
    write_text(page, _PAGE.format(table=table, wrong=listed, count=len(outcomes)))


_PAGE = """# How far the tracer can be trusted

Written by `make trust` (`python -m tacgen.loop.trust`). Effects, and none, were put into made-up
press logs and traced as `tacgen diagnose contact` does. The formulas of the logs
(`tacgen/loop/trust_cases.py`) are other ones than those that are fitted: creep as a logarithm or
a power of time against Prony terms, stiffening as tanh or a fraction against powers, hysteresis
by Bouc-Wen against plays and loops, a Gaussian bump against polynomials, and so on. Loads, sizes,
numbers of trials (30 to 80), noise in volume and in force, and schedules are drawn at random.
The strength of an effect is the RMS of what it changes beside the best k, in units of the noise
of one sample. {count} channels were traced. Thresholds were set on other seeds and on
`tests/blind`'s logs, not on these.

| | |
|---|---|
{table}

Right means: exactly the effects that were put in, no further one, and nothing unexplained.

![Found against strength](figures/trust_power.png)

Share of logs in which the effect was named (and nothing else), by strength.

![Confusion matrix](figures/trust_confusion.png)

What was put in (rows, at 1.5 times the noise and more) against what was named (columns), in per
cent of the row.

## Every wrong one

| class | channel | put in (form) | found | | seed |
|---|---|---|---|---|---|
{wrong}

## What this does not show

The study draws its sessions from one rig's habits: every press is loaded and unloaded, trials are
independent, the noise is white. A log without an unloading phase cannot show hysteresis, one ball
cannot show geometry, and a soft limit that is only neared cannot be told from stiffening; the
report of a diagnosis says which effects its data cannot tell apart.
"""


def _share(outcomes: list[Outcome]) -> str:
    return _fraction([is_right(o) for o in outcomes])


def _share_of(values: Iterable[float], limit: float) -> str:
    return _fraction([value <= limit for value in values])


def _fraction(flags: Iterable[bool | None]) -> str:
    values = [bool(flag) for flag in flags]
    if not values:
        return "not measured"
    return f"{sum(values)} of {len(values)} = {100 * sum(values) / len(values):.1f} %"


def _power_figure(single: list[Outcome]) -> Figure:
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    for axis, channel in zip(figure.subplots(1, 2, sharey=True), ("normal", "shear"), strict=True):
        by_name: dict[str, dict[float, list[bool]]] = defaultdict(lambda: defaultdict(list))
        for o in single:
            if o.channel == channel:
                by_name[o.truth[0]][o.strength].append(is_right(o))
        for name, by_strength in sorted(by_name.items()):
            points = sorted(by_strength.items())
            axis.plot([s for s, _ in points], [np.mean(f) for _, f in points], "o-", label=name)
        axis.set_title(channel)
        axis.set_xlabel("strength / noise")
        axis.legend(fontsize=6)
    figure.axes[0].set_ylabel("right and only right")
    return figure


def _confusion_figure(strong: list[Outcome]) -> Figure:
    figure = Figure(figsize=(11, 6), layout="constrained")
    axes = figure.subplots(1, 2, width_ratios=[2, 1])
    for axis, channel, forms in zip(
        axes, ("normal", "shear"), (NORMAL_FORMS, SHEAR_FORMS), strict=True
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
        axis.imshow(share, cmap="Blues", vmin=0, vmax=100)
        for (i, j), value in np.ndenumerate(share):
            if value:
                axis.text(j, i, f"{value:.0f}", ha="center", va="center", fontsize=7)
        axis.set_xticks(range(len(columns)), columns, rotation=90, fontsize=8)
        axis.set_yticks(range(len(names)), names, fontsize=8)
        axis.set_title(channel)
    return figure


def _save(figure: Figure, path: Path) -> None:
    with atomic_path(path) as partial:
        figure.savefig(partial, format="png", dpi=110)


def main() -> None:
    """Run the study and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("docs/trust.md"))
    parser.add_argument("--store", type=Path, default=Path("out/trust/outcomes.jsonl"))
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    write_page(run_study(arguments.repeats, arguments.store), arguments.out)


if __name__ == "__main__":
    main()
