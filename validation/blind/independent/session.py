"""One session on a rig: what was pressed, when, and all that is known of it."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from validation.blind.independent.covariates import Covariates, draw_covariates
from validation.blind.independent.draws import Floats, rms, uniform
from validation.blind.independent.loads import FINE_STEPS, Load, draw_habits, draw_loads
from validation.blind.independent.rigs import RIGS, draw_n_trials, draw_peaks, draw_plan


@dataclass(frozen=True)
class Clock:
    """Fine steps of K trials, all padded to the length N of the longest with their last value."""

    time_s: Floats
    """(K, N) from the start of the trial."""
    start_s: Floats
    """(K,) from the start of the session."""
    end_s: float
    sampled: NDArray[np.bool_]
    """(K, N) where the camera took a frame."""

    @property
    def duration_s(self) -> Floats:
        """Length of each trial, (K,)."""
        return self.time_s[:, -1]

    @property
    def session_s(self) -> Floats:
        """Time from the start of the session, (K, N)."""
        return self.start_s[:, None] + self.time_s

    @property
    def progress(self) -> Floats:
        """Part of the session that has passed, (K, N)."""
        return self.session_s / self.end_s

    @property
    def trial(self) -> NDArray[np.intp]:
        """Number of the trial of each frame, from 0."""
        return np.repeat(np.arange(len(self.time_s)), self.sampled.sum(1))


@dataclass(frozen=True)
class Session:
    """True forces, compliances and covariates of a session; noise as shares of the RMS signal."""

    clock: Clock
    force_n: Floats
    """(K, N) normal force."""
    shear_n: Floats
    """(K, N, 2) shear force."""
    covariates: Covariates
    peak_n: float
    friction: float
    k_n_mm3_per_n: float
    k_s_mm_per_n: float
    noise_share: float
    shear_noise_share: float
    gauge_share: float
    """Noise of the gauge over that of the response."""
    has_shear: bool
    schedules: tuple[str, ...]

    @property
    def shear_size_n(self) -> Floats:
        """Size of the shear force, (K, N)."""
        return np.hypot(self.shear_n[..., 0], self.shear_n[..., 1])

    @property
    def noise_mm3(self) -> float:
        """Standard deviation of the volume's noise."""
        return self.noise_share * self.k_n_mm3_per_n * rms(self.force_n[self.clock.sampled])

    @property
    def noise_mm(self) -> float:
        """Standard deviation of the noise of the markers' motion."""
        return self.shear_noise_share * self.k_s_mm_per_n * rms(self.shear_n[self.clock.sampled])

    @property
    def gauge_noise_n(self) -> float:
        """Standard deviation of the normal force's noise."""
        return self.gauge_share * self.noise_share * rms(self.force_n[self.clock.sampled])

    @property
    def gauge_noise_shear_n(self) -> float:
        """Standard deviation of the shear force's noise."""
        return self.gauge_share * self.shear_noise_share * rms(self.shear_n[self.clock.sampled])


def draw_session(
    rng: np.random.Generator,
    normal: Set[str],
    shear: Set[str],
    k_n_mm3_per_n: float,
    k_s_mm_per_n: float,
) -> Session:
    """A session in which the effects named can be seen."""
    rig = RIGS[str(rng.choice(list(RIGS)))]
    plan = draw_plan(rng, rig, normal, shear)
    n_trials = draw_n_trials(rng, normal | shear)
    highest_n, peaks_n = draw_peaks(rng, n_trials, "saturation" in normal)
    noise_share, shear_noise_share = uniform(rng, 0.005, 0.03), uniform(rng, 0.005, 0.03)
    gauge_share = uniform(rng, 0, 0.4) if rng.random() < 0.8 else 0.0
    # Above the gauge's noise, so that no measured force falls to nothing.
    least_force_n = 0.05 + 4.5 * gauge_share * noise_share * 0.6 * highest_n
    habits = draw_habits(rng, rig, normal, shear, least_force_n)
    loads, schedules = draw_loads(rng, plan, peaks_n, habits)
    clock = _draw_clock(rng, loads)
    return Session(
        clock=clock,
        force_n=_padded([load.force_n for load in loads]),
        shear_n=_padded([load.shear_n for load in loads]),
        covariates=draw_covariates(rng, clock.progress, clock.sampled, "geometry" in normal),
        peak_n=float(peaks_n.max()),
        friction=habits.friction,
        k_n_mm3_per_n=k_n_mm3_per_n,
        k_s_mm_per_n=k_s_mm_per_n,
        noise_share=noise_share,
        shear_noise_share=shear_noise_share,
        gauge_share=gauge_share,
        has_shear=plan.has_shear,
        schedules=schedules,
    )


def _padded(courses: list[Floats]) -> Floats:
    """Courses as rows of one array, the shorter ones holding their last value."""
    longest = max(map(len, courses))
    return np.stack(
        [np.concatenate([one, np.repeat(one[-1:], longest - len(one), 0)]) for one in courses]
    )


def _draw_clock(rng: np.random.Generator, loads: list[Load]) -> Clock:
    """When each trial starts: short pauses, or longer ones."""
    time_s = _padded([load.time_s for load in loads])
    sampled = np.zeros(time_s.shape, dtype=bool)
    start_s, now_s = np.zeros(len(loads)), uniform(rng, 0, 20)
    pause_s = (2, 10) if rng.random() < 0.5 else (5, 60)
    for index, load in enumerate(loads):
        sampled[index, : len(load.time_s) : FINE_STEPS] = True
        start_s[index] = now_s
        now_s += float(load.time_s[-1]) + uniform(rng, *pause_s)
    return Clock(time_s, start_s, now_s, sampled)
