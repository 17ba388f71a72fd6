"""How the gel's surface bends around a contact: a pyramid of Gaussians."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import Window
from tacgen.optics.smooth import Gaussian, aligned, grown

PYRAMID_SIGMA_MM = (0.236, 0.1033, 0.059, 0.0325)
"""Widths of the Gaussians, coarse to fine.

Source: Taxim's kernels of 51, 21, 11 and 5 px at 0.0295 mm/px, which OpenCV turns into standard
deviations of 8.0, 3.5, 2.0 and 1.1 px by σ = 0.3 ((k − 1)/2 − 1) + 0.8.
"""
FINAL_SIGMA_MM = 0.0325
"""Width of the last Gaussian, over the contact too; Taxim's general kernel of 5 px."""

FIRM_CONTACT = (0.2, 0.6)
"""Shares of the deepest indentation between which the gel goes from bending freely to keeping the
object's shape. Taxim switches at 0.4 (its ``contact_scale``), which leaves a ring in the picture
where real presses have none; the same switch is drawn out here."""

NEGLIGIBLE_MM = 1e-5
"""Deformation below this is none: it changes no slope by more than 2e-4 at 0.03 mm/px."""

REACH_SIGMAS = 4.6
"""Reach of all Gaussians together: so far from a straight edge 4 mm deep, 4 mm × (1 − Φ(4.6)) = 8
nm are left, less than ``NEGLIGIBLE_MM``."""


@njit(cache=True, nogil=True)
def _keep_contact(
    depth_mm: NDArray[Any], loose_mm: float, firm_mm: float, patch: Window, surface: NDArray[Any]
) -> None:
    """Hold ``patch`` of the surface to the object: weight 0 up to ``loose_mm``, 1 from ``firm_mm``
    on.
    """
    top, _, left, right = patch
    loose, per_mm = np.float32(loose_mm), np.float32(1 / (firm_mm - loose_mm))
    for r in range(depth_mm.shape[0]):
        # Rows of whole arrays are known to be contiguous, and worked on as vectors.
        row, out = depth_mm[r], surface[top + r, left:right]
        for k in range(out.shape[0]):
            hold = min(max((row[k] - loose) * per_mm, np.float32(0)), np.float32(1))
            out[k] += hold * (row[k] - out[k])


@njit(cache=True, nogil=True)
def _clear_negligible(surface: NDArray[Any], least_mm: float) -> tuple[int, int, int, int]:
    """Set what is below ``least_mm`` to 0; returns the rectangle of the rest, empty if none."""
    height, width = surface.shape
    least = np.float32(least_mm)
    deepest = np.zeros(width, np.float32)
    for r in range(height):
        row = surface[r]
        for k in range(width):
            row[k] = row[k] if row[k] >= least else np.float32(0)
            deepest[k] = max(deepest[k], row[k])
    columns = np.nonzero(deepest)[0]
    if columns.size == 0:
        return 0, 0, 0, 0
    top, bottom = 0, height
    while not surface[top].any():
        top += 1
    while not surface[bottom - 1].any():
        bottom -= 1
    return top, bottom, columns[0], columns[-1] + 1


class Deformer:
    """Turns the indentation under an object into the deformation of the whole gel.

    The skirt around a contact is ``width`` times as wide as Taxim's.
    """

    reach_px: int
    """Pixels around a contact that it can deform by more than ``NEGLIGIBLE_MM``."""

    def __init__(self, mm_per_px: float, width: float = 1.0) -> None:
        pyramid_mm = [width * sigma for sigma in PYRAMID_SIGMA_MM]
        self._pyramid = [Gaussian(sigma / mm_per_px) for sigma in pyramid_mm]
        self._final = Gaussian(FINAL_SIGMA_MM / mm_per_px)
        self._coarsest = max(blur.factor for blur in self._pyramid)
        reaches_px = [blur.reach_px for blur in (*self._pyramid, self._final)]
        sigma_px = math.hypot(*pyramid_mm, FINAL_SIGMA_MM) / mm_per_px
        self.reach_px = min(sum(reaches_px), math.ceil(REACH_SIGMAS * sigma_px))
        # Kept: new pages would cost as much as a blur.
        self._memory = np.empty(0, dtype=np.float32)

    def _zeros(self, height: int, width: int) -> NDArray[np.float32]:
        """A map of zeros in the deformer's own memory."""
        if self._memory.size < height * width:
            self._memory = np.empty(height * width, dtype=np.float32)
        surface = self._memory[: height * width].reshape(height, width)
        surface.fill(0)
        return surface

    def deform(
        self, depth_mm: NDArray[np.float32], contact: Window, shape_px: tuple[int, int]
    ) -> tuple[NDArray[np.float32], Window]:
        """The deformation of the gel around one contact patch.

        The gel takes the object's shape where they are in firm contact and falls off smoothly
        around it. Only what the contact can reach is computed, to ``NEGLIGIBLE_MM``.

        ``depth_mm`` (h, w) float32 is the indentation over the window ``contact``; beyond the edges
        of an image of ``shape_px`` the deformation goes on as at the edge. Returns the deformation
        (h', w') float32, into the gel, mm (0 below 10 nm; in the deformer's own memory, valid until
        its next use), and its window; the gel is at rest outside it.

        Source: Si & Yuan 2022, Taxim, §III-C.
        """
        frame = aligned(grown(contact, self.reach_px + 1, shape_px), self._coarsest, shape_px)
        surface = self._zeros(frame[1] - frame[0], frame[3] - frame[2])
        top, left = frame[0], frame[2]
        patch = (contact[0] - top, contact[1] - top, contact[2] - left, contact[3] - left)
        surface[patch[0] : patch[1], patch[2] : patch[3]] = depth_mm
        deepest_mm = max(float(depth_mm.max(initial=0.0)), NEGLIGIBLE_MM)
        loose_mm, firm_mm = (share * deepest_mm for share in FIRM_CONTACT)
        reach = 1
        for blur in (*self._pyramid, self._final):
            # One pixel beyond what is deformed: the edge is at rest, to ``NEGLIGIBLE_MM``.
            reach += blur.reach_px
            around = grown(patch, min(reach, self.reach_px + 1), surface.shape)
            changed = aligned(around, blur.factor, surface.shape)
            blur.apply(surface, changed)
            if blur is not self._final:
                _keep_contact(depth_mm, loose_mm, firm_mm, patch, surface)
        top, bottom, left, right = _clear_negligible(surface, NEGLIGIBLE_MM)
        if top >= bottom:
            return np.zeros((0, 0), dtype=np.float32), (0, 0, 0, 0)
        window = (frame[0] + top, frame[0] + bottom, frame[2] + left, frame[2] + right)
        return surface[top:bottom, left:right], window


def deform(depth_map_mm: NDArray[np.floating], mm_per_px: float) -> NDArray[np.float32]:
    """Deformation of the gel (H, W), mm, into the gel, around an indentation (H, W)."""
    depth = np.ascontiguousarray(depth_map_mm, dtype=np.float32)
    whole = (0, depth.shape[0], 0, depth.shape[1])
    part, (top, bottom, left, right) = Deformer(mm_per_px).deform(depth, whole, depth.shape)
    deformation = np.zeros(depth.shape, dtype=np.float32)
    deformation[top:bottom, left:right] = part
    return deformation
