"""The diagnosis of press logs beside plain ways of choosing among the same effects.

    python -m validation.contact.others --logs 12 --out others.md

Each log of ``validation.blind``'s generator, less a fifth of its trials, goes to all of them. Of
the diagnosis they share the thinned, weighted rows and the library: every form of every effect,
linearised beside the linear law, as a group of columns. Then they choose by themselves:

* ``stepwise``: forward, the form that lowers the sum of squares most, by its F test at 5 % divided
  by the number of forms.
* ``LASSO, BIC``: the point of the LASSO's path with the least Bayesian information criterion
  (Zou, Hastie & Tibshirani 2007), refitted by least squares.
* ``STLSQ``: sequentially thresholded least squares (Brunton, Proctor & Kutz 2016, SINDy), the
  threshold by cross-validation over trials, one standard error towards fewer terms.
* ``GP, ARD``: a Gaussian process of what the linear law leaves, with a length for each covariate.
  It knows no effects: a name counts as found where the covariate that its effect is shown against
  is among as many most relevant ones as effects were put in, and as none where it gains less than
  2 % on held-out trials.

A channel is right where the names are exactly those that were put in. The error is that on the
trials that none of them saw, over the true noise. Every diagnosis is kept beside the table as a
line of JSON, so that a run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import f as f_distribution
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.linear_model import LassoLarsIC
from sklearn.model_selection import GroupKFold
from threadpoolctl import threadpool_limits

from tacgen.contact.effects import Channel, Effect, Variant, all_effects
from tacgen.contact.law import respond
from tacgen.core.files import write_text
from tacgen.core.types import FloatArray
from tacgen.diagnose.contact.channel import ChannelData, ChannelSamples, linear_compliance
from tacgen.diagnose.contact.model import references_of
from tacgen.diagnose.contact.residuals import covariates_of
from tacgen.presses.press_log import Columns
from validation.blind.evaluate import Wanted, draw_wanted, judge, run, split
from validation.blind.generator import Case, draw_case

SEED = 4_100_000
KINDS = ("single", "pair", "clean")
STRENGTHS = [1.5, 2.0, 3.0]
N_FOLDS = 5
THRESHOLDS = np.geomspace(0.01, 0.6, 12)  # of STLSQ, in standard deviations of the target
MAX_GP_ROWS = 250  # scikit-learn takes seconds for its lengths with more
LEAST_GP_GAIN = 0.02  # as the diagnosis asks of a covariate


@dataclass(frozen=True)
class Form:
    """One form of an effect, and where its references lie on the log that it is fitted to."""

    effect: Effect
    variant: Variant
    references: dict[str, float]

    def columns(self, data: ChannelData, compliance: float) -> FloatArray:
        """What each probe adds to the linear law's response, (N·C, M)."""
        plain = respond(data.history, data.channel, compliance, [])
        given = {**self.references, **self.variant.shapes}
        changes = [
            respond(
                data.history,
                data.channel,
                compliance,
                [(self.effect, self.effect.complete({**given, **probe}))],
            )
            - plain
            for probe in self.variant.probes
        ]
        return np.stack([change.ravel() for change in changes], axis=1)


class Problem:
    """A channel of a log: weighted rows to fit, rows to predict, and the library on both."""

    def __init__(self, given: Columns, later: Columns, channel: Channel) -> None:
        self.data = data = ChannelSamples(given, channel).thinned()
        self.later = ChannelSamples(later, channel).every_sample()
        load = data.history.load(channel)
        self.compliance = linear_compliance(load, data.target)
        self.forms, columns = [], []
        for effect in all_effects():
            if effect.channel != channel or not effect.can_act_on(data.history):
                continue
            references = references_of(effect, data)
            for variant in effect.variants(data.history, references):
                form = Form(effect, variant, references)
                found = form.columns(data, self.compliance)
                if np.isfinite(found).all() and np.abs(found).max() > 0:
                    self.forms.append(form)
                    columns.append(found)
        root = np.repeat(np.sqrt(data.weight), data.n_outputs)[:, None]
        self.load = root * load.reshape(-1, 1)
        self.columns = [root * found for found in columns]
        self.target = root[:, 0] * data.target.ravel()
        self.trial = np.repeat(data.history.trial, data.n_outputs)

    def fitted(self, chosen: list[int]) -> tuple[FloatArray, float]:
        """Coefficients of the linear law and the chosen forms, and the sum of squares left."""
        design = np.hstack([self.load, *(self.columns[k] for k in chosen)])
        weights = np.linalg.lstsq(design, self.target, rcond=None)[0]
        left = self.target - design @ weights
        return weights, float(left @ left)

    def rms_later(self, chosen: list[int]) -> float:
        """The error on the trials that were kept away."""
        weights, rows = self.fitted(chosen)[0], self.later
        parts = [rows.history.load(rows.channel).reshape(-1, 1)]
        parts += [self.forms[k].columns(rows, self.compliance) for k in chosen]
        return _rms(rows.target.ravel() - np.hstack(parts) @ weights)

    def names(self, chosen: list[int]) -> list[str]:
        """Names of the chosen forms' effects."""
        return sorted({self.forms[k].effect.name for k in chosen})


def stepwise(problem: Problem) -> list[int]:
    """Forms that forward selection adds."""
    chosen: list[int] = []
    _, now = problem.fitted(chosen)
    while True:
        others = [k for k in range(len(problem.forms)) if k not in chosen]
        sums = [problem.fitted([*chosen, k])[1] for k in others]
        best = int(np.argmin(sums))
        added = problem.columns[others[best]].shape[1]
        left = problem.target.size - problem.fitted([*chosen, others[best]])[0].size
        ratio = (now - sums[best]) / added / (sums[best] / left)
        if f_distribution.sf(ratio, added, left) > 0.05 / len(problem.forms):
            return chosen
        chosen.append(others[best])
        now = sums[best]


def _scaled(problem: Problem) -> tuple[FloatArray, FloatArray, list[int]]:
    """Columns and target of unit size, less the linear law, and the form of each column."""
    design = np.hstack(problem.columns)
    owner = [k for k, found in enumerate(problem.columns) for _ in range(found.shape[1])]
    law = problem.load / np.linalg.norm(problem.load)
    design, target = (
        design - law @ (law.T @ design),
        problem.target - law[:, 0] * (law[:, 0] @ problem.target),
    )
    size = np.linalg.norm(design, axis=0) / np.sqrt(len(design))
    return design / np.maximum(size, 1e-12), target / target.std(), owner


def lasso_bic(problem: Problem) -> list[int]:
    """Forms with a coefficient that is not 0 where the BIC is least."""
    design, target, owner = _scaled(problem)
    found = LassoLarsIC(criterion="bic", fit_intercept=False, noise_variance=None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # columns of one effect's forms are nearly collinear
        weights = found.fit(design, target).coef_
    return sorted({owner[k] for k in np.flatnonzero(weights)})


def stlsq(problem: Problem) -> list[int]:
    """Forms that are left where held-out trials are predicted best, within a standard error."""
    design, target, owner = _scaled(problem)
    folds = list(GroupKFold(N_FOLDS).split(design, groups=problem.trial))
    errors = np.array(
        [
            [
                np.mean(
                    (target[test] - design[test] @ _thresholded(design[fit], target[fit], t)) ** 2
                )
                for fit, test in folds
            ]
            for t in THRESHOLDS
        ]
    )
    mean, error = errors.mean(axis=1), errors.std(axis=1) / np.sqrt(N_FOLDS)
    best = int(np.argmin(mean))
    last = int(np.flatnonzero(mean <= mean[best] + error[best]).max())
    return sorted(
        {owner[k] for k in np.flatnonzero(_thresholded(design, target, THRESHOLDS[last]))}
    )


def _thresholded(design: FloatArray, target: FloatArray, threshold: float) -> FloatArray:
    kept = np.ones(design.shape[1], bool)
    weights = np.zeros(design.shape[1])
    for _ in range(20):
        part = design[:, kept]
        ridge = 1e-3 * len(design) * np.eye(part.shape[1])
        weights[:] = 0.0
        weights[kept] = np.linalg.solve(part.T @ part + ridge, part.T @ target)
        fewer = np.abs(weights) >= threshold
        if (fewer == kept).all() or not fewer.any():
            return weights * fewer
        kept = fewer
    return weights


def gp_ard(problem: Problem, n_wanted: int) -> tuple[list[str], float]:
    """Names whose covariates are the most relevant, and the error on the trials kept away."""
    data, rows = problem.data, problem.later
    inputs, later = (_numeric(covariates_of(d)) for d in (data, rows))
    names = [name for name in inputs if name in later and np.ptp(inputs[name]) > 0]
    x = np.column_stack([inputs[name] for name in names])
    center, scale = x.mean(axis=0), x.std(axis=0)
    x, test = (x - center) / scale, np.column_stack([later[n] for n in names]) - center
    left = data.target - problem.compliance * data.history.load(data.channel)
    chosen = np.random.default_rng(0).permutation(len(x))[:MAX_GP_ROWS]
    relevance, predicted = np.zeros(len(names)), np.empty_like(rows.target)
    for axis in range(data.n_outputs):
        y = left[chosen, axis]
        kernel = ConstantKernel(1.0) * RBF(np.ones(len(names)), (0.1, 1e3)) + WhiteKernel(0.3)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # lengths at their bounds: covariates without effect
            process = GaussianProcessRegressor(kernel, normalize_y=True).fit(x[chosen], y)
        relevance += 1.0 / process.kernel_.k1.k2.length_scale
        predicted[:, axis] = process.predict(test / scale)
    linear = rows.target - problem.compliance * rows.history.load(rows.channel)
    rms = _rms(linear - predicted)
    if rms > (1 - LEAST_GP_GAIN) * _rms(linear):
        return [], rms
    most = {names[k] for k in np.argsort(-relevance)[: max(n_wanted, 1)]}
    shown = {form.effect.name for form in problem.forms if form.effect.shown_against in most}
    return sorted(shown), rms


def _numeric(columns: dict[str, Any]) -> dict[str, FloatArray]:
    return {
        name: np.nan_to_num(values.astype(float), nan=float(np.nanmean(values)))
        for name, values in columns.items()
        if np.issubdtype(values.dtype, np.number)
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))


OTHERS: dict[str, Callable[[Problem], list[int]]] = {
    "stepwise": stepwise,
    "LASSO, BIC": lasso_bic,
    "STLSQ": stlsq,
}


def compared(case: Case, seed: int) -> Iterator[dict[str, Any]]:
    """What each way makes of each channel of a case: right or not, its error, its time."""
    start = time.process_time()
    record = run(case, seed)
    spent = time.process_time() - start
    wrong = judge(case, record)
    given, later = ({n: part[n].to_numpy() for n in part} for part in split(case.frame, seed))
    floors: dict[Channel, float] = {"normal": case.floor_mm3, "shear": case.floor_mm}
    names_put_in: dict[Channel, tuple[str, ...]] = {"normal": case.normal, "shear": case.shear}
    for channel, wanted in names_put_in.items():
        if channel not in record["channels"]:
            continue
        ours = {"right": channel not in wrong, "error": record["later"][channel]}
        rows = {"tacgen": {**ours, "s": spent / len(record["channels"])}}
        problem = Problem(given, later, channel)
        for name, choose in OTHERS.items():
            start = time.process_time()
            chosen = choose(problem)
            rows[name] = {
                "right": problem.names(chosen) == sorted(wanted),
                "error": problem.rms_later(chosen),
                "s": time.process_time() - start,
            }
        start = time.process_time()
        names, error = gp_ard(problem, len(wanted))
        found = set(wanted) <= set(names) if wanted else not names
        spent_gp = time.process_time() - start
        rows["GP, ARD"] = {"right": found, "error": error, "s": spent_gp}
        for name, row in rows.items():
            error = float(row["error"]) / floors[channel]
            yield {"way": name, "effects": len(wanted), **row, "error": error}


def table(records: list[dict[str, Any]]) -> str:
    """A row a way: right by the number of effects put in, error over noise, time a channel."""
    by_way: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for record in records:
        by_way[record["way"]].append(record)
    lines = [
        "| way | none put in | one | two | error over noise, median, 90 % | s a channel |",
        "|" + "---|" * 6,
    ]
    for way, found in by_way.items():
        counts = [
            f"{sum(r['right'] for r in found if r['effects'] == n)} of "
            f"{sum(r['effects'] == n for r in found)}"
            for n in range(3)
        ]
        middle, high = np.quantile([r["error"] for r in found], [0.5, 0.9])
        spent = float(np.median([r["s"] for r in found]))
        cells = [way, *counts, f"{middle:.2f}, {high:.2f}", f"{spent:.2g}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def logs(count: int) -> Iterator[tuple[int, dict[str, Wanted]]]:
    """(seed, effects) of so many logs."""
    for index in range(count):
        rng = np.random.default_rng([SEED, index])
        yield SEED + index, draw_wanted(KINDS[index % len(KINDS)], STRENGTHS, rng)


def main() -> None:
    """Compare on what is not kept yet, and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--logs", type=int, default=12)
    parser.add_argument("--out", type=Path, required=True, help="the table, in Markdown")
    arguments = parser.parse_args()
    kept = arguments.out.with_suffix(".jsonl")
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.is_file() else []
    records = [json.loads(line) for line in lines]
    for seed, wanted in logs(arguments.logs):
        if any(record["seed"] == seed for record in records):
            continue
        case = draw_case(seed, normal=wanted.get("normal", ()), shear=wanted.get("shear", ()))
        with threadpool_limits(limits=1):
            found = [{"seed": seed, **record} for record in compared(case, seed)]
        records += found
        with kept.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(record) + "\n" for record in found)
        write_text(arguments.out, table(records))


if __name__ == "__main__":
    main()
