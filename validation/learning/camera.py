"""How pictures of one sensor differ where nothing touches it: gain by channel, noise, sharpness.

``python -m validation.learning.camera PRESSES…`` prints a row for each folder of ball presses. The
augmentation of the training recipes has the size of these figures
(``docs/explanation/networks.md``).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tacgen.core.types import FloatArray
from tacgen.presses.press_folder import read_presses

BORDER_FRACTION = 0.1
"""Share of the shorter side: the frame of pixels around each picture, which few contacts reach."""
SMOOTH_PX = 3.0
"""What is finer counts as noise, what is wider as gain."""
MAD_TO_STD = 1.4826
"""The standard deviation of a normal variable over its median absolute deviation."""


def gain_and_noise(
    images: NDArray[np.uint8], background: NDArray[np.uint8]
) -> tuple[FloatArray, FloatArray]:
    """Gain (N, 3) of each picture against the background, and its noise (N,) in grey levels.

    The noise is that of one picture: its difference to the background carries the noise of both
    where the background is a single exposure.
    """
    height, width = background.shape[:2]
    edge = max(1, round(BORDER_FRACTION * min(height, width)))
    border = np.ones((height, width), dtype=bool)
    border[edge:-edge, edge:-edge] = False
    rest = background.astype(np.float64)
    lit = border[..., None] & (rest > 20) & (rest < 235)
    gains, noises = [], []
    for image in images:
        picture = image.astype(np.float64)
        gains.append(
            [np.median(picture[..., c][lit[..., c]] / rest[..., c][lit[..., c]]) for c in range(3)]
        )
        fine = picture - rest
        fine -= gaussian_filter(fine, (SMOOTH_PX, SMOOTH_PX, 0))
        noises.append(MAD_TO_STD * np.median(np.abs(fine[border])))
    return np.array(gains), np.array(noises)


def main(folders: list[str]) -> None:
    """Print a Markdown row for each folder."""
    print("| presses | n | gain, std by channel | gain, mean by channel | noise, grey levels |")  # noqa: T201
    print("|---|---|---|---|---|")  # noqa: T201
    for folder in folders:
        presses = read_presses(Path(folder))
        gain, noise = gain_and_noise(presses.images, presses.background)
        spread = " / ".join(f"{value:.3f}" for value in gain.std(axis=0))
        mean = " / ".join(f"{value:.3f}" for value in gain.mean(axis=0))
        name = Path(folder).name
        print(f"| {name} | {len(gain)} | {spread} | {mean} | {np.median(noise):.2f} |")  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1:])
