"""What measurement answers on small inputs, as hashes: a change of form alone keeps every one.

    python -m validation.golden_measurement --out before.json
    python -m validation.golden_measurement --against before.json

Recorded before a rewrite and compared after it, on one machine: the choice of effects on blind
logs, the diagnosis.json of contact, markers, optics and grasps, and tables fitted to press images.
``--keep`` writes what was hashed, so that a difference can be looked at.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

Parts = dict[str, Callable[[], dict[str, str]]]
"""By name: what makes texts, by their names."""

LOGS: dict[str, dict[str, Any]] = {
    "clean": {},
    "creep": {"normal": [("creep", 1.5)]},
    "pair": {"normal": [("stiffening", 1.0), ("position", 1.0)]},
    "slip": {"shear": [("slip", 1.5)]},
}
RIG = {"rate_hz": 3.0, "friction": 0.7, "grid_shift_mm": (0.1, -0.05)}
GRASPS_BOX = "sugar_box"
SHIFT_MM = 20.0


def _as_text(value: Any) -> str:
    """JSON with floats to ten digits: what rounding changes is no other answer."""

    def plain(one: Any) -> Any:
        if isinstance(one, dict):
            return {str(key): plain(own) for key, own in one.items()}
        if isinstance(one, np.ndarray):
            return plain(one.tolist())
        if isinstance(one, Iterable) and not isinstance(one, str):
            return [plain(own) for own in one]
        if isinstance(one, float | np.floating):
            return float(f"{one:.10g}")
        return one.item() if isinstance(one, np.generic) else one

    return json.dumps(plain(value), indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def attributions() -> dict[str, str]:
    """Members, losses, fitted values and rankings of searches on blind logs."""
    from tacgen.contact.effects import Channel
    from tacgen.diagnose.contact.channel import ChannelSamples
    from tacgen.diagnose.contact.search import ContactProblem, FittedSet
    from tacgen.presses.press_log import read_press_log
    from validation.blind.generator import draw_case

    def told(one: FittedSet) -> dict[str, Any]:
        model = one.fit.model
        return {
            "members": [member.label for member in one.members],
            "unit_losses": one.unit_losses,
            "compliance": model.compliance,
            "terms": {term.name: dict(term.values) for term in model.terms},
            "covariates": [term.coefficients for term in model.covariates],
        }

    texts = {}
    for number, (name, effects) in enumerate(LOGS.items()):
        for kind, n_trials in (("", 36), ("_few", 12)):
            case = draw_case(number + 40, **effects, n_trials=n_trials)
            with tempfile.TemporaryDirectory() as folder:
                case.frame.to_csv(Path(folder) / "log.csv", index=False)
                log = read_press_log(Path(folder) / "log.csv")
            channel: Channel = "shear" if "shear" in effects else "normal"
            columns = {k: v[np.isfinite(log.columns["volume_mm3"])] for k, v in log.columns.items()}
            data = ChannelSamples(columns, channel).thinned()
            found = ContactProblem(data, np.random.default_rng(1)).run()
            texts[f"attribution/{name}{kind}"] = _as_text(
                {
                    "base": told(found.base),
                    "accepted": told(found.accepted),
                    "final": told(found.final),
                    "ranking": found.ranking,
                    "chosen": [
                        {
                            one.name: getattr(chosen, one.name)
                            for one in fields(chosen)
                            if one.name != "candidate"
                        }
                        for chosen in found.chosen
                    ],
                }
            )
    return texts


def contact_and_markers() -> dict[str, str]:
    """``diagnosis.json`` and ``contact.yaml`` of a log of the virtual rig with marker tracks."""
    from tacgen.calibrate.contact.command import LogSource
    from tacgen.diagnose.contact.command import diagnose_log
    from tacgen.rig import load_rig_recipe, run_rig
    from tacgen.rig.rig_recipe import MarkerTracks

    given = load_rig_recipe("rig")
    schedule = given.schedule.model_copy(
        update={"presses": 16, "shear_ratio": (0.15, 0.5), "force_n": (3.0, 9.0)}
    )
    recipe = given.model_copy(
        update={"schedule": schedule, "markers": MarkerTracks.model_validate(RIG), "seed": 3}
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run_rig(recipe, folder)
        tracks, sensor = folder / "markers.csv", "virtual_gelsight"
        source = LogSource(folder / "press_log.csv", markers=tracks, sensor=sensor)
        diagnose_log(source, folder / "out")
        return {
            "diagnosis/contact": _record(folder / "out"),
            "diagnosis/law": _law(folder / "out" / "contact.yaml"),
        }


def optics() -> dict[str, str]:
    """``diagnosis.json`` of presses beside a table of before, and of presses alone."""
    from tacgen.diagnose.optics.diagnose import diagnose_optics

    table = _fitted("three", "", 3, 12)
    found = {
        "vignetting": diagnose_optics(_presses("three", "vignetting", 0, 12), table),
        "alone": diagnose_optics(_presses("four", "shadow", 0, 12)),
    }
    return {f"diagnosis/optics_{name}": _as_text(one.as_dict()) for name, one in found.items()}


def grasps() -> dict[str, str]:
    """``diagnosis.json`` of grasps of a box whose centre of mass is off."""
    import pandas as pd

    from tacgen.collection.perturbed import Perturbation, simulate_perturbed
    from tacgen.collection.recipe import Recipe
    from tacgen.core.records import GraspConfig
    from tacgen.dataset.real_grasps import read_real_grasps
    from tacgen.diagnose.grasps.command import diagnose_grasps
    from tests.small_world import SHORT_LIFT

    recipe = Recipe.model_validate(
        {
            "name": "declared",
            "objects": [GRASPS_BOX],
            "grid": {"sample": 6},
            "physics": SHORT_LIFT | {"time_step_s": 1 / 240, "hold_s": 0.1},
        }
    )
    rng = np.random.default_rng(3)
    configs = [
        GraspConfig(k, GRASPS_BOX, round(force, 2), 0.0, round(y, 1), 87.5)
        for k, (force, y) in enumerate(
            zip(rng.uniform(8, 38, 10), rng.uniform(-10, 35, 10), strict=True)
        )
    ]
    world = Perturbation(center_of_mass_y_mm=SHIFT_MM)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        found = simulate_perturbed(recipe, [(c, world) for c in configs], folder / "w", workers=1)
        rows = [
            (f"g{c.index}", GRASPS_BOX, c.force_n, 0, c.y_mm, c.z_mm, found[c.point, world])
            for c in configs
        ]
        columns = ["grasp_id", "object", "force_n", "x_mm", "y_mm", "z_mm", "label"]
        table = pd.DataFrame([(*row[:-1], row[-1].label) for row in rows], columns=columns)
        (folder / "real").mkdir()
        table.to_csv(folder / "real" / "grasps.csv", index=False)
        real = read_real_grasps(folder / "real")
        diagnose_grasps(recipe, real, folder / "out", workers=1)
        return {"diagnosis/grasps": _record(folder / "out")}


def tables() -> dict[str, str]:
    """Tables fitted to three sets of press images."""
    from tacgen.optics.table import save_table

    texts = {}
    for kind, effect in (("three", ""), ("four", ""), ("three", "illumination")):
        table = _fitted(kind, effect, 5, 12)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "table.npz"
            save_table(table, path)
            with np.load(path) as arrays:
                numbers = {
                    key: hashlib.sha256(arrays[key].tobytes()).hexdigest()
                    for key in sorted(arrays.files)
                    if arrays[key].dtype.kind in "fiub"
                }
        texts[f"table/{kind}_{effect or 'clean'}"] = _as_text(numbers)
    return texts


def _presses(kind: str, effect: str, seed: int, count: int) -> Any:
    from tacgen.presses.press_images import PressImages
    from validation.optics.optics_images import make

    made = make(kind, effect, 1.0, seed, count)
    return PressImages(
        images=made.images,
        background=made.background,
        names=tuple(f"{k}.png" for k in range(count)),
        center_px=made.center_px,
        radius_px=made.radius_px,
        ball_radius_mm=np.full(count, made.ball_mm),
        mm_per_px=made.mm_per_px,
    )


def _fitted(kind: str, effect: str, seed: int, count: int) -> Any:
    from tacgen.calibrate.lookup.table_fit import fit_lookup

    return fit_lookup(_presses(kind, effect, seed, count))


def _record(out: Path) -> str:
    record = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    record.pop("inputs", None)  # hashes of files, which name folders
    return _as_text(record)


def _law(path: Path) -> str:
    import yaml

    law = yaml.safe_load(path.read_text(encoding="utf-8"))
    for key in ("versions", "data_sha256"):
        law.get("provenance", {}).pop(key, None)
    return _as_text(law)


PARTS: Parts = {
    "attributions": attributions,
    "contact": contact_and_markers,
    "optics": optics,
    "grasps": grasps,
    "tables": tables,
}


def main() -> None:
    """Hash the parts that are asked for; exit 1 if any differs from what was recorded."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", choices=PARTS, default=list(PARTS))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--against", type=Path)
    parser.add_argument("--keep", type=Path, help="Folder for the texts that are hashed.")
    options = parser.parse_args()
    found: dict[str, str] = {}
    for part in options.only:
        for name, text in PARTS[part]().items():
            found[name] = hashlib.sha256(text.encode()).hexdigest()
            if options.keep:
                path = options.keep / f"{name.replace('/', '_')}.json"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
    if options.out:
        options.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if options.against:
        known = json.loads(options.against.read_text(encoding="utf-8"))
        other = [name for name, sha256 in found.items() if known.get(name) != sha256]
        print(f"{len(found) - len(other)} of {len(found)} the same", *other, sep=os.linesep)  # noqa: T201
        sys.exit(bool(other))


if __name__ == "__main__":
    main()
