"""Error rates of ``tacgen diagnose optics`` on images with effects by independent formulas.

    python -m validation.optics.trust_optics --kept FOLDER --out out/trust_optics.md

Results are kept in FOLDER, one line a case, so that a run goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from tacgen.calibrate.lookup.table_fit import fit_lookup
from tacgen.diagnose.optics.diagnose import diagnose_optics
from tacgen.optics.table import LookupTable
from tacgen.presses.press_images import PressImages
from validation.optics.optics_images import SENSORS, STRENGTHS, make

COUNT = 28
EFFECTS = tuple(STRENGTHS)
OUTSIDE = {"scratch": "place_on_gel", "ageing": "image_number"}


def cases() -> Iterator[tuple[str, str, float, int]]:
    """(kind, effect, strength, seed): each effect once, then nothing, then other strengths."""
    for kind in SENSORS:
        yield from ((kind, effect, 1.0, 0) for effect in (*EFFECTS, *OUTSIDE))
    for seed in range(6):
        yield from ((kind, "none", 0.0, seed) for kind in SENSORS)
    for strength, seed in ((2.0, 0), (0.5, 0), (1.0, 1)):
        for kind in SENSORS:
            yield from ((kind, effect, strength, seed) for effect in EFFECTS)


def presses_of(kind: str, effect: str, strength: float, seed: int) -> PressImages:
    """Presses on a sensor with an effect."""
    made = make(kind, effect, strength, seed, COUNT)
    return PressImages(
        images=made.images,
        background=made.background,
        names=tuple(str(k) for k in range(COUNT)),
        center_px=made.center_px,
        radius_px=made.radius_px,
        ball_radius_mm=np.full(COUNT, made.ball_mm),
        mm_per_px=made.mm_per_px,
    )


@lru_cache
def table_of_before(kind: str) -> LookupTable:
    """A table of the same sensor from other presses, without any effect."""
    return fit_lookup(presses_of(kind, "", 1.0, 99))


def run(kind: str, effect: str, strength: float, seed: int) -> dict[str, Any]:
    """One case, as a record."""
    presses = presses_of(kind, "" if effect == "none" else effect, strength, seed + 100)
    table = table_of_before(kind)
    start = time.process_time()
    found = diagnose_optics(presses, table)
    return {
        "case": [kind, effect, strength, seed],
        "found": [one.name for one in found.effects],
        "verdict": found.verdict,
        "unexplained": [one.covariate for one in found.unexplained],
        "before": found.rmse_before,
        "after": found.rmse_after,
        "cpu_s": time.process_time() - start,
    }


def kept_in(file: Path) -> dict[str, dict[str, Any]]:
    """The cases that are done."""
    lines = file.read_text().splitlines() if file.exists() else []
    return {json.dumps(json.loads(line)["case"]): json.loads(line) for line in lines}


def collect(kept: Path, *, backwards: bool = False) -> list[dict[str, Any]]:
    """Every case, run where it is not kept already; two runs may meet from both ends."""
    kept.mkdir(parents=True, exist_ok=True)
    file = kept / "optics.jsonl"
    for case in [*cases()][:: -1 if backwards else 1]:
        if json.dumps(list(case)) not in kept_in(file):
            record = run(*case)
            with file.open("a") as sink:
                sink.write(json.dumps(record) + "\n")
    return finished(file)


def finished(file: Path) -> list[dict[str, Any]]:
    """The records that are there, in the order of the cases."""
    known = kept_in(file)
    keys = [json.dumps(list(case)) for case in cases()]
    return [known[key] for key in keys if key in known]


def page(records: list[dict[str, Any]]) -> str:
    """The counts as Markdown."""
    lines = ["# Error rates of the optical diagnosis", ""]
    lines += [
        f"Made by `python -m validation.optics.trust_optics`: {COUNT} presses a case, two sensors "
        "(three lamps, four lamps; other noise, ball, gel and resolution), images by "
        "`validation/optics/optics_images.py`, which shares no code or formula with the diagnosis. "
        "Nominal strengths: "
        + ", ".join(f"{name} {STRENGTHS[name]}" for name in EFFECTS)
        + " (units in that file). Every fourth press is a test press.",
        "",
        "| simulated | strength | named first | exactly it named | other results | test error |",
        "|---|---|---|---|---|---|",
    ]
    groups = defaultdict(list)
    for record in records:
        groups[record["case"][1], record["case"][2]].append(record)
    for (effect, strength), group in sorted(groups.items()):
        if effect not in EFFECTS:
            continue
        first = sum(r["found"][:1] == [effect] for r in group)
        only = sum(r["found"] == [effect] and not r["unexplained"] for r in group)
        errors = [np.mean([r[key] for r in group]) for key in ("before", "after")]
        lines.append(
            f"| `{effect}` | {strength:g} | {first}/{len(group)} | {only}/{len(group)} | "
            f"{_others(group, [effect])} | {errors[0]:.2f} → {errors[1]:.2f} |"
        )
    clean = groups["none", 0.0]
    sufficient = sum(r["verdict"] == "sufficient" for r in clean)
    lines += ["", f"No effect: `sufficient` in {sufficient} of {len(clean)}."]
    lines += [f"Other results: {_others(clean, [])}." if sufficient < len(clean) else "", ""]
    for effect, covariate in OUTSIDE.items():
        group = groups[effect, 1.0]
        right = sum(covariate in r["unexplained"] for r in group)
        named = sum(bool(r["found"]) for r in group)
        lines.append(
            f"`{effect}`, not listed: `unexplained` by `{covariate}` in {right} of {len(group)}; "
            f"an effect falsely named in {named} ({_others(group, [])})."
        )
    spent = [record["cpu_s"] for record in records]
    lines += ["", f"Processor time: median {np.median(spent):.1f} s, at most {max(spent):.1f} s."]
    return "\n".join(lines) + "\n"


def _others(group: list[dict[str, Any]], right: list[str]) -> str:
    results = []
    for record in group:
        if record["found"] != right:
            extra = [f"unexplained: {name}" for name in record["unexplained"]]
            results.append(" + ".join([*record["found"], *extra]) or "nothing")
    return "; ".join(sorted(results)) or "–"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--kept", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--backwards", action="store_true")
    parser.add_argument(
        "--only-page", action="store_true", help="write the page from the kept records, run nothing"
    )
    given = parser.parse_args()
    if given.only_page:
        given.out.write_text(page(finished(given.kept / "optics.jsonl")))
        sys.exit()
    given.out.write_text(page(collect(given.kept, backwards=given.backwards)))
