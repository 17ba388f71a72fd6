"""Effects put into measured press images, and what ``tacgen diagnose optics`` calls them.

    python -m validation.optics.altered_images --kept FOLDER [SET[=PATH] ...] [--data FOLDER]

Of each set every other press calibrates a table; the presses between, clean and with one effect
each, are diagnosed against it, and the halves are exchanged. Results are kept in FOLDER, one line
a case, so that a run goes on where it stopped. Thresholds of the diagnosis were chosen on
``taxim`` and ``fots_gelsight``, with a look at ``digit_a``; the other sets only judge.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.core.errors import PressError
from tacgen.diagnose.optics.diagnose import diagnose_optics
from tacgen.optics.table import load_table, save_table
from tacgen.presses.press_folder import read_presses
from tacgen.presses.press_images import PressImages
from tacgen.presses.screening import usable_presses
from validation.optics.press_sets import DATA, SETS

EFFECTS = {
    "blur": "blur",
    "gain": "background_gain",
    "clip": "saturation",
    "center": "press_center",
    "centers": "press_center",
    "radii": "scale",
    "vignetting": "vignetting",
    "mix": "cross_talk",
}
"""What is put in, and its right name."""
NAMES = ("clean", *EFFECTS)
TUNED_ON = ("taxim", "fots_gelsight")
LEAST_SHARE = 0.002
"""Share of the pixels: fewer that change are no effect that could be found."""
MIX = np.array([[0.85, 0.12, 0.03], [0.06, 0.84, 0.10], [0.05, 0.13, 0.82]])


def altered(presses: PressImages, effect: str) -> PressImages:
    """The presses with one effect.

    Blur of 1.5 px, gain from −7.5 to +7.5 % over the session, clipping at 200, centres off by 3 px
    (all along x, or each in a direction of its own), radii × 1.1, vignetting of 20 % at the
    corners, colours mixed by ``MIX``.
    """
    images, count = presses.images.astype(float), len(presses)
    center, radius = presses.center_px.copy(), presses.radius_px.copy()
    if effect == "blur":
        images = gaussian_filter(images, (0, 1.5, 1.5, 0))
    elif effect == "gain":
        images *= (1 + 0.15 * np.linspace(-0.5, 0.5, count))[:, None, None, None]
    elif effect == "clip":
        images = np.minimum(images, 200)
    elif effect == "center":
        center[:, 0] += 3
    elif effect == "centers":
        angle = np.random.default_rng(1).uniform(0, 2 * np.pi, count)
        center += 3 * np.column_stack([np.cos(angle), np.sin(angle)])
    elif effect == "radii":
        radius *= 1.1
    elif effect == "vignetting":
        rows, columns = np.mgrid[: images.shape[1], : images.shape[2]]
        square = (rows - rows.mean()) ** 2 + (columns - columns.mean()) ** 2
        images *= (1 - 0.2 * square / square.max())[..., None]
    elif effect == "mix":
        images = images @ MIX.T
    grey = np.rint(np.clip(images, 0, 255)).astype(np.uint8)
    return replace(presses, images=grey, center_px=center, radius_px=radius)


def run(path: Path, name: str, kept: Path) -> Iterator[dict[str, Any]]:
    """Every case of a set that is not kept already."""
    presses = usable_presses(read_presses(path))
    for half in (0, 1):
        fitted = np.arange(len(presses)) % 2 == half
        table_path = kept / f"{name}_{half}.npz"
        if not table_path.exists():
            save_table(fit_lookup(presses.select(fitted)), table_path)
        table = load_table(table_path)
        for effect in NAMES:
            if [name, half, effect] in [record["case"] for record in finished(kept)]:
                continue
            given = altered(presses.select(~fitted), effect)
            if effect != "clean" and _is_unchanged(given, presses.select(~fitted)):
                continue
            start = time.process_time()
            record: dict[str, Any] = {"case": [name, half, effect]}
            try:
                found = diagnose_optics(usable_presses(given, same_light=False), table)
            except PressError as error:
                yield {**record, "error": str(error)}
                continue
            yield {
                **record,
                "found": [one.name for one in found.effects],
                "gains": [[one.heldout_gain, one.heldout_gain_stderr] for one in found.effects],
                "verdict": found.verdict,
                "unexplained": [one.covariate for one in found.unexplained],
                "errors": [
                    found.before.rmse,
                    found.after.rmse,
                    found.before.refined,
                    found.after.refined,
                ],
                "steps": [
                    [
                        (one.candidate.effect, one.candidate.label, one.gain, one.p_value)
                        for one in step.tried[:3]
                    ]
                    for step in found.selection.steps
                ],
                "cpu_s": time.process_time() - start,
            }


def _is_unchanged(given: PressImages, clean: PressImages) -> bool:
    """Whether an effect has nothing to act on: a set with hardly a pixel above 200."""
    pixels = (given.images != clean.images).any(axis=3).mean()
    labels = np.array_equal(given.center_px, clean.center_px)
    return bool(
        pixels < LEAST_SHARE and labels and np.array_equal(given.radius_px, clean.radius_px)
    )


def finished(kept: Path) -> list[dict[str, Any]]:
    """The records that are kept."""
    file = kept / "altered.jsonl"
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def page(records: list[dict[str, Any]]) -> str:
    """The counts as Markdown: a row a set, then what went otherwise."""
    by_set: dict[str, dict[tuple[int, str], dict[str, Any]]] = defaultdict(dict)
    for record in records:
        name, half, effect = record["case"]
        by_set[name][half, effect] = record
    lines = [
        f"| set | {' | '.join(NAMES)} | right | error after ÷ clean | labels apart |",
        "|---|" + "---|" * (len(NAMES) + 3),
    ]
    others = []
    for name, cases in by_set.items():
        row, ratios, all_right = [], [], []
        for effect in NAMES:
            mine = [record for (_, e), record in cases.items() if e == effect]
            right = [_is_right(record) for record in mine]
            row.append(f"{sum(right)}/{len(right)}")
            all_right += right if effect != "clean" else []
            others += [
                f"{name}, {effect}: {_found(r)}"
                for r, ok in zip(mine, right, strict=True)
                if not ok
            ]
        for (half, effect), record in cases.items():
            if effect != "clean" and (half, "clean") in cases and "errors" in record:
                clean = cases[half, "clean"]["errors"]
                ratios.append((record["errors"][1] / clean[1], record["errors"][3] / clean[3]))
        label = f"{name} (tuned on)" if name in TUNED_ON else name
        stated, refined = np.median(ratios, axis=0), np.max(ratios, axis=0)
        lines.append(
            f"| {label} | {' | '.join(row)} | {sum(all_right)}/{len(all_right)} | "
            f"{stated[0]:.2f}, at most {refined[0]:.2f} | {stated[1]:.2f}, at most "
            f"{refined[1]:.2f} |"
        )
    weak = sum(gain <= error for r in records for gain, error in r.get("gains", []))
    spent = [record["cpu_s"] for record in records if "cpu_s" in record]
    lines += ["", f"Named although worth less than its own standard error: {weak}."]
    lines += [f"Processor time: median {np.median(spent):.0f} s, at most {max(spent):.0f} s."]
    return "\n".join([*lines, "", *(f"* {other}" for other in others), ""])


def _is_right(record: dict[str, Any]) -> bool:
    effect = record["case"][2]
    if effect == "clean":
        return bool(record.get("verdict") == "sufficient")
    return bool(record.get("found", [])[:1] == [EFFECTS[effect]])


def _found(record: dict[str, Any]) -> str:
    if "error" in record:
        return str(record["error"])
    extra = [f"unexplained: {name}" for name in record["unexplained"]]
    return ", ".join([*record["found"], *extra]) or "nothing"


def main() -> None:
    """Run what is not kept yet, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="*", metavar="SET[=PATH]", default=list(SETS))
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    options.kept.mkdir(parents=True, exist_ok=True)
    for given in options.sets:
        name, _, path = given.partition("=")
        for record in run(Path(path) if path else options.data / SETS[name], name, options.kept):
            with (options.kept / "altered.jsonl").open("a") as sink:
                sink.write(json.dumps(record) + "\n")
    sys.stdout.write(page(finished(options.kept)))


if __name__ == "__main__":
    main()
