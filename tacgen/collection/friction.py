"""The friction sweep: simulate the real grasps at every μ and keep the μ that matches best."""

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tacgen.collection import perturbed
from tacgen.collection.recipe import Recipe
from tacgen.core.errors import RecipeError
from tacgen.core.files import refuse_foreign, refuse_other_page, write_text
from tacgen.core.resources import find_object_folder
from tacgen.core.types import BoolArray, FloatArray, IntArray
from tacgen.dataset.real_grasps import RealGrasp, RealGrasps

SweepKey = tuple[str, float]
"""(grasp_id, μ)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepRules:
    """What decides which μ explain labels."""

    least_wrong_share: float = 0.1  # of labels that the interval allows to be wrong although fewer
    # are seen to be: of 10 labels none is, 35 times of 100
    missed: float = 0.05  # how often the interval may miss the true μ, both sides together


RULES = SweepRules()


@dataclass(frozen=True, slots=True)
class FrictionFit:
    """The best μ of one object, its 95 % interval, and the whole curve.

    ``bounded`` is what the labels allow: ``both`` sides, only from ``below`` (every real grasp
    succeeded: μ is at least this much), or only from ``above`` (every one failed).
    """

    mu: float
    interval: tuple[float, float]
    mu_values: FloatArray
    mislabels: IntArray
    n_grasps: int
    bounded: str


def fit_friction(
    mu_values: FloatArray, simulated: IntArray, real: IntArray, _rng: object = None
) -> FrictionFit:
    """Choose μ by the fewest mislabels; ties go to the middle of the longest run.

    ``mu_values`` (M,) ascend; ``simulated`` (M, N) is the label of every grasp at every μ, where −1
    (not executed) counts as a mislabel; ``real`` (N,) is 1 for success, 0 for failure. ``_rng`` is
    ignored: nothing is drawn.

    The interval holds every μ with as few mislabels as the best, every one that ``explaining``
    cannot tell from them, and half a step on either side.

    Source: Si et al. 2022, Sec. IV: friction by sweeping μ against about 20 real grasps.
    """
    mislabels = (simulated != real).sum(axis=1)
    mu, run = best_mu(mu_values, mislabels), best_run(mislabels)
    ends = np.flatnonzero(explaining(simulated, real) | (mislabels == mislabels.min()))[[0, -1]]
    between = (mu_values[1:] + mu_values[:-1]) / 2
    half = np.diff(mu_values)[[0, -1]] / 2 if len(mu_values) > 1 else np.zeros(2)
    lows = np.maximum([mu_values[0] - half[0], *between], 0.0)
    highs = np.array([*between, mu_values[-1] + half[1]])
    bounded, low, high = "both", lows[ends[0]], highs[ends[1]]
    if (real == 1).all():
        bounded, low, high = "below", lows[run.start], mu_values[-1]
    elif (real == 0).all():
        bounded, low, high = "above", mu_values[0], highs[run.stop - 1]
    interval = float(low), float(high)
    return FrictionFit(mu, interval, mu_values, mislabels, len(real), bounded)


def explaining(simulated: IntArray, real: IntArray) -> BoolArray:
    """The μ (M,) that explain labels about as well as the best; arguments as of ``fit_friction``.

    Grasps that no μ tells apart have one label, that of their majority: none where it is even. From
    the true μ on, every label that is passed adds a mislabel, or takes one away where it is wrong:
    a random walk, which ever falls by t with the probability (p/(1−p))^t on either side, p being
    the share of wrong labels. Falls that are likelier than ``RULES.missed`` are allowed.

    Source: Feller 1968, An Introduction to Probability Theory, vol. 1, XIV.2 (the ruin).
    """
    distinct, which = np.unique(simulated, axis=1, return_inverse=True)
    votes = np.bincount(which.ravel(), 2.0 * real - 1.0)
    counted = (votes != 0) & (distinct != distinct[0]).any(axis=0)
    curve = (distinct != (votes > 0))[:, counted].sum(axis=1)
    share = max(RULES.least_wrong_share, curve.min() / max(counted.sum(), 1))
    ratio = share / (1.0 - share) if share < 1.0 else 1.0
    return np.asarray(2.0 * ratio ** (curve - curve.min()) > RULES.missed)


def best_mu(mu_values: FloatArray, mislabels: IntArray) -> float:
    """The middle of the longest run of μ with the fewest mislabels."""
    run = best_run(mislabels)
    return float((mu_values[run.start] + mu_values[run.stop - 1]) / 2)


def best_run(mislabels: IntArray) -> range:
    """The longest run of indices at the minimum; of equally long ones the first."""
    best = mislabels == mislabels.min()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], best, [False]]).astype(int)))
    starts, stops = edges[::2], edges[1::2]
    longest = int(np.argmax(stops - starts))
    return range(int(starts[longest]), int(stops[longest]))


def sweep_friction(
    recipe: Recipe,
    real: RealGrasps,
    mu_values: Sequence[float],
    out: Path,
    *,
    workers: int,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[dict[str, FrictionFit], dict[SweepKey, perturbed.Outcome]]:
    """Fit every object's friction to its real grasps: the fits by name, and every outcome.

    Finished simulations are kept in ``out/outcomes.jsonl``; an interrupted sweep goes on from them.
    Raises ``DatasetError`` if a real grasp asks for a force that the recipe's gripper cannot give.
    """
    refuse_foreign(out, perturbed.OUTCOMES, ("friction.json", "index.html", "objects"))
    refuse_other_page(out / "index.html", "friction")
    perturbed.check_forces(recipe, real)
    changes = {mu: perturbed.Perturbation(friction=mu) for mu in mu_values}
    wanted = [(grasp.config, change) for grasp in real.grasps for change in changes.values()]
    found = perturbed.simulate_perturbed(recipe, wanted, out, workers=workers, show=show)
    outcomes = {
        (grasp.grasp_id, mu): found[grasp.config.point, change]
        for grasp in real.grasps
        for mu, change in changes.items()
    }
    fits: dict[str, FrictionFit] = {}
    for name, repeated in real.by_object().items():
        grasps = _distinct(repeated)
        labels = np.array(
            [[outcomes[grasp.grasp_id, mu].label for grasp in grasps] for mu in mu_values]
        )
        truth = np.array([grasp.label for grasp in grasps])
        fits[name] = fit_friction(np.asarray(mu_values), labels, truth)
    write_text(out / "friction.json", json.dumps(friction_json(fits), indent=2) + "\n")
    return fits, outcomes


def _distinct(grasps: Sequence[RealGrasp]) -> list[RealGrasp]:
    """The grasps without those that repeat another's configuration and label."""
    return list({(one.config.point, one.label): one for one in grasps}.values())


def data_warnings(
    real: RealGrasps, outcomes: Mapping[SweepKey, perturbed.Outcome], mu_values: Sequence[float]
) -> list[str]:
    """Problems of the data, grasps that cannot be simulated among them."""
    # A grasp that is executed at one μ is so at all: of its labels the best is looked at.
    best = [
        max((outcomes[grasp.grasp_id, mu] for mu in mu_values), key=lambda one: one.label)
        for grasp in real.grasps
    ]
    repeats = len(real.grasps) - len(_distinct(real.grasps))
    return [
        *real.warnings,
        *(
            [f"{repeats} grasp(s) repeat another's place, force and label: left out"]
            if repeats
            else []
        ),
        *perturbed.unexecuted_note(real.grasps, best, "count as mislabels at every μ"),
    ]


def mu_range(text: str) -> tuple[float, ...]:
    """The values of μ that ``start:stop:step`` means, the end included.

    Raises ``RecipeError`` if the text is not of that form, or a value lies outside [0, 2].
    """
    try:
        start, stop, step = (float(part) for part in text.split(":"))
    except ValueError:
        start, stop, step = 0.0, -1.0, 1.0
    if not (0 <= start <= stop <= 2 and step > 0 and (stop - start) / step <= 1000):
        msg = f"--mu {text}: give start:stop:step within 0 to 2, such as 0:1:0.05"
        raise RecipeError(msg)
    count = int(np.floor((stop - start) / step + 1e-9)) + 1
    return tuple(round(start + k * step, 9) for k in range(count))


def write_object_copies(
    fits: Mapping[str, FrictionFit],
    folder: Path,
    recipe: Recipe | None = None,
    kind: str = "real",
) -> None:
    """Copy each object's folder into ``folder`` with its friction replaced by the fitted one.

    Objects beside the ``recipe`` are found too. ``kind`` is what the grasps were.
    """
    for name, fit in fits.items():
        target = folder / name
        source = recipe.entry_of(name).object_folder() if recipe else find_object_folder(name)
        shutil.copytree(source, target, dirs_exist_ok=True)
        path = target / "object.yaml"
        interval = "95 % {:.3g} to {:.3g}".format(*fit.interval)
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        content["friction"] = {
            "value": round(fit.mu, 6),
            "source": f"tacgen friction, {fit.n_grasps} {kind} grasps, {interval}",
        }
        write_text(path, yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def friction_json(fits: Mapping[str, FrictionFit]) -> dict[str, dict[str, Any]]:
    """The content of ``friction.json``."""
    return {
        name: {
            "mu": round(fit.mu, 6),
            "interval": [round(end, 6) for end in fit.interval],
            "mislabels": [
                [round(float(mu), 6), int(n)]
                for mu, n in zip(fit.mu_values, fit.mislabels, strict=True)
            ],
            "n_grasps": fit.n_grasps,
            "bounded": fit.bounded,
        }
        for name, fit in fits.items()
    }
