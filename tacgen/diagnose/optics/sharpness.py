"""Whether pictures are less sharp than those that a table was calibrated on."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import t as student

from tacgen.calibrate.lookup.table_fit import image_noise_grey
from tacgen.diagnose.rules import OpticsRules
from tacgen.optics.effects import OpticalEffect, Stage, optical_effects
from tacgen.optics.table import LookupTable
from tacgen.presses.experiments import per_experiment
from tacgen.presses.press_images import PressImages

ROUNDING = 1 / 12
"""Variance that rounding to whole grey levels adds, whatever the lens does."""

WIDEST_PX = 10.0
"""Width of a Gaussian; beyond it no contact is left to see."""


@dataclass(frozen=True, slots=True)
class LostNoise:
    """A Gaussian over whole pictures, by the noise that it takes away.

    Attributes
    ----------
    effect : OpticalEffect
        That of the stage ``FOCUS``.
    sigma_mm, sigma_stderr_mm : float
        Width of the Gaussian; at least, where rounding to whole grey levels hides what is left.
    gain, gain_stderr : float
        What it explains of the noise, grey levels, over the test presses.
    p_value : float
        Probability of as little noise as this in pictures that are as sharp as the table's.
    """

    effect: OpticalEffect
    sigma_mm: float
    sigma_stderr_mm: float
    gain: float
    gain_stderr: float
    p_value: float


def noise_share(sigma_px: float) -> float:
    """What a Gaussian leaves of the second differences of white noise, as a standard deviation.

    By Parseval's theorem, over the frequencies of a row and of a column.
    """
    omega = np.linspace(0.0, np.pi, 1001)
    passed = np.exp(-((sigma_px * omega) ** 2))
    second = (2 - 2 * np.cos(omega)) ** 2
    return float(np.sqrt((passed * second).mean() / second.mean() * passed.mean()))


def lost_noise(
    shown: PressImages, tests: PressImages, table: LookupTable | None, rules: OpticsRules
) -> LostNoise | None:
    """The Gaussian that explains the noise of the pictures shown, where it is clearly too little.

    Nothing without a table from before: one fitted to the same presses has their noise. Nor of one
    whose noise is about that of rounding.
    """
    if table is None or table.noise_grey**2 <= 2 * ROUNDING:
        return None
    share, tested = (
        per_experiment(np.array([image_noise_grey(image) for image in presses.images]), each)
        / table.noise_grey
        for presses, each in ((shown, shown.experiment), (tests, tests.experiment))
    )
    error = share.std(ddof=1) / np.sqrt(len(share)) + 1e-12
    p_value = float(student.sf((rules.sharp_noise_share - share.mean()) / error, len(share) - 1))
    if p_value > rules.false_alarm or tested.mean() > rules.sharp_noise_share:
        return None
    sigmas = [_sigma_px(float(one), table.noise_grey) for one in share]
    stderr = np.std(sigmas, ddof=1) / np.sqrt(len(sigmas)) * table.mm_per_px
    gains = (1 - tested) * table.noise_grey
    (effect,) = optical_effects(Stage.FOCUS, Stage.FOCUS)
    return LostNoise(
        effect=effect,
        sigma_mm=float(np.mean(sigmas)) * table.mm_per_px,
        sigma_stderr_mm=float(stderr),
        gain=float(gains.mean()),
        gain_stderr=float(gains.std(ddof=1) / np.sqrt(len(gains))),
        p_value=p_value,
    )


def _sigma_px(share: float, noise_grey: float) -> float:
    """The width that leaves this share of a camera's noise; at least, where rounding hides it."""
    left = max((share * noise_grey) ** 2 - ROUNDING, ROUNDING) / (noise_grey**2 - ROUNDING)
    target = max(math.sqrt(min(left, 1.0)), noise_share(WIDEST_PX))
    return float(brentq(lambda sigma: noise_share(sigma) - target, 0.0, WIDEST_PX))
