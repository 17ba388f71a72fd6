"""What a press log cannot identify, and which press would."""

from dataclasses import dataclass

import numpy as np

from tacgen.presses.press_log import PressLog

FEW_TRIALS = 10  # with fewer presses the t quantile makes intervals clearly wider
SMALL_SPREAD_MM = 1.0  # positions closer together than a contact is wide are one place
HOLD_S = 1.0  # a hold long enough to tell creep from the speed of loading


@dataclass(frozen=True, slots=True)
class Limit:
    """What a log cannot identify, and what to press next to identify it."""

    subject: str
    cannot_tell: str
    press_next: str

    def __str__(self) -> str:
        return f"{self.cannot_tell}; {self.press_next}"


def limits_of(log: PressLog) -> tuple[Limit, ...]:
    """What the schedule of this log leaves open, the most important first."""
    checks = {
        "geometry": (
            n_balls(log) > 1,
            "one ball only: whether k_n depends on the indenter's size or shape is unknown",
            "press a second ball of at least twice the radius",
        ),
        "shear": (
            log.has_shear,
            "no trial holds both shear force and marker motion: k_s is unknown",
            "push sideways while pressing and track the markers",
        ),
        "trials": (
            len(log.trials) >= FEW_TRIALS,
            f"{len(log.trials)} presses only: the interval rests on few repeats and is wide",
            f"press at least {FEW_TRIALS} times, and repeat a press now and then",
        ),
        "unloading": (
            any(_is_unloaded(log, trial) for trial in log.trials),
            "no press is unloaded: hysteresis and stiffening look the same",
            "log the way back as well",
        ),
        "hold": (
            any(_is_held(log, trial) for trial in log.trials),
            f"no press is held for {HOLD_S:g} s near its peak: creep is unknown",
            "hold some presses for several seconds",
        ),
        "position": (
            _has_places(log),
            "positions on the gel are not known or all alike: whether k_n depends on them is "
            "unknown",
            "press on a grid over the gel and log x_mm and y_mm",
        ),
    }
    return tuple(Limit(name, *texts) for name, (known, *texts) in checks.items() if not known)


def n_balls(log: PressLog) -> int:
    """How many different indenters pressed, by size where it is known, else by name."""
    radii = log["radius_mm"] if "radius_mm" in log else np.array([])
    known = np.unique(np.round(radii[np.isfinite(radii)], 6)) if len(radii) else radii
    names = np.unique(log["indenter"]) if "indenter" in log else np.array([])
    return max(len(known), len(names), 1)


def _is_unloaded(log: PressLog, trial: int) -> bool:
    force = log["force_normal_n"][log["trial"] == trial]
    return len(force) > 2 and bool(force[np.argmax(force) :].min() < 0.5 * force.max())


def _is_held(log: PressLog, trial: int) -> bool:
    rows = log["trial"] == trial
    force, time_s = log["force_normal_n"][rows], log["time_s"][rows]
    held = force > 0.9 * force.max()
    return bool(held.any() and np.ptp(time_s[held]) >= HOLD_S)


def _has_places(log: PressLog) -> bool:
    known = [log[name] for name in ("x_mm", "y_mm") if name in log]
    spreads = [np.nanmax(mm) - np.nanmin(mm) for mm in known if np.isfinite(mm).any()]
    return bool(spreads and max(spreads) >= SMALL_SPREAD_MM)
