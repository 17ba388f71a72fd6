"""tacgen's image model against simple ones, on real ball presses that none of them saw.

    python -m validation.optics.against_mlp [SET ...] [--seeds N] [--data ../shared/data]

Of every set a quarter is held out by press, anew for each seed. On the rest ``tacgen calibrate
lookup``'s model is fitted with its defaults, and beside it a plain network (slope x, y, place x, y
→ change of RGB, 2 × 64 tanh), Taxim's recipe (a quadratic in place for each bin of slope) and
nothing (the background). An error is the RMSE, grey levels, inside the labelled circle, with the
place as labelled and with the centre estimated on one half of the pixels and scored on the other,
over every held-out press with a circle. It needs scikit-learn; sets that are not there are left
out. Those of ``taxim`` are the presses in the package of that name.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import griddata
from scipy.optimize import minimize

from tacgen.calibrate.lookup.prepared import Pixels, disc_pixels
from tacgen.calibrate.lookup.score import TableScore, score_table
from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.presses.experiments import experiments_of
from tacgen.presses.geometry import MAX_RADIUS_SHARE
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages, label_mm
from tacgen.presses.screening import usable_presses
from validation.optics.press_sets import DATA, SETS

Floats = NDArray[np.float64]
Guess = Callable[[Floats], Floats]
"""Change of grey level (n, 3) for slope along x and y and place, from −½ to ½, (n, 4)."""

PACKAGE_SETS: dict[str, tuple[str, dict[str, float]]] = {
    "taxim_gelsight": ("gelsight", {"mm_per_px": 0.0295, "ball_radius_mm": 2.0}),
    "taxim_mini": ("gelsight_mini", {"mm_per_px": 18.6 / 640, "ball_radius_mm": 2.0}),
}
"""Folder in the package, and what the files do not say; the Mini's ball is not known."""

HELD_OUT = 0.25
MLP_PIXELS = 700  # of each press, that the network is fitted to
BINS = 125  # of slope and of direction, of Taxim's recipe
LEAST_IN_BIN = 24  # pixels, four a coefficient
FARTHEST = 0.4  # label radii that a centre is looked for within


def all_sets(data: Path) -> Iterator[tuple[str, PressImages]]:
    """Name and presses of each set that is there."""
    for name, path in SETS.items():
        if (data / path).exists():
            yield name, read_presses(data / path)
    spec = find_spec("taxim")
    for name, (folder, known) in PACKAGE_SETS.items():
        if spec is not None and spec.origin is not None:
            pack = Path(spec.origin).parent / "calib" / folder / "dataPack.npz"
            yield name, read_presses(pack, **known)


def split(raw: PressImages, seed: int) -> tuple[PressImages, PressImages]:
    """Usable presses for a fit, and a quarter of all that have a circle, labelled or found."""
    screened = usable_presses(raw)
    at = {name: k for k, name in enumerate(screened.names)}
    counted = [k for k, name in enumerate(raw.names) if name in at or raw.labelled[k]]
    presses = raw.select(np.array(counted))
    center, radius = presses.center_px.copy(), presses.radius_px.copy()
    for k, name in enumerate(presses.names):
        if name in at:
            center[k], radius[k] = screened.center_px[at[name]], screened.radius_px[at[name]]
    presses = replace(presses, center_px=center, radius_px=radius)
    experiment = experiments_of(presses)
    presses = replace(presses, experiment=experiment)
    order = np.random.default_rng(seed).permutation(experiment.max() + 1)
    held_out = np.isin(experiment, order[: max(1, round(HELD_OUT * len(order)))])
    train = np.array([at[n] for n in np.array(presses.names)[~held_out] if n in at])
    return screened.select(train), presses.select(held_out)


def slopes(geometry: Floats, ball_radius_mm: float, pixels: Pixels) -> Floats:
    """Inputs (n, 4) of the simple models: the ball's slope at ``pixels``, and the place."""
    dx, dy = pixels.x_mm - geometry[0], pixels.y_mm - geometry[1]
    r = np.maximum(np.hypot(dx, dy), 1e-9)
    within = np.minimum(r, MAX_RADIUS_SHARE * ball_radius_mm)
    slope = within / np.sqrt(ball_radius_mm**2 - within**2) / r
    return np.column_stack([slope * dx, slope * dy, pixels.position[:, 3:5]])


def training_pixels(presses: PressImages, limit: int | None = None) -> tuple[Floats, Floats]:
    """Inputs (n, 4) and changes of grey level (n, 3), of up to ``limit`` pixels of each press."""
    inputs, changes = [], []
    for k, label in enumerate(label_mm(presses)):
        pixels = disc_pixels(presses, k, limit=limit)
        inputs.append(slopes(label, float(presses.ball_radius_mm[k]), pixels))
        changes.append(pixels.grey - presses.background[pixels.rows, pixels.columns])
    return np.concatenate(inputs), np.concatenate(changes)


def mlp(inputs: Floats, changes: Floats, seed: int) -> Guess:
    """The plain network."""
    from sklearn.neural_network import MLPRegressor

    def scaled(values: Floats) -> Floats:
        tangential = values[:, :2] / np.sqrt(1 + (values[:, :2] ** 2).sum(axis=1, keepdims=True))
        return np.column_stack([2 * tangential, 4 * values[:, 2:]])

    network = MLPRegressor(
        hidden_layer_sizes=(64, 64), activation="tanh", batch_size=512, learning_rate_init=2e-3,
        max_iter=120, alpha=0.03, random_state=seed, tol=0.0, n_iter_no_change=1000,
    )  # fmt: skip
    size = float(changes.std())
    network.fit(scaled(inputs), changes / size)
    return lambda values: np.asarray(network.predict(scaled(values))) * size


def taxim_recipe(inputs: Floats, changes: Floats) -> Guess:
    """A quadratic in place for each bin of slope and direction; empty bins are the nearest's.

    NaN everywhere where no bin has the pixels for one: a small set of small images.
    """

    def bins(values: Floats) -> NDArray[np.int64]:
        slope = np.arctan(np.hypot(values[:, 0], values[:, 1])) / (np.pi / 2 / (BINS - 1))
        turn = (np.arctan2(values[:, 1], values[:, 0]) + np.pi) / (2 * np.pi / (BINS - 1))
        return np.asarray(slope.astype(int) * BINS + turn.astype(int))

    def features(values: Floats) -> Floats:
        u, v = values[:, 2], values[:, 3]
        return np.column_stack([u * u, v * v, u * v, u, v, np.ones_like(u)])

    table = np.full((BINS * BINS, 6, 3), np.nan)
    index = bins(inputs)
    order = np.argsort(index, kind="stable")
    starts = np.flatnonzero(np.diff(index[order], prepend=-1))
    for part in np.split(order, starts[1:]):
        if len(part) >= LEAST_IN_BIN:
            solved = np.linalg.lstsq(features(inputs[part]), changes[part], rcond=None)
            table[index[part[0]]] = solved[0]
    known = np.flatnonzero(np.isfinite(table[:, 0, 0]))
    if not known.size:
        return lambda values: np.full((len(values), 3), np.nan)
    missing = np.flatnonzero(~np.isfinite(table[:, 0, 0]))
    grid = np.column_stack(np.divmod(np.arange(BINS * BINS), BINS))
    nearest = griddata(grid[known], known, grid[missing], method="nearest").astype(int)
    table[missing] = table[nearest]
    return lambda values: np.einsum("nf,nfc->nc", features(values), table[bins(values)])


def errors_of(guess: Guess, presses: PressImages) -> tuple[float, float]:
    """RMSE inside the circles, as labelled and with the centres re-estimated."""
    squares, count = np.zeros(2), 0
    for k, label in enumerate(label_mm(presses)):
        ball = float(presses.ball_radius_mm[k])

        def off(move: Floats, pixels: Pixels, label: Floats = label, ball: float = ball) -> Floats:
            geometry = label + label[2] * np.append(move, 0.0)
            made = presses.background[pixels.rows, pixels.columns].astype(float)
            made += guess(slopes(geometry, ball, pixels))
            return pixels.grey - np.clip(made, 0, 255)

        pixels = disc_pixels(presses, k)
        count += 3 * len(pixels)
        squares[0] += (off(np.zeros(2), pixels) ** 2).sum()
        for odd in (False, True):
            seen = pixels.select(pixels.odd_block == odd)
            thin = seen.select(np.arange(len(seen)) % max(1, len(seen) // 600) == 0)
            found = minimize(
                lambda move, thin=thin, off=off: float((off(move, thin) ** 2).mean()),
                np.zeros(2), method="Nelder-Mead", bounds=[(-FARTHEST, FARTHEST)] * 2,
                options={"initial_simplex": [[0, 0], [0.1, 0], [0, 0.1]], "xatol": 2e-3,
                         "fatol": 1e-2, "maxfev": 60},
            )  # fmt: skip
            scored = pixels.select(pixels.odd_block != odd)
            squares[1] += (off(found.x, scored) ** 2).sum()
    labels, refined = np.sqrt(squares / count)
    return float(labels), float(refined)


def tacgen_errors(score: TableScore) -> dict[str, Any]:
    """Inside the circle and from there to 1.5 radii."""
    rings = score.rings()
    return {
        "tacgen": (rings[0]["rmse_labels"], rings[0]["rmse_refined"]),
        "bare": (rings[0]["rmse_bare"], rings[0]["rmse_bare"]),
        "ring": (rings[1]["rmse_labels"], rings[1]["rmse_refined"], rings[1]["rmse_bare"]),
    }


def compare(raw: PressImages, seed: int, *, simple: bool = True) -> dict[str, Any]:
    """Errors of every model on one split, and the seconds of processor that the fit took."""
    train, test = split(raw, seed)
    begin = time.process_time()
    table = fit_lookup(train)
    found: dict[str, Any] = {"n": (len(train), len(test)), "fit_s": time.process_time() - begin}
    found |= tacgen_errors(score_table(table, test))
    if simple:
        found["mlp"] = errors_of(mlp(*training_pixels(train, MLP_PIXELS), seed), test)
        found["taxim"] = errors_of(taxim_recipe(*training_pixels(train)), test)
    return found


def main() -> None:
    """Print a line for each split of each set."""
    parser = argparse.ArgumentParser(description="Image models on held-out real presses.")
    parser.add_argument("sets", nargs="*", metavar="SET")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found: dict[str, list[dict[str, Any]]] = {}
    for name, raw in all_sets(options.data):
        if options.sets and name not in options.sets:
            continue
        for seed in range(options.seeds):
            one = compare(raw, seed)
            found.setdefault(name, []).append(one)
            errors = "  ".join(
                f"{model} {one[model][0]:5.2f} / {one[model][1]:5.2f}"
                for model in ("tacgen", "mlp", "taxim", "bare")
            )
            labels, refined, bare = one["ring"]
            sys.stdout.write(
                f"{name:14} {one['n'][0]:2d} → {one['n'][1]:2d}  {errors}   1 to 1.5 radii "
                f"{labels:.2f} / {refined:.2f}, bare {bare:.2f}   fit {one['fit_s']:.0f} s\n"
            )
            sys.stdout.flush()
    if options.json is not None:
        options.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
