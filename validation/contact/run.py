"""How far the tracer can be trusted: inject effects, by other formulas, and count.

    python -m validation.contact [--repeats N] [--out docs/results/diagnosis_contact.md]

Every effect of the lists, none, effects outside the lists, and pairs are put into made-up logs
(`cases.py`) at several strengths; the page says what was found. It takes about one and a half
seconds of one core a log and channel; results are kept beside the page, so that a run goes on
where it stopped.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.contact.effects import CHANNELS, Channel
from tacgen.diagnose.contact.channel import ChannelSamples
from tacgen.diagnose.contact.model import standard_errors, without_noise_bias
from tacgen.diagnose.contact.search import ContactProblem
from validation.contact.cases import (
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
    channel: Channel = "shear" if effects and effects[0][0] == "shear" else "normal"
    outcomes = []
    for name in CHANNELS if kind in ("clean", "single") else (channel,):
        names = tuple(sorted(e[1] for e in effects)) if name == channel else ()
        outcomes.append(
            _trace(columns, name, names, kind, strength, seed, noise[name], k_n, effects)
        )
    return outcomes


def _trace(
    columns: Columns,
    channel: Channel,
    names: tuple[str, ...],
    kind: str,
    strength: float,
    seed: int,
    noise: float,
    k_n: float,
    effects: list[tuple[str, str, int]],
) -> Outcome:
    data = ChannelSamples(columns, channel).thinned()
    result = ContactProblem(data, np.random.default_rng(seed)).run()
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


def run_study(repeats: int, store: Path, *, kept_only: bool = False) -> list[Outcome]:
    """Run what ``store`` does not hold yet, unless forbidden; one line of JSON per log."""
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
            if seed not in done and not kept_only:
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
