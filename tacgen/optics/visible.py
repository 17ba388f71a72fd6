"""What a person sees in a tactile picture: how much of it differs from the gel at rest."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit


@dataclass(frozen=True, slots=True)
class VisibleRules:
    """From when on a change is visible."""

    change_grey: float = 16.0
    """By which a channel of a pixel differs: a sixteenth of its range, far above the noise of the
    shipped sensors, which is 1 or less."""
    noise_sigmas: float = 4.0
    """Of the camera's noise, where that is more: noise alone reaches 3.7 (``optics/noise.py``)."""
    contact_share: float = 0.015
    """Of the picture's pixels, from which on it shows a contact: a round patch of a sixth of the
    picture's shorter side. Less is found by who looks for it; 0 is nothing to see."""


VISIBLE = VisibleRules()


@njit(cache=True, nogil=True)
def _count_changed(rgb: NDArray[np.uint8], at_rest: NDArray[np.uint8], limit: np.int32) -> int:
    count = 0
    for r in range(rgb.shape[0]):
        row, rest = rgb[r].reshape(-1), at_rest[r].reshape(-1)
        in_row = 0
        for c in range(rgb.shape[1]):
            red = abs(np.int32(row[3 * c]) - np.int32(rest[3 * c]))
            green = abs(np.int32(row[3 * c + 1]) - np.int32(rest[3 * c + 1]))
            blue = abs(np.int32(row[3 * c + 2]) - np.int32(rest[3 * c + 2]))
            in_row += 1 if max(red, green, blue) > limit else 0
        count += in_row
    return count


def visible_share(
    rgb: NDArray[np.uint8], at_rest: NDArray[np.uint8], noise_grey: float = 0.0
) -> float:
    """The share of a picture's pixels that differ visibly from the gel ``at_rest``, (H, W, 3) both.

    ``noise_grey`` is the standard deviation of the camera's noise. 0: there is nothing to see;
    ``VISIBLE.contact_share`` and more: it shows a contact.
    """
    limit = max(VISIBLE.change_grey, VISIBLE.noise_sigmas * noise_grey)
    return float(_count_changed(rgb, at_rest, np.int32(limit)) / rgb[..., 0].size)
