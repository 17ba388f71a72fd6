"""Images of a tactile pad, many imprints at a time: of the mechanics as ever, drawn on a GPU."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from tacgen.batch.warp_worlds import WarpWorlds, find_device, undrawable
from tacgen.contact.indenter import Imprint
from tacgen.core.errors import SensorError
from tacgen.optics import shade
from tacgen.optics.noise import CameraNoise
from tacgen.sensor.tactile_pad import TactilePad


def name_of(device: str, pad: TactilePad) -> str:
    """A device as datasets name it: what the bytes of a pad's images depend on.

    Raises ``SensorError`` if it is not here, or cannot draw them.
    """
    wp.config.log_level = wp.LOG_ERROR  # standard output is for results
    try:
        found = find_device(device)
    except SensorError as error:
        msg = f"optics.{error}, or leave the key out of the recipe"
        raise SensorError(msg) from None
    if problem := undrawable(pad.table):
        msg = f"optics.device = {device!r}: {problem}; leave the key out of the recipe"
        raise SensorError(msg)
    return f"{device} ({found.name}, Warp {wp.__version__})"


class PadImages:
    """Draws up to ``n`` imprints of a pad at a time: ``TactilePad.image``, within a grey level.

    Raises ``SensorError`` if it cannot draw that pad, or not on that device.
    """

    def __init__(self, pad: TactilePad, n: int, device: str) -> None:
        wp.config.log_level = wp.LOG_ERROR
        self._pad, self._noise = pad, CameraNoise(pad.table.noise_grey)
        self._worlds = WarpWorlds(
            *(pad.sensor, pad.table, n, find_device(device)),
            shadows=pad.casts_shadows,
            markers=pad.draws_markers,
            keeps_grey=True,
        )
        self._depth_mm = np.zeros((n, *pad.sensor.shape_px), np.float32)

    def images(
        self, imprints: Sequence[Imprint], rng: np.random.Generator | None = None
    ) -> NDArray[np.uint8]:
        """Images (T, H, W, 3); ``rng`` draws the camera's noise, as for one image after another."""
        images = np.empty((len(imprints), *self._pad.sensor.shape_px, 3), np.uint8)
        for first in range(0, len(imprints), self._worlds.n):
            some = imprints[first : first + self._worlds.n]
            unique = {id(one): one for one in some}
            places = {key: k for k, key in enumerate(unique)}
            grey = self._grey(list(unique.values()))
            for imprint, rgb in zip(some, images[first:], strict=False):
                image = grey[places[id(imprint)]]
                if rng is not None and self._noise.sigma_grey > 0:
                    self._noise.quantize(image, rng, rgb)
                else:
                    whole = 0, image.shape[0], 0, image.shape[1]
                    shade.quantize(image, whole, shade.whole_spans(whole), rgb)
        return images

    def _grey(self, imprints: Sequence[Imprint]) -> NDArray[np.float32]:
        """Grey levels (n, H, W, 3) before they are rounded."""
        drawn = self._worlds
        for whole, imprint in zip(self._depth_mm, imprints, strict=False):
            whole[...] = imprint.depth_map_mm(self._pad.sensor)
        depth_mm: Any = wp.array(self._depth_mm, device=drawn.device, copy=drawn.device.is_cuda)
        markers_mm = [self._pad.markers_mm(one) for one in imprints]
        return drawn.draw_imprints(depth_mm, len(imprints), markers_mm)
