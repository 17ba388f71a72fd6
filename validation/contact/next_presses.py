"""Half as many presses, chosen by what separates the explanations, against presses at random.

Each closed loop is a session on the virtual rig whose gel has one effect of a strength near what
can be seen. The same gel is diagnosed three times: after 2 n presses at random, after n at random,
and after n/2 at random with n/2 more that the diagnosis of those proposed. Right is a diagnosis
that names the effect, in its channel, and nothing else.

python -m validation.contact.next_presses --loops 112
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

from tacgen.core.errors import RecipeError
from tacgen.diagnose.contact.command import diagnose
from tacgen.diagnose.contact.next_presses import propose_presses
from tacgen.rig import RigRecipe, load_rig_recipe, simulate_session
from tacgen.rig.schedule import draw_press, press_course

RANGES = {
    "force_n": (1.0, 15.0),
    "shear_ratio": (0.0, 0.5),
    "load_s": (0.3, 4.0),
    "hold_s": (0.3, 10.0),
    "unload_s": (0.3, 4.0),
}
"""What the rig can do, for presses at random and for candidates alike."""
EFFECTS = {
    "normal": ("creep", "hysteresis", "stiffening", "saturation", "latency", "position",
               "geometry", "shear_coupling", "temperature", "drift", "conditioning"),
    "shear": ("creep", "hysteresis", "slip", "anisotropy", "normal_coupling"),
}  # fmt: skip
CANDIDATES = 200


def main() -> int:
    """Print the rates of right names, and those by effect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loops", type=int, default=112)
    parser.add_argument("--presses", type=int, default=20, help="n: half of the presses at random")
    parser.add_argument("--strength", type=float, nargs=2, default=(0.1, 0.4))
    parser.add_argument("--seed", type=int, default=7000)
    arguments = parser.parse_args()
    kinds = [(channel, name) for channel, names in EFFECTS.items() for name in names]
    rows = []
    for loop in range(arguments.loops):
        seed = arguments.seed + loop
        strength = np.random.default_rng(seed).uniform(*arguments.strength)
        found = closed_loop(*kinds[loop % len(kinds)], strength, arguments.presses, seed)
        if found is not None:
            rows.append({"effect": "/".join(kinds[loop % len(kinds)]), **found})
            sys.stderr.write(f"{rows[-1]}\n")
    table = pd.DataFrame(rows)
    sys.stdout.write(table.groupby("effect").mean().round(2).to_string() + "\n\n")
    ways = table.drop(columns="effect")
    error = 100 * ways.std() / np.sqrt(len(ways))
    for way in ways:
        sys.stdout.write(f"{way}: {100 * ways[way].mean():.0f} ± {error[way]:.0f} % right\n")
    sys.stdout.write(f"{len(table)} closed loops\n")
    return 0


def closed_loop(
    channel: str, name: str, strength: float, presses: int, seed: int
) -> dict[str, float] | None:
    """Whether each way names the effect; None if the schedule cannot show one so strong."""
    try:
        whole = simulate_session(_recipe(seed, 2 * presses, channel, name, {}, strength))
    except RecipeError:
        return None
    law = whole.truth.law.effects[0]
    values = {key: one.value for key, one in law.parameters.items() if np.isfinite(one.value)}
    few = _recipe(seed, presses, channel, name, values)
    start = _recipe(seed, presses // 2, channel, name, values)
    log = {key: column.to_numpy() for key, column in simulate_session(start).log.items()}
    diagnosis = diagnose(log)
    pool = _recipe(seed + 500_000, CANDIDATES, channel, name, values)
    drawn = [draw_press(pool, number) for number in range(CANDIDATES)]
    proposed = propose_presses(
        diagnosis,
        [press_course(pool, press, number, 0.0) for number, press in enumerate(drawn)],
        presses - presses // 2,
    )
    with TemporaryDirectory() as folder:
        path = Path(folder) / "next_presses.csv"
        pd.DataFrame([asdict(drawn[one.index]) for one in proposed]).to_csv(path, index=False)
        schedule = start.schedule.model_copy(update={"follow": str(path)})
        chosen = simulate_session(start.model_copy(update={"schedule": schedule})).log
    logs = {
        f"{2 * presses} at random": whole.log,
        f"{presses} at random": simulate_session(few).log,
        f"{presses // 2} at random, {len(proposed)} chosen": chosen,
    }
    return {way: float(_is_right(one, channel, name)) for way, one in logs.items()}


def _recipe(
    seed: int,
    presses: int,
    channel: str,
    name: str,
    parameters: dict[str, float],
    strength: float | None = None,
) -> RigRecipe:
    given = load_rig_recipe("rig").model_dump()
    given["schedule"] |= {**RANGES, "presses": presses}
    effect = {"channel": channel, "name": name, "parameters": parameters, "strength": strength}
    return RigRecipe.model_validate({**given, "seed": seed, "effects": [effect]})


def _is_right(log: pd.DataFrame, channel: str, name: str) -> bool:
    diagnosis = diagnose({key: column.to_numpy() for key, column in log.items()})
    named = {key: found.effect_names for key, found in diagnosis.channels.items()}
    return all(named[key] == ((name,) if key == channel else ()) for key in named)


if __name__ == "__main__":
    sys.exit(main())
