"""A batch against ``Sensor``: ``python -m validation.batch [FRAMES] [DEVICE]``.

FRAMES (default 1000) of all shipped objects, turned anyhow, on every shipped sensor, plain and with
shadows and markers; exit code 1 where one differs by more than 1 grey level, 0.05 on average, or
1e-6 mm.
"""

import sys
from collections.abc import Sequence

import numpy as np

import tacgen
from tacgen.core.records import Mesh
from tacgen.core.resources import object_folders, packaged
from tacgen.objects import load_object
from validation.batch.frames import Difference, compare, random_frames

PART = 32  # frames of one batch
MOST_GREY, MOST_MEAN_GREY, MOST_DELTA_MM = 1, 0.05, 1e-6


def shipped_meshes() -> list[Mesh]:
    """The surfaces of all shipped objects."""
    return [load_object(name).surface for name in object_folders()]


def shipped_sensors() -> list[str]:
    """The names of all shipped sensors."""
    return sorted(path.stem for path in (packaged("recipes") / "sensors").glob("*.yaml"))


def compare_all(n_frames: int, device: str, meshes: Sequence[Mesh]) -> bool:
    """Compare and print a line for each sensor; whether all are the same."""
    rng, is_same = np.random.default_rng(0), True
    has_dots = {
        name: tacgen.Sensor(name).description.markers is not None for name in shipped_sensors()
    }
    cases = [(name, on) for name in shipped_sensors() for on in (False, True)]
    for name, shadows in cases:
        found = []
        for _ in range(-(-n_frames // (len(cases) * PART))):
            frames = random_frames(rng, meshes, PART)
            options = {"shadows": shadows, "markers": shadows and has_dots[name]}
            found.append(compare(name, meshes, frames, device=device, **options))
        worst = Difference(
            max(one.most_grey for one in found),
            max(one.mean_grey for one in found),
            max(one.most_delta_mm for one in found),
            [line for one in found for line in one.other],
        )
        is_same &= (
            worst.most_grey <= MOST_GREY
            and worst.mean_grey <= MOST_MEAN_GREY
            and worst.most_delta_mm <= MOST_DELTA_MM
            and not worst.other
        )
        what = "shadows, markers" if shadows else "plain"
        print(  # noqa: T201
            f"{name:<18} {what:<16} {PART * len(found):5} frames on {device}: at most "
            f"{worst.most_grey} grey, {worst.mean_grey:.1e} on average, "
            f"{worst.most_delta_mm:.1e} mm {worst.other or ''}"
        )
    return is_same


if __name__ == "__main__":
    arguments = sys.argv[1:] + ["1000", "cpu"][len(sys.argv) - 1 :]
    sys.exit(not compare_all(int(arguments[0]), arguments[1], shipped_meshes()))
