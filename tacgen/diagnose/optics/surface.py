"""The slope of the gel around a ball, by three forms, with the effects on its surface."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tacgen.core.arrays import FloatArray
from tacgen.diagnose.optics.rules import RULES, SelectionRules
from tacgen.optics.deform import FINAL_SIGMA_MM, FIRM_CONTACT, PYRAMID_SIGMA_MM
from tacgen.optics.effects import optical_effect
from tacgen.optics.smooth import radial_gaussian
from tacgen.presses.geometry import MAX_RADIUS_SHARE, Membrane, radial_slope

FORMS = ("skirt", "pyramid", "elastic")
"""How the gel goes on outside the contact: an exponential tail of fitted length, the simulation's
own pyramid of Gaussians, or an elastic half-space (Hertz)."""

SurfaceEffects = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""Name and parameters of each effect on the surface."""


class Profiles:
    """Radial slopes for a set of balls over a range of contact radii, ready to be read off.

    Parameters
    ----------
    contact_mm : (N,) float
        Contact radii around which profiles are needed.
    dome_radius_mm : float
        Radius of curvature of the gel at rest; 0 for a flat one.
    """

    def __init__(
        self, contact_mm: FloatArray, dome_radius_mm: float, rules: SelectionRules = RULES
    ) -> None:
        self._contacts = np.geomspace(
            rules.smallest_contact * float(contact_mm.min()),
            rules.largest_contact * float(contact_mm.max()),
            rules.profile_contacts,
        )
        self._dome_radius_mm = dome_radius_mm
        self._rules = rules

    def slopes(
        self,
        form: str,
        membrane: Membrane,
        r_mm: FloatArray,
        contact_mm: FloatArray,
        ball_mm: FloatArray,
        effects: SurfaceEffects = (),
    ) -> NDArray[np.float64]:
        """Slope along the radius, positive outwards, and depth, mm, at ``r_mm`` from each ball.

        Both (2, n).
        """
        slope = np.zeros((2, len(r_mm)))
        contacts = tuple(self._contacts.tolist())
        for ball in np.unique(ball_mm):
            here = ball_mm == ball
            table = _profiles(
                form, membrane, effects, float(ball), contacts, self._dome_radius_mm, self._rules
            )
            for which in (0, 1):
                slope[which, here] = self._read(table[which], r_mm[here], contact_mm[here])
        return slope

    def _read(self, table: FloatArray, r_mm: FloatArray, contact_mm: FloatArray) -> FloatArray:
        """Linear in the logarithm of the contact's radius and in r over it."""
        within = 1e-3  # of a step: the last node itself has no next one to interpolate to
        ratio = np.log(self._contacts[1] / self._contacts[0])
        last = len(self._contacts) - 1 - within
        at = np.clip(np.log(contact_mm / self._contacts[0]) / ratio, 0, last)
        row = at.astype(int)
        up = at - row
        place = np.minimum(
            r_mm / contact_mm / self._rules.profile_step_radii, table.shape[1] - 1 - within
        )
        column = place.astype(int)
        right = place - column
        below = (1 - right) * table[row, column] + right * table[row, column + 1]
        above = (1 - right) * table[row + 1, column] + right * table[row + 1, column + 1]
        return np.asarray((1 - up) * below + up * above)


@lru_cache(maxsize=256)
def _profiles(
    form: str,
    membrane: Membrane,
    effects: SurfaceEffects,
    ball_mm: float,
    contacts_mm: tuple[float, ...],
    dome_radius_mm: float,
    rules: SelectionRules,
) -> NDArray[np.float64]:
    """Slopes and depths (2, n_contacts, n_radii) on the grid of shares of the contact's radius."""
    step = rules.profile_step_radii
    shares = np.arange(0.0, rules.profile_reach_radii + step / 2, step)
    rows = []
    for contact_mm in contacts_mm:
        contact = min(contact_mm, MAX_RADIUS_SHARE * ball_mm)
        r = shares * contact_mm
        slope: FloatArray
        if form == "pyramid":
            slope = _pyramid(r, contact, ball_mm, dome_radius_mm)
        elif form == "elastic":
            slope = _elastic(r, contact, ball_mm, dome_radius_mm)
        else:
            # The steps of a profile hold no slope that is steeper than the steepest contact's.
            slope = radial_slope(
                r, contact, ball_mm, membrane, dome_radius_mm, max_cap_share=MAX_RADIUS_SHARE
            )
        for name, values in effects:
            slope = optical_effect(name).on_profile(slope, step * contact_mm, **dict(values))
        rows.append(slope)
    slopes = np.array(rows)
    rise = np.cumsum(0.5 * (slopes[:, :0:-1] + slopes[:, -2::-1]), axis=1)[:, ::-1]
    depths = np.pad(rise, ((0, 0), (0, 1))) * step * np.array(contacts_mm)[:, None]
    return np.stack([slopes, depths])


def _elastic(
    r: FloatArray, contact: float, ball_mm: float, dome_radius_mm: float
) -> NDArray[np.float64]:
    """The ball's own slope inside the contact, an elastic half-space's outside.

    Source
    ------
    Hertz 1882; Johnson 1985, Contact Mechanics, §3.4.
    """
    bend_per_mm = 1 / dome_radius_mm if dome_radius_mm > 0 else 0.0
    inside = np.minimum(r, contact)
    cap = inside / np.sqrt(ball_mm**2 - inside**2) + bend_per_mm * inside
    rim = contact / np.sqrt(ball_mm**2 - contact**2) + bend_per_mm * contact
    a = np.minimum(contact / np.maximum(r, 1e-9), 1.0)
    outside = (2 / np.pi) * (np.arcsin(a) / a - np.sqrt(1 - a * a)) * rim
    return np.asarray(np.where(r < contact, cap, outside))


def _pyramid(
    r: FloatArray, contact: float, ball_mm: float, dome_radius_mm: float
) -> NDArray[np.float64]:
    """What ``tacgen.optics.deform`` makes of the ball's cap, along a radius.

    Source
    ------
    Si & Yuan 2022, Taxim, §III-C.
    """
    bend_per_mm = 1 / dome_radius_mm if dome_radius_mm > 0 else 0.0

    def sunk(s: FloatArray) -> FloatArray:
        return np.asarray(ball_mm - np.sqrt(ball_mm**2 - s**2) + 0.5 * bend_per_mm * s**2)

    depth = np.maximum(sunk(np.asarray(contact)) - sunk(np.minimum(r, contact)), 0.0)
    loose, firm = (share * depth.max() for share in FIRM_CONTACT)
    hold = np.clip((depth - loose) / (firm - loose), 0.0, 1.0)
    surface = depth
    for sigma_mm in PYRAMID_SIGMA_MM:
        surface = radial_gaussian(len(r), sigma_mm / r[1], order=0) @ surface
        surface = surface + hold * (depth - surface)
    surface = radial_gaussian(len(r), FINAL_SIGMA_MM / r[1], order=0) @ surface
    return -np.gradient(surface, r[1])
