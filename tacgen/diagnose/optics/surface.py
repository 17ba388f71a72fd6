"""The slope of the gel around a ball, by three forms of skin, and smoothed by a membrane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from tacgen.core.arrays import FloatArray
from tacgen.optics.deform import FINAL_SIGMA_MM, FIRM_CONTACT, PYRAMID_SIGMA_MM
from tacgen.presses.geometry import MAX_RADIUS_SHARE

FORMS = ("skirt", "pyramid", "elastic")
"""How the gel goes on outside the contact: an exponential tail of fitted length, the simulation's
own pyramid of Gaussians, or an elastic half-space (Hertz)."""

_JOINT = 20.0
"""Power that joins cap and tail: a kink, rounded over a twentieth of a radius."""

_N_CONTACTS = 6
_STEP = 0.03
_REACH = 3.0
"""Profiles are kept at multiples of this share of the contact's radius, up to this many radii."""

_LEAST_SIGMA = 0.01
"""Below this share of the contact's radius a Gaussian does nothing that the grid can hold."""


@dataclass(frozen=True, slots=True)
class Skin:
    """The gel's surface around a ball.

    Attributes
    ----------
    form : str
        One of ``FORMS``.
    decay_mm : float
        Length of the skirt's tail.
    sharpness : float
        Of the joint of cap and tail; a table may have been calibrated with a rounder one.
    sigma_mm : float
        Width of the Gaussian that the membrane smooths the surface with.
    """

    form: str
    decay_mm: float
    sharpness: float = _JOINT
    sigma_mm: float = 0.0


class Profiles:
    """Radial slopes for a set of balls over a range of contact radii, ready to be read off.

    Parameters
    ----------
    contact_mm : (N,) float
        Contact radii around which profiles are needed.
    dome_radius_mm : float
        Radius of curvature of the gel at rest; 0 for a flat one.
    """

    def __init__(self, contact_mm: FloatArray, dome_radius_mm: float) -> None:
        self._contacts = np.geomspace(
            0.5 * float(contact_mm.min()), 1.6 * float(contact_mm.max()), _N_CONTACTS
        )
        self._bend_per_mm = 1 / dome_radius_mm if dome_radius_mm > 0 else 0.0

    def slopes(
        self,
        skin: Skin,
        r_mm: FloatArray,
        contact_mm: FloatArray,
        ball_mm: FloatArray,
    ) -> NDArray[np.float64]:
        """Slope along the radius (n,), positive outwards, at ``r_mm`` from each pixel's ball."""
        slope = np.zeros(len(r_mm))
        for ball in np.unique(ball_mm):
            here = ball_mm == ball
            table = _profiles(skin, float(ball), tuple(self._contacts.tolist()), self._bend_per_mm)
            slope[here] = self._read(table, r_mm[here], contact_mm[here])
        return slope

    def _read(self, table: FloatArray, r_mm: FloatArray, contact_mm: FloatArray) -> FloatArray:
        """Linear in the logarithm of the contact's radius and in r over it."""
        ratio = np.log(self._contacts[1] / self._contacts[0])
        at = np.clip(np.log(contact_mm / self._contacts[0]) / ratio, 0, _N_CONTACTS - 1.001)
        row = at.astype(int)
        up = at - row
        place = np.minimum(r_mm / contact_mm / _STEP, table.shape[1] - 1.001)
        column = place.astype(int)
        right = place - column
        below = (1 - right) * table[row, column] + right * table[row, column + 1]
        above = (1 - right) * table[row + 1, column] + right * table[row + 1, column + 1]
        return np.asarray((1 - up) * below + up * above)


@lru_cache(maxsize=256)
def _profiles(
    skin: Skin, ball_mm: float, contacts_mm: tuple[float, ...], bend_per_mm: float
) -> NDArray[np.float64]:
    """Slopes (n_contacts, n_radii) on the grid of shares of the contact's radius."""
    shares = np.arange(0.0, _REACH + _STEP / 2, _STEP)
    rows = []
    for contact_mm in contacts_mm:
        contact = min(contact_mm, MAX_RADIUS_SHARE * ball_mm)
        slope = _plain(skin, shares * contact_mm, contact, ball_mm, bend_per_mm)
        width = round(skin.sigma_mm / contact_mm, 6)
        rows.append(_kernel(width, 1) @ slope if width > _LEAST_SIGMA else slope)
    return np.array(rows)


def _plain(
    skin: Skin, r: FloatArray, contact: float, ball_mm: float, bend_per_mm: float
) -> NDArray[np.float64]:
    inside = np.minimum(r, MAX_RADIUS_SHARE * ball_mm)
    cap = inside / np.sqrt(ball_mm**2 - inside**2) + bend_per_mm * inside
    rim = contact / np.sqrt(ball_mm**2 - contact**2) + bend_per_mm * contact
    if skin.form == "pyramid":
        return _pyramid(r, contact, ball_mm, bend_per_mm)
    if skin.form == "elastic":
        a = np.minimum(contact / np.maximum(r, 1e-9), 1.0)
        outside = (2 / np.pi) * (np.arcsin(a) / a - np.sqrt(1 - a * a)) * rim
        return np.asarray(np.where(r < contact, cap, outside))
    outward = np.clip((r - contact) / skin.decay_mm, -30.0, 30.0)
    tail = rim * np.exp(-outward)
    return np.asarray(cap * (1 + (cap / tail) ** skin.sharpness) ** (-1 / skin.sharpness))


def _pyramid(
    r: FloatArray, contact: float, ball_mm: float, bend_per_mm: float
) -> NDArray[np.float64]:
    """What ``tacgen.optics.deform`` makes of the ball's cap, along a radius.

    Source
    ------
    Si & Yuan 2022, Taxim, §III-C.
    """

    def sunk(s: FloatArray) -> FloatArray:
        return np.asarray(ball_mm - np.sqrt(ball_mm**2 - s**2) + 0.5 * bend_per_mm * s**2)

    depth = np.maximum(sunk(np.asarray(contact)) - sunk(np.minimum(r, contact)), 0.0)
    loose, firm = (share * depth.max() for share in FIRM_CONTACT)
    hold = np.clip((depth - loose) / (firm - loose), 0.0, 1.0)
    surface, unit = depth, r[1] / _STEP
    for sigma_mm in PYRAMID_SIGMA_MM:
        surface = _kernel(round(sigma_mm / unit, 6), 0) @ surface
        surface = surface + hold * (depth - surface)
    surface = _kernel(round(FINAL_SIGMA_MM / unit, 6), 0) @ surface
    return -np.gradient(surface, r[1])


@lru_cache(maxsize=512)
def _kernel(width: float, order: int) -> NDArray[np.float64]:
    """A Gaussian in the plane, acting on a radial function (order 0) or on its slope (order 1).

    ``width`` is the standard deviation in units of the contact's radius; beyond the grid a
    function goes on as it ends.
    """
    wide = np.arange(0.0, _REACH + 5 * width + _STEP / 2, _STEP)
    n_kept = round(_REACH / _STEP) + 1
    out, source = wide[:n_kept, None], wide[None, :]
    weight = np.exp(-0.5 * ((out - source) / width) ** 2) * ive(order, out * source / width**2)
    kernel = weight * source * _STEP / width**2
    if order == 0:
        kernel /= np.maximum(kernel.sum(axis=1, keepdims=True), 1e-12)
    kernel[:, n_kept - 1] += kernel[:, n_kept:].sum(axis=1)
    return kernel[:, :n_kept]
