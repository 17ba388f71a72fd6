"""The camera's noise."""

from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.records import rng_of

_BITS = 12  # 4096 quantiles of the normal distribution: finer than a grey level's rounding
_LEVELS = 1 << _BITS
_CHUNK = 1024  # values looked up at a time: the sums after it then work on whole vectors


@njit(cache=True, nogil=True)
def _quantize(
    image: NDArray[Any],
    words: NDArray[Any],
    quantiles: NDArray[Any],
    sigma: np.float32,
    rgb: NDArray[Any],
) -> None:
    drawn = np.empty(_CHUNK, np.float32)
    for start in range(0, image.size, _CHUNK):
        chosen = words[start : min(start + _CHUNK, image.size)]
        source, target = image.reshape(-1)[start:], rgb.reshape(-1)[start:]
        for k in range(chosen.shape[0]):
            drawn[k] = quantiles[chosen[k] >> 4]
        for k in range(chosen.shape[0]):
            grey = source[k] + sigma * drawn[k] + np.float32(0.5)
            target[k] = np.uint8(min(max(grey, np.float32(0)), np.float32(255)))


class CameraNoise:
    """Independent normal noise of one standard deviation in every pixel and channel.

    A draw of 12 random bits picks one of 4096 equally likely values: eight times quicker than
    drawing normal numbers, and the same after rounding to grey levels.
    """

    def __init__(self, sigma_grey: float) -> None:
        self.sigma_grey = sigma_grey
        # Equally likely values of a standard normal, scaled to unit variance: ±3.7 at most.
        values = np.array([NormalDist().inv_cdf((k + 0.5) / _LEVELS) for k in range(_LEVELS)])
        self.quantiles = np.asarray((values / np.sqrt(np.mean(values**2))).astype(np.float32))

    def quantize(
        self, image: NDArray[np.float32], rng: np.random.Generator, rgb: NDArray[np.uint8]
    ) -> None:
        """Add noise to a C-contiguous ``image`` (H, W, 3) and round it to 8 bits, into ``rgb``."""
        words = rng.bit_generator.random_raw((image.size + 3) // 4).view(np.uint16)
        _quantize(image, words, self.quantiles, np.float32(self.sigma_grey), rgb)


def with_camera_noise(
    rgb: NDArray[np.uint8], sigma_grey: float, seed: int, *key: int
) -> NDArray[np.uint8]:
    """An image (H, W, 3) stored without noise, with that of a camera: always the same one for a
    ``seed`` and ``key``.

    The image was rounded before, so that its variance is a twelfth of a squared grey level more.
    """
    rng = rng_of(seed, *key)
    noisy = np.empty_like(rgb)
    _camera_noise(sigma_grey).quantize(rgb.astype(np.float32), rng, noisy)
    return noisy


_camera_noise = cache(CameraNoise)
