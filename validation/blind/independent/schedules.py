"""What a rig does in one press: the shares of the peak forces over time.

Every schedule takes the peak force (N) and the loading speed (N/s), which set how long it takes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from validation.blind.independent.draws import Floats, log_uniform, smooth_course, uniform


class Profile:
    """Straight lines between knots.

    ``normal`` is a share of the peak normal force; ``along`` and ``across`` are shares of the
    largest shear force, in its main direction and at right angles to it.
    """

    def __init__(self) -> None:
        self.time_s: list[float] = [0.0]
        self.normal: list[float] = [0.0]
        self.along: list[float] = [0.0]
        self.across: list[float] = [0.0]

    @property
    def duration_s(self) -> float:
        """Time of the last knot."""
        return self.time_s[-1]

    def to(
        self,
        duration_s: float,
        normal: float | None = None,
        along: float | None = None,
        across: float | None = None,
    ) -> Profile:
        """Go to these shares within a time; those not given stay as they are."""
        self.time_s.append(self.time_s[-1] + max(duration_s, 1e-3))
        self.normal.append(self.normal[-1] if normal is None else normal)
        self.along.append(self.along[-1] if along is None else along)
        self.across.append(self.across[-1] if across is None else across)
        return self

    def follow(self, time_s: Floats, normal: Floats, along: Floats, across: Floats) -> Profile:
        """Follow a course, its time counted from the last knot."""
        self.time_s += (self.time_s[-1] + time_s).tolist()
        self.normal += normal.tolist()
        self.along += along.tolist()
        self.across += across.tolist()
        return self


Schedule = Callable[[np.random.Generator, float, float], Profile]


def _tilted(profile: Profile, rng: np.random.Generator) -> Profile:
    """The press with a shear force that goes with it, as of a tilted rig, and wobbles slowly."""
    time_s = np.linspace(0, profile.duration_s, 160)
    normal = np.interp(time_s, profile.time_s, profile.normal)
    wobble = uniform(rng, 0.0, 0.35)
    phase = time_s / profile.duration_s * uniform(rng, 0.5, 2) + rng.random()
    along = normal * (1 + wobble * np.sin(2 * np.pi * phase))
    phase = time_s / profile.duration_s * uniform(rng, 0.5, 2) + rng.random()
    across = normal * wobble * np.sin(2 * np.pi * phase)
    knots_s = np.union1d(profile.time_s, time_s)
    tilted = Profile()
    tilted.time_s = knots_s.tolist()
    tilted.normal = np.interp(knots_s, profile.time_s, profile.normal).tolist()
    tilted.along = np.interp(knots_s, time_s, along).tolist()
    tilted.across = np.interp(knots_s, time_s, across).tolist()
    return tilted


def ramp_hold_release(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """Up, hold, down at another speed."""
    profile = Profile().to(peak_n / speed, 1).to(log_uniform(rng, 0.3, 8))
    profile.to(peak_n / (speed * log_uniform(rng, 0.5, 2)), 0).to(uniform(rng, 0.1, 0.6))
    return _tilted(profile, rng)


def cyclic_partial(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """Several loads that are let go only in part; their peaks grow or vary."""
    profile, low = Profile(), 0.0
    n_cycles, grows = int(rng.integers(3, 7)), rng.random() < 0.4
    for index in range(n_cycles):
        if grows:
            top = (index + 1) / n_cycles
        else:
            top = 1.0 if index == 0 else uniform(rng, 0.6, 1)
        profile.to(abs(top - low) * peak_n / speed, top)
        low = 0.0 if index == n_cycles - 1 else top * uniform(rng, 0.1, 0.7)
        profile.to(uniform(rng, 0, 0.3)).to((top - low) * peak_n / speed, low)
    return _tilted(profile, rng)


def staircase(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """Steps up and down, a hold on each."""
    n_steps, profile, hold_s = int(rng.integers(3, 6)), Profile(), log_uniform(rng, 0.5, 4)
    rise_s = peak_n / n_steps / speed / 2
    levels = list(np.arange(1, n_steps + 1) / n_steps)
    for level in levels + levels[-2::-1]:
        profile.to(rise_s, float(level)).to(hold_s * uniform(rng, 0.8, 1.2))
    return _tilted(profile.to(rise_s, 0).to(0.3), rng)


def dwell_recover(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """Quickly up, a long hold, quickly off, and a wait."""
    profile = Profile().to(uniform(rng, 0.3, 1.2), 1).to(log_uniform(rng, 6, 60))
    return _tilted(profile.to(uniform(rng, 0.3, 1), 0).to(log_uniform(rng, 1, 15)), rng)


def press_drag(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """Press, drag to and fro, let go."""
    profile = Profile().to(peak_n / speed, 1, 0).to(uniform(rng, 0.2, 0.8))
    drag_s, hold_s = log_uniform(rng, 0.8, 4), log_uniform(rng, 0.3, 6)
    profile.to(drag_s, along=1).to(hold_s)
    for _ in range(int(rng.integers(0, 3))):
        profile.to(drag_s * 1.7, along=-uniform(rng, 0.5, 1)).to(hold_s * uniform(rng, 0.2, 1))
        profile.to(drag_s * 1.7, along=uniform(rng, 0.4, 1)).to(hold_s * uniform(rng, 0.1, 1))
    return profile.to(drag_s * 0.8, along=0).to(uniform(rng, 0.2, 2)).to(peak_n / speed, 0).to(0.2)


def circle_drag(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """Press and drag in a circle that opens, turns and closes."""
    profile = Profile().to(peak_n / speed, 1).to(0.3)
    length_s, n_knots = log_uniform(rng, 3, 12), 120
    time_s = np.linspace(length_s / n_knots, length_s, n_knots)
    part = time_s / length_s
    opened = np.minimum(1, part * uniform(rng, 1.2, 4)) * np.clip((1 - part) / 0.12, 0, 1)
    angle = 2 * np.pi * uniform(rng, 1, 2.5) * part * (1 if rng.random() < 0.5 else -1)
    profile.follow(time_s, np.ones(n_knots), opened * np.cos(angle), opened * np.sin(angle))
    return profile.to(uniform(rng, 0.2, 1), along=0, across=0).to(peak_n / speed, 0).to(0.2)


def oblique(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """Presses along one slanting line."""
    profile, n_presses = Profile(), int(rng.integers(1, 4))
    for index in range(n_presses):
        top = 1.0 if index == n_presses - 1 else uniform(rng, 0.5, 1)
        profile.to(top * peak_n / speed, top, top).to(log_uniform(rng, 0.2, 4))
        profile.to(top * peak_n / speed, 0, 0).to(0.2)
    return profile


def human(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """A hand: all forces wander smoothly."""
    length_s, n_knots = log_uniform(rng, 3, 15), 240
    time_s = np.linspace(length_s / n_knots, length_s, n_knots)
    part, width = time_s / length_s, int(rng.integers(8, 30))
    envelope = np.clip(part / 0.15, 0, 1) * np.clip((1 - part) / 0.12, 0, 1)
    normal = envelope * np.exp(0.6 * smooth_course(rng, n_knots, width))
    along = envelope * smooth_course(rng, n_knots, width)
    across = envelope * smooth_course(rng, n_knots, width) * uniform(rng, 0.2, 1)
    largest = np.hypot(along, across).max()
    return Profile().follow(time_s, normal / normal.max(), along / largest, across / largest)


def tap(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """A few short knocks."""
    profile, n_taps, width_s = Profile(), int(rng.integers(2, 6)), uniform(rng, 0.15, 0.6)
    time_s = np.linspace(width_s / 24, width_s, 24)
    for index in range(n_taps):
        profile.to(uniform(rng, 0.05, 0.4), 0, 0)
        top = 1.0 if index == 0 else uniform(rng, 0.5, 1)
        knock = top * np.sin(np.pi * time_s / width_s) ** 2
        knock[-1] = 0
        profile.follow(time_s, knock, knock, 0 * knock)
    return profile.to(0.15)


def depth_relax(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """Held at a depth: the force relaxes to a part of its peak."""
    profile, length_s = Profile().to(peak_n / speed / 2, 1), log_uniform(rng, 4, 30)
    time_s = np.linspace(length_s / 80, length_s, 80)
    rest = uniform(rng, 0.6, 0.9)
    normal = rest + (1 - rest) * np.exp(-time_s / (length_s * uniform(rng, 0.05, 0.4)))
    profile.follow(time_s, normal, 0 * time_s, 0 * time_s)
    return _tilted(profile.to(peak_n / speed / 2, 0).to(0.3), rng)


def sine_sweep(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """An oscillation about a mean that grows faster."""
    length_s, n_knots = log_uniform(rng, 4, 12), 300
    time_s = np.linspace(length_s / n_knots, length_s, n_knots)
    first_hz = uniform(rng, 0.2, 0.6)
    last_hz, depth = first_hz * uniform(rng, 1, 4), uniform(rng, 0.2, 0.45)
    phase = 2 * np.pi * (first_hz * time_s + (last_hz - first_hz) * time_s**2 / 2 / length_s)
    profile = Profile().to(peak_n * (1 - 2 * depth) / speed, 1 - 2 * depth)
    profile.follow(time_s, 1 - depth - depth * np.cos(phase), 0 * time_s, 0 * time_s)
    return _tilted(profile.to(peak_n / speed / 2, 0).to(0.2), rng)


def grip_pull(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """A gripper closes or opens in steps; at each the object is pulled to and fro."""
    profile, levels = Profile(), np.sort(rng.uniform(0.25, 1, int(rng.integers(2, 5))))
    levels[-1] = 1
    if rng.random() < 0.5:
        levels = levels[::-1]
    pull_s = log_uniform(rng, 0.4, 2)
    for level in levels:
        size = float(uniform(rng, 0.6, 1) * levels.min() ** rng.choice([0, 0.5]))
        profile.to(abs(level - profile.normal[-1]) * peak_n / speed, float(level), 0).to(0.2)
        profile.to(pull_s, along=size).to(uniform(rng, 0.1, 2))
        profile.to(2 * pull_s, along=-size * uniform(rng, 0.3, 1)).to(pull_s, along=0)
    return profile.to(peak_n * profile.normal[-1] / speed, 0).to(0.2)


def approach_stop(rng: np.random.Generator, peak_n: float, speed: float) -> Profile:
    """A slow approach; the recording stops at the end of the hold."""
    return _tilted(Profile().to(peak_n / speed, 1).to(log_uniform(rng, 0.3, 5)), rng)


SCHEDULES: dict[str, Schedule] = {
    schedule.__name__: schedule
    for schedule in (
        ramp_hold_release,
        cyclic_partial,
        staircase,
        dwell_recover,
        press_drag,
        circle_drag,
        oblique,
        human,
        tap,
        depth_relax,
        sine_sweep,
        grip_pull,
        approach_stop,
    )
}
SHEARING = ("circle_drag", "grip_pull", "human", "oblique", "press_drag")
"""Schedules with a shear force of their own."""
