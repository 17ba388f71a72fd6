"""A lens that darkens towards the corners."""

from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.compiled import njit
from tacgen.core.types import FloatArray
from tacgen.optics.effects import effect as base


@njit(cache=True, nogil=True)
def _dimmed(
    image: NDArray[Any],
    background: NDArray[Any],
    square: NDArray[Any],
    twice_change: Any,
    twice: Any,
) -> NDArray[Any]:
    """Pixels (n, 3) whose change, and which themselves, are dimmed by ``square`` (n,)."""
    dimmed = np.empty_like(image)
    for k in range(image.shape[0]):
        of_change, of_all = twice_change * square[k], twice * square[k]
        for c in range(3):
            change = (image[k, c] - background[k, c]) * of_change
            dimmed[k, c] = (image[k, c] - change) * (1 - of_all)
    return dimmed


class Vignetting(base.OpticalEffect):
    """1 − strength · r² of the light arrives, r = 1 at the corners.

    ``change_strength`` is for a background that was taken through the same lens: only what
    a contact changes is dimmed.
    """

    name = "vignetting"
    stage = base.Stage.LENS
    parameters = MappingProxyType(
        dict.fromkeys(
            ("strength", "change_strength"), base.OpticalParameter(0.0, -0.6, 0.95, step=0.02)
        )
    )

    def apply(
        self,
        array: FloatArray,
        patch: base.Patch,
        *,
        strength: float = 0.0,
        change_strength: float = 0.0,
        **_: Any,
    ) -> FloatArray:
        """Dim the change, then the whole."""
        square = np.asarray(patch.u**2 + patch.v**2, array.dtype)
        square, image = np.broadcast_to(square, array.shape[:-1]).ravel(), array.reshape(-1, 3)
        background = np.broadcast_to(patch.background, array.shape).reshape(-1, 3)
        twice_change, twice = array.dtype.type(2 * change_strength), array.dtype.type(2 * strength)
        dimmed = _dimmed(image, background, square, twice_change, twice)
        return np.asarray(dimmed).reshape(array.shape)

    def candidates(self, scene: base.PressScene) -> list[base.OpticalCandidate]:
        """A background through the same lens, or not."""
        change, whole = ({name: self.parameters[name]} for name in ("change_strength", "strength"))
        return [
            base.OpticalCandidate(self.name, "of what presses change", change),
            base.OpticalCandidate(self.name, "of the background too", whole),
        ]


base.register(Vignetting())
